//! The service: permissions, limits and memory around the panel method on the compute pool.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use moldline_host::{
    Cache, CacheStatus, Code, Completed, ComputePool, Flights, Joined, PoolLimits, Principal, Product,
    Progress, Reports, Role, ServiceError, Supply, Task, Tenant, Ticket, Timing,
};
use moldline_panel::{
    Analysis, Flow, Inputs, Linearisation, Monitor, Outputs, Reference, SetupSummary, Stage,
};

use crate::{
    configuration::{Configuration, Definition},
    merging::Merging,
    progress::reporter,
    solved::{self, Solved},
};

/// Limits on requests and on the memory of the service.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits {
    /// Of a mesh.
    pub mesh: moldline_mesh::Limits,
    /// Bytes of all configurations in memory.
    pub configuration_bytes: u64,
    /// Bytes of all solutions, including those in progress; a single one may use them all.
    pub solution_bytes: u64,
    /// Flows of one analysis, and directions or seeds of one product.
    pub vectors: usize,
    /// Bytes of the numbers in one answer, or in one block of directions or seeds.
    pub vector_bytes: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            mesh: moldline_mesh::Limits {
                vertices: 200_000,
                cells: 200_000,
                groups: 1000,
                ..Default::default()
            },
            configuration_bytes: 512 << 20,
            solution_bytes: 4 << 30,
            vectors: 64,
            vector_bytes: 128 << 20,
        }
    }
}

/// Positions of the vertices, and the Mach number.
#[derive(Clone, Debug, PartialEq)]
pub struct Geometry {
    /// Vertices, m; the reference positions if absent.
    pub vertices: Option<Vec<[f64; 3]>>,
    /// Mach number.
    pub mach: f64,
}

/// The point of a derivative: the id of an analysis, a geometry, or preferably both.
#[derive(Clone, Debug, PartialEq)]
pub struct AnalysisPoint {
    /// The analysis's id; may be empty.
    pub analysis_id: String,
    /// The geometry of the analysis.
    pub geometry: Option<Geometry>,
    /// Flow angles and reference values.
    pub flow: Flow,
}

/// The answer to a request for a configuration.
#[derive(Clone, Debug)]
pub struct Created {
    /// The configuration.
    pub configuration: Arc<Configuration>,
    /// Whether it was new.
    pub created: bool,
}

/// Analyses of one solution.
#[derive(Clone, Debug)]
pub struct Analysed {
    /// The solution.
    pub solved: Arc<Solved>,
    /// One analysis per flow.
    pub analyses: Vec<Analysis>,
    /// Whether the solution was known.
    pub reused: bool,
    /// Where the time went.
    pub timing: Timing,
}

/// Load and contents of the service.
#[derive(Clone, Debug)]
pub struct Status {
    /// Time since the start.
    pub uptime: Duration,
    /// Running tasks.
    pub running: usize,
    /// Waiting tasks.
    pub queued: usize,
    /// Limits of the pool.
    pub pool: PoolLimits,
    /// The cache of configurations.
    pub configurations: CacheStatus,
    /// The cache of solutions, with the bytes of those in progress.
    pub solutions: CacheStatus,
}

type Key = (Tenant, String);

/// The panel method for many callers.
#[derive(Debug)]
pub struct PanelService {
    pool: Arc<ComputePool>,
    configurations: Arc<Cache<Key, Configuration>>,
    solutions: Arc<Cache<Key, Solved>>,
    preparations: Flights<Key, Configuration>,
    flights: Flights<Key, Solved>,
    limits: Limits,
    started: Instant,
}

impl PanelService {
    /// A service without configurations.
    pub fn new(pool: Arc<ComputePool>, limits: Limits) -> Self {
        Self {
            pool,
            configurations: Arc::new(Cache::new(limits.configuration_bytes)),
            solutions: Arc::new(Cache::new(limits.solution_bytes)),
            preparations: Flights::default(),
            flights: Flights::default(),
            limits,
            started: Instant::now(),
        }
    }

    /// The limits in force.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// The working memory.
    pub fn memory(&self) -> &Arc<Supply> {
        self.pool.memory()
    }

    /// Whether the pool gets work done.
    ///
    /// # Errors
    /// As [`ComputePool::moving`].
    pub fn moving(&self) -> Result<(), String> {
        self.pool.moving()
    }

    /// Number of running and waiting tasks.
    pub fn load(&self) -> usize {
        self.pool.load()
    }

    /// The current status.
    pub fn status(&self) -> Status {
        let pool = self.pool.limits();
        let work = self.pool.work(None);
        let running = work.iter().filter(|work| work.running.is_some()).count();
        Status {
            uptime: self.started.elapsed(),
            running,
            queued: work.len() - running,
            pool,
            configurations: self.configurations.status(),
            solutions: self.solutions.status(),
        }
    }

    /// The configuration of that content, prepared if it is not in memory.
    ///
    /// # Errors
    /// `InvalidArgument` naming the invalid field; `ResourceExhausted` if an analysis of it would need more memory than the limit.
    pub async fn create_configuration(
        &self,
        caller: &Principal,
        definition: Definition,
    ) -> Result<Created, ServiceError> {
        caller.need(Role::User)?;
        let id = definition.id();
        let key = (caller.tenant.clone(), id.clone());
        let (cache, pool, limits) =
            (Arc::clone(&self.configurations), Arc::clone(&self.pool), self.limits.clone());
        let task = task(caller, "prepare", &id);
        let keep = {
            let (cache, key) = (Arc::clone(&cache), key.clone());
            move |configuration: &Arc<Configuration>| cache.keep(key, Arc::clone(configuration))
        };
        let prepare = |_: Reports<Configuration>| async move {
            let prepared = pool.run(task, move |ticket| {
                let claim = cache.claim("the configuration", definition.bytes())?;
                let monitor = reporter(ticket.cancellation().clone(), |_| {});
                definition.prepare(id, &limits.mesh, limits.solution_bytes, claim, &monitor)
            });
            let Completed { value, ran, .. } = prepared.await?;
            tracing::info!(configuration = value.id, seconds = ran.as_secs_f64(), "prepared a configuration");
            Ok(value)
        };
        let found = || self.configurations.get(&key);
        match self.preparations.join(key.clone(), found, prepare, keep) {
            Joined::Found(configuration) => Ok(Created { configuration, created: false }),
            Joined::Following(follower) => {
                Ok(Created { configuration: follower.wait(|_| {}).await?, created: false })
            }
            Joined::Started(follower) => {
                Ok(Created { configuration: follower.wait(|_| {}).await?, created: true })
            }
        }
    }

    /// The configuration of that id.
    ///
    /// # Errors
    /// `NotFound` if the caller's tenant has not created it, or it was evicted.
    pub fn configuration(&self, caller: &Principal, id: &str) -> Result<Arc<Configuration>, ServiceError> {
        let key = (caller.tenant.clone(), id.to_owned());
        self.configurations.get(&key).ok_or_else(|| ServiceError::not_found("configuration", id))
    }

    /// Analyses of the flow over one geometry, at all angles in `flows`.
    ///
    /// # Errors
    /// `InvalidArgument` naming the invalid field; `FailedPrecondition` if the method fails on these vertices;
    /// `ResourceExhausted`.
    pub async fn analyse(
        &self,
        caller: &Principal,
        configuration_id: &str,
        geometry: Geometry,
        flows: Vec<Flow>,
        tell: impl FnMut(Progress),
    ) -> Result<Analysed, ServiceError> {
        caller.need(Role::User)?;
        let configuration = self.configuration(caller, configuration_id)?;
        if flows.is_empty() {
            return Err(ServiceError::invalid("flows", "is empty: name one angle of attack at least"));
        }
        let size = size_of::<f64>() * (configuration.cells + configuration.vertices.len());
        self.check_count("flows", flows.len(), size)?;
        for (index, flow) in flows.iter().enumerate() {
            check_flow(&format!("flows[{index}]"), "reference", flow, &configuration.summary)?;
        }
        let id = name(&configuration, &geometry);
        let (solved, reused, timing) = self.solved(caller, &configuration, id, Some(geometry), tell).await?;
        let solution = Arc::clone(&solved.solution);
        let analyse = move |ticket: &Ticket| {
            let analyse = |flow| {
                ticket.cancellation().check()?;
                match &configuration.merging {
                    None => Ok(solution.analyse(flow)?),
                    Some(merging) => {
                        let analysis = solution.analyse(flow).map_err(|error| merging.explain(error))?;
                        Ok(merging.analysis(analysis))
                    }
                }
            };
            flows.iter().map(analyse).collect()
        };
        let Completed { value, queued, ran } =
            self.pool.run(task(caller, "analyse", configuration_id), analyse).await?;
        Ok(Analysed { solved, analyses: value, reused, timing: timing + Timing { queued, engine: ran } })
    }

    /// Changes of the outputs along several directions of the inputs (forward mode).
    ///
    /// # Errors
    /// As [`analyse`](Self::analyse); `NotFound` for an id without geometry whose solution is not in memory.
    pub async fn jvp(
        &self,
        caller: &Principal,
        configuration_id: &str,
        at: AnalysisPoint,
        directions: Vec<Inputs>,
    ) -> Result<Product<Vec<Outputs>>, ServiceError> {
        let count = directions.len();
        self.product(
            caller,
            configuration_id,
            at,
            ("jvp", "directions"),
            count,
            move |linearisation, merging, monitor| match merging {
                None => Ok(linearisation.jvp(&directions, monitor)?),
                Some(merging) => {
                    let merged = merging.directions(directions)?;
                    linearisation.jvp(&merged, monitor).map_err(|error| merging.explain(error))
                }
            },
        )
        .await
    }

    /// Gradients of several weighted sums of the outputs (reverse mode).
    ///
    /// # Errors
    /// As [`jvp`](Self::jvp).
    pub async fn vjp(
        &self,
        caller: &Principal,
        configuration_id: &str,
        at: AnalysisPoint,
        seeds: Vec<Outputs>,
    ) -> Result<Product<Vec<Inputs>>, ServiceError> {
        let count = seeds.len();
        self.product(
            caller,
            configuration_id,
            at,
            ("vjp", "seeds"),
            count,
            move |linearisation, merging, monitor| {
                let gradients = linearisation.vjp(&seeds, monitor)?;
                Ok(match merging {
                    None => gradients,
                    Some(merging) => merging.gradients(gradients),
                })
            },
        )
        .await
    }

    async fn product<T: Send + 'static>(
        &self,
        caller: &Principal,
        configuration_id: &str,
        at: AnalysisPoint,
        (kind, what): (&'static str, &str),
        count: usize,
        work: impl FnOnce(&Linearisation, Option<&Merging>, &dyn Monitor<Stage>) -> Result<Vec<T>, ServiceError>
        + Send
        + 'static,
    ) -> Result<Product<Vec<T>>, ServiceError> {
        caller.need(Role::User)?;
        let configuration = self.configuration(caller, configuration_id)?;
        self.check_count(what, count, size_of::<[f64; 3]>() * configuration.vertices.len())?;
        let AnalysisPoint { analysis_id, geometry, flow } = at;
        check_flow("at.flow", "at.reference", &flow, &configuration.summary)?;
        let id = match &geometry {
            None if analysis_id.is_empty() => {
                let description = "is missing: name the analysis, send its geometry, or best both";
                return Err(ServiceError::invalid("at", description));
            }
            None => analysis_id,
            Some(geometry) => {
                let id = name(&configuration, geometry);
                if !analysis_id.is_empty() && analysis_id != id {
                    let description = format!("is not that of at.geometry, which is `{id}`");
                    return Err(ServiceError::invalid("at.analysis_id", description));
                }
                id
            }
        };
        let (solved, _, timing) = self.solved(caller, &configuration, id, geometry, |_| {}).await?;
        let solutions = Arc::clone(&self.solutions);
        let run = move |ticket: &Ticket| {
            // The memory of the products besides the system.
            let bytes = configuration.summary.memory.saturating_sub(solved.solution.bytes());
            let _claim = solutions.claim("the product with the derivative", bytes)?;
            let linearisation = solved.solution.linearise(&flow)?;
            let monitor = reporter(ticket.cancellation().clone(), |progress| ticket.progress(&progress));
            work(&linearisation, configuration.merging.as_ref(), &monitor)
        };
        let Completed { value, queued, ran } =
            self.pool.run(task(caller, kind, configuration_id), run).await?;
        Ok(Product { value, timing: timing + Timing { queued, engine: ran } })
    }

    /// The solution of that id, computed from `geometry` if it is not in memory; whether it was known, and the time that it took.
    async fn solved(
        &self,
        caller: &Principal,
        configuration: &Arc<Configuration>,
        id: String,
        geometry: Option<Geometry>,
        tell: impl FnMut(Progress),
    ) -> Result<(Arc<Solved>, bool, Timing), ServiceError> {
        let key = (caller.tenant.clone(), id.clone());
        let Some(Geometry { vertices, mach }) = geometry else {
            let found = self.solutions.get(&key);
            let found = found.ok_or_else(|| {
                let description = "the server keeps no analysis of that id: it never made it, or dropped it for newer ones; \
                                   send at.geometry with it";
                ServiceError::new(Code::NotFound, "").at("at.analysis_id", description)
            })?;
            if found.configuration != configuration.id {
                let description = format!(
                    "is an analysis of the configuration `{}`, not of `{}`; name that configuration, or send at.geometry",
                    found.configuration, configuration.id
                );
                return Err(ServiceError::invalid("at.analysis_id", description));
            }
            return Ok((found, true, Timing::default()));
        };
        let arrival = Instant::now();
        let vertices = vertices.map_or_else(|| Arc::clone(&configuration.vertices), Arc::new);
        let (pool, solutions) = (Arc::clone(&self.pool), Arc::clone(&self.solutions));
        let keep = {
            let (solutions, key) = (Arc::clone(&solutions), key.clone());
            move |solved: &Arc<Solved>| solutions.keep(key, Arc::clone(solved))
        };
        let task = task(caller, "solve", &configuration.id);
        let configuration = Arc::clone(configuration);
        let spent = Arc::new(std::sync::OnceLock::new());
        let solve = {
            let spent = Arc::clone(&spent);
            |reports: Reports<Solved>| async move {
                let work = move |ticket: &Ticket| {
                    let claim = solutions.claim("the analysis", configuration.summary.memory)?;
                    let tell = |progress: Progress| {
                        ticket.progress(&progress);
                        reports.tell(progress);
                    };
                    Solved::new(id, &configuration, &vertices, mach, claim, ticket.cancellation(), tell)
                };
                let Completed { value, queued, ran } = pool.run(task, work).await?;
                let seconds = ran.as_secs_f64();
                tracing::info!(analysis = value.id, seconds, rounds = value.residuals.len(), "solved");
                let _ = spent.set(Timing { queued, engine: ran });
                Ok(value)
            }
        };
        match self.flights.join(key.clone(), || self.solutions.get(&key), solve, keep) {
            Joined::Found(solved) => Ok((solved, true, Timing::default())),
            Joined::Following(follower) => {
                // The work of another call, for which this one waited.
                let solved = follower.wait(tell).await?;
                Ok((solved, true, Timing { queued: arrival.elapsed(), engine: Duration::ZERO }))
            }
            Joined::Started(follower) => {
                let solved = follower.wait(tell).await?;
                Ok((solved, false, spent.get().copied().unwrap_or_default()))
            }
        }
    }

    fn check_count(&self, field: &str, count: usize, bytes: usize) -> Result<(), ServiceError> {
        let most = self.limits.vectors.min(self.limits.vector_bytes / bytes.max(1)).max(1);
        if count == 0 {
            return Err(ServiceError::invalid(field, "is empty"));
        }
        if count > most {
            let description = format!(
                "{count} are more than the limit of {most} for a mesh of this size; send fewer at a time"
            );
            return Err(ServiceError::invalid(field, description));
        }
        Ok(())
    }
}

fn name(configuration: &Configuration, geometry: &Geometry) -> String {
    let vertices = geometry.vertices.as_ref().unwrap_or(&configuration.vertices);
    solved::name(configuration, vertices, geometry.mach)
}

/// Validates a flow before anything is solved for it.
fn check_flow(
    angles: &str,
    reference: &str,
    flow: &Flow,
    summary: &SetupSummary,
) -> Result<(), ServiceError> {
    let finite = |field: String, value: f64| match value.is_finite() {
        true => Ok(()),
        false => Err(ServiceError::invalid(field, format!("{value} is not a finite number"))),
    };
    finite(format!("{angles}.alpha"), flow.alpha)?;
    finite(format!("{angles}.sideslip"), flow.sideslip)?;
    if summary.symmetric && flow.sideslip != 0.0 {
        let description = format!(
            "{} rad needs both halves; this configuration solves one with a symmetry plane",
            flow.sideslip
        );
        return Err(ServiceError::invalid(format!("{angles}.sideslip"), description));
    }
    let Reference { area, chord, span, point } = flow.reference;
    for (name, value) in [("area", area), ("chord", chord), ("span", span)] {
        if !(value.is_finite() && value > 0.0) {
            let description = format!("{value} is not a positive number");
            return Err(ServiceError::invalid(format!("{reference}.{name}"), description));
        }
    }
    point.iter().enumerate().try_for_each(|(axis, &x)| finite(format!("{reference}.point[{axis}]"), x))
}

/// A task on a configuration.
fn task(caller: &Principal, kind: &'static str, configuration: &str) -> Task {
    Task {
        kind,
        tenant: caller.tenant.clone(),
        setup: Some(configuration.to_owned()),
        session: None,
        memory: 0,
    }
}
