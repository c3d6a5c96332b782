//! Set-ups in memory while they are in use, loaded from the store or built when they are needed.

use std::{
    future,
    sync::Arc,
    time::{Duration, Instant},
};

use moldline_deform::{Derived, Setup};
use moldline_host::{
    Cache, CacheStatus, Code, ComputePool, Flights, Joined, Progress, Reports, ServiceError, Task, Tenant,
};
use moldline_setup_files::{BUILD, decode_derived, encode_derived};
use moldline_store::Store;

use crate::{
    limits::Limits,
    progress::{progress, reporter},
    read::{self, Content, Read, explained},
    setup_id::SetupId,
};

/// A built set-up.
#[derive(Debug)]
pub struct StoredSetup {
    /// Its id.
    pub id: SetupId,
    /// The user's title.
    pub name: String,
    /// The engine's set-up.
    pub engine: Arc<Setup>,
    /// Values of the scalar outputs for the reference mesh.
    pub functions: Vec<f64>,
    /// Time that the engine took to build it.
    pub build_time: Duration,
}

impl StoredSetup {
    /// Time from its content to the answer, for tenants to which it is new: a bit longer than the build, so that storing it is
    /// covered too.
    pub(crate) fn answer_time(&self) -> Duration {
        self.build_time + self.build_time / 10 + Duration::from_millis(20)
    }

    /// The set-up report as a JSON document.
    pub fn report_json(&self) -> String {
        moldline_setup_files::report_json(self.engine.report()).to_string()
    }
}

/// Set-ups in memory within a budget of bytes, each built or loaded once for all concurrent requests.
#[derive(Debug)]
pub struct SetupCache {
    store: Store,
    pool: Arc<ComputePool>,
    limits: Limits,
    cache: Arc<Cache<String, StoredSetup>>,
    flights: Flights<String, StoredSetup>,
}

impl SetupCache {
    /// An empty cache.
    pub fn new(store: Store, pool: Arc<ComputePool>, limits: &Limits) -> Self {
        // Linearisations share the engine's set-up.
        let in_use = |setup: &StoredSetup| Arc::strong_count(&setup.engine) > 1;
        let cache = Arc::new(Cache::new(limits.setup_bytes as u64).pinning(in_use));
        Self { store, pool, limits: limits.clone(), cache, flights: Flights::default() }
    }

    /// The set-up of an upload, built now if it is not in memory. With `hide`, one that is known already is answered, and
    /// reports, as if it were built now.
    ///
    /// # Errors
    /// Those of the engine, and `ResourceExhausted` if the pool is full.
    pub async fn of_content(
        &self,
        tenant: &Tenant,
        content: Content,
        hide: bool,
        mut tell: impl FnMut(Progress),
    ) -> Result<Arc<StoredSetup>, ServiceError> {
        let began = Instant::now();
        self.make_room()?;
        let id = content.id.to_string();
        let known = hide && self.store.has_derived(&id, BUILD).await.unwrap_or(false);
        let (store, pool, tenant) = (self.store.clone(), Arc::clone(&self.pool), tenant.clone());
        let Content { id: name, read, .. } = content;
        let work = |reports: Reports<StoredSetup>| async move {
            make(&store, &pool, tenant, name, future::ready(Ok(read)), reports).await
        };
        let mut held = Vec::new();
        let setup = match self.flights.join(id.clone(), || self.cache.get(&id), work, self.keep(&id)) {
            Joined::Found(setup) => {
                // The same reports as from a build.
                held.extend(moldline_deform::Stage::OF_SETUP.iter().map(|&stage| progress(stage, 1.0)));
                setup
            }
            Joined::Following(follower) if hide => follower.wait(|step| held.push(step)).await?,
            Joined::Started(follower) if known => follower.wait(|step| held.push(step)).await?,
            Joined::Following(follower) | Joined::Started(follower) => return follower.wait(tell).await,
        };
        let left = match hide {
            true => setup.build_time.saturating_sub(began.elapsed()),
            false => Duration::ZERO,
        };
        let pause = left / (held.len() as u32 + 1);
        for step in held {
            if !pause.is_zero() {
                tokio::time::sleep(pause).await;
            }
            tell(step);
        }
        Ok(setup)
    }

    /// The set-up of that id, loaded now if it is not in memory; `None` if the store has none.
    ///
    /// # Errors
    /// If the store does not answer, its objects are damaged, or the pool is full.
    pub async fn named(&self, tenant: &Tenant, id: &str) -> Result<Option<Arc<StoredSetup>>, ServiceError> {
        if let Some(setup) = self.cache.get(&id.to_owned()) {
            return Ok(Some(setup));
        }
        self.make_room()?;
        let Some(files) = self.store.setup(id).await? else { return Ok(None) };
        let (store, pool) = (self.store.clone(), Arc::clone(&self.pool));
        let (tenant, limits) = (tenant.clone(), self.limits.clone());
        let contents = files.iter().map(|(path, content)| (path.as_str(), &content[..]));
        let memory = read::memory(contents, &self.limits);
        let task =
            Task { kind: "load", tenant: tenant.clone(), setup: Some(id.to_owned()), session: None, memory };
        let name = SetupId::new(id.to_owned());
        let work = |reports: Reports<StoredSetup>| async move {
            let read = async { Ok(pool.run(task, move |_| read::stored(files, &limits)).await?.value) };
            make(&store, &pool, tenant, name, read, reports).await
        };
        let key = id.to_owned();
        match self.flights.join(key.clone(), || self.cache.get(&key), work, self.keep(id)) {
            Joined::Found(setup) => Ok(Some(setup)),
            Joined::Following(follower) | Joined::Started(follower) => follower.wait(|_| {}).await.map(Some),
        }
    }

    /// How full the cache is.
    pub fn status(&self) -> CacheStatus {
        self.cache.status()
    }

    /// Rejects another set-up while those in use fill the budget.
    fn make_room(&self) -> Result<(), ServiceError> {
        if self.cache.shrink() {
            return Ok(());
        }
        let CacheStatus { bytes, budget, .. } = self.cache.status();
        let message =
            format!("set-ups in use have {bytes} bytes, and the limit is {budget}; try again later");
        Err(ServiceError::new(Code::ResourceExhausted, message).retry_after(Duration::from_secs(1)))
    }

    fn keep(&self, id: &str) -> impl FnOnce(&Arc<StoredSetup>) + Send + 'static {
        let (cache, id) = (Arc::clone(&self.cache), id.to_owned());
        move |setup| cache.insert(id, "", Arc::clone(setup), setup.engine.bytes())
    }
}

/// Builds a set-up from what `read` returns. Restores the derived data of this build of the engine if the store has them, and
/// stores them if not.
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
    let task = Task {
        kind: "build",
        tenant,
        setup: Some(id.to_string()),
        session: None,
        memory: input.build_memory(),
    };
    let (setup, derived) = pool
        .run(task, move |ticket| {
            let start = Instant::now();
            let reporter = reporter(ticket.cancellation().clone(), |progress| {
                ticket.progress(&progress);
                reports.tell(progress);
            });
            let known = stored.and_then(|stored| Known::read(&stored));
            let origin = Arc::clone(&input.origin);
            let explain = |error| explained(&origin, error);
            let (engine, build_time, derived) = match known {
                Some(Known { build_time, derived }) => {
                    (Setup::restore(input, derived, &reporter).map_err(explain)?, build_time, None)
                }
                None => {
                    let engine = Setup::build(input, &reporter).map_err(explain)?;
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
        // They can be derived again.
        tracing::warn!(%error, "cannot store the derived data of a set-up");
    }
    Ok(setup)
}

/// The stored result of a build.
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
