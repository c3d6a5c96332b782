//! `moldline store`: what can be removed, and whether the rest is whole.

use moldline_service::Store;
use tokio::runtime;

use crate::{
    config,
    local::{Failure, say},
};

/// `moldline store`
pub fn run(options: &config::Store) -> Result<(), Failure> {
    let runtime = runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        match options {
            config::Store::Gc(options) => collect(options).await,
            config::Store::Verify(place) => verify(place).await,
        }
    })
}

async fn collect(options: &config::Collect) -> Result<(), Failure> {
    let store = open(&options.place).await?;
    let collected = store.collect(options.grace, options.dry_run).await?;
    for object in &collected.objects {
        say(object)?;
    }
    let verb = if options.dry_run { "would remove" } else { "removed" };
    say(&format_args!("{verb} {} objects of {} bytes", collected.objects.len(), collected.bytes))
}

async fn verify(place: &config::Place) -> Result<(), Failure> {
    let verified = open(place).await?.verify().await?;
    for fault in &verified.faults {
        say(fault)?;
    }
    say(&format_args!("read {} objects of {} bytes", verified.objects, verified.bytes))?;
    match verified.faults.len() {
        0 => Ok(()),
        faults => Err(Failure::Damaged(faults)),
    }
}

/// Makes none: a place mistyped is no store that is empty and sound.
async fn open(place: &config::Place) -> Result<Store, Failure> {
    Store::open_existing(&place.store).await.map_err(Failure::NoStore)
}
