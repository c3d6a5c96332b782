//! The mesh service on the real engine, without a transport.
#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::{
    fs,
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
};

use moldline_deform::Setup;
use moldline_host::{Code, PoolLimits, Principal, ServiceError};
use moldline_mesh_service::{
    At, ControlPointVectors, Design, Directions, FileEntry, Limits, Page, Seeds, Service, Store, Upload,
    UploadHeader, UploadSource, Uploaded, Values, Wanted,
};
use moldline_testing::{ball, eventually};

fn service(threads: usize, limits: Limits) -> Service {
    Service::new(PoolLimits { threads, running: threads, queued: 16, work: PoolLimits::WORK }, limits)
        .unwrap()
}

fn local() -> Principal {
    Principal::local()
}

/// Opens a session.
async fn open(service: &Service, setup: &str) -> String {
    service.open_session(&local(), setup, "", "").await.unwrap().id
}

/// The engine's set-up.
async fn engine(service: &Service, setup: &str) -> Arc<Setup> {
    Arc::clone(&service.get_setup(&local(), setup).await.unwrap().setup.engine)
}

async fn create(service: &Service, title: &str) -> Result<String, ServiceError> {
    let created = service.create_setup(&local(), uploaded("", &ball::setup_file(title)), |_| {}).await?;
    Ok(created.setup.id.to_string())
}

fn moved(x: f64) -> Design {
    Design { values: Values::Vector(vec![x]), control_points: Vec::new() }
}

/// The header of an upload of one set-up file.
fn header(request_id: &str, file: &str) -> UploadHeader {
    let entry = FileEntry { path: "setup.json".to_owned(), size: file.len() as u64 };
    let source = UploadSource::Files(vec![entry]);
    UploadHeader { request_id: request_id.to_owned(), setup_file: None, visibility: None, source }
}

/// The upload of one set-up file.
fn uploaded(request_id: &str, file: &str) -> Uploaded {
    let limits = Limits::default();
    let mut upload = Upload::begin(header(request_id, file), &limits).unwrap();
    upload.append(0, file.as_bytes(), &limits).unwrap();
    upload.finish().unwrap()
}

#[tokio::test]
async fn a_set_up_is_built_once_and_reports_in_order() {
    let service = service(2, Limits::default());
    let file = ball::setup_file("ball");
    let mut stages = Vec::new();
    let first =
        service.create_setup(&local(), uploaded("", &file), |step| stages.push(step.stage)).await.unwrap();
    stages.dedup();
    assert!(first.built);
    assert_eq!(first.setup.name, "ball");
    assert_eq!(stages[..2], ["read", "mesh"]);
    assert_eq!(stages.last(), Some(&"report"));

    let again = service.create_setup(&local(), uploaded("", &file), |_| {}).await.unwrap();
    assert!(!again.built);
    assert!(Arc::ptr_eq(&first.setup, &again.setup), "memory is shared");
    assert_ne!(create(&service, "another").await.unwrap(), first.setup.id.as_str());
}

#[tokio::test]
async fn concurrent_uploads_share_one_build() {
    let service = Arc::new(service(2, Limits::default()));
    let file = ball::setup_file("ball");
    let builds = (0..8).map(|_| {
        let (service, file) = (Arc::clone(&service), file.clone());
        tokio::spawn(
            async move { service.create_setup(&local(), uploaded("", &file), |_| {}).await.unwrap() },
        )
    });
    let mut built = 0;
    let mut ids = Vec::new();
    for build in builds.collect::<Vec<_>>() {
        let created = build.await.unwrap();
        built += usize::from(created.built);
        ids.push(created.setup.id.clone());
    }
    ids.dedup();
    assert_eq!((built, ids.len()), (1, 1));
}

#[tokio::test]
async fn an_abandoned_build_leaves_nothing_behind() {
    let service = Arc::new(service(1, Limits::default()));
    let file = ball::setup_file("ball");
    let told = Arc::new(Mutex::new(0));
    let build = tokio::spawn({
        let (service, file, told) = (Arc::clone(&service), file.clone(), Arc::clone(&told));
        async move {
            service
                .create_setup(&local(), uploaded("", &file), |_| *told.lock().unwrap() += 1)
                .await
                .map(drop)
        }
    });
    eventually("report", async || (*told.lock().unwrap() > 0).then_some(())).await;
    build.abort();
    let _ = build.await;
    eventually("idle pool", async || (service.load() == 0).then_some(())).await;
    assert!(create(&service, "ball").await.is_ok());
}

#[tokio::test]
async fn deform_gives_the_engines_bits_whatever_the_number_of_threads() {
    let mut results = Vec::new();
    for threads in [1, 2, 3] {
        let service = service(threads, Limits::default());
        let setup = create(&service, "ball").await.unwrap();
        let session = open(&service, &setup).await;
        let deformed = service.deform(&local(), &session, moved(1.5)).await.unwrap();
        let direct = engine(&service, &setup).await.deform(&[1.5], &moldline_deform::NoMonitor).unwrap();
        assert_eq!(deformed.deformation().vertices, direct.vertices);
        results.push((deformed.deformation().vertices.clone(), deformed.id().to_owned()));
    }
    results.dedup();
    assert_eq!(results.len(), 1);
    // A ball that moves by 1.5 m is a ball around (1.5, 0, 0).
    for [x, y, z] in &results[0].0 {
        assert!((((x - 1.5).powi(2) + y * y + z * z).sqrt() - 1.0).abs() < 1e-12);
    }
}

#[tokio::test]
async fn given_control_points_replace_those_of_a_component() {
    let service = service(2, Limits::default());
    let setup = create(&service, "ball").await.unwrap();
    let session = open(&service, &setup).await;
    let points = engine(&service, &setup).await.parameterisation().control_points(&[0.75]).unwrap();
    let design = Design { control_points: vec![("ball".to_owned(), points[0].clone())], ..Design::default() };
    let given = service.deform(&local(), &session, design).await.unwrap();
    let own = service.deform(&local(), &session, moved(0.75)).await.unwrap();
    assert_eq!(given.deformation().vertices, own.deformation().vertices);
    assert_ne!(given.id(), own.id());
}

#[tokio::test]
async fn invalid_designs_are_rejected_by_entry() {
    let service = service(1, Limits::default());
    let session = open(&service, &create(&service, "ball").await.unwrap()).await;
    let named = |name: &str| Design {
        values: Values::Named([(name.to_owned(), 0.0)].into()),
        control_points: Vec::new(),
    };
    for (design, field) in [
        (moved(f64::NAN), "design[0]"),
        (moved(2.5), "design[0]"),
        (Design { values: Values::Vector(vec![]), ..Design::default() }, "design"),
        (named("ball.y"), "design[\"ball.y\"]"),
        (
            Design { control_points: vec![("wing".to_owned(), vec![])], ..Design::default() },
            "control_points[\"wing\"]",
        ),
        (
            Design { control_points: vec![("ball".to_owned(), vec![])], ..Design::default() },
            "control_points[0]",
        ),
    ] {
        let error = service.deform(&local(), &session, design).await.unwrap_err();
        assert_eq!((error.code, error.violations[0].field.as_str()), (Code::InvalidArgument, field));
    }
}

#[tokio::test]
async fn sessions_have_a_limit_and_request_ids() {
    let service = service(1, Limits { sessions: 2, ..Limits::default() });
    let (setup, other) = (create(&service, "ball").await.unwrap(), create(&service, "other").await.unwrap());
    let opened = service.open_session(&local(), &setup, "mine", "a").await.unwrap();
    assert_eq!(service.open_session(&local(), &setup, "mine", "a").await.unwrap(), opened);
    let first = opened.id;
    assert_eq!(service.open_session(&local(), &other, "", "a").await.unwrap_err().code, Code::AlreadyExists);
    open(&service, &setup).await;
    assert_eq!(
        service.open_session(&local(), &setup, "", "").await.unwrap_err().code,
        Code::ResourceExhausted
    );
    service.close_session(&local(), &first).await.unwrap();
    assert_eq!(service.close_session(&local(), &first).await.unwrap_err().code, Code::NotFound);
    open(&service, &setup).await;
}

#[tokio::test]
async fn a_request_id_names_one_upload() {
    let service = service(1, Limits::default());
    let upload = |title| uploaded("id", &ball::setup_file(title));
    let first = service.create_setup(&local(), upload("ball"), |_| {}).await.unwrap();
    let retry = service.create_setup(&local(), upload("ball"), |_| {}).await.unwrap();
    assert_eq!(first.setup.id, retry.setup.id);
    let error = service.create_setup(&local(), upload("other"), |_| {}).await.unwrap_err();
    assert_eq!(error.code, Code::AlreadyExists);
}

#[tokio::test]
async fn concurrent_uploads_have_a_limit() {
    let service = service(1, Limits { uploads: 1, ..Limits::default() });
    let file = ball::setup_file("ball");
    let receiving = service.receive(&local(), header("", &file)).unwrap();
    let error = service.receive(&local(), header("", &file)).unwrap_err();
    assert_eq!(error.code, Code::ResourceExhausted);
    assert!(error.retry_after.is_some());
    drop(receiving);
    assert!(service.receive(&local(), header("", &file)).is_ok());
}

fn along(x: f64) -> Directions {
    Directions { design: Some(vec![vec![x]]), control_points: Vec::new() }
}

/// The x coordinate of the first vertex.
fn first_x(vertices: usize) -> Seeds {
    let mut seed = vec![[0.0; 3]; vertices];
    seed[0][0] = 1.0;
    Seeds { vertices: Some(vec![seed]), functions: None }
}

#[tokio::test]
async fn products_are_those_of_a_ball_that_moves() {
    let service = service(2, Limits::default());
    let session = open(&service, &create(&service, "ball").await.unwrap()).await;
    let deformed = service.deform(&local(), &session, moved(0.5)).await.unwrap();
    let vertices = deformed.deformation().vertices.len();
    for at in [At::id(deformed.id()), At::design(moved(0.5)), At::design(moved(-0.25))] {
        let tangents = service.jvp(&local(), &session, at.clone(), along(2.0)).await.unwrap().value;
        for [x, y, z] in &tangents[0].vertices {
            assert!((x - 2.0).abs() < 1e-12 && y.abs() < 1e-12 && z.abs() < 1e-12);
        }
        // The volume of a ball does not depend on where it is.
        assert!(tangents[0].functions.iter().all(|change| change.abs() < 1e-10));
        let wanted = Wanted { design: true, control_points: vec!["ball".to_owned()] };
        let gradients =
            service.vjp(&local(), &session, at.clone(), first_x(vertices), wanted).await.unwrap().value;
        assert!((gradients.design.unwrap()[0][0] - 1.0).abs() < 1e-12);
        let by_points = &gradients.control_points[0].vectors[0];
        assert!((by_points.iter().map(|point| point[0]).sum::<f64>() - 1.0).abs() < 1e-12);
        // All control points moved together are the ball moved.
        let vectors = vec![vec![[2.0, 0.0, 0.0]; by_points.len()]];
        let directions = Directions {
            design: None,
            control_points: vec![ControlPointVectors { component: "ball".to_owned(), vectors }],
        };
        let by_points = service.jvp(&local(), &session, at.clone(), directions).await.unwrap().value;
        for (a, b) in by_points[0].vertices.iter().zip(&tangents[0].vertices) {
            assert!((0..3).all(|axis| (a[axis] - b[axis]).abs() < 1e-12));
        }
        let at = service.linearised(&local(), &session, at).await.unwrap().value;
        let columns = service.jacobian(&local(), &at, 0).await.unwrap().value;
        assert_eq!(columns.len(), 1);
        assert!((columns[0].vertices[0][0] - 1.0).abs() < 1e-12);
    }
}

#[tokio::test]
async fn products_at_the_same_design_share_one_linearisation() {
    let service = Arc::new(service(2, Limits::default()));
    let session = open(&service, &create(&service, "ball").await.unwrap()).await;
    let asked = (0..8).map(|_| {
        let (service, session) = (Arc::clone(&service), session.clone());
        tokio::spawn(async move {
            service.linearised(&local(), &session, At::design(moved(0.5))).await.unwrap().value
        })
    });
    let mut made = Vec::new();
    for one in asked.collect::<Vec<_>>() {
        made.push(one.await.unwrap());
    }
    assert!(made.iter().all(|other| Arc::ptr_eq(other, &made[0])));
    let again = service.deform(&local(), &session, moved(0.5)).await.unwrap();
    assert_eq!(again.deformation().vertices, made[0].deformation().vertices);
    assert_eq!(again.id(), made[0].id());
}

#[tokio::test]
async fn a_block_of_the_jacobian_and_the_vectors_of_a_request_have_limits() {
    let service = service(1, Limits { vectors: 2, ..Limits::default() });
    let session = open(&service, &create(&service, "ball").await.unwrap()).await;
    let directions = Directions { design: Some(vec![vec![1.0]; 3]), control_points: Vec::new() };
    let error = service.jvp(&local(), &session, At::design(moved(0.0)), directions).await.unwrap_err();
    assert_eq!((error.code, error.violations[0].field.as_str()), (Code::InvalidArgument, "design.shape[0]"));
    assert!(error.message.contains('3') && error.message.contains("1..=2"));
    assert_eq!(service.load(), 0, "rejected before any work");
}

#[tokio::test]
async fn evicted_set_ups_are_loaded_again_with_the_same_bits() {
    let unbounded = service(1, Limits::default());
    let bytes = engine(&unbounded, &create(&unbounded, "first").await.unwrap()).await.bytes();

    let service =
        service(1, Limits { setup_bytes: bytes + bytes / 2, linearisation_bytes: 0, ..Limits::default() });
    let first = create(&service, "first").await.unwrap();
    let session = open(&service, &first).await;
    let before = service.deform(&local(), &session, moved(0.5)).await.unwrap();
    let (vertices, id) = (before.deformation().vertices.clone(), before.id().to_owned());
    let second = create(&service, "second").await.unwrap();
    let other = service.get_setup(&local(), &second).await.unwrap();
    assert_eq!(service.status(&local()).await.unwrap().setups_resident, 2, "both are in use");
    let error = create(&service, "third").await.unwrap_err();
    assert_eq!(error.code, Code::ResourceExhausted);
    drop((before, other));
    let elsewhere = open(&service, &second).await;
    service.deform(&local(), &elsewhere, moved(0.1)).await.unwrap();
    create(&service, "third").await.unwrap();
    let cache = service.status(&local()).await.unwrap().setup_cache;
    assert_eq!((cache.entries, cache.evictions), (2, 1), "the second one is held by its linearisation");
    assert!(service.get_setup(&local(), &second).await.is_ok());
    // The session has lost nothing: its set-up is loaded, and the linearisation recomputed.
    let seeds = || first_x(vertices.len());
    let wanted = Wanted { design: true, control_points: Vec::new() };
    let error = service.vjp(&local(), &session, At::id(&id), seeds(), wanted.clone()).await.unwrap_err();
    assert_eq!((error.code, error.violations[0].field.as_str()), (Code::NotFound, "at.linearisation_id"));
    let at = At { id: Some(id), design: Some(moved(0.5)) };
    assert!(service.vjp(&local(), &session, at, seeds(), wanted).await.is_ok());
    let after = service.deform(&local(), &session, moved(0.5)).await.unwrap();
    assert_eq!(after.deformation().vertices, vertices);
}

#[tokio::test]
async fn linearisations_are_shared_by_a_tenants_sessions_and_recomputed_to_the_same_bits() {
    let unbounded = service(1, Limits::default());
    let session = open(&unbounded, &create(&unbounded, "ball").await.unwrap()).await;
    let bytes = unbounded.deform(&local(), &session, moved(0.1)).await.unwrap().bytes();

    let service = service(1, Limits { linearisation_bytes: 2 * bytes + bytes / 2, ..Limits::default() });
    let setup = create(&service, "ball").await.unwrap();
    let sessions = [open(&service, &setup).await, open(&service, &setup).await];
    let caller = local();
    let mut ids = Vec::new();
    for x in [0.1, 0.2] {
        ids.push(service.deform(&caller, &sessions[0], moved(x)).await.unwrap().id().to_owned());
    }
    let product = |session: usize, at: At| service.jvp(&caller, &sessions[session], at, along(1.0));
    let before = product(0, At::id(&ids[0])).await.unwrap().value;
    assert_eq!(product(1, At::id(&ids[0])).await.unwrap().value, before, "of the same tenant and set-up");
    service.deform(&caller, &sessions[1], moved(0.3)).await.unwrap();
    let error = product(0, At::id(&ids[1])).await.unwrap_err();
    assert_eq!((error.code, error.violations[0].field.as_str()), (Code::NotFound, "at.linearisation_id"));
    let both = At { id: Some(ids[1].clone()), design: Some(moved(0.2)) };
    let again = product(0, both).await.unwrap().value;
    assert_eq!(again, product(1, At::id(&ids[1])).await.unwrap().value, "it is held again");
    let wrong = At { id: Some(ids[1].clone()), design: Some(moved(0.25)) };
    let error = product(0, wrong).await.unwrap_err();
    assert_eq!(
        (error.code, error.violations[0].field.as_str()),
        (Code::InvalidArgument, "at.linearisation_id")
    );
    let error = product(0, At::default()).await.unwrap_err();
    assert_eq!((error.code, error.violations[0].field.as_str()), (Code::InvalidArgument, "at"));

    let other = open(&service, &create(&service, "another").await.unwrap()).await;
    let error = service.jvp(&caller, &other, At::id(&ids[1]), along(1.0)).await.unwrap_err();
    assert_eq!(error.code, Code::NotFound, "of another set-up");
    service.close_session(&caller, &sessions[0]).await.unwrap();
    assert_eq!(product(0, At::id(&ids[1])).await.unwrap_err().violations[0].field, "session_id");
}

/// The last file below a folder.
fn last_file(folder: &Path) -> PathBuf {
    let path = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).max().unwrap();
    if path.is_dir() { last_file(&path) } else { path }
}

#[tokio::test]
async fn a_damaged_record_affects_nothing_else_and_can_be_rewritten() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path().to_str().unwrap()).await.unwrap();
    let limits = PoolLimits { threads: 1, running: 1, queued: 16, work: PoolLimits::WORK };
    let service = Service::with_store(store, limits, Limits::default()).unwrap();
    let (good, bad) = (create(&service, "good").await.unwrap(), create(&service, "bad").await.unwrap());
    let (whole, damaged) = (open(&service, &good).await, open(&service, &good).await);
    let spoil = |row: &str| fs::write(last_file(&folder.path().join(row)), b"not what was written").unwrap();
    spoil(&format!("access/local/{bad}"));
    spoil(&format!("session/local/{damaged}"));
    let is_fault = |error: ServiceError| error.code == Code::Internal && error.message.contains("damaged");

    assert!(is_fault(service.get_setup(&local(), &bad).await.unwrap_err()));
    assert!(is_fault(service.get_session(&local(), &damaged).await.unwrap_err()));
    // Lists, quotas and the status skip it.
    let setups = service.list_setups(&local(), &Page::default()).await.unwrap().entries;
    assert_eq!(setups.iter().map(|setup| &setup.id).collect::<Vec<_>>(), [&good]);
    let sessions = service.list_sessions(&local(), &Page::default()).await.unwrap().entries;
    assert_eq!(sessions.iter().map(|session| &session.id).collect::<Vec<_>>(), [&whole]);
    create(&service, "another").await.unwrap();
    service.status(&local()).await.unwrap();
    // The way out: upload the same content again, close the session.
    assert_eq!(create(&service, "bad").await.unwrap(), bad);
    assert!(service.get_setup(&local(), &bad).await.unwrap().access.owned);
    service.close_session(&local(), &damaged).await.unwrap();
    assert_eq!(service.get_session(&local(), &damaged).await.unwrap_err().code, Code::NotFound);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn copies_of_one_opening_at_the_same_time_get_one_session() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path().to_str().unwrap()).await.unwrap();
    let limits = PoolLimits { threads: 1, running: 1, queued: 16, work: PoolLimits::WORK };
    let service = Arc::new(Service::with_store(store, limits, Limits::default()).unwrap());
    let setup = create(&service, "one").await.unwrap();
    for round in 0..60 {
        let copies: Vec<_> = (0..8)
            .map(|_| {
                let (service, setup) = (Arc::clone(&service), setup.clone());
                tokio::spawn(async move {
                    service.open_session(&local(), &setup, "", &format!("round {round}")).await
                })
            })
            .collect();
        let mut ids = Vec::new();
        for copy in copies {
            ids.push(copy.await.unwrap().unwrap().id);
        }
        assert!(ids.iter().all(|id| *id == ids[0]), "{ids:?}");
        service.close_session(&local(), &ids[0]).await.unwrap();
        let late = service.open_session(&local(), &setup, "", &format!("round {round}")).await.unwrap_err();
        assert_eq!(late.code, Code::NotFound, "the session is closed");
    }
}
