//! What is made again or loaded again when it is needed: held within a budget of bytes.

use std::{
    collections::HashMap,
    hash::Hash,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use crate::status::CacheStatus;

/// Values by key, up to so many bytes. What is used least recently goes first, of the group that holds most; what somebody
/// uses at the moment stays.
#[derive(Debug)]
pub struct Cache<K, V> {
    state: Mutex<State<K, V>>,
    budget: usize,
    /// Whether somebody uses it otherwise than through this cache.
    in_use: fn(&V) -> bool,
}

#[derive(Debug)]
struct State<K, V> {
    entries: HashMap<K, Entry<V>>,
    /// Grows with every use.
    clock: u64,
    status: CacheStatus,
}

#[derive(Debug)]
struct Entry<V> {
    value: Arc<V>,
    group: String,
    bytes: usize,
    used: u64,
}

impl<K: Eq + Hash + Clone, V> Cache<K, V> {
    /// An empty one.
    pub fn new(budget: usize, in_use: fn(&V) -> bool) -> Self {
        let status = CacheStatus { budget, ..CacheStatus::default() };
        Self { state: Mutex::new(State { entries: HashMap::new(), clock: 0, status }), budget, in_use }
    }

    /// The value, which stays as long as somebody holds it.
    pub fn get(&self, key: &K) -> Option<Arc<V>> {
        let mut state = self.lock();
        state.clock += 1;
        let used = state.clock;
        let found = state.entries.get_mut(key).map(|entry| {
            entry.used = used;
            Arc::clone(&entry.value)
        });
        match found {
            Some(_) => state.status.hits += 1,
            None => state.status.misses += 1,
        }
        found
    }

    /// Holds a value, in place of another of that key, and lets go of others until all fit.
    pub fn insert(&self, key: K, group: &str, value: Arc<V>, bytes: usize) {
        let mut state = self.lock();
        state.clock += 1;
        let entry = Entry { value, group: group.to_owned(), bytes, used: state.clock };
        let mut dropped = Vec::from_iter(state.entries.insert(key.clone(), entry));
        state.status.bytes += bytes;
        state.status.bytes -= dropped.iter().map(|entry| entry.bytes).sum::<usize>();
        dropped.extend(self.evict(&mut state, Some(&key)));
        drop(state);
        // Large, and so not freed under the lock.
        drop(dropped);
    }

    /// Lets go of what nobody uses until all fit; whether they do.
    pub fn shrink(&self) -> bool {
        let mut state = self.lock();
        let dropped = self.evict(&mut state, None);
        let fits = state.status.bytes <= self.budget;
        drop(state);
        drop(dropped);
        fits
    }

    fn evict(&self, state: &mut State<K, V>, new: Option<&K>) -> Vec<Entry<V>> {
        let mut dropped = Vec::new();
        while state.status.bytes > self.budget {
            let Some(victim) = state.victim(new, self.in_use) else { break };
            let Some(entry) = state.entries.remove(&victim) else { break };
            state.status.bytes -= entry.bytes;
            state.status.evictions += 1;
            dropped.push(entry);
        }
        dropped
    }

    /// How full it is.
    pub fn status(&self) -> CacheStatus {
        let state = self.lock();
        CacheStatus { entries: state.entries.len(), ..state.status }
    }

    /// Entries and bytes of one group.
    pub fn of_group(&self, group: &str) -> (usize, usize) {
        let state = self.lock();
        let of = state.entries.values().filter(|entry| entry.group == group);
        of.fold((0, 0), |(count, bytes), entry| (count + 1, bytes + entry.bytes))
    }

    fn lock(&self) -> MutexGuard<'_, State<K, V>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<K: Eq + Hash + Clone, V> State<K, V> {
    /// What goes next to make room for `new`.
    fn victim(&self, new: Option<&K>, in_use: fn(&V) -> bool) -> Option<K> {
        let mut held: HashMap<&str, usize> = HashMap::new();
        for entry in self.entries.values() {
            *held.entry(&entry.group).or_default() += entry.bytes;
        }
        // A use can only begin through `get`, which waits for the lock.
        let idle = self.entries.iter().filter(|(key, entry)| {
            Some(*key) != new && Arc::strong_count(&entry.value) == 1 && !in_use(&entry.value)
        });
        let next = idle.max_by_key(|(_, entry)| (held[entry.group.as_str()], std::cmp::Reverse(entry.used)));
        next.map(|(key, _)| key.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn insert(cache: &Cache<&'static str, u32>, key: &'static str, group: &str, bytes: usize) {
        cache.insert(key, group, Arc::new(0), bytes);
    }

    #[test]
    fn what_is_used_least_recently_goes_and_what_is_in_use_stays() {
        let cache = Cache::new(30, |_| false);
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
    fn a_group_that_holds_much_loses_first() {
        let cache = Cache::new(40, |_| false);
        insert(&cache, "quiet", "one", 10);
        for key in ["a", "b", "c", "d", "e", "f"] {
            insert(&cache, key, "two", 10);
        }
        assert!(cache.get(&"quiet").is_some());
        assert_eq!(cache.of_group("two"), (3, 30));
    }

    #[test]
    fn a_value_takes_the_place_of_another_of_its_key() {
        let cache = Cache::new(40, |_| false);
        insert(&cache, "a", "", 10);
        insert(&cache, "a", "", 15);
        assert_eq!((cache.status().entries, cache.status().bytes, cache.status().evictions), (1, 15, 0));
    }
}
