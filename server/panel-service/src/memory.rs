//! What is kept in memory, by key, within a budget of bytes.

use std::{
    collections::HashMap,
    hash::Hash,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use moldline_service::{CacheStatus, Code, ServiceError};

/// Values that are kept, and the bytes of all that live. What has been used least recently goes first; what is in use stays.
#[derive(Debug)]
pub struct Memory<K, T> {
    state: Mutex<State<K, T>>,
    claimed: Arc<AtomicU64>,
    budget: u64,
}

#[derive(Debug)]
struct State<K, T> {
    kept: HashMap<K, Kept<T>>,
    /// Grows with every use.
    clock: u64,
    hits: u64,
    misses: u64,
    evictions: u64,
}

#[derive(Debug)]
struct Kept<T> {
    value: Arc<T>,
    used: u64,
}

/// Bytes of the budget, given back when it is dropped. A value owns the claim of its own bytes.
#[derive(Debug)]
pub struct Claim {
    claimed: Arc<AtomicU64>,
    bytes: u64,
}

impl Claim {
    /// Gives back what is beyond `bytes`.
    pub fn shrink(&mut self, bytes: u64) {
        let less = self.bytes.saturating_sub(bytes);
        self.bytes -= less;
        self.claimed.fetch_sub(less, Ordering::Relaxed);
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        self.claimed.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

impl<K: Eq + Hash + Clone, T> Memory<K, T> {
    /// Nothing yet, and at most so many bytes.
    pub fn new(budget: u64) -> Self {
        let state = State { kept: HashMap::new(), clock: 0, hits: 0, misses: 0, evictions: 0 };
        Self { state: Mutex::new(state), claimed: Arc::default(), budget }
    }

    /// The value of `key`, if it is kept; it counts as used now.
    pub fn get(&self, key: &K) -> Option<Arc<T>> {
        let mut state = self.lock();
        state.clock += 1;
        let now = state.clock;
        let found = state.kept.get_mut(key).map(|kept| {
            kept.used = now;
            Arc::clone(&kept.value)
        });
        match found {
            Some(_) => state.hits += 1,
            None => state.misses += 1,
        }
        found
    }

    /// Claims `bytes` for `what`, giving up values that nobody uses.
    ///
    /// # Errors
    /// `ResourceExhausted`: for good if it is more than the budget, else with a time after which to try again.
    pub fn claim(&self, what: &str, bytes: u64) -> Result<Claim, ServiceError> {
        let budget = self.budget;
        if bytes > budget {
            let message = format!("{what} needs {bytes} bytes, the server's limit is {budget}");
            return Err(ServiceError::new(Code::ResourceExhausted, message));
        }
        let mut state = self.lock();
        // Claims are made under the lock, and given back at any time.
        while self.claimed.load(Ordering::Relaxed) > budget - bytes {
            let unused = state.kept.iter().filter(|(_, kept)| Arc::strong_count(&kept.value) == 1);
            let Some(oldest) = unused.min_by_key(|(_, kept)| kept.used).map(|(key, _)| key.clone()) else {
                let claimed = self.claimed.load(Ordering::Relaxed);
                let message = format!(
                    "{what} needs {bytes} bytes, and {claimed} of the server's limit of {budget} are in use; try again later"
                );
                let delay = Duration::from_secs(1);
                return Err(ServiceError::new(Code::ResourceExhausted, message).retry_after(delay));
            };
            state.kept.remove(&oldest);
            state.evictions += 1;
        }
        self.claimed.fetch_add(bytes, Ordering::Relaxed);
        Ok(Claim { claimed: Arc::clone(&self.claimed), bytes })
    }

    /// Keeps a value, which owns the claim of its bytes.
    pub fn keep(&self, key: K, value: Arc<T>) {
        let mut state = self.lock();
        state.clock += 1;
        let used = state.clock;
        state.kept.insert(key, Kept { value, used });
    }

    /// What is kept, and the bytes of all that live.
    pub fn status(&self) -> CacheStatus {
        let state = self.lock();
        CacheStatus {
            entries: state.kept.len(),
            bytes: self.claimed.load(Ordering::Relaxed) as usize,
            budget: self.budget as usize,
            hits: state.hits,
            misses: state.misses,
            evictions: state.evictions,
        }
    }

    fn lock(&self) -> MutexGuard<'_, State<K, T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Value(#[allow(dead_code, reason = "held")] Claim);

    fn keep(memory: &Memory<u32, Value>, key: u32, bytes: u64) -> Arc<Value> {
        let value = Arc::new(Value(memory.claim("it", bytes).unwrap()));
        memory.keep(key, Arc::clone(&value));
        value
    }

    #[test]
    fn what_was_used_least_recently_goes_first() {
        let memory = Memory::new(100);
        for key in 0..3 {
            keep(&memory, key, 30);
        }
        assert!(memory.get(&0).is_some());
        keep(&memory, 3, 30);
        assert_eq!([0, 1, 2, 3].map(|key| memory.get(&key).is_some()), [true, false, true, true]);
        let status = memory.status();
        assert_eq!((status.entries, status.bytes, status.evictions), (3, 90, 1));
    }

    #[test]
    fn what_is_in_use_stays_and_counts() {
        let memory = Memory::new(100);
        let used = keep(&memory, 0, 60);
        let error = memory.claim("it", 50).unwrap_err();
        assert_eq!(error.code, Code::ResourceExhausted);
        assert!(
            error.retry_after.is_some() && error.message.contains("60 of the server's limit of 100"),
            "{error}"
        );
        drop(used);
        assert!(memory.claim("it", 50).is_ok());
        assert_eq!(memory.status().bytes, 0);
    }

    #[test]
    fn more_than_the_budget_is_refused_for_good() {
        let error = Memory::<u32, Value>::new(100).claim("it", 101).unwrap_err();
        assert_eq!((error.code, error.retry_after), (Code::ResourceExhausted, None));
        assert_eq!(error.message, "it needs 101 bytes, the server's limit is 100");
    }

    #[test]
    fn a_claim_gives_back_what_it_does_not_need() {
        let memory = Memory::<u32, Value>::new(100);
        let mut claim = memory.claim("it", 80).unwrap();
        claim.shrink(30);
        claim.shrink(50);
        assert_eq!(memory.status().bytes, 30);
        drop(claim);
        assert_eq!(memory.status().bytes, 0);
    }
}
