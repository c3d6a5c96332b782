//! What the service does, in the order in which a client meets it.

use std::{
    sync::Arc,
    time::{Duration, Instant, SystemTime},
};

use futures::{
    Stream, StreamExt, TryStreamExt, future,
    stream::{self, Iter},
};
use moldline_check::Report;
use moldline_deform::Tangent;
use moldline_store::{
    AccessRecord, Claim, Generation, SessionRecord, Shared, Store, StoreError, unless_damaged,
};
use tokio::sync::Semaphore;

use crate::{
    access::{Access, Listed, Page, Session, SessionUpdate, SetupSummary, Visibility},
    cache::Cache,
    checks::{CheckRequest, Watcher},
    error::{Code, ServiceError, shorten},
    flight::{Flights, Joined, Reports},
    limits::Limits,
    linearisation::{Design, Directions, Gradients, Linearised, Resolved, Seeds, Wanted},
    pool::{Completed, ComputePool, PoolLimits, Task, Ticket},
    principal::{Principal, Role, Tenant},
    progress::{Progress, Reporter},
    read,
    sessions::{self, Sessions},
    setups::{SetupId, Setups, StoredSetup},
    status::{CacheStatus, Status},
    upload::{Upload, UploadHeader, Uploaded},
};

/// Records read at a time.
const AT_ONCE: usize = 32;

/// The service, shared by all transports.
#[derive(Debug)]
pub struct Service {
    limits: Limits,
    started: Instant,
    store: Store,
    pool: Arc<ComputePool>,
    uploads: Semaphore,
    setups: Setups,
    sessions: Sessions,
    /// Linearisations by tenant and id.
    held: Arc<Cache<(Tenant, String), Linearised>>,
    /// Those that are being made for products.
    linearisations: Flights<(Tenant, String), Linearised>,
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
    /// A service that keeps everything in memory and ends with it.
    ///
    /// # Errors
    /// If the operating system gives no threads.
    pub fn new(pool: PoolLimits, limits: Limits) -> Result<Self, rayon::ThreadPoolBuildError> {
        Self::with_store(Store::in_memory(), pool, limits)
    }

    /// A service on a store, which others may use as well.
    ///
    /// # Errors
    /// If the operating system gives no threads.
    pub fn with_store(
        store: Store,
        pool: PoolLimits,
        limits: Limits,
    ) -> Result<Self, rayon::ThreadPoolBuildError> {
        let pool = Arc::new(ComputePool::new(pool, limits.load)?);
        Ok(Self {
            started: Instant::now(),
            uploads: Semaphore::new(limits.uploads),
            setups: Setups::new(store.clone(), Arc::clone(&pool), &limits),
            sessions: Sessions::new(store.clone()),
            held: Arc::new(Cache::new(limits.linearisation_bytes, |_| false)),
            linearisations: Flights::default(),
            checking: Arc::new(Semaphore::new(limits.checks)),
            checks: Flights::default(),
            pool,
            store,
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
    /// `InvalidArgument` for the header's faults, `ResourceExhausted` if too many uploads are under way,
    /// `PermissionDenied` to readers.
    pub fn receive(&self, caller: &Principal, header: UploadHeader) -> Result<Receiving<'_>, ServiceError> {
        caller.need(Role::User)?;
        let place = self.uploads.try_acquire().map_err(|_| too_many("uploads", self.limits.uploads))?;
        let upload = Upload::begin(header, &self.limits)?;
        Ok(Receiving { upload, limits: &self.limits, _place: place })
    }

    /// Builds an uploaded set-up, or finds the one with the same content, and stores it. Dropping the future gives up on
    /// it; the build ends when nobody waits for it.
    ///
    /// # Errors
    /// `InvalidArgument` for every fault of the files, `AlreadyExists` for a request id that came with other content,
    /// `ResourceExhausted` if there is no room, `Unavailable` if it cannot be stored, `PermissionDenied` to readers.
    pub async fn create_setup(
        &self,
        caller: &Principal,
        uploaded: Uploaded,
        mut tell: impl FnMut(Progress),
    ) -> Result<Created, ServiceError> {
        caller.need(Role::User)?;
        let tenant = &caller.tenant;
        tell(Progress { stage: "read", fraction: 0.0, message: "reading the files".to_owned() });
        let request_id = uploaded.header.request_id.clone();
        let visibility = uploaded.header.visibility.clone();
        let limits = self.limits.clone();
        let task = Task { kind: "read", tenant: tenant.clone(), setup: None, session: None };
        let mut content = self.pool.run(task, move |_| read::uploaded(uploaded, &limits)).await?.value;
        let id = content.id.to_string();
        tell(Progress { stage: "read", fraction: 1.0, message: format!("set-up {id}") });

        self.claim(caller, &request_id, &["setup", &id, &format!("{visibility:?}")]).await?;
        let bytes: u64 = content.files.iter().map(|(_, file)| file.len() as u64).sum();
        let known = self.store.access_or_damage(tenant.as_str(), &id).await?.map(|known| known.record);
        if !matches!(known, Some(Ok(record)) if record.owned) {
            self.check_quota(caller, bytes).await?;
        }
        let files = std::mem::take(&mut content.files);
        let setup = self.setups.of_content(tenant, content, tell).await?;
        self.store.put_setup(&files).await?;
        let (access, built) = self.own(caller, &setup, bytes, visibility).await?;
        Ok(Created { setup, access, built })
    }

    /// Refuses what a tenant has no room for.
    async fn check_quota(&self, caller: &Principal, more: u64) -> Result<(), ServiceError> {
        let owned = self.store.owned(caller.tenant.as_str()).await?;
        let limit = self.limits.setups;
        if owned.len() >= limit {
            let message = format!("you have {} set-ups, which is the limit; delete some", owned.len());
            return Err(ServiceError::new(Code::ResourceExhausted, message));
        }
        let (held, limit) =
            (owned.iter().map(|(_, record)| record.bytes).sum::<u64>(), self.limits.stored_bytes);
        if held.saturating_add(more) > limit {
            let message = format!(
                "your set-ups have {held} bytes, and {more} more exceed the limit of {limit}; delete some"
            );
            return Err(ServiceError::new(Code::ResourceExhausted, message));
        }
        Ok(())
    }

    /// Makes the caller an owner of a set-up; whether that is new to it.
    async fn own(
        &self,
        caller: &Principal,
        setup: &StoredSetup,
        bytes: u64,
        visibility: Option<Visibility>,
    ) -> Result<(Access, bool), ServiceError> {
        let (tenant, id) = (caller.tenant.as_str(), setup.id.as_str());
        loop {
            let known = self.store.access_or_damage(tenant, id).await?;
            let number = known.as_ref().map_or(1, |known| known.number + 1);
            let known = unless_damaged(known.map(|known| known.record).transpose())?;
            let (record, new) = match known.filter(|record| record.owned) {
                Some(record) => match &visibility {
                    Some(visibility) => (AccessRecord { shared: shared(visibility), ..record }, false),
                    None => return Ok((owner_access(&record), false)),
                },
                None => {
                    let shared = shared(visibility.as_ref().unwrap_or(&Visibility::Private));
                    (access_record(setup, bytes, shared), true)
                }
            };
            if self.store.put_access(tenant, id, number, &record).await? {
                return Ok((owner_access(&record), new));
            }
        }
    }

    /// The set-up of that name.
    ///
    /// # Errors
    /// `NotFound`, `Unavailable` if the store does not answer.
    pub async fn get_setup(&self, caller: &Principal, id: &str) -> Result<SetupView, ServiceError> {
        let not_found = || ServiceError::not_found("setup", id);
        let (_, access) = self.access(&caller.tenant, id).await?.ok_or_else(not_found)?;
        let setup = self.setups.named(&caller.tenant, id).await?.ok_or_else(not_found)?;
        Ok(SetupView { setup, access })
    }

    /// What a set-up is to a tenant; `None` if it may not use it.
    async fn access(&self, tenant: &Tenant, id: &str) -> Result<Option<(AccessRecord, Access)>, StoreError> {
        if !SetupId::is_one(id) {
            return Ok(None);
        }
        let own = self.store.access(tenant.as_str(), id).await?.map(|known| known.record);
        if let Some(record) = own.filter(|record| record.owned) {
            let access = owner_access(&record);
            return Ok(Some((record, access)));
        }
        let granted = self.store.granted(tenant.as_str(), id).await?;
        Ok(granted.map(|record| {
            let visibility = match record.shared {
                Shared::Public => Visibility::Public,
                _ => Visibility::Tenants([tenant.clone()].into()),
            };
            (record, Access { owned: false, visibility })
        }))
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
        let names = self.store.setups_of(caller.tenant.as_str()).await?;
        let summaries = after(names, page).map(|id| async move {
            let found = unless_damaged(self.access(&caller.tenant, &id).await)?;
            Ok(found.map(|(record, access)| SetupSummary {
                id,
                name: record.name,
                vertices: record.vertices as usize,
                cells: record.cells as usize,
                variables: record.variables as usize,
                created: record.created,
                access,
            }))
        });
        self.listed(page, summaries.buffered(AT_ONCE), |summary: &SetupSummary| summary.id.clone()).await
    }

    /// As many of `entries` as fit a page.
    async fn listed<T>(
        &self,
        page: &Page,
        entries: impl Stream<Item = Result<Option<T>, ServiceError>>,
        name: impl Fn(&T) -> String,
    ) -> Result<Listed<T>, ServiceError> {
        let size = if page.size == 0 { self.limits.page } else { page.size.min(self.limits.page) };
        let found = entries.try_filter_map(future::ok).take(size + 1);
        let mut entries: Vec<T> = found.try_collect().await?;
        let more = entries.len() > size;
        entries.truncate(size);
        let next = entries.last().filter(|_| more).map(name);
        Ok(Listed { entries, next })
    }

    /// Changes who else may use a set-up of the caller's own.
    ///
    /// # Errors
    /// `NotFound`, `PermissionDenied` to readers, `Unavailable` if it cannot be stored.
    pub async fn share_setup(
        &self,
        caller: &Principal,
        id: &str,
        visibility: Visibility,
    ) -> Result<Access, ServiceError> {
        caller.need(Role::User)?;
        self.change_access(caller, id, |record| record.shared = shared(&visibility)).await
    }

    /// Gives up a set-up of the caller's own. Sessions on it go on.
    ///
    /// # Errors
    /// `NotFound`, `PermissionDenied` to readers, `Unavailable` if it cannot be stored.
    pub async fn delete_setup(&self, caller: &Principal, id: &str) -> Result<(), ServiceError> {
        caller.need(Role::User)?;
        self.change_access(caller, id, |record| record.owned = false).await.map(drop)
    }

    async fn change_access(
        &self,
        caller: &Principal,
        id: &str,
        change: impl Fn(&mut AccessRecord),
    ) -> Result<Access, ServiceError> {
        let tenant = caller.tenant.as_str();
        let not_found = || ServiceError::not_found("setup", id);
        if !SetupId::is_one(id) {
            return Err(not_found());
        }
        loop {
            let known = self.store.access(tenant, id).await?.filter(|known| known.record.owned);
            let mut known = known.ok_or_else(not_found)?;
            change(&mut known.record);
            if self.store.put_access(tenant, id, known.number + 1, &known.record).await? {
                return Ok(owner_access(&known.record));
            }
        }
    }

    /// Binds a request id to what it asks for.
    async fn claim(
        &self,
        caller: &Principal,
        request_id: &str,
        request: &[&str],
    ) -> Result<bool, ServiceError> {
        let limit = self.limits.request_id_bytes;
        if request_id.len() > limit {
            let length = request_id.len();
            return Err(ServiceError::invalid(
                "request_id",
                format!("{length} bytes are more than the limit of {limit}"),
            ));
        }
        let mut hasher = blake3::Hasher::new();
        for part in request {
            hasher.update(&(part.len() as u64).to_le_bytes());
            hasher.update(part.as_bytes());
        }
        let hash = hasher.finalize().to_hex();
        match self.store.claim(caller.tenant.as_str(), request_id, hash.as_str()).await? {
            Claim::New => Ok(false),
            Claim::Repeated => Ok(true),
            Claim::Taken => Err(ServiceError::new(Code::AlreadyExists, "").at(
                "request_id",
                format!(
                    "`{}` named a request with other content before; choose a new one",
                    shorten(request_id)
                ),
            )),
        }
    }

    /// Opens a session on a set-up, at its baseline. The same request id again gives the same session.
    ///
    /// # Errors
    /// `NotFound`, `ResourceExhausted`, `AlreadyExists`, `PermissionDenied` to readers, `Unavailable` if it cannot be
    /// stored.
    pub async fn open_session(
        &self,
        caller: &Principal,
        setup_id: &str,
        label: &str,
        request_id: &str,
    ) -> Result<Session, ServiceError> {
        caller.need(Role::User)?;
        self.check_label(label)?;
        let tenant = &caller.tenant;
        let setup = self.get_setup(caller, setup_id).await?.setup;
        let repeated = self.claim(caller, request_id, &["session", setup_id, label]).await?;
        let id = sessions::id_for(tenant, request_id);
        if repeated {
            if let Some(session) = self.store.session(tenant.as_str(), &id).await? {
                return Ok(sessions::session(&id, session));
            }
            if self.store.session_at(tenant.as_str(), &id, 1).await?.is_some() {
                // A retry that comes after the session was closed.
                return Err(ServiceError::not_found("session", &id));
            }
        }
        let (open, limit) = (self.store.sessions(tenant.as_str()).await?.len(), self.limits.sessions);
        if open >= limit {
            let message = format!("{open} of your sessions are open, which is the limit; close some");
            return Err(ServiceError::new(Code::ResourceExhausted, message));
        }
        let parameterisation = setup.engine.parameterisation();
        let (design, control_points) =
            Resolved::new(parameterisation, Design::default())?.numbers(parameterisation);
        let now = SystemTime::now();
        let record = SessionRecord {
            setup: setup_id.to_owned(),
            design,
            control_points,
            label: label.to_owned(),
            created: now,
            updated: now,
            request: request_id.to_owned(),
        };
        let latest = match self.store.put_session(tenant.as_str(), &id, 1, &record).await? {
            true => Generation { number: 1, record },
            // The same request at the same time.
            false => self.sessions.get(tenant, &id).await?,
        };
        self.sessions.opened(tenant, &id, setup_id);
        Ok(sessions::session(&id, latest))
    }

    fn check_label(&self, label: &str) -> Result<(), ServiceError> {
        let (length, limit) = (label.len(), self.limits.label_bytes);
        if length <= limit {
            return Ok(());
        }
        Err(ServiceError::invalid("label", format!("{length} bytes are more than the limit of {limit}")))
    }

    /// The session as it was stored last.
    ///
    /// # Errors
    /// `NotFound`, `Unavailable` if the store does not answer.
    pub async fn get_session(&self, caller: &Principal, id: &str) -> Result<Session, ServiceError> {
        Ok(sessions::session(id, self.sessions.get(&caller.tenant, id).await?))
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
        let tenant = caller.tenant.as_str();
        let found = after(self.store.sessions(tenant).await?, page).map(|id| async move {
            let latest = unless_damaged(self.store.session(tenant, &id).await)?;
            Ok(latest.map(|latest| Session { design: None, ..sessions::session(&id, latest) }))
        });
        self.listed(page, found.buffered(AT_ONCE), |session: &Session| session.id.clone()).await
    }

    /// Stores a session's design. Of two updates of one generation one wins; a retry of the winner is answered like it.
    ///
    /// # Errors
    /// `NotFound`, `InvalidArgument` naming the entry of the design, `Aborted` if the session is at another generation,
    /// `AlreadyExists` for a request id that came with another update, `PermissionDenied` to readers, `Unavailable` if it
    /// cannot be stored.
    pub async fn update_session(
        &self,
        caller: &Principal,
        id: &str,
        update: SessionUpdate,
    ) -> Result<Session, ServiceError> {
        caller.need(Role::User)?;
        let (tenant, expected) = (&caller.tenant, update.expected_generation);
        if let Some(label) = &update.label {
            self.check_label(label)?;
        }
        let Generation { number, mut record } = self.sessions.get(tenant, id).await?;
        let setup = self.resident(caller, id, &record.setup).await?;
        let parameterisation = setup.engine.parameterisation();
        let design = update.design.map(|design| Resolved::new(parameterisation, design)).transpose()?;
        let design = design.map(|design| design.numbers(parameterisation));
        let label = update.label;
        let request = [id, &expected.to_string(), &format!("{design:?}"), &format!("{label:?}")];
        self.claim(caller, &update.request_id, &request).await?;

        let next = expected.saturating_add(1);
        if number == expected {
            if let Some((design, control_points)) = design {
                (record.design, record.control_points) = (design, control_points);
            }
            if let Some(label) = label {
                record.label = label;
            }
            record.updated = SystemTime::now();
            record.request = update.request_id.clone();
            if self.store.put_session(tenant.as_str(), id, next, &record).await? {
                return Ok(sessions::session(id, Generation { number: next, record }));
            }
        }
        // Perhaps this very request was carried out before.
        if !update.request_id.is_empty()
            && let Some(record) = self.store.session_at(tenant.as_str(), id, next).await?
            && record.request == update.request_id
        {
            return Ok(sessions::session(id, Generation { number: next, record }));
        }
        let found = self.sessions.get(tenant, id).await?.number;
        Err(ServiceError::new(Code::Aborted, "").at(
            "expected_generation",
            format!("{expected} is not the session's generation {found}; read the session again"),
        ))
    }

    /// Closes a session for good; one whose record is damaged too.
    ///
    /// # Errors
    /// `NotFound`, `PermissionDenied` to readers, `Unavailable` if it cannot be stored.
    pub async fn close_session(&self, caller: &Principal, id: &str) -> Result<(), ServiceError> {
        caller.need(Role::User)?;
        self.sessions.find(&caller.tenant, id).await?;
        self.store.close_session(caller.tenant.as_str(), id).await?;
        self.sessions.closed(&caller.tenant, id);
        Ok(())
    }

    /// The set-up of an open session.
    async fn session_setup(&self, caller: &Principal, id: &str) -> Result<Arc<StoredSetup>, ServiceError> {
        let setup = self.sessions.setup_of(&caller.tenant, id).await?;
        self.resident(caller, id, &setup).await
    }

    async fn resident(
        &self,
        caller: &Principal,
        session_id: &str,
        setup: &str,
    ) -> Result<Arc<StoredSetup>, ServiceError> {
        self.setups.named(&caller.tenant, setup).await?.ok_or_else(|| {
            let text = format!("set-up {setup} of session {session_id} is missing in the store");
            ServiceError::new(Code::Internal, text)
        })
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
        let setup = self.session_setup(caller, session_id).await?;
        let design = Resolved::new(setup.engine.parameterisation(), design)?;
        let id = design.id(&setup.id);
        let task = self.task("deform", caller, &setup, session_id);
        let linearised = Arc::new(linearise(&self.pool, task, setup, design, id).await?);
        keep(&self.held, &caller.tenant, &linearised);
        Ok(linearised)
    }

    /// The derivative at some point: what is held in memory for the caller's tenant; or, if its design is given, a
    /// linearisation made now, once however many ask for it, with the same bits.
    ///
    /// # Errors
    /// As [`Service::deform`]; `NotFound` for an id that is not held and comes without its design.
    pub async fn linearised(
        &self,
        caller: &Principal,
        session_id: &str,
        at: At,
    ) -> Result<Product<Arc<Linearised>>, ServiceError> {
        caller.need(Role::User)?;
        let setup = self.session_setup(caller, session_id).await?;
        let found = |value| Product { value, timing: Timing::default() };
        at.check()?;
        let design = match at.design {
            Some(design) => design,
            None => {
                let id = at.id.unwrap_or_default();
                let held = self.held.get(&(caller.tenant.clone(), id.clone()));
                // Of another session's set-up it is nothing to this one.
                let held = held.filter(|linearised| *linearised.setup_id() == setup.id);
                return held.map(found).ok_or_else(|| not_kept(&id));
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
        let key = (caller.tenant.clone(), id.clone());
        let find = || self.held.get(&key);
        let land = {
            let (held, tenant) = (Arc::clone(&self.held), caller.tenant.clone());
            move |linearised: &Arc<Linearised>| keep(&held, &tenant, linearised)
        };
        let task = self.task("linearise", caller, &setup, session_id);
        let work = |_| {
            let pool = Arc::clone(&self.pool);
            async move { linearise(&pool, task, setup, design, id).await }
        };
        let follower = match self.linearisations.join(key.clone(), find, work, land) {
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
        let setup = self.session_setup(caller, session_id).await?;
        at.check()?;
        let directions = directions.check(&setup.engine, &self.limits)?;
        let at = self.linearised(caller, session_id, at).await?;
        let task = self.task("jvp", caller, &setup, session_id);
        self.product(task, at, move |linearised| linearised.jvp(&directions)).await
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
        let setup = self.session_setup(caller, session_id).await?;
        at.check()?;
        let wanted = wanted.check(setup.engine.parameterisation())?;
        let seeds = seeds.check(&setup.engine, &self.limits)?;
        let at = self.linearised(caller, session_id, at).await?;
        let task = self.task("vjp", caller, &setup, session_id);
        self.product(task, at, move |linearised| linearised.vjp(&seeds, &wanted)).await
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
        let task = Task { kind: "jacobian", tenant: caller.tenant.clone(), setup: None, session: None };
        self.product(task, at, move |linearised| linearised.jacobian(first, count)).await
    }

    /// What the service does and holds.
    ///
    /// # Errors
    /// `Unavailable` if the store does not answer.
    pub async fn status(&self, caller: &Principal) -> Result<Status, ServiceError> {
        let all_tenants = caller.role >= Role::Admin;
        let own = (!all_tenants).then_some(&caller.tenant);
        let work = self.pool.work(own);
        let running = work.iter().filter(|work| work.running.is_some()).count();
        let (setups_stored, stored_bytes, sessions) = match own {
            Some(tenant) => {
                let owned = self.store.owned(tenant.as_str()).await?;
                let bytes = owned.iter().map(|(_, record)| record.bytes).sum();
                (owned.len(), bytes, self.store.sessions(tenant.as_str()).await?.len())
            }
            None => {
                let (setups, bytes) = self.store.size().await?;
                let mut sessions = 0;
                for tenant in self.store.tenants().await? {
                    sessions += self.store.sessions(&tenant).await?.len();
                }
                (setups, bytes, sessions)
            }
        };
        let mut setup_cache = self.setups.status();
        let mut linearisation_cache = self.held.status();
        if let Some(tenant) = own {
            // Of what others do nothing is told: neither what they hold nor how often they ask.
            let (entries, bytes) = self.held.of_group(tenant.as_str());
            linearisation_cache =
                CacheStatus { entries, bytes, budget: linearisation_cache.budget, ..CacheStatus::default() };
            setup_cache = CacheStatus { budget: setup_cache.budget, ..CacheStatus::default() };
        }
        let limits = self.pool.limits();
        Ok(Status {
            version: env!("CARGO_PKG_VERSION"),
            uptime: self.started.elapsed(),
            all_tenants,
            running,
            queued: work.len() - running,
            running_limit: limits.running,
            queued_limit: limits.queued,
            sessions,
            setups_resident: setup_cache.entries,
            setups_stored,
            stored_bytes,
            setup_cache,
            linearisation_cache,
            work,
        })
    }

    /// What the pool is told of work in a session.
    fn task(&self, kind: &'static str, caller: &Principal, setup: &StoredSetup, session_id: &str) -> Task {
        Task {
            kind,
            tenant: caller.tenant.clone(),
            setup: Some(setup.id.to_string()),
            session: Some(session_id.to_owned()),
        }
    }

    async fn product<T: Send + 'static>(
        &self,
        task: Task,
        Product { value: at, timing }: Product<Arc<Linearised>>,
        work: impl FnOnce(&Linearised) -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<Product<T>, ServiceError> {
        let Completed { value, queued, ran } = self.pool.run(task, move |_| work(&at)).await?;
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
        let id = Some(setup.id.to_string());
        let task = Task { kind: "check", tenant: caller.tenant.clone(), setup: id, session: None };
        let work = |reports: Reports<Product<Report>>| {
            let place = Arc::clone(&self.checking).try_acquire_owned();
            let (pool, limit) = (Arc::clone(&self.pool), self.limits.checks);
            async move {
                let _place = place.map_err(|_| too_many("checks", limit))?;
                let work = move |ticket: &Ticket| {
                    let watcher = Watcher::new(ticket.cancellation().clone(), |progress| {
                        ticket.progress(&progress);
                        reports.tell(progress);
                    });
                    Ok(Report::new(&setup.engine, &request, &watcher)?)
                };
                let Completed { value, queued, ran } = pool.run(task, work).await?;
                Ok(Product { value, timing: Timing { queued, engine: ran } })
            }
        };
        match self.checks.join(key, || None, work, |_| {}) {
            Joined::Found(report) => Ok(report),
            Joined::Following(follower) | Joined::Started(follower) => follower.land(tell).await,
        }
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
    task: Task,
    setup: Arc<StoredSetup>,
    design: Resolved,
    id: String,
) -> Result<Linearised, ServiceError> {
    let work = move |ticket: &Ticket| {
        let monitor = Reporter::new(ticket.cancellation().clone(), |progress| ticket.progress(&progress));
        design.linearise(id, setup.id.clone(), &setup.engine, &monitor)
    };
    let Completed { value, queued, ran } = pool.run(task, work).await?;
    Ok(value.taking(Timing { queued, engine: ran }))
}

fn keep(held: &Cache<(Tenant, String), Linearised>, tenant: &Tenant, linearised: &Arc<Linearised>) {
    let key = (tenant.clone(), linearised.id().to_owned());
    held.insert(key, tenant.as_str(), Arc::clone(linearised), linearised.bytes());
}

/// Names of a page and those after it.
fn after(names: Vec<String>, page: &Page) -> Iter<impl Iterator<Item = String>> {
    let token = page.token.clone();
    stream::iter(names.into_iter().filter(move |name| *name > token))
}

fn owner_access(record: &AccessRecord) -> Access {
    let visibility = match &record.shared {
        Shared::Private => Visibility::Private,
        Shared::Public => Visibility::Public,
        Shared::Tenants(tenants) => {
            Visibility::Tenants(tenants.iter().filter_map(|tenant| Tenant::new(tenant).ok()).collect())
        }
    };
    Access { owned: true, visibility }
}

fn shared(visibility: &Visibility) -> Shared {
    match visibility {
        Visibility::Private => Shared::Private,
        Visibility::Public => Shared::Public,
        Visibility::Tenants(tenants) => Shared::Tenants(tenants.iter().map(Tenant::to_string).collect()),
    }
}

fn access_record(setup: &StoredSetup, bytes: u64, shared: Shared) -> AccessRecord {
    let mesh = setup.engine.mesh();
    AccessRecord {
        owned: true,
        shared,
        name: setup.name.clone(),
        vertices: mesh.vertices.len() as u64,
        cells: mesh.cells.len() as u64,
        variables: setup.engine.parameterisation().variables().len() as u64,
        bytes,
        created: SystemTime::now(),
    }
}

fn too_many(what: &str, limit: usize) -> ServiceError {
    let message = format!("the limit of {limit} {what} at a time is reached; try again later");
    ServiceError::new(Code::ResourceExhausted, message).retry_after(Duration::from_secs(1))
}

fn not_kept(id: &str) -> ServiceError {
    let description = format!(
        "the server holds no linearisation `{}` (any more); Deform again, or send the design with the id",
        shorten(id)
    );
    ServiceError::new(Code::NotFound, "").at("at.linearisation_id", description)
}
