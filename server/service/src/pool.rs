//! The one place where the engine computes: a bounded rayon pool with a bounded queue before it.
//!
//! Nothing heavy runs on the async runtime's threads, and no request makes threads of its own.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
    time::{Duration, Instant},
};

use tokio::sync::{Semaphore, oneshot};

use crate::{
    cancel::{Cancellation, Interest},
    error::{Code, ServiceError},
};

/// How much computes at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PoolLimits {
    /// Threads of the pool. Results do not depend on it.
    pub threads: usize,
    /// Engine calls that share the threads at a time.
    pub running: usize,
    /// Engine calls that wait for their turn; beyond it callers are turned away.
    pub queued: usize,
}

/// What a piece of work gave, and when.
#[derive(Debug)]
pub struct Completed<T> {
    /// The result.
    pub value: T,
    /// From the call until a thread started on it.
    pub queued: Duration,
    /// From then to the end.
    pub ran: Duration,
}

/// A pool of threads behind an orderly queue.
#[derive(Debug)]
pub struct ComputePool {
    threads: rayon::ThreadPool,
    /// One permit for each call that may run.
    running: Arc<Semaphore>,
    /// One permit for each call that may run or wait.
    admitted: Arc<Semaphore>,
    limits: PoolLimits,
}

impl ComputePool {
    /// Starts the threads.
    ///
    /// # Errors
    /// If the operating system gives no threads.
    pub fn new(limits: PoolLimits) -> Result<Self, rayon::ThreadPoolBuildError> {
        let threads = rayon::ThreadPoolBuilder::new()
            .num_threads(limits.threads)
            .thread_name(|index| format!("compute-{index}"))
            .build()?;
        let running = limits.running.max(1);
        Ok(Self {
            threads,
            running: Arc::new(Semaphore::new(running)),
            admitted: Arc::new(Semaphore::new(running + limits.queued)),
            limits: PoolLimits { running, ..limits },
        })
    }

    /// Runs `work` on the pool when its turn comes, first come first served. Dropping the future takes it out of the
    /// queue or, once it runs, sets the flag given to it; its place is free when it has really ended.
    ///
    /// # Errors
    /// `ResourceExhausted` if the queue is full, `Internal` if `work` panics, and what `work` returns.
    pub async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Cancellation) -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<Completed<T>, ServiceError> {
        let arrival = Instant::now();
        let place = Arc::clone(&self.admitted).try_acquire_owned().map_err(|_| self.full())?;
        let turn = Arc::clone(&self.running).acquire_owned().await.map_err(|_| gone())?;

        let interest = Interest::default();
        let cancellation = interest.cancellation();
        let (sender, receiver) = oneshot::channel();
        self.threads.spawn_fifo(move || {
            let start = Instant::now();
            // Nothing the closure may have left half done is used again: it owns what it changes.
            let outcome = catch_unwind(AssertUnwindSafe(|| work(&cancellation))).unwrap_or_else(|panic| {
                tracing::error!(panic = panic_text(&*panic), "engine call panicked");
                Err(ServiceError::new(
                    Code::Internal,
                    "the engine failed unexpectedly; the server's log has the cause",
                ))
            });
            let completed =
                outcome.map(|value| Completed { value, queued: start - arrival, ran: start.elapsed() });
            drop((turn, place));
            // Nobody receives it if the caller has gone.
            let _ = sender.send(completed);
        });
        let completed = receiver.await.map_err(|_| gone())?;
        drop(interest);
        completed
    }

    /// How much computes at a time.
    pub fn limits(&self) -> PoolLimits {
        self.limits
    }

    /// Engine calls that run or wait.
    pub fn load(&self) -> usize {
        self.limits.running + self.limits.queued - self.admitted.available_permits()
    }

    fn full(&self) -> ServiceError {
        let PoolLimits { running, queued, .. } = self.limits;
        ServiceError::new(
            Code::ResourceExhausted,
            format!("the server computes {running} requests and {queued} more wait, which is its limit; try again later"),
        )
        .retry_after(Duration::from_secs(1))
    }
}

fn gone() -> ServiceError {
    ServiceError::new(Code::Internal, "the compute pool has been shut down")
}

fn panic_text(panic: &(dyn std::any::Any + Send)) -> &str {
    panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no message")
}

#[cfg(test)]
mod tests {
    use std::sync::{atomic::AtomicBool, atomic::Ordering, mpsc};

    use super::*;

    fn pool(running: usize, queued: usize) -> Arc<ComputePool> {
        Arc::new(ComputePool::new(PoolLimits { threads: 2, running, queued }).unwrap())
    }

    #[tokio::test]
    async fn a_panic_is_an_internal_error_and_the_pool_goes_on() {
        let pool = pool(1, 0);
        let error = pool.run::<()>(|_| panic!("a fault of the engine")).await.unwrap_err();
        assert_eq!(error.code, Code::Internal);
        assert!(!error.message.contains("a fault of the engine"), "inner workings are logged, not sent");
        assert_eq!(pool.run(|_| Ok(7)).await.unwrap().value, 7);
    }

    #[tokio::test]
    async fn a_panic_inside_parallel_work_is_caught_too() {
        use rayon::prelude::*;
        let pool = pool(1, 0);
        let error = pool
            .run(|_| {
                Ok((0..1000)
                    .into_par_iter()
                    .map(|i| if i == 500 { panic!("inside") } else { i })
                    .sum::<i32>())
            })
            .await
            .unwrap_err();
        assert_eq!(error.code, Code::Internal);
        assert_eq!(pool.load(), 0);
    }

    #[tokio::test]
    async fn beyond_the_queue_callers_are_turned_away() {
        let pool = pool(1, 1);
        let (release, blocked) = mpsc::channel::<()>();
        let running = tokio::spawn({
            let pool = Arc::clone(&pool);
            async move { pool.run(move |_| blocked.recv().map_err(|_| gone())).await }
        });
        let waiting = tokio::spawn({
            let pool = Arc::clone(&pool);
            async move { pool.run(|_| Ok(())).await }
        });
        while pool.load() < 2 {
            tokio::task::yield_now().await;
        }
        let error = pool.run(|_| Ok(())).await.unwrap_err();
        assert_eq!(error.code, Code::ResourceExhausted);
        assert!(error.retry_after.is_some());
        release.send(()).unwrap();
        running.await.unwrap().unwrap();
        waiting.await.unwrap().unwrap();
        assert_eq!(pool.load(), 0);
    }

    #[tokio::test]
    async fn dropping_the_future_cancels_what_runs_and_forgets_what_waits() {
        let pool = pool(1, 1);
        let (started, has_started) = oneshot::channel();
        let running = tokio::spawn({
            let pool = Arc::clone(&pool);
            async move {
                pool.run(move |cancellation| {
                    started.send(()).unwrap();
                    while !cancellation.requested() {
                        std::thread::yield_now();
                    }
                    Ok(())
                })
                .await
            }
        });
        has_started.await.unwrap();
        let ran = Arc::new(AtomicBool::new(false));
        let waiting = tokio::spawn({
            let (pool, ran) = (Arc::clone(&pool), Arc::clone(&ran));
            async move { pool.run(move |_| Ok(ran.swap(true, Ordering::SeqCst))).await }
        });
        while pool.load() < 2 {
            tokio::task::yield_now().await;
        }
        waiting.abort();
        assert!(waiting.await.unwrap_err().is_cancelled());
        running.abort();
        while pool.load() > 0 {
            tokio::task::yield_now().await;
        }
        assert!(!ran.load(Ordering::SeqCst), "work taken out of the queue never starts");
    }
}
