//! Supplies of which tenants take a share before they use it: bytes of memory, places for uploads, for checks, for operations.
//!
//! A tenant may hold at most three times what stays free (a dynamic threshold, as switches share their buffers): alone three
//! quarters of a supply, beside one that takes as much three sevenths. So there is always a part left for one that comes later,
//! and no share has to be configured. Where there is one tenant only, it may hold everything.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use crate::{
    error::{Code, ServiceError},
    principal::Tenant,
};

/// What a tenant may hold, relative to what stays free.
const THRESHOLD: u64 = 3;

/// Whether several tenants share a supply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sharing {
    /// One tenant may take all.
    Alone,
    /// Something always stays for others.
    Fair,
}

/// Something limited.
#[derive(Debug)]
pub struct Supply {
    /// Such as `bytes of working memory`.
    what: &'static str,
    /// What the operator may change, such as `--memory`.
    option: &'static str,
    limit: u64,
    sharing: Sharing,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    used: u64,
    most: u64,
    of: HashMap<Tenant, u64>,
}

/// A tenant's share of a supply; returned when this is dropped.
#[derive(Debug)]
pub struct Share {
    supply: Arc<Supply>,
    tenant: Tenant,
    amount: u64,
}

impl Supply {
    /// A supply of `limit`. `what` and `option` are for messages: `bytes of working memory`, `--memory`.
    pub fn new(what: &'static str, option: &'static str, limit: u64, sharing: Sharing) -> Arc<Self> {
        Arc::new(Self { what, option, limit, sharing, state: Mutex::default() })
    }

    /// Takes `amount` for `purpose`, such as `the message`.
    ///
    /// # Errors
    /// `ResourceExhausted`: for good if a tenant can never hold as much, else with a time after which to try again.
    pub fn take(
        self: &Arc<Self>,
        tenant: &Tenant,
        purpose: &str,
        amount: u64,
    ) -> Result<Share, ServiceError> {
        let mut share = Share { supply: Arc::clone(self), tenant: tenant.clone(), amount: 0 };
        share.grow(purpose, amount)?;
        Ok(share)
    }

    /// The limit.
    pub fn limit(&self) -> u64 {
        self.limit
    }

    /// What is taken now.
    pub fn used(&self) -> u64 {
        self.lock().used
    }

    /// The most that was ever taken at a time.
    pub fn most(&self) -> u64 {
        self.lock().most
    }

    /// What a tenant holds.
    pub fn of(&self, tenant: &Tenant) -> u64 {
        self.lock().of.get(tenant).copied().unwrap_or_default()
    }

    /// What one tenant may hold if nobody else holds anything.
    pub fn largest(&self) -> u64 {
        match self.sharing {
            Sharing::Alone => self.limit,
            // Whole units: of one place, the whole.
            Sharing::Fair => (self.limit / (1 + THRESHOLD) * THRESHOLD).max(self.limit.min(1)),
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn allows(&self, used: u64, own: u64) -> bool {
        let Some(free) = self.limit.checked_sub(used) else { return false };
        // The first unit of anybody is never refused while there is one.
        self.sharing == Sharing::Alone || own <= free.saturating_mul(THRESHOLD) || own == 1
    }
}

impl Share {
    /// Takes `more` of the supply.
    ///
    /// # Errors
    /// As [`Supply::take`]; the share stays as it is.
    pub fn grow(&mut self, purpose: &str, more: u64) -> Result<(), ServiceError> {
        if more == 0 {
            return Ok(());
        }
        let supply = &self.supply;
        let mut state = supply.lock();
        let own = state.of.get(&self.tenant).copied().unwrap_or_default();
        let (used, after) = (state.used.saturating_add(more), own.saturating_add(more));
        if !supply.allows(used, after) {
            let (what, option, limit) = (supply.what, supply.option, supply.limit);
            let largest = supply.largest();
            if self.amount.saturating_add(more) > largest {
                let message = format!(
                    "{purpose} needs {} {what}, and {largest} is the most for one caller of this server; send less at a \
                     time, or let the server have more ({option})",
                    self.amount.saturating_add(more)
                );
                return Err(ServiceError::new(Code::ResourceExhausted, message));
            }
            let message = format!(
                "{purpose} needs {more} {what}; you hold {own}, and one caller's share of the {limit} is used up for now; \
                 try again later"
            );
            return Err(
                ServiceError::new(Code::ResourceExhausted, message).retry_after(Duration::from_secs(1))
            );
        }
        state.used = used;
        state.most = state.most.max(used);
        state.of.insert(self.tenant.clone(), after);
        drop(state);
        self.amount += more;
        Ok(())
    }

    /// Returns what exceeds `amount`.
    pub fn shrink(&mut self, amount: u64) {
        let excess = self.amount.saturating_sub(amount);
        if excess == 0 {
            return;
        }
        self.amount -= excess;
        let mut state = self.supply.lock();
        state.used -= excess;
        if let Some(own) = state.of.get_mut(&self.tenant) {
            *own -= excess;
            if *own == 0 {
                state.of.remove(&self.tenant);
            }
        }
    }

    /// What it holds.
    pub fn amount(&self) -> u64 {
        self.amount
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        self.shrink(0);
    }
}

#[cfg(test)]
mod tests {
    use moldline_testing::Random;

    use super::*;

    fn tenant(name: &str) -> Tenant {
        Tenant::new(name).unwrap()
    }

    fn below(random: &mut Random, count: usize) -> usize {
        (random.unit() * count as f64) as usize
    }

    #[test]
    fn one_tenant_takes_three_quarters_and_others_get_in() {
        let supply = Supply::new("bytes", "--memory", 1000, Sharing::Fair);
        let (anna, ben) = (tenant("anna"), tenant("ben"));
        let mut all: Vec<Share> = Vec::new();
        while let Ok(share) = supply.take(&anna, "a part", 10) {
            all.push(share);
        }
        assert_eq!(supply.of(&anna), supply.largest());
        assert_eq!(supply.largest(), 750);
        let error = supply.take(&anna, "a part", 10).unwrap_err();
        assert_eq!(error.code, Code::ResourceExhausted);
        assert!(error.retry_after.is_some() && error.message.contains("try again"));
        let _other = supply.take(&ben, "a part", 180).unwrap();
        // What can never be had is refused for good.
        let error = supply.take(&ben, "a monster", 751).unwrap_err();
        assert!(error.retry_after.is_none() && error.message.contains("--memory"), "{error}");
        all.clear();
        assert_eq!((supply.used(), supply.of(&anna)), (180, 0));
        assert_eq!(supply.most(), 930);
    }

    #[test]
    fn a_single_place_can_be_taken_and_a_lonely_tenant_takes_all() {
        let place = Supply::new("checks", "--checks", 1, Sharing::Fair);
        let taken = place.take(&tenant("anna"), "a check", 1).unwrap();
        assert!(place.take(&tenant("ben"), "a check", 1).unwrap_err().retry_after.is_some());
        drop(taken);
        assert!(place.take(&tenant("ben"), "a check", 1).is_ok());
        let alone = Supply::new("places", "--queued", 8, Sharing::Alone);
        let all: Vec<_> = (0..8).map(|_| alone.take(&tenant("anna"), "a place", 1).unwrap()).collect();
        assert!(alone.take(&tenant("anna"), "a place", 1).is_err());
        drop(all);
    }

    #[test]
    fn the_account_is_right_whatever_happens() {
        let supply = Supply::new("bytes", "--memory", 1 << 20, Sharing::Fair);
        let mut random = Random::new(7);
        let tenants: Vec<Tenant> = (0..5).map(|i| tenant(&format!("t{i}"))).collect();
        let mut shares: Vec<Share> = Vec::new();
        for _ in 0..10_000 {
            let amount = below(&mut random, 1 << 18) as u64;
            match below(&mut random, 4) {
                0 | 1 => shares.extend(supply.take(&tenants[below(&mut random, 5)], "a part", amount)),
                2 if !shares.is_empty() => {
                    let index = below(&mut random, shares.len());
                    let _ = shares[index].grow("more", amount);
                    shares[index].shrink(amount);
                }
                _ if !shares.is_empty() => drop(shares.swap_remove(below(&mut random, shares.len()))),
                _ => {}
            }
            let held: u64 = shares.iter().map(Share::amount).sum();
            assert_eq!(supply.used(), held);
            assert!(held <= supply.limit());
            for tenant in &tenants {
                let own: u64 = shares.iter().filter(|share| share.tenant == *tenant).map(Share::amount).sum();
                assert_eq!(supply.of(tenant), own);
                assert!(own <= supply.largest());
            }
        }
        shares.clear();
        assert_eq!(supply.used(), 0);
    }
}
