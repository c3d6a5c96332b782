//! What the service does and holds.

use std::time::Duration;

use crate::principal::Tenant;

/// What the service does and holds: of all tenants to an administrator, of the caller's tenant to others.
#[derive(Clone, Debug, PartialEq)]
pub struct Status {
    /// Of the program.
    pub version: &'static str,
    /// Since the service started.
    pub uptime: Duration,
    /// Whether the figures are those of all tenants.
    pub all_tenants: bool,
    /// Requests that compute.
    pub running: usize,
    /// Requests that wait for it.
    pub queued: usize,
    /// How many may compute.
    pub running_limit: usize,
    /// How many may wait.
    pub queued_limit: usize,
    /// Open sessions.
    pub sessions: usize,
    /// Set-ups in memory.
    pub setups_resident: usize,
    /// Set-ups in the store.
    pub setups_stored: usize,
    /// Bytes in the store.
    pub stored_bytes: u64,
    /// Set-ups in memory.
    pub setup_cache: CacheStatus,
    /// Linearisations in memory.
    pub linearisation_cache: CacheStatus,
    /// What computes or waits for it, longest first.
    pub work: Vec<Work>,
}

/// How full a cache is, and how well it serves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CacheStatus {
    /// Things held.
    pub entries: usize,
    /// Bytes held.
    pub bytes: usize,
    /// Bytes that may be held.
    pub budget: usize,
    /// Requests that found what they looked for. Like the following, since the start and 0 to others than administrators.
    pub hits: u64,
    /// Requests that did not.
    pub misses: u64,
    /// Things dropped to make room.
    pub evictions: u64,
}

/// A piece of work that computes or waits for it.
#[derive(Clone, Debug, PartialEq)]
pub struct Work {
    /// Such as `build`, `deform`, `jvp`.
    pub kind: &'static str,
    /// Whose it is.
    pub tenant: Tenant,
    /// Its set-up, where that is known.
    pub setup: Option<String>,
    /// Its session, if it belongs to one.
    pub session: Option<String>,
    /// Since it came.
    pub age: Duration,
    /// Since it computes; `None` while it waits.
    pub running: Option<Duration>,
    /// The stage that it has come to, where that is known.
    pub stage: Option<&'static str>,
    /// Share of the stage that is done.
    pub fraction: f64,
}
