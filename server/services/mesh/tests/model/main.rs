//! Random sequences of calls, to two servers on one store, against a model: every answer is the one that the model expects.
//!
//! `PROPTEST_CASES=1000 cargo test -p moldline-mesh-service --test model` tries more than the default.
#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

mod world;

use moldline_mesh_service::Store;
use proptest::{prelude::*, test_runner::TestRunner};

use world::{Call, Shared, TENANTS, TITLES, World};

fn shared() -> impl Strategy<Value = Shared> {
    prop_oneof![
        2 => Just(Shared::Private),
        2 => (0..TENANTS.len()).prop_map(Shared::With),
        1 => Just(Shared::Public),
    ]
}

fn call() -> impl Strategy<Value = Call> {
    let title = 0..TITLES.len();
    let request = 0..20_usize;
    let session = any::<usize>();
    prop_oneof![
        4 => (title.clone(), proptest::option::of(shared())).prop_map(|(title, visibility)| Call::Upload { title, visibility }),
        3 => (title.clone(), shared()).prop_map(|(title, visibility)| Call::Share { title, visibility }),
        1 => title.clone().prop_map(|title| Call::Delete { title }),
        6 => (title, request.clone()).prop_map(|(title, request)| Call::Open { title, request }),
        30 => (session, prop_oneof![3 => Just(0_u64), 1 => 1..12_u64], -3..4_i8, request)
            .prop_map(|(session, behind, x, request)| Call::Update { session, behind, x, request }),
        8 => (session, 0..12_usize).prop_map(|(session, back)| Call::Retry { session, back }),
        1 => session.prop_map(|session| Call::Close { session }),
        2 => session.prop_map(|session| Call::Get { session }),
        4 => (session, -3..4_i8).prop_map(|(session, x)| Call::Deform { session, x }),
        2 => Just(Call::List),
        1 => Just(Call::Collect),
        1 => Just(Call::Restart),
    ]
}

#[test]
fn every_answer_is_the_models() {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let cases = std::env::var("PROPTEST_CASES").ok().and_then(|cases| cases.parse().ok()).unwrap_or(24);
    let config = ProptestConfig {
        cases,
        failure_persistence: None,
        max_shrink_iters: 200,
        ..ProptestConfig::default()
    };
    let calls = proptest::collection::vec((0..2_usize, 0..TENANTS.len(), call()), 1..120);
    let run = |(on_disk, calls): (bool, Vec<(usize, usize, Call)>)| {
        runtime.block_on(async {
            let folder = tempfile::tempdir().unwrap();
            let store = match on_disk {
                true => Store::open(folder.path().to_str().unwrap()).await.unwrap(),
                false => Store::in_memory(),
            };
            let mut world = World::new(store).await;
            for (server, tenant, call) in calls {
                world.call(server, tenant, call).await;
            }
            world.check_all().await;
        });
        Ok(())
    };
    TestRunner::new(config).run(&(any::<bool>(), calls), run).unwrap();
}
