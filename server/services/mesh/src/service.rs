//! The service: its state, and what all its methods share. The methods are in `setups`, `sessions`, `derivatives`, `checks` and
//! `status`.

use std::{collections::HashMap, sync::Arc, time::Instant};

use futures::{
    Stream, StreamExt, TryStreamExt, future,
    stream::{self, Iter},
};
use moldline_check::Report;
use moldline_host::{
    Cache, Code, ComputePool, Flights, PoolLimits, Principal, Product, ServiceError, Supply, Task, Tenant,
    shorten,
};
use moldline_store::{Excess, Quota, Store};

use crate::{
    access::{Listed, Page},
    limits::Limits,
    linearisation::Linearised,
    quotas::Quotas,
    session_index::SessionIndex,
    setup_cache::{SetupCache, StoredSetup},
    setup_id::SetupId,
    status::Figures,
};

/// Records read from the store at a time.
pub(crate) const AT_ONCE: usize = 32;

/// The mesh service, shared by all transports.
#[derive(Debug)]
pub struct Service {
    pub(crate) limits: Limits,
    pub(crate) quotas: Quotas,
    pub(crate) started: Instant,
    pub(crate) store: Store,
    pub(crate) pool: Arc<ComputePool>,
    /// Places of uploads.
    pub(crate) uploads: Arc<Supply>,
    pub(crate) setups: SetupCache,
    pub(crate) sessions: SessionIndex,
    pub(crate) figures: Arc<Figures>,
    /// Linearisations by tenant and id.
    pub(crate) linearisations: Arc<Cache<(Tenant, String), Linearised>>,
    /// Linearisations that are being computed for products.
    pub(crate) linearising: Flights<(Tenant, String), Linearised>,
    /// Places of checks.
    pub(crate) check_places: Arc<Supply>,
    /// Checks in progress, by set-up and request.
    pub(crate) checks: Flights<(SetupId, String), Product<Report>>,
}

impl Service {
    /// A service that keeps everything in memory; nothing outlives it.
    ///
    /// # Errors
    /// If the operating system cannot start the threads.
    pub fn new(pool: PoolLimits, limits: Limits) -> Result<Self, rayon::ThreadPoolBuildError> {
        Self::with_store(Store::in_memory(), pool, limits)
    }

    /// A service on a store, which other services may use as well.
    ///
    /// # Errors
    /// If the operating system cannot start the threads.
    pub fn with_store(
        store: Store,
        pool: PoolLimits,
        limits: Limits,
    ) -> Result<Self, rayon::ThreadPoolBuildError> {
        let sharing = limits.sharing;
        let memory = Supply::new("bytes of working memory", "--memory", limits.memory, sharing);
        let pool = Arc::new(ComputePool::sharing(pool, limits.load, sharing, memory)?);
        Ok(Self {
            started: Instant::now(),
            uploads: Supply::new("uploads at a time", "--uploads", limits.uploads as u64, sharing),
            setups: SetupCache::new(store.clone(), Arc::clone(&pool), &limits),
            sessions: SessionIndex::new(store.clone()),
            figures: Arc::default(),
            linearisations: Arc::new(Cache::new(limits.linearisation_bytes as u64)),
            linearising: Flights::default(),
            check_places: Supply::new("checks at a time", "--checks", limits.checks as u64, sharing),
            checks: Flights::default(),
            quotas: Quotas::new(limits.quota()),
            pool,
            store,
            limits,
        })
    }

    /// The limits in force.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Gives single tenants quotas of their own in place of those before; the others have that of the limits. What a tenant
    /// holds already stays, also beyond its quota.
    pub fn set_quotas(&self, special: HashMap<Tenant, Quota>) {
        self.quotas.replace(special);
    }

    /// The working memory.
    pub fn memory(&self) -> &Arc<Supply> {
        self.pool.memory()
    }

    /// Whether the pool gets work done.
    ///
    /// # Errors
    /// As [`ComputePool::moving`].
    pub fn moving(&self) -> Result<(), String> {
        self.pool.moving()
    }

    /// Number of running and waiting tasks.
    pub fn load(&self) -> usize {
        self.pool.load()
    }

    /// A task in a session.
    pub(crate) fn task(
        &self,
        kind: &'static str,
        caller: &Principal,
        setup: &StoredSetup,
        session_id: &str,
    ) -> Task {
        Task {
            kind,
            tenant: caller.tenant.clone(),
            setup: Some(setup.id.to_string()),
            session: Some(session_id.to_owned()),
            memory: 0,
        }
    }

    /// Rejects a request id that is too long.
    pub(crate) fn check_request_id(&self, request_id: &str) -> Result<(), ServiceError> {
        let (length, limit) = (request_id.len(), self.limits.request_id_bytes);
        if length <= limit {
            return Ok(());
        }
        Err(ServiceError::invalid("request_id", format!("{length} bytes are more than the limit of {limit}")))
    }

    /// The error that a tenant holds as much as it may. `more`: bytes that were to be added.
    pub(crate) fn exceeds(quota: Quota, excess: Excess, more: u64) -> ServiceError {
        let Quota { setups, sessions, bytes } = quota;
        let message = match excess {
            Excess::Sessions(open) => {
                format!("{open} of your sessions are open, and the limit is {sessions}; close some")
            }
            Excess::Setups(held) => {
                format!("you have {held} set-ups, and the limit is {setups}; delete some")
            }
            Excess::Bytes(held) => format!(
                "your set-ups and sessions have {held} bytes, and {more} more exceed the limit of {bytes}; delete some"
            ),
            Excess::Deleted(held) => format!(
                "{} set-ups of {} bytes that you deleted are not collected yet, which is the limit; wait for the next \
                 collection of the store",
                held.count, held.bytes
            ),
        };
        ServiceError::new(Code::ResourceExhausted, message)
    }

    /// As many of `entries` as fit a page.
    pub(crate) async fn listed<T>(
        &self,
        page: &Page,
        entries: impl Stream<Item = Result<Option<T>, ServiceError>>,
        name: impl Fn(&T) -> String,
    ) -> Result<Listed<T>, ServiceError> {
        let size = if page.size == 0 { self.limits.page } else { page.size.min(self.limits.page) };
        let found = entries.try_filter_map(future::ok).take(size + 1);
        let mut entries: Vec<T> = found.try_collect().await?;
        let more = entries.len() > size;
        entries.truncate(size);
        let next = entries.last().filter(|_| more).map(name);
        Ok(Listed { entries, next })
    }
}

/// The hash by which a repeated request is recognised.
pub(crate) fn request_hash(request: &[&str]) -> String {
    let mut hasher = blake3::Hasher::new();
    for part in request {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part.as_bytes());
    }
    hasher.finalize().to_hex().to_string()
}

/// The error that a request id named another request before.
pub(crate) fn taken(request_id: &str) -> ServiceError {
    let request_id = shorten(request_id);
    let text = format!("`{request_id}` named a request with other content before; choose a new one");
    ServiceError::new(Code::AlreadyExists, "").at("request_id", text)
}

/// The names from the first one of a page on.
pub(crate) fn after(
    names: impl IntoIterator<Item = String>,
    page: &Page,
) -> Iter<impl Iterator<Item = String>> {
    let token = page.token.clone();
    stream::iter(names.into_iter().filter(move |name| *name > token))
}
