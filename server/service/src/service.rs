//! What the service does, in the order in which a client meets it.

use std::{collections::BTreeMap, sync::Arc, time::Duration};

use moldline_deform::{Deformation, Monitor, Setup};
use moldline_parameterisation::{Override, Parameterisation};
use tokio::sync::Semaphore;

use crate::{
    error::{Code, ServiceError, shorten},
    flight::{Flights, Joined, Reports},
    limits::Limits,
    pool::{ComputePool, PoolLimits},
    progress::{Progress, Reporter},
    read::{self, Content},
    requests::Answers,
    sessions::Sessions,
    setups::{SetupId, Setups, StoredSetup},
    upload::{Upload, UploadHeader, Uploaded},
};

/// The service, shared by all transports.
#[derive(Debug)]
pub struct Service {
    limits: Limits,
    pool: Arc<ComputePool>,
    uploads: Semaphore,
    setups: Arc<Setups>,
    builds: Flights<SetupId, StoredSetup>,
    created: std::sync::Mutex<Answers>,
    sessions: Sessions,
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
    /// Whether this call built it.
    pub built: bool,
}

/// What to deform to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Design {
    /// Values of the design variables.
    pub values: Values,
    /// Control points from outside, in place of what the values make of a component: its name and its points, metres.
    pub control_points: Vec<(String, Vec<[f64; 3]>)>,
}

/// Values of the design variables, each in its variable's unit.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Every variable in order.
    Vector(Vec<f64>),
    /// Some variables by name; the others stay at their baseline.
    Named(BTreeMap<String, f64>),
}

impl Default for Values {
    fn default() -> Self {
        Self::Named(BTreeMap::new())
    }
}

/// The answer to [`Service::deform`].
#[derive(Debug)]
pub struct Deformed {
    /// What the engine made.
    pub deformation: Deformation,
    /// Names set-up and design in later requests for derivatives.
    pub linearisation_id: String,
    /// Time that the request waited.
    pub queued: Duration,
    /// Time of the engine.
    pub engine: Duration,
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
            uploads: Semaphore::new(limits.uploads),
            setups: Arc::new(Setups::new(limits.setups)),
            builds: Flights::default(),
            created: std::sync::Mutex::new(Answers::new(ANSWERS)),
            sessions: Sessions::new(limits.sessions),
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
    pub fn receive(&self, header: UploadHeader) -> Result<Receiving<'_>, ServiceError> {
        let place = self.uploads.try_acquire().map_err(|_| {
            ServiceError::new(
                Code::ResourceExhausted,
                format!("{} uploads are under way, which is the limit; try again later", self.limits.uploads),
            )
            .retry_after(Duration::from_secs(1))
        })?;
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
        uploaded: Uploaded,
        mut tell: impl FnMut(Progress),
    ) -> Result<Created, ServiceError> {
        tell(Progress { stage: "read", fraction: 0.0, message: "reading the files".to_owned() });
        let request_id = uploaded.header.request_id.clone();
        let limits = self.limits.clone();
        let content = self.pool.run(move |_| read::read(uploaded, &limits)).await?.value;
        tell(Progress { stage: "read", fraction: 1.0, message: format!("set-up {}", content.id) });

        let id = content.id.clone();
        self.answers().find(&request_id, id.as_str())?;
        let created = self.find_or_build(content, tell).await?;
        self.answers().remember(&request_id, id.as_str(), id.as_str());
        Ok(created)
    }

    async fn find_or_build(
        &self,
        content: Content,
        tell: impl FnMut(Progress),
    ) -> Result<Created, ServiceError> {
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
                    Ok(Setup::build(input, &reporter)?)
                })
                .await?;
            tracing::info!(setup = %id, seconds = built.ran.as_secs_f64(), "built a set-up");
            Ok(StoredSetup { id, name, engine: built.value, build_time: built.ran })
        };
        let joined = self.builds.join(id.clone(), || self.setups.get(id.as_str()), build, land);
        let (setup, built) = match joined {
            Joined::Found(setup) => (setup, false),
            Joined::Following(follower) => (follower.land(tell).await?, false),
            Joined::Started(follower) => (follower.land(tell).await?, true),
        };
        Ok(Created { setup, built })
    }

    /// The set-up of that name.
    ///
    /// # Errors
    /// `NotFound`.
    pub fn setup(&self, id: &str) -> Result<Arc<StoredSetup>, ServiceError> {
        self.setups.get(id).ok_or_else(|| ServiceError::not_found("setup", id))
    }

    /// Opens a session on a set-up and returns its id. The same request id again gives the same session.
    ///
    /// # Errors
    /// `NotFound`, `ResourceExhausted`, `AlreadyExists`.
    pub fn open_session(&self, setup_id: &str, request_id: &str) -> Result<String, ServiceError> {
        let limit = self.limits.request_id_bytes;
        if request_id.len() > limit {
            let length = request_id.len();
            return Err(ServiceError::invalid(
                "request_id",
                format!("{length} bytes are more than the limit of {limit}"),
            ));
        }
        self.sessions.open(self.setup(setup_id)?, request_id)
    }

    /// Closes a session.
    ///
    /// # Errors
    /// `NotFound`.
    pub fn close_session(&self, id: &str) -> Result<(), ServiceError> {
        self.sessions.close(id)
    }

    /// Deforms the session's mesh. The same set-up and design give the same bits, whoever asks, whenever.
    ///
    /// # Errors
    /// `NotFound` for the session, `InvalidArgument` naming the entry of the design, `FailedPrecondition` if the engine
    /// cannot reach it, `ResourceExhausted` if the queue is full.
    pub async fn deform(&self, session_id: &str, design: Design) -> Result<Deformed, ServiceError> {
        let setup = self.sessions.setup(session_id)?;
        let design = Resolved::new(setup.engine.parameterisation(), design)?;
        let linearisation_id = design.linearisation_id(&setup.id);
        let completed = self
            .pool
            .run(move |cancellation| {
                let monitor = Reporter::new(cancellation.clone(), |_| {});
                design.deform(&setup.engine, &monitor)
            })
            .await?;
        Ok(Deformed {
            deformation: completed.value,
            linearisation_id,
            queued: completed.queued,
            engine: completed.ran,
        })
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

/// A design that has been checked, before it takes a place in the queue.
struct Resolved {
    vector: Vec<f64>,
    overrides: Vec<Override>,
}

impl Resolved {
    fn new(parameterisation: &Parameterisation, design: Design) -> Result<Self, ServiceError> {
        let vector = match &design.values {
            Values::Vector(vector) => vector.clone(),
            Values::Named(values) => {
                parameterisation.design(values.iter().map(|(name, &value)| (name.as_str(), value)))?
            }
        };
        parameterisation.validate(&vector)?;
        let overrides = design.control_points.into_iter().map(|(name, control_points)| {
            let component = parameterisation.components().iter().position(|known| *known == name);
            let component = component.ok_or_else(|| unknown_component(&name, parameterisation))?;
            Ok(Override { component, control_points })
        });
        Ok(Self { vector, overrides: overrides.collect::<Result<_, ServiceError>>()? })
    }

    fn deform(&self, setup: &Setup, monitor: &dyn Monitor) -> Result<Deformation, ServiceError> {
        Ok(if self.overrides.is_empty() {
            setup.deform(&self.vector, monitor)?
        } else {
            let points = setup.parameterisation().control_points_with(&self.vector, &self.overrides)?;
            setup.deform_control_points(&points, monitor)?
        })
    }

    /// A name for (set-up, design): the same for the same, on any server.
    fn linearisation_id(&self, setup: &SetupId) -> String {
        let mut hasher = blake3::Hasher::new();
        hasher.update(setup.as_str().as_bytes());
        for value in &self.vector {
            hasher.update(&value.to_le_bytes());
        }
        for Override { component, control_points } in &self.overrides {
            hasher.update(&(*component as u64).to_le_bytes());
            for value in control_points.iter().flatten() {
                hasher.update(&value.to_le_bytes());
            }
        }
        hasher.finalize().to_hex().to_string()
    }
}

fn unknown_component(name: &str, parameterisation: &Parameterisation) -> ServiceError {
    ServiceError::invalid(
        format!("control_points[\"{}\"]", shorten(name)),
        format!("there is no such component; there are: {}", parameterisation.components().join(", ")),
    )
}
