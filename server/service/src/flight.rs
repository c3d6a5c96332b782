//! Single flight: of all who ask for the same thing, one's work is done and all get its result.

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

/// What has happened in a flight so far.
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

/// Where the work tells its progress.
#[derive(Debug)]
pub struct Reports<T>(watch::Sender<Log<T>>);

impl<T> Clone for Reports<T> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<T> Reports<T> {
    /// Tells all who follow.
    pub fn tell(&self, progress: Progress) {
        self.0.send_modify(|log| log.steps.push(progress));
    }
}

/// Flights by key. What has landed is not kept here.
#[derive(Debug)]
pub struct Flights<K, T>(Arc<Mutex<HashMap<K, Reports<T>>>>);

impl<K, T> Default for Flights<K, T> {
    fn default() -> Self {
        Self(Arc::default())
    }
}

impl<K: Eq + Hash + Clone + Send + 'static, T: Send + Sync + 'static> Flights<K, T> {
    /// Follows the flight of `key`; or, if there is none, takes what `find` knows has landed; or starts `work`, which
    /// is dropped when nobody follows any more. `land` keeps the result where `find` looks.
    pub fn join<W>(
        &self,
        key: K,
        find: impl FnOnce() -> Option<Arc<T>>,
        work: impl FnOnce(Reports<T>) -> W,
        land: impl FnOnce(&Arc<T>) + Send + 'static,
    ) -> Joined<T>
    where
        W: Future<Output = Result<T, ServiceError>> + Send + 'static,
    {
        let mut flights = self.lock();
        if let Some(reports) = flights.get(&key) {
            return Joined::Following(Follower { log: reports.0.subscribe(), seen: 0 });
        }
        // A flight ends after its result is kept: what is in neither place has not been done.
        if let Some(found) = find() {
            return Joined::Found(found);
        }
        let (sender, log) = watch::channel(Log::default());
        let reports = Reports(sender);
        flights.insert(key.clone(), reports.clone());
        let work = work(reports.clone());
        tokio::spawn(Self(Arc::clone(&self.0)).fly(key, reports, work, land));
        Joined::Started(Follower { log, seen: 0 })
    }

    #[cfg(test)]
    fn contains(&self, key: &K) -> bool {
        self.lock().contains_key(key)
    }

    async fn fly<W>(self, key: K, reports: Reports<T>, work: W, land: impl FnOnce(&Arc<T>))
    where
        W: Future<Output = Result<T, ServiceError>>,
    {
        tokio::pin!(work);
        let outcome = loop {
            tokio::select! {
                outcome = &mut work => break outcome.map(Arc::new),
                () = reports.0.closed() => {
                    // Whoever joins does so under the lock: if there is nobody now, nobody will come.
                    let mut flights = self.lock();
                    if reports.0.is_closed() {
                        flights.remove(&key);
                        return;
                    }
                }
            }
        };
        if let Ok(value) = &outcome {
            land(value);
        }
        self.lock().remove(&key);
        reports.0.send_modify(|log| log.outcome = Some(outcome));
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<K, Reports<T>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What [`Flights::join`] came upon.
#[derive(Debug)]
pub enum Joined<T> {
    /// It had landed.
    Found(Arc<T>),
    /// It was in flight.
    Following(Follower<T>),
    /// This call started it.
    Started(Follower<T>),
}

/// One who waits for a flight.
#[derive(Debug)]
pub struct Follower<T> {
    log: watch::Receiver<Log<T>>,
    seen: usize,
}

impl<T> Follower<T> {
    /// Passes every step on to `tell`, those before it joined first, and returns the result.
    ///
    /// # Errors
    /// The work's own error.
    pub async fn land(mut self, mut tell: impl FnMut(Progress)) -> Result<Arc<T>, ServiceError> {
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

    fn none() -> Option<Arc<u32>> {
        None
    }

    fn follower(joined: Joined<u32>) -> Follower<u32> {
        match joined {
            Joined::Found(_) => panic!("nothing has landed"),
            Joined::Following(follower) | Joined::Started(follower) => follower,
        }
    }

    fn step(fraction: f64) -> Progress {
        Progress { stage: "work", fraction, message: String::new() }
    }

    #[tokio::test]
    async fn two_who_ask_share_one_piece_of_work_and_see_all_its_steps() {
        let flights = Flights::<u32, u32>::default();
        let landings = Arc::new(AtomicUsize::new(0));
        let (release, blocked) = oneshot::channel::<()>();
        let counter = Arc::clone(&landings);
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
            follower(first).land(|progress| of_first.push(progress.fraction)),
            follower(second).land(|progress| of_second.push(progress.fraction))
        );
        assert!(Arc::ptr_eq(&a.unwrap(), &b.unwrap()));
        assert_eq!(of_first, [0.0, 1.0]);
        assert_eq!(of_second, [0.0, 1.0]);
        assert_eq!(landings.load(Ordering::SeqCst), 1);
        assert!(!flights.contains(&1));
    }

    #[tokio::test]
    async fn work_that_nobody_follows_is_dropped_and_can_be_started_again() {
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
        while flights.contains(&1) {
            tokio::task::yield_now().await;
        }
        let again = flights.join(1, none, |_| async { Ok(5) }, |_| {});
        assert!(matches!(again, Joined::Started(_)));
        assert_eq!(*follower(again).land(|_| {}).await.unwrap(), 5);
    }

    #[tokio::test]
    async fn an_error_reaches_all_and_is_not_remembered() {
        let flights = Flights::<u32, u32>::default();
        let refuse = |_| async { Err(ServiceError::invalid("mesh", "is empty")) };
        let first = flights.join(1, none, refuse, |_| {});
        let second = flights.join(1, none, refuse, |_| {});
        assert_eq!(
            follower(first).land(|_| {}).await.unwrap_err(),
            follower(second).land(|_| {}).await.unwrap_err()
        );
        let third = flights.join(1, none, |_| async { Ok(1) }, |_| {});
        assert!(matches!(third, Joined::Started(_)));
        assert_eq!(*follower(third).land(|_| {}).await.unwrap(), 1);
    }

    #[tokio::test]
    async fn what_has_landed_is_found() {
        let flights = Flights::<u32, u32>::default();
        let joined = flights.join(1, || Some(Arc::new(3)), |_| async { panic!("it is there") }, |_| {});
        assert!(matches!(joined, Joined::Found(value) if *value == 3));
        assert!(!flights.contains(&1));
    }
}
