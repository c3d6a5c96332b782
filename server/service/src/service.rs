//! What the service does, in the order in which a client meets it.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use moldline_check::Report;
use moldline_deform::{Setup, Tangent};
use tokio::sync::Semaphore;

use crate::{
    access::{Access, Listed, Page, Session, SessionUpdate, SetupSummary, Visibility},
    cancel::Cancellation,
    checks::{CheckRequest, Watcher},
    error::{Code, ServiceError, shorten},
    flight::{Flights, Joined, Reports},
    limits::Limits,
    linearisation::{Design, Directions, Gradients, Linearised, Resolved, Seeds, Wanted},
    pool::{Completed, ComputePool, PoolLimits},
    principal::{Principal, Role},
    progress::{Progress, Reporter},
    read::{self, Content},
    requests::Answers,
    sessions::Sessions,
    setups::{Owners, SetupId, Setups, StoredSetup},
    status::{CacheStatus, Status},
    upload::{Upload, UploadHeader, Uploaded},
};

/// The service, shared by all transports.
#[derive(Debug)]
pub struct Service {
    limits: Limits,
    started: Instant,
    pool: Arc<ComputePool>,
    owners: Owners,
    uploads: Semaphore,
    setups: Arc<Setups>,
    builds: Flights<SetupId, StoredSetup>,
    created: std::sync::Mutex<Answers>,
    sessions: Arc<Sessions<Linearised>>,
    /// Linearisations that are being made for products, by session and id.
    linearisations: Flights<(String, String), Linearised>,
    /// One permit for each check that may run.
    checking: Arc<Semaphore>,
    /// Checks under way, by set-up and what is asked.
    checks: Flights<(SetupId, String), Product<Report>>,
}

/// An upload under way; its place is free when this is dropped.
#[derive(Debug)]
pub struct Receiving<'a> {
    upload: Upload,
    limits: &'a Limits,
    _place: tokio::sync::SemaphorePermit<'a>,
}

/// The answer to an upload.
#[derive(Clone, Debug)]
pub struct Created {
    /// The set-up.
    pub setup: Arc<StoredSetup>,
    /// What it is to the caller.
    pub access: Access,
    /// Whether it is new to the caller.
    pub built: bool,
}

/// A set-up, and what it is to the caller.
#[derive(Clone, Debug)]
pub struct SetupView {
    /// The set-up.
    pub setup: Arc<StoredSetup>,
    /// What it is to the caller.
    pub access: Access,
}

/// Where a derivative is taken: by id, by design, or best by both.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct At {
    /// Name of a linearisation, as deform gave it.
    pub id: Option<String>,
    /// A design, linearised again if the service does not hold it; that of the id, if there is one.
    pub design: Option<Design>,
}

impl At {
    /// Where the service holds a linearisation of that name.
    pub fn id(id: impl Into<String>) -> Self {
        Self { id: Some(id.into()), design: None }
    }

    /// At a design.
    pub fn design(design: Design) -> Self {
        Self { id: None, design: Some(design) }
    }

    /// # Errors
    /// `InvalidArgument` if it is nowhere.
    fn check(&self) -> Result<(), ServiceError> {
        match self {
            Self { id: None, design: None } => Err(ServiceError::invalid(
                "at",
                "is missing: name a linearisation, send a design point, or both",
            )),
            _ => Ok(()),
        }
    }
}

/// Where the time of a request went.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timing {
    /// Waiting for the engine.
    pub queued: Duration,
    /// In the engine.
    pub engine: Duration,
}

impl std::ops::Add for Timing {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { queued: self.queued + other.queued, engine: self.engine + other.engine }
    }
}

/// What a product with a derivative gives.
#[derive(Clone, Debug)]
pub struct Product<T> {
    /// The result.
    pub value: T,
    /// Of the product, and of the linearisation if it was made for it.
    pub timing: Timing,
}

impl Service {
    /// A service without set-ups.
    ///
    /// # Errors
    /// If the operating system gives no threads.
    pub fn new(pool: PoolLimits, limits: Limits) -> Result<Self, rayon::ThreadPoolBuildError> {
        /// Set-ups are few: this outlives any client's retries.
        const ANSWERS: usize = 4096;
        Ok(Self {
            pool: Arc::new(ComputePool::new(pool)?),
            started: Instant::now(),
            owners: Owners::default(),
            uploads: Semaphore::new(limits.uploads),
            setups: Arc::new(Setups::new(limits.setups)),
            builds: Flights::default(),
            created: std::sync::Mutex::new(Answers::new(ANSWERS)),
            sessions: Arc::new(Sessions::new(&limits)),
            linearisations: Flights::default(),
            checking: Arc::new(Semaphore::new(limits.checks)),
            checks: Flights::default(),
            limits,
        })
    }

    /// The limits in force.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Requests that compute or wait for it.
    pub fn load(&self) -> usize {
        self.pool.load()
    }

    /// Begins to receive a set-up.
    ///
    /// # Errors
    /// `InvalidArgument` for the header's faults, `ResourceExhausted` if too many uploads are under way.
    pub fn receive(&self, caller: &Principal, header: UploadHeader) -> Result<Receiving<'_>, ServiceError> {
        caller.need(Role::User)?;
        let place = self.uploads.try_acquire().map_err(|_| too_many("uploads", self.limits.uploads))?;
        let upload = Upload::begin(header, &self.limits)?;
        Ok(Receiving { upload, limits: &self.limits, _place: place })
    }

    /// Builds an uploaded set-up, or finds the one with the same content. Dropping the future gives up on it; the build
    /// ends when nobody waits for it.
    ///
    /// # Errors
    /// `InvalidArgument` for every fault of the files, `AlreadyExists` for a request id that came with other content,
    /// `ResourceExhausted` if there is no room.
    pub async fn create_setup(
        &self,
        caller: &Principal,
        uploaded: Uploaded,
        mut tell: impl FnMut(Progress),
    ) -> Result<Created, ServiceError> {
        caller.need(Role::User)?;
        tell(Progress { stage: "read", fraction: 0.0, message: "reading the files".to_owned() });
        let request_id = match uploaded.header.request_id.as_str() {
            "" => String::new(),
            id => format!("{}/{id}", caller.tenant),
        };
        let visibility = uploaded.header.visibility.clone();
        let limits = self.limits.clone();
        let content = self.pool.run(move |_| read::read(uploaded, &limits)).await?.value;
        tell(Progress { stage: "read", fraction: 1.0, message: format!("set-up {}", content.id) });

        let id = content.id.clone();
        self.answers().find(&request_id, id.as_str())?;
        let setup = self.find_or_build(content, tell).await?;
        self.answers().remember(&request_id, id.as_str(), id.as_str());
        let (access, built) = self.owners.add(id.as_str(), &caller.tenant, visibility);
        Ok(Created { setup, access, built })
    }

    async fn find_or_build(
        &self,
        content: Content,
        tell: impl FnMut(Progress),
    ) -> Result<Arc<StoredSetup>, ServiceError> {
        let id = content.id.clone();
        let (setups, pool) = (Arc::clone(&self.setups), Arc::clone(&self.pool));
        let land = {
            let setups = Arc::clone(&setups);
            move |setup: &Arc<StoredSetup>| setups.insert(Arc::clone(setup))
        };
        let build = |reports: Reports<StoredSetup>| async move {
            setups.make_room()?;
            let Content { id, name, input } = content;
            let built = pool
                .run(move |cancellation| {
                    let reporter = Reporter::new(cancellation.clone(), |progress| reports.tell(progress));
                    let setup = Setup::build(input, &reporter)?;
                    let functions = setup.reference_functions();
                    Ok((Arc::new(setup), functions))
                })
                .await?;
            tracing::info!(setup = %id, seconds = built.ran.as_secs_f64(), "built a set-up");
            let (engine, functions) = built.value;
            Ok(StoredSetup { id, name, engine, functions, build_time: built.ran })
        };
        let joined = self.builds.join(id.clone(), || self.setups.get(id.as_str()), build, land);
        match joined {
            Joined::Found(setup) => Ok(setup),
            Joined::Following(follower) | Joined::Started(follower) => follower.land(tell).await,
        }
    }

    /// The set-up of that name.
    ///
    /// # Errors
    /// `NotFound`.
    pub async fn get_setup(&self, caller: &Principal, id: &str) -> Result<SetupView, ServiceError> {
        let not_found = || ServiceError::not_found("setup", id);
        let (_, access) = self.owners.access(id, &caller.tenant).ok_or_else(not_found)?;
        let setup = self.setups.get(id).ok_or_else(not_found)?;
        Ok(SetupView { setup, access })
    }

    /// The set-ups that the caller may use.
    ///
    /// # Errors
    /// `Unavailable` if the store does not answer.
    pub async fn list_setups(
        &self,
        caller: &Principal,
        page: &Page,
    ) -> Result<Listed<SetupSummary>, ServiceError> {
        let mut setups = self.setups.all();
        setups.sort_by(|a, b| a.id.cmp(&b.id));
        let visible = setups.iter().filter(|setup| setup.id.as_str() > page.token.as_str());
        let visible = visible.filter_map(|setup| {
            let (created, access) = self.owners.access(setup.id.as_str(), &caller.tenant)?;
            Some(SetupSummary {
                id: setup.id.to_string(),
                name: setup.name.clone(),
                vertices: setup.engine.mesh().vertices.len(),
                cells: setup.engine.mesh().cells.len(),
                variables: setup.engine.parameterisation().variables().len(),
                created,
                access,
            })
        });
        let mut entries: Vec<SetupSummary> = visible.collect();
        let size = if page.size == 0 { self.limits.page } else { page.size.min(self.limits.page) };
        let more = entries.len() > size;
        entries.truncate(size);
        let next = entries.last().filter(|_| more).map(|last| last.id.clone());
        Ok(Listed { entries, next })
    }

    /// Changes who else may use a set-up of the caller's own.
    ///
    /// # Errors
    /// `NotFound`, `PermissionDenied` to readers.
    pub async fn share_setup(
        &self,
        caller: &Principal,
        id: &str,
        visibility: Visibility,
    ) -> Result<Access, ServiceError> {
        caller.need(Role::User)?;
        match self.owners.access(id, &caller.tenant) {
            Some((_, Access { owned: true, .. })) => {
                Ok(self.owners.add(id, &caller.tenant, Some(visibility)).0)
            }
            _ => Err(ServiceError::not_found("setup", id)),
        }
    }

    /// Gives up a set-up of the caller's own. Sessions on it go on.
    ///
    /// # Errors
    /// `NotFound`, `PermissionDenied` to readers.
    pub async fn delete_setup(&self, caller: &Principal, id: &str) -> Result<(), ServiceError> {
        caller.need(Role::User)?;
        match self.owners.remove(id, &caller.tenant) {
            true => Ok(()),
            false => Err(ServiceError::not_found("setup", id)),
        }
    }

    /// Opens a session on a set-up, at its baseline. The same request id again gives the same session.
    ///
    /// # Errors
    /// `NotFound`, `ResourceExhausted`, `AlreadyExists`, `PermissionDenied` to readers.
    pub async fn open_session(
        &self,
        caller: &Principal,
        setup_id: &str,
        label: &str,
        request_id: &str,
    ) -> Result<Session, ServiceError> {
        caller.need(Role::User)?;
        let limit = self.limits.request_id_bytes;
        if request_id.len() > limit {
            let length = request_id.len();
            return Err(ServiceError::invalid(
                "request_id",
                format!("{length} bytes are more than the limit of {limit}"),
            ));
        }
        let setup = self.get_setup(caller, setup_id).await?.setup;
        let parameterisation = setup.engine.parameterisation();
        let design = Resolved::new(parameterisation, Design::default())?.design(parameterisation);
        self.sessions.open(&caller.tenant, setup, design, label, request_id)
    }

    /// The session as it was stored last.
    ///
    /// # Errors
    /// `NotFound`.
    pub async fn get_session(&self, caller: &Principal, id: &str) -> Result<Session, ServiceError> {
        self.sessions.get(&caller.tenant, id)
    }

    /// The caller's open sessions.
    ///
    /// # Errors
    /// `Unavailable` if the store does not answer.
    pub async fn list_sessions(
        &self,
        caller: &Principal,
        page: &Page,
    ) -> Result<Listed<Session>, ServiceError> {
        Ok(self.sessions.list(&caller.tenant, page, self.limits.page))
    }

    /// Stores a session's design.
    ///
    /// # Errors
    /// `NotFound`, `InvalidArgument` naming the entry of the design, `Aborted` if the session is at another generation,
    /// `PermissionDenied` to readers.
    pub async fn update_session(
        &self,
        caller: &Principal,
        id: &str,
        update: SessionUpdate,
    ) -> Result<Session, ServiceError> {
        caller.need(Role::User)?;
        let setup = self.sessions.setup(&caller.tenant, id)?;
        let parameterisation = setup.engine.parameterisation();
        let design = update.design.map(|design| Resolved::new(parameterisation, design)).transpose()?;
        self.sessions.update(&caller.tenant, id, update.expected_generation, |session| {
            if let Some(design) = design {
                session.design = Some(design.design(parameterisation));
            }
            if let Some(label) = update.label {
                session.label = label;
            }
        })
    }

    /// Closes a session.
    ///
    /// # Errors
    /// `NotFound`.
    pub async fn close_session(&self, caller: &Principal, id: &str) -> Result<(), ServiceError> {
        caller.need(Role::User)?;
        self.sessions.close(&caller.tenant, id)
    }

    /// Deforms the session's mesh, and keeps its linearisation. The same set-up and design give the same bits, whoever
    /// asks, whenever.
    ///
    /// # Errors
    /// `NotFound` for the session, `InvalidArgument` naming the entry of the design, `FailedPrecondition` if the engine
    /// cannot reach it, `ResourceExhausted` if the queue is full.
    pub async fn deform(
        &self,
        caller: &Principal,
        session_id: &str,
        design: Design,
    ) -> Result<Arc<Linearised>, ServiceError> {
        caller.need(Role::User)?;
        let setup = self.sessions.setup(&caller.tenant, session_id)?;
        let design = Resolved::new(setup.engine.parameterisation(), design)?;
        let id = design.id(&setup.id);
        let linearised = Arc::new(linearise(&self.pool, setup, design, id).await?);
        keep(&self.sessions, session_id, &linearised);
        Ok(linearised)
    }

    /// The derivative at some point: what the session keeps; or, if it is given by design, a linearisation made now, once
    /// however many ask for it.
    ///
    /// # Errors
    /// As [`Service::deform`]; `NotFound` for an id that the session does not keep.
    pub async fn linearised(
        &self,
        caller: &Principal,
        session_id: &str,
        at: At,
    ) -> Result<Product<Arc<Linearised>>, ServiceError> {
        caller.need(Role::User)?;
        let setup = self.sessions.setup(&caller.tenant, session_id)?;
        let found = |value| Product { value, timing: Timing::default() };
        at.check()?;
        let design = match at.design {
            Some(design) => design,
            None => {
                let id = at.id.unwrap_or_default();
                return self.sessions.find(session_id, &id).map(found).ok_or_else(|| not_kept(&id));
            }
        };
        const FIELD: &str = "at.design_point";
        let design =
            Resolved::new(setup.engine.parameterisation(), design).map_err(|error| error.within(FIELD))?;
        let id = design.id(&setup.id);
        if let Some(given) = at.id.filter(|given| *given != id) {
            let description =
                format!("`{}` is not the linearisation of the design that came with it", shorten(&given));
            return Err(ServiceError::invalid("at.linearisation_id", description));
        }
        let find = || self.sessions.find(session_id, &id);
        let land = {
            let (sessions, session_id) = (Arc::clone(&self.sessions), session_id.to_owned());
            move |linearised: &Arc<Linearised>| keep(&sessions, &session_id, linearised)
        };
        let work = |_| {
            let (pool, id) = (Arc::clone(&self.pool), id.clone());
            async move { linearise(&pool, setup, design, id).await }
        };
        let follower = match self.linearisations.join((session_id.to_owned(), id.clone()), find, work, land) {
            Joined::Found(linearised) => return Ok(found(linearised)),
            Joined::Following(follower) | Joined::Started(follower) => follower,
        };
        let value = follower.land(|_| {}).await.map_err(|error| error.within(FIELD))?;
        Ok(Product { timing: value.timing(), value })
    }

    /// Changes of the outputs along directions of the inputs.
    ///
    /// # Errors
    /// As [`Service::linearised`]; `InvalidArgument` for directions that do not fit.
    pub async fn jvp(
        &self,
        caller: &Principal,
        session_id: &str,
        at: At,
        directions: Directions,
    ) -> Result<Product<Vec<Tangent>>, ServiceError> {
        caller.need(Role::User)?;
        let setup = self.sessions.setup(&caller.tenant, session_id)?;
        at.check()?;
        let directions = directions.check(&setup.engine, &self.limits)?;
        let at = self.linearised(caller, session_id, at).await?;
        self.product(at, move |linearised| linearised.jvp(&directions)).await
    }

    /// Gradients of weighted sums of the outputs.
    ///
    /// # Errors
    /// As [`Service::linearised`]; `InvalidArgument` for seeds that do not fit.
    pub async fn vjp(
        &self,
        caller: &Principal,
        session_id: &str,
        at: At,
        seeds: Seeds,
        wanted: Wanted,
    ) -> Result<Product<Gradients>, ServiceError> {
        caller.need(Role::User)?;
        let setup = self.sessions.setup(&caller.tenant, session_id)?;
        at.check()?;
        let wanted = wanted.check(setup.engine.parameterisation())?;
        let seeds = seeds.check(&setup.engine, &self.limits)?;
        let at = self.linearised(caller, session_id, at).await?;
        self.product(at, move |linearised| linearised.vjp(&seeds, &wanted)).await
    }

    /// Columns of the Jacobian from the `first` one on: one at least, and as many as are made at a time.
    ///
    /// # Errors
    /// `ResourceExhausted` if the queue is full.
    pub async fn jacobian(
        &self,
        caller: &Principal,
        at: &Arc<Linearised>,
        first: usize,
    ) -> Result<Product<Vec<Tangent>>, ServiceError> {
        caller.need(Role::User)?;
        let count = self.limits.vector_bytes / at.vector_bytes().max(1);
        let count = count.clamp(1, self.limits.vectors.max(1));
        let at = Product { value: Arc::clone(at), timing: Timing::default() };
        self.product(at, move |linearised| linearised.jacobian(first, count)).await
    }

    /// What the service does and holds.
    ///
    /// # Errors
    /// `Unavailable` if the store does not answer.
    pub async fn status(&self, caller: &Principal) -> Result<Status, ServiceError> {
        let all_tenants = caller.role >= Role::Admin;
        let owner = (!all_tenants).then_some(&caller.tenant);
        let usable = |setup: &&Arc<StoredSetup>| {
            all_tenants || self.owners.access(setup.id.as_str(), &caller.tenant).is_some()
        };
        let setups = self.setups.all().iter().filter(usable).count();
        let PoolLimits { running, queued, .. } = self.pool.limits();
        Ok(Status {
            version: env!("CARGO_PKG_VERSION"),
            uptime: self.started.elapsed(),
            all_tenants,
            running: self.pool.load().min(running),
            queued: self.pool.load().saturating_sub(running),
            running_limit: running,
            queued_limit: queued,
            sessions: self.sessions.count(owner),
            setups_resident: setups,
            setups_stored: setups,
            stored_bytes: 0,
            // Bounded by number, not by bytes.
            setup_cache: CacheStatus { entries: setups, ..CacheStatus::default() },
            linearisation_cache: self.sessions.cache(owner),
            work: Vec::new(),
        })
    }

    async fn product<T: Send + 'static>(
        &self,
        Product { value: at, timing }: Product<Arc<Linearised>>,
        work: impl FnOnce(&Linearised) -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<Product<T>, ServiceError> {
        let Completed { value, queued, ran } = self.pool.run(move |_| work(&at)).await?;
        Ok(Product { value, timing: timing + Timing { queued, engine: ran } })
    }

    /// Checks the derivatives of a set-up. Who asks for the same as somebody else at the same time gets the same check.
    /// Dropping the future gives up on it; the check ends when nobody waits for it.
    ///
    /// # Errors
    /// `NotFound`, `InvalidArgument` naming what does not fit, `FailedPrecondition` if the engine cannot reach a design,
    /// `ResourceExhausted` if other checks are under way or the queue is full.
    pub async fn check(
        &self,
        caller: &Principal,
        setup_id: &str,
        request: CheckRequest,
        tell: impl FnMut(Progress),
    ) -> Result<Arc<Product<Report>>, ServiceError> {
        caller.need(Role::User)?;
        let SetupView { setup, .. } = self.get_setup(caller, setup_id).await?;
        let request = request.resolve(setup.engine.parameterisation(), &self.limits)?;
        let key = (setup.id.clone(), format!("{request:?}"));
        let work = |reports: Reports<Product<Report>>| {
            let place = Arc::clone(&self.checking).try_acquire_owned();
            let (pool, limit) = (Arc::clone(&self.pool), self.limits.checks);
            async move {
                let _place = place.map_err(|_| too_many("checks", limit))?;
                let work = move |cancellation: &Cancellation| {
                    let watcher = Watcher::new(cancellation.clone(), |progress| reports.tell(progress));
                    Ok(Report::new(&setup.engine, &request, &watcher)?)
                };
                let Completed { value, queued, ran } = pool.run(work).await?;
                Ok(Product { value, timing: Timing { queued, engine: ran } })
            }
        };
        match self.checks.join(key, || None, work, |_| {}) {
            Joined::Found(report) => Ok(report),
            Joined::Following(follower) | Joined::Started(follower) => follower.land(tell).await,
        }
    }

    fn answers(&self) -> std::sync::MutexGuard<'_, Answers> {
        self.created.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

impl Receiving<'_> {
    /// Takes the next bytes of a file.
    ///
    /// # Errors
    /// `InvalidArgument` if they do not fit the header.
    pub fn append(&mut self, file: usize, data: &[u8]) -> Result<(), ServiceError> {
        self.upload.append(file, data, self.limits)
    }

    /// How much of it has come.
    pub fn progress(&self) -> Progress {
        let message = "receiving the files".to_owned();
        Progress { stage: "receive", fraction: self.upload.fraction(), message }
    }

    /// Ends the upload.
    ///
    /// # Errors
    /// `InvalidArgument` naming the first file that is not complete.
    pub fn finish(self) -> Result<Uploaded, ServiceError> {
        self.upload.finish()
    }
}

async fn linearise(
    pool: &ComputePool,
    setup: Arc<StoredSetup>,
    design: Resolved,
    id: String,
) -> Result<Linearised, ServiceError> {
    let work = move |cancellation: &Cancellation| {
        let monitor = Reporter::new(cancellation.clone(), |_| {});
        design.linearise(id, &setup.engine, &monitor)
    };
    let Completed { value, queued, ran } = pool.run(work).await?;
    Ok(value.taking(Timing { queued, engine: ran }))
}

fn keep(sessions: &Sessions<Linearised>, session_id: &str, linearised: &Arc<Linearised>) {
    sessions.keep(session_id, linearised.id(), Arc::clone(linearised), linearised.bytes());
}

fn too_many(what: &str, limit: usize) -> ServiceError {
    let message = format!("the limit of {limit} {what} at a time is reached; try again later");
    ServiceError::new(Code::ResourceExhausted, message).retry_after(Duration::from_secs(1))
}

fn not_kept(id: &str) -> ServiceError {
    let description = format!(
        "the session keeps no linearisation `{}`: it never made it, or dropped it for newer ones; Deform again, or send \
         the design in place of the id",
        shorten(id)
    );
    ServiceError::new(Code::NotFound, "").at("at.linearisation_id", description)
}
