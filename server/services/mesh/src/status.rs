//! Status of the service.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use moldline_host::{CacheStatus, Principal, Role, ServiceError, Tenant, Work};
use moldline_store::{Health, Store, StoreError, Survey};

use crate::service::Service;

/// Load and contents of the service: of all tenants for administrators, of the caller's tenant for others.
#[derive(Clone, Debug, PartialEq)]
pub struct Status {
    /// Version of the program.
    pub version: &'static str,
    /// Time since the start.
    pub uptime: Duration,
    /// Whether the figures are of all tenants.
    pub all_tenants: bool,
    /// Running tasks.
    pub running: usize,
    /// Waiting tasks.
    pub queued: usize,
    /// Most running tasks.
    pub running_limit: usize,
    /// Most waiting tasks.
    pub queued_limit: usize,
    /// Open sessions.
    pub sessions: usize,
    /// Set-ups in memory.
    pub setups_resident: usize,
    /// Set-ups that somebody owns.
    pub setups_stored: usize,
    /// Bytes of set-ups and sessions, as they count for their tenants.
    pub stored_bytes: u64,
    /// The cache of set-ups.
    pub setup_cache: CacheStatus,
    /// The cache of linearisations.
    pub linearisation_cache: CacheStatus,
    /// Running and waiting tasks, oldest first.
    pub work: Vec<Work>,
}

impl Service {
    /// Whether the store can be used, for readiness. Cheap: it is looked at once a second at most.
    ///
    /// # Errors
    /// `Vanished` if it is gone or another one, `Full`, `ReadOnly`, `Unavailable` if it does not answer.
    pub async fn store_health(&self) -> Result<Health, StoreError> {
        self.store.health().await
    }

    /// The current status.
    ///
    /// # Errors
    /// `Unavailable` if the store does not answer.
    pub async fn status(&self, caller: &Principal) -> Result<Status, ServiceError> {
        match caller.role >= Role::Admin {
            true => Ok(self.status_with(None, self.store.survey().await?)),
            false => {
                let usage = self.store.usage(caller.tenant.as_str()).await?;
                let survey = Survey {
                    setups: usage.setups.count,
                    sessions: usage.sessions.count,
                    bytes: usage.setups.and(usage.sessions).bytes,
                };
                Ok(self.status_with(Some(&caller.tenant), survey))
            }
        }
    }

    /// The status of all tenants, for metrics: without waiting for a large store, of which it has the last figures.
    pub async fn figures(&self) -> Status {
        self.status_with(None, self.figures.of(&self.store).await)
    }

    fn status_with(&self, own: Option<&Tenant>, survey: Survey) -> Status {
        let work = self.pool.work(own);
        let running = work.iter().filter(|work| work.running.is_some()).count();
        let mut setup_cache = self.setups.status();
        let mut linearisation_cache = self.linearisations.status();
        if let Some(tenant) = own {
            // Nothing about other tenants: neither what they hold nor how often they ask.
            let (entries, bytes) = self.linearisations.of_group(tenant.as_str());
            linearisation_cache =
                CacheStatus { entries, bytes, budget: linearisation_cache.budget, ..CacheStatus::default() };
            setup_cache = CacheStatus { budget: setup_cache.budget, ..CacheStatus::default() };
        }
        let limits = self.pool.limits();
        Status {
            version: env!("CARGO_PKG_VERSION"),
            uptime: self.started.elapsed(),
            all_tenants: own.is_none(),
            running,
            queued: work.len() - running,
            running_limit: limits.running,
            queued_limit: limits.queued,
            sessions: survey.sessions,
            setups_resident: setup_cache.entries,
            setups_stored: survey.setups,
            stored_bytes: survey.bytes,
            setup_cache,
            linearisation_cache,
            work,
        }
    }
}

/// Figures of the store. They are made anew in the background when they are asked for, but in one of twenty parts of the time
/// at most.
#[derive(Debug, Default)]
pub(crate) struct Figures(Mutex<Last>);

#[derive(Debug, Default)]
struct Last {
    survey: Survey,
    /// When it was made, and how long that took.
    made: Option<(Instant, Duration)>,
    running: bool,
}

impl Figures {
    /// How long a survey is waited for.
    const PATIENCE: Duration = Duration::from_millis(10);

    async fn of(self: &Arc<Self>, store: &Store) -> Survey {
        let due = {
            let mut last = self.lock();
            let due = !last.running && last.made.is_none_or(|(at, took)| at.elapsed() >= 20 * took);
            last.running |= due;
            due
        };
        if due {
            let (figures, store) = (Arc::clone(self), store.clone());
            let survey = tokio::spawn(async move {
                let began = Instant::now();
                let survey = store.survey().await;
                let mut last = figures.lock();
                last.running = false;
                last.made = Some((Instant::now(), began.elapsed()));
                match survey {
                    Ok(survey) => last.survey = survey,
                    Err(error) => tracing::warn!(%error, "the figures of the store are old"),
                }
            });
            // It goes on by itself.
            let _ = tokio::time::timeout(Self::PATIENCE, survey).await;
        }
        self.lock().survey
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Last> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
