//! Access control: every method, role and two tenants; sessions on several services; restarts.
#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::collections::BTreeSet;

use moldline_host::{Code, PoolLimits, Principal, Role, ServiceError, Tenant};
use moldline_mesh_service::{
    Access, At, Design, Directions, FileEntry, Limits, Page, Seeds, Service, SessionUpdate, Store, Upload,
    UploadHeader, UploadSource, Uploaded, Values, Visibility, Wanted,
};
use moldline_testing::ball;

fn tenant(name: &str) -> Tenant {
    Tenant::new(name).unwrap()
}

fn principal(name: &str, role: Role) -> Principal {
    Principal { tenant: tenant(name), role }
}

fn user(name: &str) -> Principal {
    principal(name, Role::User)
}

fn on(store: &Store, limits: Limits) -> Service {
    let pool = PoolLimits { threads: 2, running: 2, queued: 16, work: PoolLimits::WORK };
    Service::with_store(store.clone(), pool, limits).unwrap()
}

fn service() -> Service {
    on(&Store::in_memory(), Limits::default())
}

fn header(visibility: Option<Visibility>, size: usize) -> UploadHeader {
    let entry = FileEntry { path: "setup.json".to_owned(), size: size as u64 };
    let source = UploadSource::Files(vec![entry]);
    UploadHeader { request_id: String::new(), setup_file: None, visibility, source }
}

fn uploaded(title: &str, visibility: Option<Visibility>) -> Uploaded {
    let (file, limits) = (ball::setup_file(title), Limits::default());
    let mut upload = Upload::begin(header(visibility, file.len()), &limits).unwrap();
    upload.append(0, file.as_bytes(), &limits).unwrap();
    upload.finish().unwrap()
}

async fn create(
    service: &Service,
    caller: &Principal,
    visibility: Option<Visibility>,
) -> Result<(String, bool, Access), ServiceError> {
    let created = service.create_setup(caller, uploaded("ball", visibility), |_| {}).await?;
    Ok((created.setup.id.to_string(), created.built, created.access))
}

fn moved(x: f64) -> Design {
    Design { values: Values::Vector(vec![x]), control_points: Vec::new() }
}

fn along() -> Directions {
    Directions { design: Some(vec![vec![1.0]]), control_points: Vec::new() }
}

fn seeds() -> Seeds {
    Seeds { vertices: Some(vec![vec![[1.0; 3]; ball::VERTICES]]), functions: None }
}

fn update(expected_generation: u64, x: f64, request_id: &str) -> SessionUpdate {
    SessionUpdate {
        expected_generation,
        design: Some(moved(x)),
        label: None,
        request_id: request_id.to_owned(),
    }
}

const METHODS: [&str; 14] = [
    "receive",
    "create_setup",
    "get_setup",
    "list_setups",
    "share_setup",
    "open_session",
    "get_session",
    "list_sessions",
    "update_session",
    "deform",
    "linearised",
    "jvp",
    "vjp",
    "status",
];

/// Calls a method on a set-up and a session; the outcome is `ok`, `empty` for lists without entries, or the code.
async fn call(service: &Service, caller: &Principal, method: &str, setup: &str, session: &str) -> String {
    let at = || At::design(moved(0.0));
    let wanted = Wanted { design: true, control_points: Vec::new() };
    let listed = |count: usize| if count == 0 { "empty".to_owned() } else { "ok".to_owned() };
    let done = match method {
        "receive" => service.receive(caller, header(None, 10)).map(drop),
        "create_setup" => create(service, caller, None).await.map(drop),
        "get_setup" => service.get_setup(caller, setup).await.map(drop),
        "share_setup" => service.share_setup(caller, setup, Visibility::Private).await.map(drop),
        "delete_setup" => service.delete_setup(caller, setup).await,
        "open_session" => service.open_session(caller, setup, "", "").await.map(drop),
        "get_session" => service.get_session(caller, session).await.map(drop),
        "update_session" => {
            let update = SessionUpdate { expected_generation: 1, ..SessionUpdate::default() };
            service.update_session(caller, session, update).await.map(drop)
        }
        "close_session" => service.close_session(caller, session).await,
        "deform" => service.deform(caller, session, moved(0.0)).await.map(drop),
        "linearised" => service.linearised(caller, session, at()).await.map(drop),
        "jvp" => service.jvp(caller, session, at(), along()).await.map(drop),
        "vjp" => service.vjp(caller, session, at(), seeds(), wanted).await.map(drop),
        "status" => service.status(caller).await.map(drop),
        "list_setups" => match service.list_setups(caller, &Page::default()).await {
            Ok(found) => return listed(found.entries.len()),
            Err(error) => Err(error),
        },
        "list_sessions" => match service.list_sessions(caller, &Page::default()).await {
            Ok(found) => return listed(found.entries.len()),
            Err(error) => Err(error),
        },
        other => panic!("{other}"),
    };
    match done {
        Ok(()) => "ok".to_owned(),
        Err(error) => error.code.name().to_owned(),
    }
}

#[tokio::test]
async fn every_method_for_every_role_and_two_tenants() {
    for (visibility, seen) in [
        (Visibility::Private, "NOT_FOUND"),
        (Visibility::Tenants(BTreeSet::from([tenant("third")])), "NOT_FOUND"),
        (Visibility::Tenants(BTreeSet::from([tenant("other")])), "ok"),
        (Visibility::Public, "ok"),
    ] {
        for (name, role) in [("owner", 0), ("other", 1)]
            .into_iter()
            .flat_map(|(name, _)| [Role::Reader, Role::User, Role::Admin].map(|role| (name, role)))
        {
            let service = service();
            let owner = user("owner");
            let (setup, ..) = create(&service, &owner, Some(visibility.clone())).await.unwrap();
            let session = service.open_session(&owner, &setup, "", "").await.unwrap().id;
            let caller = principal(name, role);
            let (own, reader) = (name == "owner", role == Role::Reader);
            let not_for_readers = |outcome: &'static str| if reader { "PERMISSION_DENIED" } else { outcome };
            let of_owner = if own { "ok" } else { "NOT_FOUND" };
            let visible = if own { "ok" } else { seen };
            for method in METHODS.into_iter().chain(["close_session", "delete_setup"]) {
                let expected = match method {
                    "status" => "ok",
                    "get_setup" => visible,
                    "list_setups" => {
                        if visible == "ok" {
                            "ok"
                        } else {
                            "empty"
                        }
                    }
                    "get_session" => of_owner,
                    "list_sessions" => {
                        if own {
                            "ok"
                        } else {
                            "empty"
                        }
                    }
                    "receive" => not_for_readers("ok"),
                    // Last, since it makes the caller an owner.
                    "create_setup" => continue,
                    "open_session" => not_for_readers(visible),
                    _ => not_for_readers(of_owner),
                };
                // Sessions that others open belong to them, as checked before.
                if method == "open_session" && !own && expected == "ok" {
                    continue;
                }
                let outcome = call(&service, &caller, method, &setup, &session).await;
                assert_eq!(outcome, expected, "{method} by {name} as {role:?} of what is {visibility:?}");
                // The owner's changes are undone for the next method.
                if method == "share_setup" && own {
                    let _ = service.share_setup(&owner, &setup, visibility.clone()).await;
                }
            }
            let outcome = call(&service, &caller, "create_setup", &setup, &session).await;
            assert_eq!(outcome, not_for_readers("ok"), "create_setup by {name} as {role:?}");
        }
    }
}

/// The answers about another tenant's object and about one that does not exist are the same.
#[tokio::test]
async fn others_cannot_tell_whether_an_object_exists() {
    let service = service();
    let (owner, other) = (user("owner"), user("other"));
    let (setup, ..) = create(&service, &owner, None).await.unwrap();
    let session = service.open_session(&owner, &setup, "", "").await.unwrap().id;
    let (no_setup, no_session) = ("0".repeat(64), "0".repeat(32));
    let text = |error: ServiceError| {
        let text = format!("{error} {:?} {:?}", error.violations, error.retry_after);
        text.replace(&setup, "ID").replace(&no_setup, "ID").replace(&session, "ID").replace(&no_session, "ID")
    };
    let update = SessionUpdate::default;
    assert_eq!(
        text(service.get_setup(&other, &setup).await.unwrap_err()),
        text(service.get_setup(&other, &no_setup).await.unwrap_err())
    );
    assert_eq!(
        text(service.delete_setup(&other, &setup).await.unwrap_err()),
        text(service.delete_setup(&other, &no_setup).await.unwrap_err())
    );
    assert_eq!(
        text(service.share_setup(&other, &setup, Visibility::Public).await.unwrap_err()),
        text(service.share_setup(&other, &no_setup, Visibility::Public).await.unwrap_err())
    );
    assert_eq!(
        text(service.update_session(&other, &session, update()).await.unwrap_err()),
        text(service.update_session(&other, &no_session, update()).await.unwrap_err())
    );
    assert_eq!(
        text(service.deform(&other, &session, moved(0.0)).await.unwrap_err()),
        text(service.deform(&other, &no_session, moved(0.0)).await.unwrap_err())
    );
    for id in ["", "..", "../owner", &format!("../owner/{session}"), "@public"] {
        assert_eq!(service.get_session(&other, id).await.unwrap_err().code, Code::NotFound, "{id}");
        assert_eq!(service.get_setup(&other, id).await.unwrap_err().code, Code::NotFound, "{id}");
    }
    let status = service.status(&other).await.unwrap();
    assert_eq!((status.sessions, status.setups_stored, status.stored_bytes), (0, 0, 0));
    assert_eq!((status.setups_resident, status.setup_cache.bytes, status.work.len()), (0, 0, 0));
}

#[tokio::test]
async fn content_uploaded_by_another_tenant_is_new_to_the_caller() {
    let service = service();
    let (first, second) = (user("first"), user("second"));
    let stages = |caller: Principal| {
        let service = &service;
        async move {
            let mut stages = Vec::new();
            let created =
                service.create_setup(&caller, uploaded("ball", None), |step| stages.push(step.stage)).await;
            stages.dedup();
            (created.unwrap(), stages)
        }
    };
    let (created, steps) = stages(first.clone()).await;
    let setup = created.setup.id.to_string();
    assert!(created.built);
    let (again, seen) = stages(second.clone()).await;
    assert!(again.built, "as if nobody had uploaded it before");
    assert_eq!(seen, steps, "nor do the steps tell");
    assert_eq!(again.access, Access { owned: true, visibility: Visibility::Private });
    assert!(!create(&service, &first, None).await.unwrap().1);
    // Each deletes its own.
    service.delete_setup(&first, &setup).await.unwrap();
    assert_eq!(service.get_setup(&first, &setup).await.unwrap_err().code, Code::NotFound);
    assert!(service.get_setup(&second, &setup).await.is_ok());
    assert!(create(&service, &first, None).await.unwrap().1, "new again");
}

#[tokio::test]
async fn sharing_is_visible_and_can_be_revoked() {
    let service = service();
    let (owner, friend, other) = (user("owner"), user("friend"), user("other"));
    let shared = Visibility::Tenants(BTreeSet::from([tenant("friend"), tenant("third")]));
    let (setup, _, access) = create(&service, &owner, Some(shared.clone())).await.unwrap();
    assert_eq!(access, Access { owned: true, visibility: shared });
    let seen = service.get_setup(&friend, &setup).await.unwrap().access;
    let only_me = Visibility::Tenants(BTreeSet::from([tenant("friend")]));
    assert_eq!(seen, Access { owned: false, visibility: only_me }, "without the names of others");
    assert_eq!(service.get_setup(&other, &setup).await.unwrap_err().code, Code::NotFound);
    let session = service.open_session(&friend, &setup, "", "").await.unwrap().id;
    service.share_setup(&owner, &setup, Visibility::Private).await.unwrap();
    assert_eq!(service.get_setup(&friend, &setup).await.unwrap_err().code, Code::NotFound);
    assert!(service.list_setups(&friend, &Page::default()).await.unwrap().entries.is_empty());
    assert_eq!(service.get_session(&friend, &session).await.unwrap().id, session, "its own design");
    service.share_setup(&owner, &setup, Visibility::Public).await.unwrap();
    assert_eq!(service.list_setups(&other, &Page::default()).await.unwrap().entries.len(), 1);
}

#[tokio::test]
async fn a_session_moves_between_services_with_the_same_bits() {
    let store = Store::in_memory();
    let (one, two) = (on(&store, Limits::default()), on(&store, Limits::default()));
    let caller = user("a");
    let (setup, ..) = create(&one, &caller, None).await.unwrap();
    let session = one.open_session(&caller, &setup, "run 7", "").await.unwrap();
    let mut generation = session.generation;
    let mut designs = Vec::new();
    for (step, service) in [&one, &two, &one, &two].into_iter().enumerate() {
        let held = service.get_session(&caller, &session.id).await.unwrap();
        assert_eq!(held.generation, generation);
        let x = 0.1 + 0.2 * step as f64;
        let deformed = service.deform(&caller, &session.id, moved(x)).await.unwrap();
        let elsewhere = if step % 2 == 0 { &two } else { &one };
        let there = elsewhere.deform(&caller, &session.id, moved(x)).await.unwrap();
        assert_eq!(
            (there.id(), &there.deformation().vertices),
            (deformed.id(), &deformed.deformation().vertices)
        );
        let updated = service.update_session(&caller, &session.id, update(generation, x, "")).await.unwrap();
        generation = updated.generation;
        designs.push(updated.design.unwrap());
        let lost = elsewhere.update_session(&caller, &session.id, update(generation - 1, 9e9, "")).await;
        assert_eq!(lost.unwrap_err().code, Code::InvalidArgument, "the design is checked first");
        let lost = elsewhere.update_session(&caller, &session.id, update(generation - 1, 0.9, "")).await;
        assert_eq!(lost.unwrap_err().code, Code::Aborted);
    }
    let held = two.get_session(&caller, &session.id).await.unwrap();
    assert_eq!((held.design.as_ref(), held.label.as_str()), (designs.last(), "run 7"));
    two.close_session(&caller, &session.id).await.unwrap();
    assert_eq!(one.get_session(&caller, &session.id).await.unwrap_err().code, Code::NotFound);
}

#[tokio::test]
async fn one_of_many_updates_of_a_generation_wins() {
    let store = Store::in_memory();
    let services = std::sync::Arc::new([on(&store, Limits::default()), on(&store, Limits::default())]);
    let caller = user("a");
    let (setup, ..) = create(&services[0], &caller, None).await.unwrap();
    let id = services[0].open_session(&caller, &setup, "", "").await.unwrap().id;
    let tries = (0..16).map(|k| {
        let (services, caller, id) = (services.clone(), caller.clone(), id.clone());
        tokio::spawn(async move {
            services[k % 2].update_session(&caller, &id, update(1, 0.01 * k as f64, "")).await
        })
    });
    let (mut won, mut aborted) = (Vec::new(), 0);
    for one in tries.collect::<Vec<_>>() {
        match one.await.unwrap() {
            Ok(session) => won.push(session),
            Err(error) => {
                assert_eq!(error.code, Code::Aborted);
                aborted += 1;
            }
        }
    }
    assert_eq!((won.len(), aborted), (1, 15));
    assert_eq!(services[1].get_session(&caller, &id).await.unwrap(), won[0]);
}

#[tokio::test]
async fn retries_are_recognised_after_a_restart_and_by_another_server() {
    let store = Store::in_memory();
    let caller = user("a");
    let first = on(&store, Limits::default());
    let (setup, ..) = create(&first, &caller, None).await.unwrap();
    let opened = first.open_session(&caller, &setup, "", "open").await.unwrap();
    let updated = first.update_session(&caller, &opened.id, update(1, 0.5, "step 1")).await.unwrap();
    drop(first);
    let second = on(&store, Limits::default());
    let again = second.open_session(&caller, &setup, "", "open").await.unwrap();
    assert_eq!(again.id, opened.id);
    let again = second.update_session(&caller, &opened.id, update(1, 0.5, "step 1")).await.unwrap();
    assert_eq!(again, updated);
    for changed in [update(1, 0.6, "step 1"), update(2, 0.5, "step 1")] {
        let error = second.update_session(&caller, &opened.id, changed).await.unwrap_err();
        assert_eq!(error.code, Code::AlreadyExists);
    }
    let error = second.open_session(&caller, &setup, "label", "open").await.unwrap_err();
    assert_eq!(error.code, Code::AlreadyExists);
    // Request ids belong to their tenant.
    let other = user("b");
    let (theirs, ..) = create(&second, &other, None).await.unwrap();
    assert_ne!(second.open_session(&other, &theirs, "", "open").await.unwrap().id, opened.id);
    second.close_session(&caller, &opened.id).await.unwrap();
    assert_eq!(second.open_session(&caller, &setup, "", "open").await.unwrap_err().code, Code::NotFound);
}

#[tokio::test]
async fn tenants_have_quotas_of_their_own() {
    let size = ball::setup_file("ball").len() as u64;
    let limits = Limits { setups: 2, sessions: 2, stored_bytes: 2 * size + 10, ..Limits::default() };
    let service = on(&Store::in_memory(), limits);
    let (a, b) = (user("a"), user("b"));
    let create = async |caller: &Principal, title: &str| {
        service
            .create_setup(caller, uploaded(title, None), |_| {})
            .await
            .map(|made| made.setup.id.to_string())
    };
    let first = create(&a, "one").await.unwrap();
    assert_eq!(create(&a, &"x".repeat(100)).await.unwrap_err().code, Code::ResourceExhausted, "bytes");
    create(&a, "two").await.unwrap();
    assert_eq!(create(&a, "six").await.unwrap_err().code, Code::ResourceExhausted, "set-ups");
    assert!(create(&a, "one").await.is_ok(), "it is there already");
    assert!(create(&b, "six").await.is_ok(), "another's quota");
    service.delete_setup(&a, &first).await.unwrap();
    let second = create(&a, "six").await.unwrap();
    for _ in 0..2 {
        service.open_session(&a, &second, "", "").await.unwrap();
    }
    assert_eq!(service.open_session(&a, &second, "", "").await.unwrap_err().code, Code::ResourceExhausted);
    assert!(service.open_session(&b, &create(&b, "six").await.unwrap(), "", "").await.is_ok());
}

#[tokio::test]
async fn lists_come_in_pages() {
    let service = on(&Store::in_memory(), Limits { page: 2, ..Limits::default() });
    let caller = user("a");
    let (setup, ..) = create(&service, &caller, None).await.unwrap();
    let mut ids = BTreeSet::new();
    for _ in 0..5 {
        ids.insert(service.open_session(&caller, &setup, "", "").await.unwrap().id);
    }
    let (mut page, mut seen, mut sizes) = (Page::default(), Vec::new(), Vec::new());
    loop {
        let listed = service.list_sessions(&caller, &page).await.unwrap();
        sizes.push(listed.entries.len());
        seen.extend(listed.entries.into_iter().map(|session| session.id));
        match listed.next {
            Some(token) => page.token = token,
            None => break,
        }
    }
    assert_eq!(sizes, [2, 2, 1]);
    assert_eq!(seen, Vec::from_iter(ids));
}

#[tokio::test]
async fn only_unreachable_content_is_collected() {
    let store = Store::in_memory();
    let service = on(&store, Limits::default());
    let (a, b) = (user("a"), user("b"));
    let (setup, ..) = create(&service, &a, None).await.unwrap();
    create(&service, &b, None).await.unwrap();
    let session = service.open_session(&a, &setup, "", "").await.unwrap().id;
    let collect = async || store.collect(std::time::Duration::ZERO, false).await.unwrap().objects;
    assert!(collect().await.is_empty());
    service.delete_setup(&a, &setup).await.unwrap();
    service.delete_setup(&b, &setup).await.unwrap();
    assert!(collect().await.iter().all(|name| name.starts_with("access/")), "a session needs the rest");
    assert!(service.deform(&a, &session, moved(0.1)).await.is_ok());
    service.close_session(&a, &session).await.unwrap();
    let planned = store.collect(std::time::Duration::ZERO, true).await.unwrap().objects;
    assert_eq!(collect().await, planned);
    assert!(planned.iter().any(|name| name.starts_with("blob/")));
    assert_eq!(store.survey().await.unwrap().setups, 0);
}

#[tokio::test]
async fn another_tenants_session_ends_with_its_access_and_goes_on_with_it() {
    let (owner, friend) = (user("owner"), user("friend"));
    let later = async || tokio::time::sleep(std::time::Duration::from_millis(1100)).await;
    for deletes in [false, true] {
        let store = Store::in_memory();
        let (one, two) = (on(&store, Limits::default()), on(&store, Limits::default()));
        let shared = Visibility::Tenants(BTreeSet::from([tenant("friend")]));
        let (setup, ..) = create(&one, &owner, Some(shared.clone())).await.unwrap();
        let own = one.open_session(&owner, &setup, "", "").await.unwrap().id;
        let theirs = two.open_session(&friend, &setup, "", "").await.unwrap().id;
        let held = two.linearised(&friend, &theirs, At::design(moved(0.5))).await.unwrap().value;
        match deletes {
            true => one.delete_setup(&owner, &setup).await.unwrap(),
            false => drop(one.share_setup(&owner, &setup, Visibility::Private).await.unwrap()),
        }
        later().await;
        for service in [&one, &two] {
            for method in ["deform", "linearised", "jvp", "vjp", "update_session"] {
                let outcome = call(service, &friend, method, &setup, &theirs).await;
                assert_eq!(outcome, "PERMISSION_DENIED", "{method}");
                let outcome = call(service, &owner, method, &setup, &own).await;
                assert!(matches!(outcome.as_str(), "ok" | "ABORTED"), "{method} of the owner: {outcome}");
            }
            let at = At::id(held.id());
            let error = service.jvp(&friend, &theirs, at, along()).await.unwrap_err();
            assert_eq!(error.code, Code::PermissionDenied);
            assert!(error.message.contains("upload it yourself"), "{error}");
            assert_eq!(call(service, &friend, "get_session", &setup, &theirs).await, "ok");
        }
        // What runs is finished: later columns of a Jacobian come from the linearisation in hand.
        assert!(two.jacobian(&friend, &held, 0).await.is_ok());
        // Shared again, it goes on where it was.
        create(&one, &owner, Some(shared)).await.unwrap();
        assert_eq!(call(&two, &friend, "deform", &setup, &theirs).await, "ok");
        two.close_session(&friend, &theirs).await.unwrap();
        // So it does for who has the content itself.
        let theirs = two.open_session(&friend, &setup, "", "").await.unwrap().id;
        create(&two, &friend, None).await.unwrap();
        one.delete_setup(&owner, &setup).await.unwrap();
        two.delete_setup(&friend, &setup).await.unwrap();
        later().await;
        assert_eq!(call(&two, &friend, "deform", &setup, &theirs).await, "ok");
    }
}

#[tokio::test]
async fn a_first_upload_takes_the_time_of_its_build_whoever_has_the_content() {
    let store = Store::in_memory();
    let file = ball::setup_file("timed");
    let upload = async |service: &Service, name: &str| {
        let (mut upload, limits) =
            (Upload::begin(header(None, file.len()), &Limits::default()).unwrap(), Limits::default());
        upload.append(0, file.as_bytes(), &limits).unwrap();
        let (began, mut steps) = (std::time::Instant::now(), Vec::new());
        let tell = |_| steps.push(began.elapsed());
        let created = service.create_setup(&user(name), upload.finish().unwrap(), tell).await.unwrap();
        (created.setup.build_time, began.elapsed(), steps)
    };
    let service = on(&store, Limits::default());
    let (build, first, _) = upload(&service, "first").await;
    assert!(first >= build);
    // Another tenant, with the set-up in memory, restored from the store, and two at once.
    let fresh = on(&store, Limits::default());
    for (service, name) in [(&service, "second"), (&fresh, "third")] {
        let (recorded, took, steps) = upload(service, name).await;
        assert_eq!(recorded, build, "the fields are those of the first");
        assert!(took >= build, "{took:?} of {build:?}");
        // The steps do not come at once.
        assert!(*steps.last().unwrap() >= build / 2, "{steps:?} of {build:?}");
    }
    let together = futures::future::join_all(["fourth", "fifth"].map(|name| upload(&fresh, name))).await;
    assert!(together.iter().all(|(_, took, _)| *took >= build));
    // One's own content again tells nothing, and takes no time; nor does it where nothing is to be hidden.
    let (_, again, _) = upload(&service, "second").await;
    let open = on(&store, Limits { hide_known: false, ..Limits::default() });
    open.get_setup(&user("second"), &{
        store.setups_of("second").await.unwrap().into_iter().next().unwrap()
    })
    .await
    .unwrap();
    let (_, known, _) = upload(&open, "sixth").await;
    assert!(again < build && known < build, "{again:?}, {known:?} of {build:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn quotas_hold_for_many_calls_at_once_on_two_servers() {
    let folder = tempfile::tempdir().unwrap();
    let limits = Limits { setups: 5, sessions: 20, ..Limits::default() };
    let mut services = Vec::new();
    for _ in 0..2 {
        let store = Store::open(folder.path().to_str().unwrap()).await.unwrap();
        let pool = PoolLimits { threads: 2, running: 2, queued: 64, work: PoolLimits::WORK };
        services.push(std::sync::Arc::new(Service::with_store(store, pool, limits.clone()).unwrap()));
    }
    let caller = user("a");
    let tries = (0..12).map(|k| {
        let (service, caller) = (services[k % 2].clone(), caller.clone());
        tokio::spawn(async move {
            let made = service.create_setup(&caller, uploaded(&format!("set-up {k}"), None), |_| {}).await;
            made.map(|made| made.setup.id.to_string())
        })
    });
    let mut setups = Vec::new();
    for one in tries.collect::<Vec<_>>() {
        match one.await.unwrap() {
            Ok(id) => setups.push(id),
            Err(error) => assert_eq!(error.code, Code::ResourceExhausted, "{error}"),
        }
    }
    assert!((1..=5).contains(&setups.len()), "{}", setups.len());
    assert_eq!(services[0].list_setups(&caller, &Page::default()).await.unwrap().entries.len(), setups.len());
    for _ in 0..2 {
        let tries = (0..50).map(|k| {
            let (service, caller, setup) = (services[k % 2].clone(), caller.clone(), setups[0].clone());
            tokio::spawn(async move { service.open_session(&caller, &setup, "", &format!("open {k}")).await })
        });
        let mut open = BTreeSet::new();
        for one in tries.collect::<Vec<_>>() {
            match one.await.unwrap() {
                Ok(session) => drop(open.insert(session.id)),
                Err(error) => {
                    assert!(matches!(error.code, Code::ResourceExhausted | Code::NotFound), "{error}")
                }
            }
        }
        assert!(open.len() <= 20, "{}", open.len());
        let listed = services[1].list_sessions(&caller, &Page::default()).await.unwrap().entries;
        assert_eq!(listed.into_iter().map(|session| session.id).collect::<BTreeSet<_>>(), open);
        assert_eq!(services[0].status(&caller).await.unwrap().sessions, open.len());
    }
}

#[tokio::test]
async fn long_lists_of_tenants_are_refused() {
    let service = on(&Store::in_memory(), Limits { shared_with: 3, ..Limits::default() });
    let many = |count: usize| Visibility::Tenants((0..count).map(|k| tenant(&format!("t{k}"))).collect());
    let owner = user("owner");
    let (setup, ..) = create(&service, &owner, Some(many(3))).await.unwrap();
    service.share_setup(&owner, &setup, many(3)).await.unwrap();
    let error = service.share_setup(&owner, &setup, many(4)).await.unwrap_err();
    assert_eq!((error.code, error.violations[0].field.as_str()), (Code::InvalidArgument, "shared_with"));
    let error = service.receive(&owner, header(Some(many(4)), 10)).unwrap_err();
    assert_eq!(
        (error.code, error.violations[0].field.as_str()),
        (Code::InvalidArgument, "header.shared_with")
    );
}

#[tokio::test]
async fn the_last_updates_are_recognised_and_no_more_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path().to_str().unwrap()).await.unwrap();
    let service = on(&store, Limits::default());
    let caller = user("a");
    let (setup, ..) = create(&service, &caller, None).await.unwrap();
    let id = service.open_session(&caller, &setup, "", "open").await.unwrap().id;
    let step = |k: u64| update(k, 0.001 * k as f64, &format!("step {k}"));
    for k in 1..=40 {
        service.update_session(&caller, &id, step(k)).await.unwrap();
    }
    for k in 33..=40 {
        let again = service.update_session(&caller, &id, step(k)).await;
        assert_eq!(again.unwrap().generation, k + 1);
        let other = SessionUpdate { label: Some("other".to_owned()), ..step(k) };
        assert_eq!(service.update_session(&caller, &id, other).await.unwrap_err().code, Code::AlreadyExists);
    }
    assert_eq!(service.update_session(&caller, &id, step(20)).await.unwrap_err().code, Code::Aborted);
    let files = std::fs::read_dir(folder.path().join("session/a").join(&id)).unwrap().count();
    assert_eq!(files, 8, "old generations are gone");
    assert!(!folder.path().join("request").exists(), "request ids of sessions need no objects");
    service.close_session(&caller, &id).await.unwrap();
    assert_eq!(std::fs::read_dir(folder.path().join("session/a")).unwrap().count(), 0);
    assert_eq!(service.open_session(&caller, &setup, "", "open").await.unwrap_err().code, Code::NotFound);
    assert_eq!(
        service.open_session(&caller, &setup, "x", "open").await.unwrap_err().code,
        Code::AlreadyExists
    );
}
