//! The compute pool: a bounded rayon pool behind a bounded, fair queue.
//!
//! Nothing heavy runs on the async runtime's threads, and no request starts threads of its own.

use std::{
    collections::{BTreeMap, HashMap},
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use tokio::sync::oneshot;

use crate::{
    cancel::{Cancellation, Interest},
    error::{Code, ServiceError},
    principal::Tenant,
    progress::Progress,
    supply::{Share, Sharing, Supply},
};

/// Sizes of pool and queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PoolLimits {
    /// Threads of the pool. Results do not depend on their number.
    pub threads: usize,
    /// Tasks that share the threads at a time.
    pub running: usize,
    /// Tasks that wait for their turn; more are rejected.
    pub queued: usize,
    /// Longest time that a task may run. Then it is cancelled, and its caller told so.
    pub work: Duration,
}

impl PoolLimits {
    /// The usual limit of the time that a task may run: minutes more than the largest set-ups need.
    pub const WORK: Duration = Duration::from_secs(600);
}

/// The result of a task, and its times.
#[derive(Debug)]
pub struct Completed<T> {
    /// The result.
    pub value: T,
    /// From the call until a thread started it.
    pub queued: Duration,
    /// From then until the end.
    pub ran: Duration,
}

/// Owner and kind of a task, for the queue and for status reports.
#[derive(Clone, Debug)]
pub struct Task {
    /// Such as `build` or `deform`.
    pub kind: &'static str,
    /// Its owner.
    pub tenant: Tenant,
    /// Id of the set-up or configuration, if known.
    pub setup: Option<String>,
    /// Id of the session, if there is one.
    pub session: Option<String>,
    /// An estimate of the working memory that it takes while it runs, bytes; 0 if others account for it.
    pub memory: u64,
}

/// A pool of threads behind a fair queue: tenants take turns, and the tasks of one tenant run in order of arrival.
#[derive(Debug)]
pub struct ComputePool {
    threads: rayon::ThreadPool,
    queue: Arc<Queue>,
    memory: Arc<Supply>,
}

/// Running and waiting tasks.
#[derive(Debug)]
struct Queue {
    limits: PoolLimits,
    /// Most tasks of one tenant.
    of_tenant: usize,
    /// Running and waiting tasks as places of which tenants have a share.
    shares: Arc<Supply>,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    /// Running and waiting tasks, in order of arrival.
    places: BTreeMap<u64, Entry>,
    arrivals: u64,
    running: usize,
    /// Turn in which each tenant was last served.
    served: HashMap<Tenant, u64>,
    turns: u64,
}

#[derive(Debug)]
struct Entry {
    _share: Share,
    task: Task,
    arrival: Instant,
    /// Starts the task; `None` once it runs.
    call: Option<oneshot::Sender<()>>,
    start: Option<Instant>,
    stage: Option<(&'static str, f64)>,
}

/// Status of a task.
#[derive(Clone, Debug, PartialEq)]
pub struct Work {
    /// Such as `build`, `deform`, `jvp`.
    pub kind: &'static str,
    /// Its owner.
    pub tenant: Tenant,
    /// Id of the set-up or configuration, if known.
    pub setup: Option<String>,
    /// Id of the session, if there is one.
    pub session: Option<String>,
    /// Time since its arrival.
    pub age: Duration,
    /// Time since its start; `None` while it waits.
    pub running: Option<Duration>,
    /// The current stage, if known.
    pub stage: Option<&'static str>,
    /// Share of the stage that is done, 0 to 1.
    pub fraction: f64,
}

/// A place in the queue, later among the running tasks; free when this is dropped.
#[derive(Debug)]
struct Place {
    queue: Arc<Queue>,
    number: u64,
}

/// Passed to a task on the pool: its cancellation flag, and a channel for progress.
#[derive(Debug)]
pub struct Ticket {
    cancellation: Cancellation,
    place: Place,
}

impl Ticket {
    /// The flag that is set when the caller no longer waits.
    pub fn cancellation(&self) -> &Cancellation {
        &self.cancellation
    }

    /// Records progress for [`ComputePool::work`].
    pub fn progress(&self, progress: &Progress) {
        if let Some(entry) = self.place.queue.lock().places.get_mut(&self.place.number) {
            entry.stage = Some((progress.stage, progress.fraction));
        }
    }
}

impl ComputePool {
    /// Starts the threads, for one tenant with all the memory that there is. `of_tenant`: most running and waiting tasks of one
    /// tenant.
    ///
    /// # Errors
    /// If the operating system cannot start the threads.
    pub fn new(limits: PoolLimits, of_tenant: usize) -> Result<Self, rayon::ThreadPoolBuildError> {
        let memory = Supply::new("bytes of working memory", "--memory", u64::MAX, Sharing::Alone);
        Self::sharing(limits, of_tenant, Sharing::Alone, memory)
    }

    /// Starts the threads, with places and memory shared by tenants.
    ///
    /// # Errors
    /// If the operating system cannot start the threads.
    pub fn sharing(
        limits: PoolLimits,
        of_tenant: usize,
        sharing: Sharing,
        memory: Arc<Supply>,
    ) -> Result<Self, rayon::ThreadPoolBuildError> {
        let threads = rayon::ThreadPoolBuilder::new()
            .num_threads(limits.threads)
            .thread_name(|index| format!("compute-{index}"))
            .build()?;
        let limits = PoolLimits { running: limits.running.max(1), ..limits };
        let places = (limits.running + limits.queued) as u64;
        let shares = Supply::new("places to compute or wait", "--queued", places, sharing);
        let queue = Arc::new(Queue { limits, of_tenant, shares, state: Mutex::default() });
        Ok(Self { threads, queue, memory })
    }

    /// Runs `work` on the pool when its turn comes. Dropping the future removes it from the queue or, once it runs, sets its
    /// cancellation flag; the place is free when the work has actually ended.
    ///
    /// # Errors
    /// `ResourceExhausted` if the queue or the tenant's share of it is full, or of the memory, `DeadlineExceeded` if `work` runs longer than the
    /// limit, `Internal` if it panics, and what it returns.
    pub async fn run<T: Send + 'static>(
        &self,
        task: Task,
        work: impl FnOnce(&Ticket) -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<Completed<T>, ServiceError> {
        let arrival = Instant::now();
        let (kind, tenant, bytes) = (task.kind, task.tenant.clone(), task.memory);
        let (place, turn) = self.queue.enter(task)?;
        turn.await.map_err(|_| gone())?;
        let memory = self.memory.take(&tenant, &format!("`{kind}`"), bytes)?;

        let interest = Interest::default();
        let ticket = Ticket { cancellation: interest.cancellation(), place };
        let (sender, receiver) = oneshot::channel();
        self.threads.spawn_fifo(move || {
            let start = Instant::now();
            // The closure owns what it changes: nothing that it leaves half done is used again.
            let outcome = catch_unwind(AssertUnwindSafe(|| work(&ticket))).unwrap_or_else(|panic| {
                tracing::error!(panic = panic_text(&*panic), "engine call panicked");
                Err(ServiceError::new(
                    Code::Internal,
                    "the engine failed unexpectedly; the server's log has the cause",
                ))
            });
            let completed =
                outcome.map(|value| Completed { value, queued: start - arrival, ran: start.elapsed() });
            drop((ticket, memory));
            // There is no receiver if the caller has gone.
            let _ = sender.send(completed);
        });
        // The time before a thread is free counts, too: it is spent on tasks that have the same limit.
        let limit = self.queue.limits.work;
        let completed = tokio::time::timeout(limit, receiver).await;
        // Cancels the task if it still runs.
        drop(interest);
        match completed {
            Ok(completed) => completed.map_err(|_| gone())?,
            Err(_) => Err(took_too_long(kind, limit)),
        }
    }

    /// The working memory, of which requests take their part too.
    pub fn memory(&self) -> &Arc<Supply> {
        &self.memory
    }

    /// The sizes in force.
    pub fn limits(&self) -> PoolLimits {
        self.queue.limits
    }

    /// Number of running and waiting tasks.
    pub fn load(&self) -> usize {
        self.queue.lock().places.len()
    }

    /// Whether work gets done.
    ///
    /// # Errors
    /// A sentence that says that all places are taken by tasks that do not end although they have been cancelled.
    pub fn moving(&self) -> Result<(), String> {
        /// From its cancellation, a task has this time to end.
        const GRACE: Duration = Duration::from_secs(30);
        let PoolLimits { running, work, .. } = self.queue.limits;
        let state = self.queue.lock();
        let overdue =
            |entry: &&Entry| entry.start.is_some_and(|start| start.elapsed() > work.saturating_add(GRACE));
        match state.places.values().filter(overdue).count() {
            stuck if stuck >= running => {
                Err(format!("all {stuck} pieces of work that run are overdue and do not end"))
            }
            _ => Ok(()),
        }
    }

    /// Running and waiting tasks, oldest first: all, or those of one tenant.
    pub fn work(&self, of: Option<&Tenant>) -> Vec<Work> {
        let state = self.queue.lock();
        let entries = state.places.values().filter(|entry| of.is_none_or(|of| entry.task.tenant == *of));
        let work = entries.map(|entry| Work {
            kind: entry.task.kind,
            tenant: entry.task.tenant.clone(),
            setup: entry.task.setup.clone(),
            session: entry.task.session.clone(),
            age: entry.arrival.elapsed(),
            running: entry.start.map(|start| start.elapsed()),
            stage: entry.stage.map(|(stage, _)| stage),
            fraction: entry.stage.map_or(0.0, |(_, fraction)| fraction),
        });
        work.collect()
    }
}

impl Queue {
    /// Takes a place; the receiver is told when its turn comes.
    fn enter(self: &Arc<Self>, task: Task) -> Result<(Place, oneshot::Receiver<()>), ServiceError> {
        let mut state = self.lock();
        let PoolLimits { running, queued, .. } = self.limits;
        if state.places.len() >= running + queued {
            return Err(full(format!(
                "the server computes {running} requests and {queued} more wait, which is its limit; try again later"
            )));
        }
        let own = state.places.values().filter(|entry| entry.task.tenant == task.tenant).count();
        if own >= self.of_tenant {
            return Err(full(format!(
                "{own} requests of yours compute or wait, which is the limit for one tenant; try again later"
            )));
        }
        let _share = self.shares.take(&task.tenant, "the request", 1)?;
        let (call, turn) = oneshot::channel();
        let number = state.arrivals;
        state.arrivals += 1;
        let entry =
            Entry { _share, task, arrival: Instant::now(), call: Some(call), start: None, stage: None };
        state.places.insert(number, entry);
        state.call(running);
        drop(state);
        Ok((Place { queue: Arc::clone(self), number }, turn))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Starts tasks while fewer than `limit` run: first of the tenant with the fewest running, then of the one served longest
    /// ago.
    fn call(&mut self, limit: usize) {
        while self.running < limit {
            let mut running: HashMap<&Tenant, usize> = HashMap::new();
            for entry in self.places.values().filter(|entry| entry.start.is_some()) {
                *running.entry(&entry.task.tenant).or_default() += 1;
            }
            let waiting = self.places.iter().filter(|(_, entry)| entry.start.is_none());
            let next = waiting.min_by_key(|(number, entry)| {
                let tenant = &entry.task.tenant;
                let served = self.served.get(tenant).copied().unwrap_or_default();
                (running.get(tenant).copied().unwrap_or_default(), served, **number)
            });
            let Some(number) = next.map(|(number, _)| *number) else { return };
            let Some(entry) = self.places.get_mut(&number) else { return };
            entry.start = Some(Instant::now());
            self.running += 1;
            self.turns += 1;
            self.served.insert(entry.task.tenant.clone(), self.turns);
            // A caller that has gone frees its place when it is dropped.
            let _ = entry.call.take().map(|call| call.send(()));
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut state = self.queue.lock();
        if state.places.remove(&self.number).is_some_and(|entry| entry.start.is_some()) {
            state.running -= 1;
        }
        if state.places.is_empty() {
            state.served.clear();
        }
        state.call(self.queue.limits.running);
    }
}

fn full(message: String) -> ServiceError {
    ServiceError::new(Code::ResourceExhausted, message).retry_after(Duration::from_secs(1))
}

fn took_too_long(kind: &str, limit: Duration) -> ServiceError {
    let message = format!(
        "`{kind}` took longer than the {} s that one piece of work may take on this server, and was given up; send a \
         coarser mesh, fewer training vertices or fewer directions at a time, or let the server allow more (--max-work)",
        limit.as_secs_f64()
    );
    ServiceError::new(Code::DeadlineExceeded, message)
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
    use moldline_testing::eventually;

    fn limits(threads: usize, running: usize, queued: usize) -> PoolLimits {
        PoolLimits { threads, running, queued, work: PoolLimits::WORK }
    }

    fn pool(running: usize, queued: usize) -> Arc<ComputePool> {
        Arc::new(ComputePool::new(limits(2, running, queued), usize::MAX).unwrap())
    }

    fn of(tenant: &str) -> Task {
        Task { kind: "test", tenant: Tenant::new(tenant).unwrap(), setup: None, session: None, memory: 0 }
    }

    #[tokio::test]
    async fn a_panic_is_an_internal_error_and_the_pool_goes_on() {
        let pool = pool(1, 0);
        let error = pool.run::<()>(of("a"), |_| panic!("a fault of the engine")).await.unwrap_err();
        assert_eq!(error.code, Code::Internal);
        assert!(!error.message.contains("a fault of the engine"), "inner workings are logged, not sent");
        assert_eq!(pool.run(of("a"), |_| Ok(7)).await.unwrap().value, 7);
    }

    #[tokio::test]
    async fn a_panic_inside_parallel_work_is_caught_too() {
        use rayon::prelude::*;
        let pool = pool(1, 0);
        let error = pool
            .run(of("a"), |_| {
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
    async fn work_beyond_its_time_is_cancelled_and_its_caller_told() {
        let limits = PoolLimits { work: Duration::from_millis(50), ..limits(2, 1, 1) };
        let pool = ComputePool::new(limits, usize::MAX).unwrap();
        let error = pool
            .run(of("a"), |ticket| {
                while !ticket.cancellation().requested() {
                    std::thread::sleep(Duration::from_millis(1));
                }
                Ok(())
            })
            .await
            .unwrap_err();
        assert_eq!(error.code, Code::DeadlineExceeded);
        assert!(error.message.contains("0.05 s") && error.message.contains("--max-work"), "{error}");
        eventually("idle pool", async || (pool.load() == 0).then_some(())).await;
        assert_eq!(pool.run(of("a"), |_| Ok(7)).await.unwrap().value, 7);
    }

    #[tokio::test]
    async fn callers_beyond_the_queue_are_rejected() {
        let pool = pool(1, 1);
        let (release, blocked) = mpsc::channel::<()>();
        let running = tokio::spawn({
            let pool = Arc::clone(&pool);
            async move { pool.run(of("a"), move |_| blocked.recv().map_err(|_| gone())).await }
        });
        let waiting = tokio::spawn({
            let pool = Arc::clone(&pool);
            async move { pool.run(of("a"), |_| Ok(())).await }
        });
        eventually("second task", async || (pool.load() >= 2).then_some(())).await;
        let error = pool.run(of("a"), |_| Ok(())).await.unwrap_err();
        assert_eq!(error.code, Code::ResourceExhausted);
        assert!(error.retry_after.is_some());
        release.send(()).unwrap();
        running.await.unwrap().unwrap();
        waiting.await.unwrap().unwrap();
        assert_eq!(pool.load(), 0);
    }

    #[tokio::test]
    async fn dropping_the_future_cancels_a_running_task_and_removes_a_waiting_one() {
        let pool = pool(1, 1);
        let (started, has_started) = oneshot::channel();
        let running = tokio::spawn({
            let pool = Arc::clone(&pool);
            async move {
                pool.run(of("a"), move |ticket| {
                    started.send(()).unwrap();
                    while !ticket.cancellation().requested() {
                        std::thread::sleep(Duration::from_millis(1));
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
            async move { pool.run(of("a"), move |_| Ok(ran.swap(true, Ordering::SeqCst))).await }
        });
        eventually("second task", async || (pool.load() >= 2).then_some(())).await;
        waiting.abort();
        assert!(waiting.await.unwrap_err().is_cancelled());
        running.abort();
        eventually("idle pool", async || (pool.load() == 0).then_some(())).await;
        assert!(!ran.load(Ordering::SeqCst), "work taken out of the queue never starts");
    }

    #[tokio::test]
    async fn tenants_take_turns_however_many_tasks_one_of_them_has() {
        let pool = pool(1, 16);
        let (release, blocked) = mpsc::channel::<()>();
        let running = tokio::spawn({
            let pool = Arc::clone(&pool);
            async move { pool.run(of("a"), move |_| blocked.recv().map_err(|_| gone())).await }
        });
        eventually("running task", async || (pool.load() >= 1).then_some(())).await;
        let order = Arc::new(Mutex::new(Vec::new()));
        let mut all = Vec::new();
        for (load, tenant) in (2..).zip(["a", "a", "a", "a", "b", "c", "b"]) {
            let (pool_of, order) = (Arc::clone(&pool), Arc::clone(&order));
            all.push(tokio::spawn(async move {
                let work = move |_: &Ticket| {
                    order.lock().unwrap().push(tenant);
                    Ok(())
                };
                pool_of.run(of(tenant), work).await.unwrap();
            }));
            eventually("next task", async || (pool.load() >= load).then_some(())).await;
        }
        assert_eq!(pool.work(Some(&Tenant::new("b").unwrap())).len(), 2);
        assert_eq!(pool.work(None).iter().filter(|work| work.running.is_some()).count(), 1);
        release.send(()).unwrap();
        running.await.unwrap().unwrap();
        for one in all {
            one.await.unwrap();
        }
        assert_eq!(*order.lock().unwrap(), ["b", "c", "a", "b", "a", "a", "a"]);
    }

    #[tokio::test]
    async fn one_tenant_cannot_fill_the_queue() {
        let limits = limits(1, 1, 8);
        let pool = Arc::new(ComputePool::new(limits, 2).unwrap());
        let (release, blocked) = mpsc::channel::<()>();
        let mut all = vec![tokio::spawn({
            let pool = Arc::clone(&pool);
            async move { pool.run(of("a"), move |_| blocked.recv().map_err(|_| gone())).await.map(drop) }
        })];
        for (load, tenant) in [(1, "a"), (2, "b")] {
            eventually("next task", async || (pool.load() >= load).then_some(())).await;
            let pool = Arc::clone(&pool);
            all.push(tokio::spawn(async move { pool.run(of(tenant), |_| Ok(())).await.map(drop) }));
        }
        eventually("third task", async || (pool.load() >= 3).then_some(())).await;
        let error = pool.run(of("a"), |_| Ok(())).await.unwrap_err();
        assert_eq!(error.code, Code::ResourceExhausted);
        release.send(()).unwrap();
        for one in all {
            one.await.unwrap().unwrap();
        }
    }
}
