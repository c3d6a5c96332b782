//! Single flight: concurrent requests for the same result share one computation.

use std::{
    collections::HashMap,
    hash::Hash,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use tokio::sync::watch;

use crate::{
    error::{Code, ServiceError},
    progress::Progress,
};

/// Progress and outcome of a computation so far.
#[derive(Debug)]
struct Log<T> {
    steps: Vec<Progress>,
    outcome: Option<Result<Arc<T>, ServiceError>>,
}

impl<T> Default for Log<T> {
    fn default() -> Self {
        Self { steps: Vec::new(), outcome: None }
    }
}

/// The channel for progress reports of a computation.
#[derive(Debug)]
pub struct Reports<T>(watch::Sender<Log<T>>);

impl<T> Clone for Reports<T> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<T> Reports<T> {
    /// Reports to all followers.
    pub fn tell(&self, progress: Progress) {
        self.0.send_modify(|log| log.steps.push(progress));
    }
}

/// Computations in progress, by key; results are cached elsewhere.
#[derive(Debug)]
pub struct Flights<K, T>(Arc<Mutex<HashMap<K, Reports<T>>>>);

impl<K, T> Default for Flights<K, T> {
    fn default() -> Self {
        Self(Arc::default())
    }
}

impl<K: Eq + Hash + Clone + Send + 'static, T: Send + Sync + 'static> Flights<K, T> {
    /// Joins the computation of `key` if it is in progress; otherwise takes the result that `find` returns; otherwise starts
    /// `work`, which is dropped once nobody follows it. `keep` caches the result where `find` looks.
    pub fn join<W>(
        &self,
        key: K,
        find: impl FnOnce() -> Option<Arc<T>>,
        work: impl FnOnce(Reports<T>) -> W,
        keep: impl FnOnce(&Arc<T>) + Send + 'static,
    ) -> Joined<T>
    where
        W: Future<Output = Result<T, ServiceError>> + Send + 'static,
    {
        let mut flights = self.lock();
        if let Some(reports) = flights.get(&key) {
            return Joined::Following(Follower { log: reports.0.subscribe(), seen: 0 });
        }
        // A result is cached before its flight ends: what is in neither place has not been computed.
        if let Some(found) = find() {
            return Joined::Found(found);
        }
        let (sender, log) = watch::channel(Log::default());
        let reports = Reports(sender);
        flights.insert(key.clone(), reports.clone());
        let work = work(reports.clone());
        tokio::spawn(Self(Arc::clone(&self.0)).fly(key, reports, work, keep));
        Joined::Started(Follower { log, seen: 0 })
    }

    #[cfg(test)]
    fn contains(&self, key: &K) -> bool {
        self.lock().contains_key(key)
    }

    async fn fly<W>(self, key: K, reports: Reports<T>, work: W, keep: impl FnOnce(&Arc<T>))
    where
        W: Future<Output = Result<T, ServiceError>>,
    {
        tokio::pin!(work);
        let outcome = loop {
            tokio::select! {
                outcome = &mut work => break outcome.map(Arc::new),
                () = reports.0.closed() => {
                    // Joining takes the lock: a flight without followers under the lock stays without.
                    let mut flights = self.lock();
                    if reports.0.is_closed() {
                        flights.remove(&key);
                        return;
                    }
                }
            }
        };
        if let Ok(value) = &outcome {
            keep(value);
        }
        self.lock().remove(&key);
        reports.0.send_modify(|log| log.outcome = Some(outcome));
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<K, Reports<T>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What [`Flights::join`] found.
#[derive(Debug)]
pub enum Joined<T> {
    /// The result.
    Found(Arc<T>),
    /// The computation in progress.
    Following(Follower<T>),
    /// Nothing: this call started the computation.
    Started(Follower<T>),
}

/// A request that waits for a computation.
#[derive(Debug)]
pub struct Follower<T> {
    log: watch::Receiver<Log<T>>,
    seen: usize,
}

impl<T> Follower<T> {
    /// Passes every report on to `tell`, those from before it joined first, and returns the result.
    ///
    /// # Errors
    /// The error of the computation.
    pub async fn wait(mut self, mut tell: impl FnMut(Progress)) -> Result<Arc<T>, ServiceError> {
        loop {
            let (news, outcome) = {
                let log = self.log.borrow_and_update();
                (log.steps[self.seen..].to_vec(), log.outcome.clone())
            };
            self.seen += news.len();
            news.into_iter().for_each(&mut tell);
            if let Some(outcome) = outcome {
                return outcome;
            }
            if self.log.changed().await.is_err() {
                return Err(ServiceError::new(Code::Internal, "the work ended without a result"));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use tokio::sync::oneshot;

    use super::*;
    use moldline_testing::eventually;

    fn none() -> Option<Arc<u32>> {
        None
    }

    fn follower(joined: Joined<u32>) -> Follower<u32> {
        match joined {
            Joined::Found(_) => panic!("nothing is cached"),
            Joined::Following(follower) | Joined::Started(follower) => follower,
        }
    }

    fn step(fraction: f64) -> Progress {
        Progress { stage: "work", fraction, message: String::new() }
    }

    #[tokio::test]
    async fn two_requests_share_one_computation_and_see_all_its_steps() {
        let flights = Flights::<u32, u32>::default();
        let results = Arc::new(AtomicUsize::new(0));
        let (release, blocked) = oneshot::channel::<()>();
        let counter = Arc::clone(&results);
        let first = flights.join(
            1,
            none,
            |reports| async move {
                reports.tell(step(0.0));
                blocked.await.unwrap();
                reports.tell(step(1.0));
                Ok(42)
            },
            move |_| {
                counter.fetch_add(1, Ordering::SeqCst);
            },
        );
        assert!(matches!(first, Joined::Started(_)));
        tokio::task::yield_now().await;
        let second = flights.join(1, none, |_| async { panic!("the first one's work is followed") }, |_| {});
        assert!(matches!(second, Joined::Following(_)));
        release.send(()).unwrap();
        let (mut of_first, mut of_second) = (Vec::new(), Vec::new());
        let (a, b) = tokio::join!(
            follower(first).wait(|progress| of_first.push(progress.fraction)),
            follower(second).wait(|progress| of_second.push(progress.fraction))
        );
        assert!(Arc::ptr_eq(&a.unwrap(), &b.unwrap()));
        assert_eq!(of_first, [0.0, 1.0]);
        assert_eq!(of_second, [0.0, 1.0]);
        assert_eq!(results.load(Ordering::SeqCst), 1);
        assert!(!flights.contains(&1));
    }

    #[tokio::test]
    async fn work_without_followers_is_dropped_and_can_be_started_again() {
        let flights = Flights::<u32, u32>::default();
        let (held, dropped) = oneshot::channel::<()>();
        let first = flights.join(
            1,
            none,
            |_| async move {
                let _held = held;
                std::future::pending().await
            },
            |_| {},
        );
        let second = flights.join(1, none, |_| async { Ok(0) }, |_| {});
        drop(first);
        for _ in 0..20 {
            tokio::task::yield_now().await;
        }
        assert!(flights.contains(&1), "the second one still waits");
        drop(second);
        assert!(dropped.await.is_err(), "the work's state is gone");
        eventually("end of the flight", async || (!flights.contains(&1)).then_some(())).await;
        let again = flights.join(1, none, |_| async { Ok(5) }, |_| {});
        assert!(matches!(again, Joined::Started(_)));
        assert_eq!(*follower(again).wait(|_| {}).await.unwrap(), 5);
    }

    #[tokio::test]
    async fn an_error_reaches_all_followers_and_is_not_cached() {
        let flights = Flights::<u32, u32>::default();
        let fail = |_| async { Err(ServiceError::invalid("mesh", "is empty")) };
        let first = flights.join(1, none, fail, |_| {});
        let second = flights.join(1, none, fail, |_| {});
        assert_eq!(
            follower(first).wait(|_| {}).await.unwrap_err(),
            follower(second).wait(|_| {}).await.unwrap_err()
        );
        let third = flights.join(1, none, |_| async { Ok(1) }, |_| {});
        assert!(matches!(third, Joined::Started(_)));
        assert_eq!(*follower(third).wait(|_| {}).await.unwrap(), 1);
    }

    #[tokio::test]
    async fn a_cached_result_is_found() {
        let flights = Flights::<u32, u32>::default();
        let joined = flights.join(1, || Some(Arc::new(3)), |_| async { panic!("it is there") }, |_| {});
        assert!(matches!(joined, Joined::Found(value) if *value == 3));
        assert!(!flights.contains(&1));
    }
}
