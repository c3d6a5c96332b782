//! The store in memory and on a real folder: races, damage, crashes, full disks.
#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::{
    collections::BTreeSet,
    fs,
    io::{BufRead, BufReader, Write},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::{Duration, SystemTime},
};

use moldline_store::{
    AccessRecord, Claim, Excess, Kind, Numbers, Quota, Schedule, SessionRecord, Shared, Store, StoreError,
};

fn files(content: &str) -> Vec<(String, Vec<u8>)> {
    let big: Vec<u8> = content.bytes().cycle().take(100_000).collect();
    vec![("setup.toml".to_owned(), content.as_bytes().to_vec()), ("mesh.msh".to_owned(), big)]
}

fn access(shared: Shared) -> AccessRecord {
    AccessRecord {
        owned: true,
        shared,
        name: "a set-up".to_owned(),
        vertices: 1,
        cells: 2,
        variables: 3,
        bytes: 4,
        created: SystemTime::UNIX_EPOCH,
    }
}

fn session(setup: &str, x: f64) -> SessionRecord {
    SessionRecord {
        setup: setup.to_owned(),
        design: Numbers(vec![x]),
        control_points: Vec::new(),
        label: String::new(),
        created: SystemTime::UNIX_EPOCH,
        updated: SystemTime::UNIX_EPOCH,
        request: String::new(),
        opened: String::new(),
        updates: Vec::new(),
        own: true,
        charged: 0,
    }
}

async fn folder() -> (tempfile::TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path().to_str().unwrap()).await.unwrap();
    (folder, store)
}

/// An empty place in the object store that tests may use, if there is one.
fn remote() -> Option<String> {
    match std::env::var("MOLDLINE_TEST_S3") {
        Ok(place) => Some(format!("{place}/{}", uuid::Uuid::new_v4())),
        Err(_) => {
            eprintln!("not on an object store: MOLDLINE_TEST_S3 names none");
            None
        }
    }
}

/// A set-up with all that can be stored of it.
async fn filled(store: &Store) -> String {
    let id = store.put_setup(&files("content")).await.unwrap();
    store.put_derived(&id, "build", vec![7; 1000]).await.unwrap();
    store.put_access("a", &id, 1, &access(Shared::Public)).await.unwrap();
    store.put_session("a", "s", 1, &session(&id, 0.5)).await.unwrap();
    store.claim("a", "request", "hash").await.unwrap();
    id
}

#[tokio::test]
async fn stored_objects_are_found_by_every_store_at_the_location() {
    let folder = tempfile::tempdir().unwrap();
    let on_disk = folder.path().to_str().unwrap().to_owned();
    for place in [Some(on_disk), remote()].into_iter().flatten() {
        let store = Store::open(&place).await.unwrap();
        let id = filled(&store).await;
        is_all_there(&store, &id, "first").await;
        is_all_there(&Store::open(&place).await.unwrap(), &id, "second").await;
    }
}

async fn is_all_there(store: &Store, id: &str, name: &str) {
    let found = store.setup(id).await.unwrap().unwrap();
    let found: Vec<(String, Vec<u8>)> = found.into_iter().map(|(path, data)| (path, data.to_vec())).collect();
    assert_eq!(found, files("content"));
    assert_eq!(store.derived(id, "build").await.unwrap().unwrap(), vec![7; 1000]);
    assert_eq!(store.derived(id, "another").await.unwrap(), None);
    assert_eq!(store.session("a", "s").await.unwrap().unwrap().record, session(id, 0.5));
    assert_eq!(store.session("b", "s").await.unwrap(), None);
    assert_eq!(store.granted("b", id).await.unwrap().unwrap(), access(Shared::Public));
    assert_eq!(store.claim("a", "request", "hash").await.unwrap(), Claim::Repeated);
    assert_eq!(store.claim("a", "request", "other").await.unwrap(), Claim::Taken);
    assert_eq!(store.claim("b", name, "other").await.unwrap(), Claim::New);
    assert_eq!(store.verify().await.unwrap().faults, []);
    assert!(store.collect(Duration::ZERO, true).await.unwrap().objects.is_empty());
}

#[tokio::test]
async fn an_existing_store_is_required_where_none_may_be_created() {
    let folder = tempfile::tempdir().unwrap();
    let missing = folder.path().join("missing");
    let on_disk = missing.to_str().unwrap().to_owned();
    for place in [Some(on_disk.clone()), remote()].into_iter().flatten() {
        let refused = Store::open_existing(&place).await.unwrap_err();
        assert!(matches!(&refused, StoreError::Location { location, .. } if *location == place), "{refused}");
        assert!(place != on_disk || !missing.exists());
        let id = filled(&Store::open(&place).await.unwrap()).await;
        is_all_there(&Store::open_existing(&place).await.unwrap(), &id, "first").await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn one_of_many_writers_of_a_generation_wins() {
    let (_folder, on_disk) = folder().await;
    let mut stores = vec![Store::in_memory(), on_disk];
    if let Some(place) = remote() {
        stores.push(Store::open(&place).await.unwrap());
    }
    for store in stores {
        for number in 1..=20 {
            let tries = (0..16).map(|k| {
                let store = store.clone();
                tokio::spawn(async move {
                    let record = session("setup", f64::from(k));
                    store.put_session("a", "s", number, &record).await.unwrap().then_some(record)
                })
            });
            let mut winners = Vec::new();
            for one in tries.collect::<Vec<_>>() {
                winners.extend(one.await.unwrap());
            }
            assert_eq!(winners.len(), 1, "generation {number}");
            let latest = store.session("a", "s").await.unwrap().unwrap();
            assert_eq!((latest.number, &latest.record), (number, &winners[0]));
        }
    }
}

/// All files of a folder.
fn objects(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { found.extend(objects(&path)) } else { found.push(path) }
    }
    found.sort();
    found
}

#[tokio::test]
async fn flipped_bits_and_truncated_files_are_found_and_named() {
    let (folder, store) = folder().await;
    let id = filled(&store).await;
    let mut kinds = BTreeSet::new();
    for path in objects(folder.path()) {
        let name = path.strip_prefix(folder.path()).unwrap().to_str().unwrap().to_owned();
        let kind = name.split('/').next().unwrap().to_owned();
        // `format` and `identity` identify the folder, a grant and an entry of the index have names only.
        if matches!(kind.as_str(), "format" | "identity" | "grant" | "index") {
            continue;
        }
        let whole = fs::read(&path).unwrap();
        let mut flipped = whole.clone();
        flipped[whole.len() / 2] ^= 4;
        for damaged in [flipped, whole[..whole.len() / 2].to_vec(), Vec::new()] {
            fs::write(&path, &damaged).unwrap();
            let faults = store.verify().await.unwrap().faults;
            assert!(faults.iter().any(|fault| fault.to_string().contains(&name)), "{name}: {faults:?}");
            let error = match kind.as_str() {
                "blob" | "setup" => store.setup(&id).await.map(drop),
                "derived" => store.derived(&id, "build").await.map(drop),
                "access" => store.access("a", &id).await.map(drop),
                "session" => store.session("a", "s").await.map(drop),
                "request" => store.claim("a", "request", "hash").await.map(drop),
                other => panic!("{other}"),
            };
            let Err(StoreError::Corrupt { object, .. }) = error else { panic!("{name}: {error:?}") };
            assert_eq!(object, name);
            if kind == "access" {
                assert_eq!(store.granted("b", &id).await.unwrap(), None);
            }
        }
        fs::write(&path, whole).unwrap();
        kinds.insert(kind);
    }
    assert_eq!(kinds.len(), 6);
    assert_eq!(store.verify().await.unwrap().faults, []);
    // Storing the same content again repairs a set-up.
    for path in objects(&folder.path().join("blob")) {
        fs::write(path, b"damaged").unwrap();
    }
    store.put_setup(&files("content")).await.unwrap();
    assert_eq!(store.verify().await.unwrap().faults, []);
    fs::remove_dir_all(folder.path().join("blob")).unwrap();
    assert_eq!(store.verify().await.unwrap().faults.len(), 1);
    assert!(store.setup(&id).await.unwrap_err().to_string().contains("missing"));
}

#[tokio::test]
async fn a_collection_removes_unreachable_objects_that_are_old_enough() {
    let (folder, store) = folder().await;
    fs::create_dir(folder.path().join("blob")).unwrap();
    fs::write(folder.path().join("blob").join("staged#1"), b"half").unwrap();
    collects(&store, 3).await;
    if let Some(place) = remote() {
        collects(&Store::open(&place).await.unwrap(), 2).await;
    }
}

/// `blobs`: number of unreachable ones.
async fn collects(store: &Store, blobs: usize) {
    let id = filled(store).await;
    let other = store.put_setup(&files("of nobody")).await.unwrap();
    for number in 2..=20 {
        assert!(store.put_session("a", "s", number, &session(&id, number as f64)).await.unwrap());
    }
    store.put_session("a", "t", 1, &session(&other, 0.0)).await.unwrap();
    store.close_session("a", "t", "opened").await.unwrap();
    assert!(store.collect(Duration::from_secs(60), false).await.unwrap().objects.is_empty(), "all is young");
    let planned = store.collect(Duration::ZERO, true).await.unwrap();
    assert!(store.setup(&other).await.unwrap().is_some(), "nothing was removed");
    let collected = store.collect(Duration::ZERO, false).await.unwrap();
    assert_eq!(collected, planned);
    let gone = |what: &str| collected.objects.iter().filter(|name| name.starts_with(what)).count();
    assert_eq!((gone("blob/"), gone("setup/")), (blobs, 1));
    assert_eq!(collected.objects.len(), blobs + 1, "{collected:?}");
    assert_eq!(store.setup(&other).await.unwrap(), None);
    assert!(store.setup(&id).await.unwrap().is_some());
    // Old generations went as new ones came, all of a closed session but its mark as it was closed.
    let latest = store.session("a", "s").await.unwrap().unwrap();
    assert_eq!((latest.number, latest.record.design), (20, Numbers(vec![20.0])));
    assert!(store.session_at("a", "s", 13).await.unwrap().is_some());
    assert!(store.session_at("a", "s", 12).await.unwrap().is_none());
    assert!(store.session_at("a", "t", 1).await.unwrap().is_none());
    assert_eq!(store.closed_session("a", "t").await.unwrap().as_deref(), Some("opened"));
    assert_eq!(store.verify().await.unwrap().faults, []);
    assert!(store.collect(Duration::ZERO, false).await.unwrap().objects.is_empty());
}

const PLACE: &str = "MOLDLINE_TEST_STORE";

/// This test binary as another process that runs one test only.
fn child(test: &str, place: &Path, shell: &str) -> Command {
    let mut command = Command::new("sh");
    let binary = std::env::current_exe().unwrap();
    command.arg("-c").arg(format!("{shell} exec \"$0\" --exact {test} --nocapture")).arg(binary);
    command.env(PLACE, place).stdout(Stdio::piped()).stderr(Stdio::null());
    command
}

/// Not a test by itself: the process to be killed. It prints what has been acknowledged.
#[tokio::test]
async fn a_process_that_writes() {
    let Ok(place) = std::env::var(PLACE) else { return };
    let store = Store::open(&place).await.unwrap();
    let start = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_nanos();
    for k in 0_u64.. {
        let content = format!("{start}-{k}");
        let id = store.put_setup(&files(&content)).await.unwrap();
        store.put_derived(&id, "build", vec![1; 300_000]).await.unwrap();
        assert!(store.put_access("a", &id, 1, &access(Shared::Private)).await.unwrap());
        println!("\nsetup {id} {content}");
        let number = store.session("a", "s").await.unwrap().map_or(1, |latest| latest.number + 1);
        if store.put_session("a", "s", number, &session(&id, k as f64)).await.unwrap() {
            println!("\nsession {number} {id} {k}");
        }
        std::io::stdout().flush().unwrap();
    }
}

#[tokio::test]
async fn acknowledged_objects_survive_sigkill_and_partial_ones_are_never_visible() {
    let (folder, store) = folder().await;
    let mut acknowledged = 0;
    for round in 0..6 {
        let mut children: Vec<_> =
            (0..2).map(|_| child("a_process_that_writes", folder.path(), "").spawn().unwrap()).collect();
        // The processes are killed at another moment of their work in each round.
        std::thread::sleep(Duration::from_millis(300 + 70 * round));
        children.iter_mut().for_each(|child| child.kill().unwrap());
        for mut child in children {
            child.wait().unwrap();
            // A truncated line was not acknowledged.
            let mut output = Vec::new();
            let mut reader = BufReader::new(child.stdout.take().unwrap());
            while reader.read_until(b'\n', &mut output).unwrap() > 0 {}
            let text = String::from_utf8(output).unwrap();
            let end = text.rfind('\n').map_or(0, |end| end + 1);
            for line in text[..end].lines() {
                match line.split(' ').collect::<Vec<_>>()[..] {
                    ["setup", id, content] => {
                        let found = store.setup(id).await.unwrap().unwrap();
                        assert_eq!(found[0].1, content.as_bytes());
                        assert!(store.access("a", id).await.unwrap().is_some());
                        acknowledged += 1;
                    }
                    ["session", number, id, k] => {
                        let number: u64 = number.parse().unwrap();
                        let found = store.session_at("a", "s", number).await.unwrap();
                        let latest = store.session("a", "s").await.unwrap().unwrap().number;
                        assert!(found.is_some() || number + 8 <= latest, "generation {number} of {latest}");
                        if let Some(found) = found {
                            assert_eq!(found, session(id, k.parse().unwrap()));
                        }
                    }
                    _ => {}
                }
            }
        }
        assert_eq!(store.verify().await.unwrap().faults, [], "round {round}");
    }
    assert!(acknowledged > 0);
    let sessions = store.session("a", "s").await.unwrap().unwrap().number;
    store.collect(Duration::ZERO, false).await.unwrap();
    assert!(objects(folder.path()).iter().all(|path| !path.to_str().unwrap().contains('#')), "left-overs");
    assert_eq!(store.session("a", "s").await.unwrap().unwrap().number, sessions);
    assert_eq!(store.verify().await.unwrap().faults, []);
}

/// Not a test by itself: a process that may write small files only, as on a full disk.
#[tokio::test]
async fn a_process_without_space() {
    let Ok(place) = std::env::var(PLACE) else { return };
    let store = Store::open(&place).await.unwrap();
    let error = store.put_setup(&files("too large")).await.unwrap_err();
    assert!(matches!(error, StoreError::Full { .. }), "{error:?}");
    let id = store.put_setup(&[("setup.toml".to_owned(), b"small".to_vec())]).await.unwrap();
    assert!(store.setup(&id).await.unwrap().is_some(), "it goes on");
    println!("\nfull: {error}");
}

#[cfg(unix)]
#[tokio::test]
async fn a_full_disk_is_reported_and_leaves_nothing_behind() {
    let (folder, store) = folder().await;
    let id = filled(&store).await;
    // Without the signal, writing beyond the limit fails as on a full disk instead of ending the process.
    let limited =
        child("a_process_without_space", folder.path(), "trap '' XFSZ; ulimit -f 16;").output().unwrap();
    let text = String::from_utf8(limited.stdout).unwrap();
    assert!(limited.status.success() && text.contains("no space left for blob/"), "{text}");
    assert!(objects(folder.path()).iter().all(|path| !path.to_str().unwrap().contains('#')));
    assert_eq!(store.verify().await.unwrap().faults, []);
    assert!(store.setup(&id).await.unwrap().is_some());
}

#[tokio::test]
async fn invalid_locations_are_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, b"").unwrap();
    for place in [file.to_str().unwrap(), "ftp://host/x"] {
        let error = Store::open(place).await.unwrap_err();
        assert!(matches!(&error, StoreError::Location { location, .. } if location == place), "{error:?}");
    }
    fs::write(folder.path().join("format"), b"something else").unwrap();
    assert!(Store::open(folder.path().to_str().unwrap()).await.is_err());
}

#[cfg(unix)]
#[tokio::test]
async fn folders_and_files_are_for_their_owner_alone() {
    use std::os::unix::fs::PermissionsExt;
    let outer = tempfile::tempdir().unwrap();
    let (made, open) = (outer.path().join("made"), outer.path().join("open"));
    fs::create_dir(&open).unwrap();
    fs::set_permissions(&open, fs::Permissions::from_mode(0o755)).unwrap();
    for place in [made, open] {
        filled(&Store::open(place.to_str().unwrap()).await.unwrap()).await;
        let files = objects(&place);
        let folders: BTreeSet<&Path> = files.iter().flat_map(|path| path.ancestors().skip(1)).collect();
        for path in files.iter().map(PathBuf::as_path).chain(folders) {
            if path.starts_with(&place) {
                let mode = fs::metadata(path).unwrap().permissions().mode();
                assert_eq!(mode & 0o077, 0, "{} has {mode:o}", path.display());
            }
        }
    }
}

fn vanished<T: std::fmt::Debug>(outcome: Result<T, StoreError>) {
    assert!(matches!(&outcome, Err(StoreError::Vanished { .. })), "{outcome:?}");
}

#[tokio::test]
async fn a_store_that_vanished_is_told_and_never_replaced() {
    let outer = tempfile::tempdir().unwrap();
    let (place, aside) = (outer.path().join("store"), outer.path().join("aside"));
    let store = Store::open(place.to_str().unwrap()).await.unwrap();
    let id = filled(&store).await;
    assert!(store.health().await.unwrap().free.unwrap() > 0);
    fs::rename(&place, &aside).unwrap();
    for another in [false, true] {
        if another {
            // An empty disk under the same name, on which another store was begun.
            Store::open(place.to_str().unwrap()).await.unwrap();
        }
        let before = place.exists().then(|| objects(&place));
        vanished(store.setup(&id).await);
        vanished(store.session("a", "s").await);
        vanished(store.granted("b", &id).await);
        vanished(store.put_setup(&files("content")).await);
        vanished(store.put_session("a", "t", 1, &session(&id, 0.5)).await);
        vanished(store.claim("a", "another", "hash").await);
        vanished(store.collect(Duration::ZERO, false).await);
        std::thread::sleep(Duration::from_millis(1100));
        vanished(store.health().await);
        assert_eq!(place.exists().then(|| objects(&place)), before, "nothing was written");
    }
    fs::remove_dir_all(&place).unwrap();
    fs::rename(&aside, &place).unwrap();
    is_all_there(&store, &id, "first").await;
    std::thread::sleep(Duration::from_millis(1100));
    store.health().await.unwrap();
}

/// What the tenant `a` may hold.
const QUOTA: Quota = Quota { setups: 5, sessions: 20, bytes: 1000 };

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_quota_holds_for_many_at_once_on_several_servers() {
    let folder = tempfile::tempdir().unwrap();
    let places = [Some(folder.path().to_str().unwrap().to_owned()), remote()];
    for place in places.into_iter().flatten() {
        // Handles of one server share turns, those of another one do not.
        for servers in [1, 2, 3] {
            let tenant = format!("tenant-{servers}");
            let mut stores = Vec::new();
            for _ in 0..servers {
                stores.push(Store::open(&place).await.unwrap());
            }
            for (kind, limit) in [(Kind::Session, 20), (Kind::Setup, 5)] {
                let tries = (0..60).map(|k: usize| {
                    let (store, tenant) = (stores[k % servers].clone(), tenant.clone());
                    tokio::spawn(async move {
                        let id = format!("{k:032}");
                        let place = store.reserve(&tenant, kind, &id, 10, &QUOTA).await.unwrap();
                        place.map(|place| place.keep()).is_ok()
                    })
                });
                let mut kept = 0;
                for one in tries.collect::<Vec<_>>() {
                    kept += usize::from(one.await.unwrap());
                }
                assert_eq!(kept, stores[0].entries(&tenant, kind).await.unwrap().len());
                assert!(kept <= limit, "{kept} of {limit} with {servers} servers");
                if servers == 1 {
                    assert_eq!(kept, limit, "nobody is pushed out");
                }
                // What is free can be had.
                for k in 0..limit {
                    let id = format!("another {k}");
                    if let Ok(place) = stores[0].reserve(&tenant, kind, &id, 10, &QUOTA).await.unwrap() {
                        place.keep();
                    }
                }
                assert_eq!(stores[0].entries(&tenant, kind).await.unwrap().len(), limit);
            }
        }
    }
}

#[tokio::test]
async fn bytes_count_for_set_ups_sessions_and_what_was_deleted() {
    let store = Store::in_memory();
    let reserve = async |kind, id: &str, bytes| {
        let place = store.reserve("a", kind, id, bytes, &QUOTA).await.unwrap();
        place.map(|place| place.keep())
    };
    assert_eq!(reserve(Kind::Setup, "one", 600).await, Ok(()));
    assert_eq!(reserve(Kind::Session, "s", 300).await, Ok(()));
    assert_eq!(reserve(Kind::Setup, "two", 101).await, Err(Excess::Bytes(900)));
    assert_eq!(reserve(Kind::Session, "s", 350).await, Ok(()), "a session grows");
    assert_eq!(reserve(Kind::Session, "s", 401).await, Err(Excess::Bytes(950)));
    assert_eq!(store.usage("a").await.unwrap().sessions.bytes, 350, "the larger entry counts");
    assert_eq!(reserve(Kind::Setup, "one", 600).await, Ok(()), "it is there");
    assert_eq!(store.usage("b").await.unwrap(), moldline_store::Usage::default());
    // Deleted set-ups count until they are collected, as often again.
    let record = AccessRecord { bytes: 600, ..access(Shared::Private) };
    for k in 0..4 {
        let id = format!("{k:064}");
        let held = reserve(Kind::Setup, &id, 50).await;
        if k == 3 {
            assert!(matches!(held, Err(Excess::Deleted(_))), "{held:?}");
            break;
        }
        assert_eq!(held, Ok(()));
        assert!(store.put_access("a", &id, 1, &AccessRecord { bytes: 600, ..record.clone() }).await.unwrap());
        assert!(
            store.put_access("a", &id, 2, &AccessRecord { owned: false, ..record.clone() }).await.unwrap()
        );
    }
    let usage = store.usage("a").await.unwrap();
    assert_eq!((usage.setups.count, usage.deleted.count, usage.deleted.bytes), (1, 3, 1800));
    store.collect(Duration::ZERO, false).await.unwrap();
    let usage = store.usage("a").await.unwrap();
    assert_eq!(
        (usage.setups.count, usage.deleted.count, usage.sessions.count),
        (0, 0, 0),
        "nor had the rest records"
    );
}

#[tokio::test]
async fn the_index_follows_the_records_whatever_crashes_left() {
    let (folder, store) = folder().await;
    let id = filled(&store).await;
    store.put_session("a", "closed", 1, &session(&id, 0.5)).await.unwrap();
    store.close_session("a", "closed", "").await.unwrap();
    let expected = async || {
        let entries = async |kind| store.entries("a", kind).await.unwrap().into_keys().collect::<Vec<_>>();
        assert_eq!(entries(Kind::Setup).await, [id.as_str()]);
        assert_eq!(entries(Kind::Session).await, ["s"]);
        assert_eq!(store.survey().await.unwrap().sessions, 1);
    };
    // Lost entries, and entries of nothing.
    fs::remove_dir_all(folder.path().join("index")).unwrap();
    for (kind, of) in [(Kind::Setup, "nothing"), (Kind::Session, "closed"), (Kind::Session, "never")] {
        store.reserve("a", kind, of, 1, &QUOTA).await.unwrap().unwrap().keep();
    }
    store.collect(Duration::ZERO, false).await.unwrap();
    expected().await;
    // A reservation that nobody keeps.
    drop(store.reserve("a", Kind::Session, "dropped", 1, &QUOTA).await.unwrap().unwrap());
    drop(store.reserve("a", Kind::Session, "s", 1, &QUOTA).await.unwrap().unwrap());
    tokio::time::sleep(Duration::from_millis(300)).await;
    expected().await;
    // A store of the format before has none.
    fs::remove_dir_all(folder.path().join("index")).unwrap();
    let old = folder.path().join("session/a/old");
    fs::create_dir_all(&old).unwrap();
    fs::write(old.join("closed"), "closed").unwrap();
    fs::write(folder.path().join("format"), "moldline store 1").unwrap();
    let place = folder.path().to_str().unwrap();
    Store::open(place).await.unwrap();
    expected().await;
    assert_eq!(fs::read_to_string(folder.path().join("format")).unwrap(), "moldline store 2");
    assert_eq!(store.session("a", "old").await.unwrap(), None);
    assert!(store.closed_session("a", "old").await.unwrap().is_some());
}

#[tokio::test]
async fn sharing_leaves_grants_for_those_who_are_named_last() {
    let (folder, store) = folder().await;
    let tenants = |of: std::ops::Range<usize>| Shared::Tenants(of.map(|k| format!("tenant-{k}")).collect());
    let id = store.put_setup(&files("content")).await.unwrap();
    let steps =
        [tenants(0..50), tenants(40..60), Shared::Public, tenants(0..2), Shared::Private, tenants(7..8)];
    for (number, shared) in (1..).zip(steps) {
        store.put_access("owner", &id, number, &access(shared.clone())).await.unwrap();
        let names = match &shared {
            Shared::Private => 0,
            Shared::Public => 1,
            Shared::Tenants(tenants) => tenants.len(),
        };
        let grants = folder.path().join("grant");
        assert_eq!(if grants.exists() { objects(&grants).len() } else { 0 }, names, "{shared:?}");
        for k in 0..60 {
            let tenant = format!("tenant-{k}");
            let expected = match &shared {
                Shared::Private => false,
                Shared::Public => true,
                Shared::Tenants(tenants) => tenants.contains(&tenant),
            };
            assert_eq!(store.granted(&tenant, &id).await.unwrap().is_some(), expected, "{tenant}");
        }
    }
}

#[tokio::test]
async fn a_writer_that_slept_through_many_generations_loses() {
    let (_folder, on_disk) = folder().await;
    for store in [Store::in_memory(), on_disk] {
        for number in 1..=20 {
            assert!(store.put_session("a", "s", number, &session("setup", 0.0)).await.unwrap());
        }
        assert!(store.session_at("a", "s", 6).await.unwrap().is_none());
        assert!(!store.put_session("a", "s", 6, &session("setup", 1.0)).await.unwrap(), "6 was taken once");
        assert!(!store.put_session("a", "s", 15, &session("setup", 1.0)).await.unwrap());
        store.close_session("a", "s", "").await.unwrap();
        assert!(!store.put_session("a", "s", 21, &session("setup", 1.0)).await.unwrap(), "it is closed");
        assert_eq!(store.session("a", "s").await.unwrap(), None);
    }
}

#[tokio::test]
async fn a_missing_set_up_that_an_owner_or_a_session_needs_is_found() {
    let (folder, store) = folder().await;
    let id = filled(&store).await;
    fs::remove_file(folder.path().join("setup").join(&id)).unwrap();
    let faults = |verified: moldline_store::Verified| -> Vec<String> {
        verified.faults.iter().map(ToString::to_string).collect()
    };
    let found = faults(store.verify().await.unwrap());
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(found.iter().all(|fault| fault.contains(&format!("setup/{id}"))));
    assert!(found[0].contains(&format!("access/a/{id}")) && found[1].contains("session/a/s"), "{found:?}");
    // Nobody needs it once its owner and the session are gone.
    store.close_session("a", "s", "").await.unwrap();
    store.put_access("a", &id, 2, &AccessRecord { owned: false, ..access(Shared::Private) }).await.unwrap();
    assert!(faults(store.verify().await.unwrap()).is_empty());
}

#[tokio::test]
async fn a_store_is_collected_by_one_of_many_servers() {
    let (folder, store) = folder().await;
    let schedule = Schedule { every: Duration::from_secs(3600), grace: Duration::ZERO };
    filled(&store).await;
    store.put_setup(&files("of nobody")).await.unwrap();
    let mut servers = Vec::new();
    for _ in 0..4 {
        servers.push(Store::open(folder.path().to_str().unwrap()).await.unwrap());
    }
    let tries = servers.iter().map(|server| server.collect_if_due(schedule));
    let done: Vec<_> =
        futures::future::join_all(tries).await.into_iter().filter_map(Result::unwrap).collect();
    assert_eq!(done.len(), 1);
    assert_eq!(done[0].objects.len(), 3, "{done:?}");
    assert!(store.collect_if_due(schedule).await.unwrap().is_none(), "it is not due");
    assert_eq!(store.verify().await.unwrap().faults, []);
}
