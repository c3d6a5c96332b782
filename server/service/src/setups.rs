//! Set-ups by the hash of their content: in memory while they are used, in the store for good.

use std::{
    fmt, future,
    sync::Arc,
    time::{Duration, Instant},
};

use moldline_deform::{Derived, Setup};
use moldline_setup::{BUILD, decode_derived, encode_derived};
use moldline_store::Store;

use crate::{
    cache::Cache,
    error::{Code, ServiceError},
    flight::{Flights, Joined, Reports},
    limits::Limits,
    pool::{ComputePool, Task},
    principal::Tenant,
    progress::{Progress, Reporter},
    read::{self, Content, Read},
    status::CacheStatus,
};

/// Name of a set-up: the hash of its content in hexadecimal digits.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SetupId(String);

impl SetupId {
    /// Of the digits.
    pub(crate) fn new(digits: String) -> Self {
        Self(digits)
    }

    /// Whether a caller's text can be the name of a set-up.
    pub(crate) fn is_one(text: &str) -> bool {
        text.len() == 2 * blake3::OUT_LEN
            && text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
    }

    /// The digits.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for SetupId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// A set-up that is built.
#[derive(Debug)]
pub struct StoredSetup {
    /// Its name.
    pub id: SetupId,
    /// The user's title of it.
    pub name: String,
    /// What the engine made of it.
    pub engine: Arc<Setup>,
    /// Values of the scalar outputs for the reference mesh.
    pub functions: Vec<f64>,
    /// How long the engine took.
    pub build_time: Duration,
}

impl StoredSetup {
    /// What the set-up found, as a JSON document.
    pub fn report_json(&self) -> String {
        moldline_setup::report_json(self.engine.report()).to_string()
    }
}

/// Set-ups in memory: built or loaded once however many ask, and held within a budget.
#[derive(Debug)]
pub struct Setups {
    store: Store,
    pool: Arc<ComputePool>,
    limits: Limits,
    held: Arc<Cache<String, StoredSetup>>,
    flights: Flights<String, StoredSetup>,
}

impl Setups {
    /// None in memory yet.
    pub fn new(store: Store, pool: Arc<ComputePool>, limits: &Limits) -> Self {
        let held = Arc::new(Cache::new(limits.setup_bytes, |setup: &StoredSetup| {
            // Linearisations hold it too.
            Arc::strong_count(&setup.engine) > 1
        }));
        Self { store, pool, limits: limits.clone(), held, flights: Flights::default() }
    }

    /// The set-up of what has been read, made now if it is not in memory.
    ///
    /// # Errors
    /// As the engine has them, or if the pool is full.
    pub async fn of_content(
        &self,
        tenant: &Tenant,
        content: Content,
        mut tell: impl FnMut(Progress),
    ) -> Result<Arc<StoredSetup>, ServiceError> {
        self.make_room()?;
        let id = content.id.to_string();
        let (store, pool, tenant) = (self.store.clone(), Arc::clone(&self.pool), tenant.clone());
        let Content { id: name, read, .. } = content;
        let work = |reports: Reports<StoredSetup>| async move {
            make(&store, &pool, tenant, name, future::ready(Ok(read)), reports).await
        };
        match self.flights.join(id.clone(), || self.held.get(&id), work, self.land(&id)) {
            Joined::Found(setup) => {
                // The same steps, whoever built it.
                moldline_deform::Stage::OF_SETUP
                    .iter()
                    .for_each(|&stage| tell(Progress::of_stage(stage, 1.0)));
                Ok(setup)
            }
            Joined::Following(follower) | Joined::Started(follower) => follower.land(tell).await,
        }
    }

    /// The set-up of that name, loaded now if it is not in memory; `None` if the store has none.
    ///
    /// # Errors
    /// If the store does not answer, its objects are damaged, or the pool is full.
    pub async fn named(&self, tenant: &Tenant, id: &str) -> Result<Option<Arc<StoredSetup>>, ServiceError> {
        if let Some(setup) = self.held.get(&id.to_owned()) {
            return Ok(Some(setup));
        }
        self.make_room()?;
        let Some(files) = self.store.setup(id).await? else { return Ok(None) };
        let (store, pool) = (self.store.clone(), Arc::clone(&self.pool));
        let (tenant, limits) = (tenant.clone(), self.limits.clone());
        let task = Task { kind: "load", tenant: tenant.clone(), setup: Some(id.to_owned()), session: None };
        let name = SetupId::new(id.to_owned());
        let work = |reports: Reports<StoredSetup>| async move {
            let read = async { Ok(pool.run(task, move |_| read::stored(files, &limits)).await?.value) };
            make(&store, &pool, tenant, name, read, reports).await
        };
        let key = id.to_owned();
        match self.flights.join(key.clone(), || self.held.get(&key), work, self.land(id)) {
            Joined::Found(setup) => Ok(Some(setup)),
            Joined::Following(follower) | Joined::Started(follower) => follower.land(|_| {}).await.map(Some),
        }
    }

    /// How full the memory for set-ups is.
    pub fn status(&self) -> CacheStatus {
        self.held.status()
    }

    /// Refuses another one while those in use fill the memory.
    fn make_room(&self) -> Result<(), ServiceError> {
        if self.held.shrink() {
            return Ok(());
        }
        let CacheStatus { bytes, budget, .. } = self.held.status();
        let message =
            format!("set-ups in use have {bytes} bytes, and the limit is {budget}; try again later");
        Err(ServiceError::new(Code::ResourceExhausted, message).retry_after(Duration::from_secs(1)))
    }

    fn land(&self, id: &str) -> impl FnOnce(&Arc<StoredSetup>) + Send + 'static {
        let (held, id) = (Arc::clone(&self.held), id.to_owned());
        move |setup| held.insert(id, "", Arc::clone(setup), setup.engine.bytes())
    }
}

/// Builds a set-up as it is `read`; from what this build of the engine derived of it before, if that is stored, and stores it if not.
async fn make(
    store: &Store,
    pool: &ComputePool,
    tenant: Tenant,
    id: SetupId,
    read: impl Future<Output = Result<Read, ServiceError>>,
    reports: Reports<StoredSetup>,
) -> Result<StoredSetup, ServiceError> {
    let (read, stored) = tokio::join!(read, store.derived(id.as_str(), BUILD));
    let Read { name, input } = read?;
    let stored = stored.unwrap_or_else(|error| {
        tracing::warn!(%error, "building the set-up anew");
        None
    });
    let stored_as = id.clone();
    let task = Task { kind: "build", tenant, setup: Some(id.to_string()), session: None };
    let (setup, derived) = pool
        .run(task, move |ticket| {
            let start = Instant::now();
            let reporter = Reporter::new(ticket.cancellation().clone(), |progress| {
                ticket.progress(&progress);
                reports.tell(progress);
            });
            let known = stored.and_then(|stored| Known::read(&stored));
            let (engine, build_time, derived) = match known {
                Some(Known { build_time, derived }) => {
                    (Setup::restore(input, derived, &reporter)?, build_time, None)
                }
                None => {
                    let engine = Setup::build(input, &reporter)?;
                    let build_time = start.elapsed();
                    let known = Known { build_time, derived: engine.derived() };
                    (engine, build_time, Some(known.write()))
                }
            };
            let functions = engine.reference_functions();
            let verb = if derived.is_some() { "built a set-up" } else { "loaded a set-up" };
            tracing::info!(setup = %id, seconds = start.elapsed().as_secs_f64(), "{verb}");
            Ok((StoredSetup { id, name, engine: Arc::new(engine), functions, build_time }, derived))
        })
        .await?
        .value;
    if let Some(derived) = derived
        && let Err(error) = store.put_derived(stored_as.as_str(), BUILD, derived).await
    {
        // Only time is lost: it can be derived again.
        tracing::warn!(%error, "cannot store what was derived of a set-up");
    }
    Ok(setup)
}

/// What is stored of a build.
struct Known {
    build_time: Duration,
    derived: Derived,
}

impl Known {
    fn read(bytes: &[u8]) -> Option<Self> {
        let (nanoseconds, derived) = bytes.split_first_chunk::<8>()?;
        let build_time = Duration::from_nanos(u64::from_le_bytes(*nanoseconds));
        Some(Self { build_time, derived: decode_derived(derived)? })
    }

    fn write(self) -> Vec<u8> {
        let nanoseconds = u64::try_from(self.build_time.as_nanos()).unwrap_or(u64::MAX);
        [&nanoseconds.to_le_bytes()[..], &encode_derived(&self.derived)].concat()
    }
}
