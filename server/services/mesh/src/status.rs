//! Status of the service.

use std::time::Duration;

use moldline_host::{CacheStatus, Principal, Role, ServiceError, Work};
use moldline_store::{Health, StoreError};

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
    /// Set-ups in the store.
    pub setups_stored: usize,
    /// Bytes of the set-ups in the store.
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
        let all_tenants = caller.role >= Role::Admin;
        let own = (!all_tenants).then_some(&caller.tenant);
        let work = self.pool.work(own);
        let running = work.iter().filter(|work| work.running.is_some()).count();
        let (setups_stored, stored_bytes, sessions) = match own {
            Some(tenant) => {
                let owned = self.store.owned(tenant.as_str()).await?;
                let bytes = owned.iter().map(|(_, record)| record.bytes).sum();
                (owned.len(), bytes, self.store.sessions(tenant.as_str()).await?.len())
            }
            None => {
                let (setups, bytes) = self.store.size().await?;
                let mut sessions = 0;
                for tenant in self.store.tenants().await? {
                    sessions += self.store.sessions(&tenant).await?.len();
                }
                (setups, bytes, sessions)
            }
        };
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
        Ok(Status {
            version: env!("CARGO_PKG_VERSION"),
            uptime: self.started.elapsed(),
            all_tenants,
            running,
            queued: work.len() - running,
            running_limit: limits.running,
            queued_limit: limits.queued,
            sessions,
            setups_resident: setup_cache.entries,
            setups_stored,
            stored_bytes,
            setup_cache,
            linearisation_cache,
            work,
        })
    }
}
