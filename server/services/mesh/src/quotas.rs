//! What tenants may hold in the store: one quota for all but a few, which can be exchanged while the service runs.

use std::{
    collections::HashMap,
    sync::{PoisonError, RwLock},
};

use moldline_host::Tenant;
use moldline_store::Quota;

/// Quotas by tenant.
#[derive(Debug)]
pub(crate) struct Quotas {
    usual: Quota,
    special: RwLock<HashMap<Tenant, Quota>>,
}

impl Quotas {
    /// The same for all.
    pub(crate) fn new(usual: Quota) -> Self {
        Self { usual, special: RwLock::default() }
    }

    /// Exchanges those of single tenants; the others have the usual one.
    pub(crate) fn replace(&self, special: HashMap<Tenant, Quota>) {
        *self.special.write().unwrap_or_else(PoisonError::into_inner) = special;
    }

    /// The quota of a tenant.
    pub(crate) fn of(&self, tenant: &Tenant) -> Quota {
        let special = self.special.read().unwrap_or_else(PoisonError::into_inner);
        special.get(tenant).copied().unwrap_or(self.usual)
    }
}
