//! Leases: a task is done by one server of many. A lease is a row of generations; whoever writes the next one has it.

use std::time::{Duration, Instant, SystemTime};

use serde::{Deserialize, Serialize};

use crate::{error::StoreError, rows::Generation, store::Store};

/// A lease in the store.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct LeaseRecord {
    holder: String,
    /// Others may take it after this time.
    until: SystemTime,
    /// When the task was last completed.
    done: Option<SystemTime>,
}

/// The right to do a task for some time.
#[derive(Debug)]
pub(crate) struct Lease {
    store: Store,
    row: String,
    number: u64,
    record: LeaseRecord,
    term: Duration,
    /// The holder stops before others may begin.
    ends: Instant,
}

impl Store {
    /// Takes the lease of a task that is due, unless another one has it.
    pub(crate) async fn lease(
        &self,
        task: &str,
        term: Duration,
        every: Duration,
    ) -> Result<Option<Lease>, StoreError> {
        let row = format!("lease/{task}");
        let latest: Option<Generation<LeaseRecord>> = self.latest(&row).await?;
        let (number, done) = match &latest {
            Some(latest) => (latest.number, latest.record.done),
            None => (0, None),
        };
        let now = SystemTime::now();
        // A clock that was set back must not stop the task for good.
        let within = |until: SystemTime, longest: Duration| until > now && until < now + longest;
        let held = latest.is_some_and(|latest| within(latest.record.until, 2 * term));
        let early = done.is_some_and(|done| within(done + every, 2 * every));
        if held || early {
            return Ok(None);
        }
        let holder = uuid::Uuid::new_v4().to_string();
        let record = LeaseRecord { holder, until: now, done };
        let mut lease = Lease { store: self.clone(), row, number, record, term, ends: Instant::now() };
        Ok(lease.extend(term).await?.then_some(lease))
    }
}

impl Lease {
    /// Whether the task may go on; renews the lease in time.
    pub async fn holds(&mut self) -> Result<bool, StoreError> {
        let left = self.ends.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Ok(false);
        }
        if left < self.term / 2 { self.extend(self.term).await } else { Ok(true) }
    }

    /// Gives the lease back; the task is done.
    pub async fn finish(mut self) -> Result<(), StoreError> {
        self.record.done = Some(SystemTime::now());
        self.extend(Duration::ZERO).await.map(drop)
    }

    async fn extend(&mut self, term: Duration) -> Result<bool, StoreError> {
        let began = Instant::now();
        self.record.until = SystemTime::now() + term;
        if !self.store.append(&self.row, self.number + 1, &self.record).await? {
            return Ok(false);
        }
        self.number += 1;
        self.ends = began + term.mul_f64(0.8);
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOUR: Duration = Duration::from_secs(3600);

    #[tokio::test]
    async fn one_of_many_gets_a_lease_and_the_next_when_it_ends_or_is_due() {
        let store = Store::in_memory();
        let term = Duration::from_millis(300);
        let tries = futures::future::join_all((0..16).map(|_| store.lease("task", term, HOUR))).await;
        let mut got: Vec<Lease> = tries.into_iter().filter_map(Result::unwrap).collect();
        assert_eq!(got.len(), 1);
        let mut first = got.remove(0);
        assert!(first.holds().await.unwrap());
        assert!(store.lease("task", term, HOUR).await.unwrap().is_none());
        // Renewed, it is held on.
        for _ in 0..6 {
            tokio::time::sleep(term / 4).await;
            assert!(first.holds().await.unwrap());
            assert!(store.lease("task", term, HOUR).await.unwrap().is_none());
        }
        // A holder that sleeps loses it, and sees so before another one has it.
        tokio::time::sleep(term + Duration::from_millis(50)).await;
        assert!(!first.holds().await.unwrap());
        let second = store.lease("task", term, HOUR).await.unwrap().unwrap();
        second.finish().await.unwrap();
        assert!(store.lease("task", term, HOUR).await.unwrap().is_none(), "it was done just now");
        tokio::time::sleep(Duration::from_millis(20)).await;
        assert!(store.lease("task", term, Duration::from_millis(10)).await.unwrap().is_some(), "it is due");
        assert!(store.backend.list("lease").await.unwrap().len() <= 8);
    }
}
