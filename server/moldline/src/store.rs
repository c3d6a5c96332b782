//! `moldline store`: garbage collection and verification of a store; how a server keeps its store.

use std::time::Duration;

use clap::{Args, Subcommand};
use moldline_mesh_service::{Schedule, Store, StoreError};
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

/// How a server keeps its store.
#[derive(Clone, Debug, Args)]
pub struct Keeping {
    /// Refuse to begin an empty store where there is none
    #[arg(long, env = "MOLDLINE_EXISTING_STORE")]
    pub existing_store: bool,
    /// Time between collections of what nobody can reach any more, as in `30m` or `6h`, for all servers on the store together;
    /// `0s` for none but by `moldline store gc`
    #[arg(long, env = "MOLDLINE_COLLECT_EVERY", default_value = "1h", value_parser = values::duration, value_name = "TIME")]
    pub collect_every: Duration,
    /// What a collection leaves alone: objects younger than this, as in `24h`; an hour at least
    #[arg(long, env = "MOLDLINE_COLLECT_GRACE", default_value = "24h", value_parser = grace, value_name = "TIME")]
    pub collect_grace: Duration,
}

impl Keeping {
    /// Opens the store of a server.
    ///
    /// # Errors
    /// If it cannot be reached, is no store, or does not exist and must.
    pub async fn open(&self, place: &str) -> Result<Store, StoreError> {
        match self.existing_store {
            true => Store::open_existing(place).await,
            false => Store::open(place).await,
        }
    }

    /// Starts collecting, on a schedule, for as long as the runtime lives.
    pub fn start(&self, store: Store) {
        if !self.collect_every.is_zero() {
            let schedule = Schedule { every: self.collect_every, grace: self.collect_grace };
            tokio::spawn(store.collect_by_itself(schedule));
        }
    }
}

/// A grace period that is safe under running servers.
fn grace(text: &str) -> Result<Duration, String> {
    match values::duration(text)? {
        grace if grace < Duration::from_secs(3600) => {
            Err("it is less than an hour, which an upload may take".to_owned())
        }
        grace => Ok(grace),
    }
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
