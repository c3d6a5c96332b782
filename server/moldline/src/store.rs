//! `moldline store`: garbage collection and verification of a store.

use std::time::Duration;

use clap::{Args, Subcommand};
use moldline_mesh_service::Store;
use tokio::runtime;

use crate::{failure::Failure, output::say, values};

/// Commands on a store.
#[derive(Debug, Subcommand)]
pub enum StoreCommand {
    /// Remove unreachable objects: set-ups that all owners have deleted, closed sessions, old generations, left-overs
    Gc(Collect),
    /// Read all objects and list the damaged ones
    Verify(Place),
}

/// The location of a store.
#[derive(Debug, Args)]
pub struct Place {
    /// The store, as given to `moldline serve`
    #[arg(long, env = "MOLDLINE_STORE", default_value = "moldline-store", value_name = "PLACE")]
    pub store: String,
}

/// Options of `moldline store gc`.
#[derive(Debug, Args)]
pub struct Collect {
    /// The store.
    #[command(flatten)]
    pub place: Place,
    /// List the objects that would be removed, and remove none
    #[arg(long)]
    pub dry_run: bool,
    /// Keep objects younger than this, as in `90s`, `30m`, `24h`, `7d`; less than an hour is safe only while no server
    /// uses the store
    #[arg(long, default_value = "24h", value_parser = values::duration)]
    pub grace: Duration,
}

/// `moldline store`
pub fn run(options: &StoreCommand) -> Result<(), Failure> {
    let runtime = runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        match options {
            StoreCommand::Gc(options) => collect(options).await,
            StoreCommand::Verify(place) => verify(place).await,
        }
    })
}

async fn collect(options: &Collect) -> Result<(), Failure> {
    let store = open(&options.place).await?;
    let collected = store.collect(options.grace, options.dry_run).await?;
    for object in &collected.objects {
        say(object)?;
    }
    let verb = if options.dry_run { "would remove" } else { "removed" };
    say(&format_args!("{verb} {} objects of {} bytes", collected.objects.len(), collected.bytes))
}

async fn verify(place: &Place) -> Result<(), Failure> {
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

/// Opens a store that exists: a mistyped location must not pass for an empty, sound store.
async fn open(place: &Place) -> Result<Store, Failure> {
    Store::open_existing(&place.store).await.map_err(Failure::NoStore)
}
