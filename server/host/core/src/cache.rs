//! An LRU cache of values that can be recomputed or reloaded, within a budget of bytes.

use std::{
    cmp::Reverse,
    collections::HashMap,
    hash::Hash,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use crate::error::{Code, ServiceError};

/// Values by key. The least recently used one is evicted first, from the group that holds most bytes; values in use are never
/// evicted.
///
/// Bytes are counted in one of two ways. [`insert`](Self::insert) counts a finished value for as long as it is cached, even
/// beyond the budget. [`claim`](Self::claim) reserves memory before it is allocated, or fails; a value that owns its
/// [`Claim`] counts for as long as it lives, and is cached by [`keep`](Self::keep).
#[derive(Debug)]
pub struct Cache<K, V> {
    state: Mutex<State<K, V>>,
    claimed: Arc<AtomicU64>,
    budget: u64,
    /// Whether a value is in use although nobody holds its `Arc`.
    pinned: fn(&V) -> bool,
}

#[derive(Debug)]
struct State<K, V> {
    entries: HashMap<K, Entry<V>>,
    /// Increases with every use.
    clock: u64,
    hits: u64,
    misses: u64,
    evictions: u64,
}

#[derive(Debug)]
struct Entry<V> {
    value: Arc<V>,
    group: String,
    /// `None` if the value owns its claim.
    claim: Option<Claim>,
    used: u64,
}

/// Reserved bytes of a budget, released when this is dropped.
#[derive(Debug)]
pub struct Claim {
    claimed: Arc<AtomicU64>,
    bytes: u64,
}

/// How full a cache is, and how well it serves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CacheStatus {
    /// Cached values.
    pub entries: usize,
    /// Bytes of the budget in use.
    pub bytes: usize,
    /// The budget, bytes.
    pub budget: usize,
    /// Requests that found their value. Like the next two, counted from the start; 0 in answers to others than administrators.
    pub hits: u64,
    /// Requests that did not find their value.
    pub misses: u64,
    /// Values dropped to make room.
    pub evictions: u64,
}

impl Claim {
    fn new(claimed: &Arc<AtomicU64>, bytes: u64) -> Self {
        claimed.fetch_add(bytes, Ordering::Relaxed);
        Self { claimed: Arc::clone(claimed), bytes }
    }

    /// Releases what exceeds `bytes`.
    pub fn shrink(&mut self, bytes: u64) {
        let excess = self.bytes.saturating_sub(bytes);
        self.bytes -= excess;
        self.claimed.fetch_sub(excess, Ordering::Relaxed);
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        self.claimed.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

impl<K: Eq + Hash + Clone, V> Cache<K, V> {
    /// An empty cache with a budget in bytes.
    pub fn new(budget: u64) -> Self {
        let state = State { entries: HashMap::new(), clock: 0, hits: 0, misses: 0, evictions: 0 };
        Self { state: Mutex::new(state), claimed: Arc::default(), budget, pinned: |_| false }
    }

    /// Never evicts a value for which `pinned` holds, even if nobody holds its `Arc`.
    #[must_use]
    pub fn pinning(self, pinned: fn(&V) -> bool) -> Self {
        Self { pinned, ..self }
    }

    /// The value of `key`, if it is cached. Not evicted as long as the caller holds it.
    pub fn get(&self, key: &K) -> Option<Arc<V>> {
        let mut state = self.lock();
        let used = state.tick();
        let found = state.entries.get_mut(key).map(|entry| {
            entry.used = used;
            Arc::clone(&entry.value)
        });
        match found {
            Some(_) => state.hits += 1,
            None => state.misses += 1,
        }
        found
    }

    /// Caches a value of `bytes` in place of another of that key, and evicts others until all fit.
    pub fn insert(&self, key: K, group: &str, value: Arc<V>, bytes: usize) {
        let mut state = self.lock();
        let claim = Some(Claim::new(&self.claimed, bytes as u64));
        let replaced = state.insert(key.clone(), group, value, claim);
        let evicted = self.evict(&mut state, self.budget, Some(&key));
        // Large, and so not freed under the lock.
        drop(state);
        drop((replaced, evicted));
    }

    /// Caches a value that owns the claim of its bytes.
    pub fn keep(&self, key: K, value: Arc<V>) {
        self.lock().insert(key, "", value, None);
    }

    /// Reserves `bytes` for `what`, evicting values that are not in use.
    ///
    /// # Errors
    /// `ResourceExhausted`: for good if `bytes` exceed the budget, else with a time after which to try again.
    pub fn claim(&self, what: &str, bytes: u64) -> Result<Claim, ServiceError> {
        let budget = self.budget;
        let Some(rest) = budget.checked_sub(bytes) else {
            let message = format!("{what} needs {bytes} bytes, the server's limit is {budget}");
            return Err(ServiceError::new(Code::ResourceExhausted, message));
        };
        let mut state = self.lock();
        let evicted = self.evict(&mut state, rest, None);
        // Claims begin under the lock, and end at any time.
        let claimed = self.claimed();
        let claim = if claimed <= rest {
            Ok(Claim::new(&self.claimed, bytes))
        } else {
            let message = format!(
                "{what} needs {bytes} bytes, and {claimed} of the server's limit of {budget} are in use; try again later"
            );
            let delay = Duration::from_secs(1);
            Err(ServiceError::new(Code::ResourceExhausted, message).retry_after(delay))
        };
        drop(state);
        drop(evicted);
        claim
    }

    /// Evicts values that are not in use until all fit; whether they do.
    pub fn shrink(&self) -> bool {
        let mut state = self.lock();
        let evicted = self.evict(&mut state, self.budget, None);
        let fits = self.claimed() <= self.budget;
        drop(state);
        drop(evicted);
        fits
    }

    /// How full the cache is.
    pub fn status(&self) -> CacheStatus {
        let state = self.lock();
        CacheStatus {
            entries: state.entries.len(),
            bytes: self.claimed() as usize,
            budget: self.budget as usize,
            hits: state.hits,
            misses: state.misses,
            evictions: state.evictions,
        }
    }

    /// Entries and bytes of one group.
    pub fn of_group(&self, group: &str) -> (usize, usize) {
        let state = self.lock();
        let of = state.entries.values().filter(|entry| entry.group == group);
        of.fold((0, 0), |(count, bytes), entry| (count + 1, bytes + entry.bytes() as usize))
    }

    /// Evicts values other than that of `new` until at most `most` bytes are in use, if it can.
    fn evict(&self, state: &mut State<K, V>, most: u64, new: Option<&K>) -> Vec<Arc<V>> {
        let mut evicted = Vec::new();
        while self.claimed() > most {
            let Some(victim) = state.victim(new, self.pinned) else { break };
            let Some(Entry { value, claim, .. }) = state.entries.remove(&victim) else { break };
            state.evictions += 1;
            match claim {
                Some(_) => evicted.push(value),
                // Its bytes are released with it.
                None => drop(value),
            }
        }
        evicted
    }

    fn claimed(&self) -> u64 {
        self.claimed.load(Ordering::Relaxed)
    }

    fn lock(&self) -> MutexGuard<'_, State<K, V>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<K: Eq + Hash + Clone, V> State<K, V> {
    fn tick(&mut self) -> u64 {
        self.clock += 1;
        self.clock
    }

    fn insert(&mut self, key: K, group: &str, value: Arc<V>, claim: Option<Claim>) -> Option<Arc<V>> {
        let entry = Entry { value, group: group.to_owned(), claim, used: self.tick() };
        self.entries.insert(key, entry).map(|replaced| replaced.value)
    }

    /// The next value to evict, other than that of `new`.
    fn victim(&self, new: Option<&K>, pinned: fn(&V) -> bool) -> Option<K> {
        let mut held: HashMap<&str, u64> = HashMap::new();
        for entry in self.entries.values() {
            *held.entry(&entry.group).or_default() += entry.bytes();
        }
        // A use can only begin through `get`, which waits for the lock.
        let idle = self.entries.iter().filter(|(key, entry)| {
            Some(*key) != new && Arc::strong_count(&entry.value) == 1 && !pinned(&entry.value)
        });
        let next = idle.max_by_key(|(_, entry)| (held[entry.group.as_str()], Reverse(entry.used)));
        next.map(|(key, _)| key.clone())
    }
}

impl<V> Entry<V> {
    fn bytes(&self) -> u64 {
        self.claim.as_ref().map_or(0, |claim| claim.bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn insert(cache: &Cache<&'static str, u32>, key: &'static str, group: &str, bytes: usize) {
        cache.insert(key, group, Arc::new(0), bytes);
    }

    #[test]
    fn the_least_recently_used_is_evicted_and_what_is_in_use_stays() {
        let cache = Cache::new(30);
        insert(&cache, "a", "", 10);
        insert(&cache, "b", "", 10);
        insert(&cache, "c", "", 10);
        let held = cache.get(&"b");
        assert!(cache.get(&"a").is_some());
        insert(&cache, "d", "", 10);
        assert!(cache.get(&"c").is_none(), "used least recently of those that nobody holds");
        assert!(cache.get(&"a").is_some() && held.is_some());
        insert(&cache, "e", "", 30);
        let status = cache.status();
        assert_eq!((status.entries, status.bytes), (2, 40), "the one held and the new one");
        drop(held);
        insert(&cache, "f", "", 1);
        assert_eq!(cache.status().bytes, 1);
        assert_eq!(cache.status().evictions, 5);
    }

    #[test]
    fn the_largest_group_loses_first() {
        let cache = Cache::new(40);
        insert(&cache, "quiet", "one", 10);
        for key in ["a", "b", "c", "d", "e", "f"] {
            insert(&cache, key, "two", 10);
        }
        assert!(cache.get(&"quiet").is_some());
        assert_eq!(cache.of_group("two"), (3, 30));
    }

    #[test]
    fn a_value_replaces_another_of_its_key() {
        let cache = Cache::new(40);
        insert(&cache, "a", "", 10);
        insert(&cache, "a", "", 15);
        assert_eq!((cache.status().entries, cache.status().bytes, cache.status().evictions), (1, 15, 0));
    }

    #[test]
    fn pinned_values_stay() {
        let cache = Cache::new(10).pinning(|value: &u32| *value == 1);
        cache.insert("a", "", Arc::new(1), 10);
        cache.insert("b", "", Arc::new(0), 10);
        assert!(cache.shrink(), "without the other one");
        assert!(cache.get(&"a").is_some() && cache.get(&"b").is_none());
        cache.insert("c", "", Arc::new(1), 1);
        assert!(!cache.shrink(), "both are pinned");
    }

    struct Value(#[allow(dead_code, reason = "held")] Claim);

    fn keep(cache: &Cache<u32, Value>, key: u32, bytes: u64) -> Arc<Value> {
        let value = Arc::new(Value(cache.claim("it", bytes).unwrap()));
        cache.keep(key, Arc::clone(&value));
        value
    }

    #[test]
    fn a_claim_evicts_the_least_recently_used() {
        let cache = Cache::new(100);
        for key in 0..3 {
            keep(&cache, key, 30);
        }
        assert!(cache.get(&0).is_some());
        keep(&cache, 3, 30);
        assert_eq!([0, 1, 2, 3].map(|key| cache.get(&key).is_some()), [true, false, true, true]);
        let status = cache.status();
        assert_eq!((status.entries, status.bytes, status.evictions), (3, 90, 1));
    }

    #[test]
    fn claimed_values_in_use_stay_and_count() {
        let cache = Cache::new(100);
        let used = keep(&cache, 0, 60);
        let error = cache.claim("it", 50).unwrap_err();
        assert_eq!(error.code, Code::ResourceExhausted);
        assert!(
            error.retry_after.is_some() && error.message.contains("60 of the server's limit of 100"),
            "{error}"
        );
        drop(used);
        assert!(cache.claim("it", 50).is_ok());
        assert_eq!(cache.status().bytes, 0);
    }

    #[test]
    fn more_than_the_budget_is_rejected_for_good() {
        let error = Cache::<u32, Value>::new(100).claim("it", 101).unwrap_err();
        assert_eq!((error.code, error.retry_after), (Code::ResourceExhausted, None));
        assert_eq!(error.message, "it needs 101 bytes, the server's limit is 100");
    }

    #[test]
    fn a_claim_releases_what_it_does_not_need() {
        let cache = Cache::<u32, Value>::new(100);
        let mut claim = cache.claim("it", 80).unwrap();
        claim.shrink(30);
        claim.shrink(50);
        assert_eq!(cache.status().bytes, 30);
        drop(claim);
        assert_eq!(cache.status().bytes, 0);
    }
}
