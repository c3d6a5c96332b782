//! Sequences of calls, six bytes each, to two servers on one store: every answer is the one that a model expects.
#![no_main]
#![allow(clippy::unwrap_used, reason = "the model is one of tests")]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use moldline_mesh_service::Store;
use tokio::runtime::{Builder, Runtime};

#[path = "../../../server/services/mesh/tests/model/world.rs"]
mod world;

use world::{Call, Shared, TENANTS, TITLES, World};

/// Longest sequence.
const CALLS: usize = 100;

static RUNTIME: LazyLock<Runtime> =
    LazyLock::new(|| Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap());

fn shared(byte: u8) -> Shared {
    match byte % 5 {
        0 | 1 => Shared::Private,
        2 | 3 => Shared::With(usize::from(byte / 5) % TENANTS.len()),
        _ => Shared::Public,
    }
}

/// The call of a few bytes, updates most often.
fn call([kind, a, b, c]: [u8; 4]) -> Call {
    let (title, request, session) = (usize::from(a) % TITLES.len(), usize::from(b) % 20, usize::from(a));
    let x = i8::try_from(c % 7).unwrap() - 3;
    match kind % 64 {
        0..4 => Call::Upload { title, visibility: (b > 127).then(|| shared(c)) },
        4..6 => Call::Share { title, visibility: shared(c) },
        6..10 => Call::Open { title, request },
        10..46 => {
            Call::Update { session, behind: if b > 200 { u64::from(b - 200) % 12 } else { 0 }, x, request }
        }
        46..54 => Call::Retry { session, back: usize::from(b) % 12 },
        54 => Call::Delete { title },
        55 => Call::Close { session },
        56..58 => Call::Get { session },
        58..61 => Call::Deform { session, x },
        61 => Call::List,
        62 => Call::Collect,
        _ => Call::Restart,
    }
}

fuzz_target!(|input: &[u8]| {
    RUNTIME.block_on(async {
        let mut world = World::new(Store::in_memory()).await;
        for &[kind, a, b, c, server, tenant] in input.as_chunks::<6>().0.iter().take(CALLS) {
            let (server, tenant) = (usize::from(server) % 2, usize::from(tenant) % TENANTS.len());
            world.call(server, tenant, call([kind, a, b, c])).await;
        }
        world.check_all().await;
    });
});
