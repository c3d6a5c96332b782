//! Client, set-ups and sessions.

use std::{
    fmt,
    ops::{AddAssign, Deref, Range},
    path::Path,
    sync::Arc,
    time::Duration,
};

use moldline_proto::v1::{self, create_setup_response::Event};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use uuid::Uuid;

use crate::{
    At, Code, ControlPoints, Deformation, DesignPoint, Directions, Error, Gradients, Jacobian, Mesh, Options,
    Point, Progress, Seeds, SessionState, SessionUpdate, SetupFacts, SetupSummary, Status, Tangents, Timings,
    Visibility,
    connection::{Connection, Deadline},
    convert, upload,
};

/// Vectors and bytes of one request, within the server's usual limits; larger blocks go in several requests.
const MOST_VECTORS: usize = 64;
const MOST_BYTES: usize = 32 << 20;

/// Takes each step of something long.
pub type Tell = Box<dyn Fn(Progress) + Send + Sync>;

/// Of [`Client::create_setup`].
#[derive(Default)]
pub struct CreateOptions {
    /// The file that describes the set-up; the server's usual names if empty.
    pub setup_file: String,
    /// Who else may use it. If absent, nobody if it is new, else as it was.
    pub visibility: Option<Visibility>,
    /// Tenants, with [`Visibility::Tenants`].
    pub shared_with: Vec<String>,
    /// Is told how far it has come.
    pub progress: Option<Tell>,
    /// Name of this request, so that a retry is recognised; made up if absent.
    pub request_id: Option<String>,
    /// How long it may take; no limit if absent.
    pub timeout: Option<Duration>,
}

impl fmt::Debug for CreateOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("CreateOptions").field("setup_file", &self.setup_file).finish_non_exhaustive()
    }
}

/// A connection to a server. Clones share it, as do set-ups and sessions.
#[derive(Clone, Debug)]
pub struct Client {
    connection: Arc<Connection>,
    timeout: Option<Duration>,
}

impl Client {
    /// To an address such as `127.0.0.1:50051`, in plain text; connects when it is first used.
    ///
    /// # Errors
    /// [`Code::Client`] if that is no address.
    pub fn new(address: &str) -> Result<Self, Error> {
        Self::with(address, &Options::default())
    }

    /// To an address such as `127.0.0.1:50051`; connects when it is first used.
    ///
    /// # Errors
    /// [`Code::Client`] if that is no address, or a file of the options cannot be used.
    pub fn with(address: &str, options: &Options) -> Result<Self, Error> {
        Ok(Self { connection: Arc::new(Connection::new(address, options)?), timeout: options.timeout })
    }

    /// The same connection, with another limit for the time of each call.
    #[must_use]
    pub fn with_timeout(&self, timeout: Option<Duration>) -> Self {
        Self { connection: self.connection.clone(), timeout }
    }

    /// Uploads and builds a set-up; the same content again gives the set-up that exists. `path` is its folder, or an
    /// archive of it (.tar, .tar.gz, .tgz, .zip).
    ///
    /// # Errors
    /// [`Code::InvalidArgument`] naming every field that is wrong.
    pub async fn create_setup(&self, path: impl AsRef<Path>, options: CreateOptions) -> Result<Setup, Error> {
        let (files, source) = upload::files(path.as_ref())?;
        let header = v1::SetupHeader {
            request_id: request_id(options.request_id),
            setup_file: options.setup_file,
            source: Some(source),
            visibility: options.visibility.map(convert::visibility).unwrap_or_default().into(),
            shared_with: options.shared_with,
        };
        let files = Arc::new(files);
        let progress = options.progress.as_deref();
        let attempt = |mut stub: crate::connection::Stub, request: tonic::Request<()>| {
            let (header, files) = (header.clone(), files.clone());
            async move {
                let (sender, receiver) = mpsc::channel(4);
                let upload = tokio::task::spawn_blocking(move || upload::upload(header, &files, &sender));
                let request = request.map(|()| ReceiverStream::new(receiver));
                let answer = async {
                    let mut events = stub.create_setup(request).await?.into_inner();
                    let mut created = None;
                    while let Some(event) = events.message().await? {
                        match (event.event, progress) {
                            (Some(Event::Created(setup)), _) => created = Some(setup),
                            (
                                Some(Event::Progress(v1::Progress { stage, fraction, message })),
                                Some(tell),
                            ) => {
                                tell(Progress { stage, fraction, message });
                            }
                            _ => {}
                        }
                    }
                    created.ok_or_else(|| Error::internal("the server ended without a result"))
                };
                let answer = answer.await;
                // A file that could not be read is why the server got too little.
                match upload.await {
                    Ok(Err(error)) => Err(error),
                    _ => answer,
                }
            }
        };
        let created = self.connection.attempts(Deadline::after(options.timeout), attempt).await?;
        Ok(Setup::new(self, convert::setup_facts(created.setup, created.built)?))
    }

    /// The set-up of that id.
    ///
    /// # Errors
    /// [`Code::NotFound`] if there is none that the caller may see.
    pub async fn get_setup(&self, id: &str) -> Result<Setup, Error> {
        self.get_setup_until(id, self.deadline()).await
    }

    async fn get_setup_until(&self, id: &str, deadline: Deadline) -> Result<Setup, Error> {
        let request = v1::GetSetupRequest { setup_id: id.to_owned(), ..Default::default() };
        let response = self.setup_parts(request, deadline).await?;
        Ok(Setup::new(self, convert::setup_facts(response.setup, false)?))
    }

    async fn setup_parts(
        &self,
        request: v1::GetSetupRequest,
        deadline: Deadline,
    ) -> Result<v1::GetSetupResponse, Error> {
        self.connection
            .call(deadline, request, |mut stub, request| async move { stub.get_setup(request).await })
            .await
    }

    /// The set-ups that the caller may use: its own, those shared with it, and public ones; in the order of their ids.
    ///
    /// # Errors
    /// Those of any call.
    pub async fn list_setups(&self) -> Result<Vec<SetupSummary>, Error> {
        let deadline = self.deadline();
        let mut setups = Vec::new();
        let mut request = v1::ListSetupsRequest::default();
        loop {
            let page = self
                .connection
                .call(deadline, request, |mut stub, request| async move { stub.list_setups(request).await });
            let page = page.await?;
            setups.extend(page.setups.into_iter().map(convert::setup_summary));
            if page.next_page_token.is_empty() {
                return Ok(setups);
            }
            request = v1::ListSetupsRequest { page_token: page.next_page_token, ..Default::default() };
        }
    }

    /// The open session of that id, on whichever server it was opened.
    ///
    /// # Errors
    /// [`Code::NotFound`] if there is none that the caller may see.
    pub async fn resume(&self, session_id: &str) -> Result<Session, Error> {
        let deadline = self.deadline();
        let state = self.get_session(session_id, deadline).await?;
        let setup = self.get_setup_until(&state.setup_id, deadline).await?;
        Ok(Session { setup, state })
    }

    async fn get_session(&self, id: &str, deadline: Deadline) -> Result<SessionState, Error> {
        let request = v1::GetSessionRequest { session_id: id.to_owned() };
        let response = self
            .connection
            .call(deadline, request, |mut stub, request| async move { stub.get_session(request).await })
            .await?;
        convert::session_state(response.session)
    }

    /// The caller's open sessions, without their designs; in the order of their ids.
    ///
    /// # Errors
    /// Those of any call.
    pub async fn list_sessions(&self) -> Result<Vec<SessionState>, Error> {
        let deadline = self.deadline();
        let mut sessions = Vec::new();
        let mut request = v1::ListSessionsRequest::default();
        loop {
            let page = self.connection.call(deadline, request, |mut stub, request| async move {
                stub.list_sessions(request).await
            });
            let page = page.await?;
            for session in page.sessions {
                sessions.push(convert::session_state(Some(session))?);
            }
            if page.next_page_token.is_empty() {
                return Ok(sessions);
            }
            request = v1::ListSessionsRequest { page_token: page.next_page_token, ..Default::default() };
        }
    }

    /// What the server does and holds: of the caller's tenant, or of all for administrators.
    ///
    /// # Errors
    /// Those of any call.
    pub async fn status(&self) -> Result<Status, Error> {
        let response =
            self.connection.call(self.deadline(), v1::GetStatusRequest {}, |mut stub, request| async move {
                stub.get_status(request).await
            });
        Ok(convert::status(response.await?))
    }

    fn deadline(&self) -> Deadline {
        Deadline::after(self.timeout)
    }
}

/// A set-up on the server: geometry, mesh, design variables and options. Immutable, and shared by all its users.
#[derive(Clone, Debug)]
pub struct Setup {
    client: Client,
    facts: Arc<SetupFacts>,
}

impl Deref for Setup {
    type Target = SetupFacts;

    fn deref(&self) -> &SetupFacts {
        &self.facts
    }
}

impl Setup {
    fn new(client: &Client, facts: SetupFacts) -> Self {
        Self { client: client.clone(), facts: Arc::new(facts) }
    }

    /// The same, with another limit for the time of each call.
    #[must_use]
    pub fn with_timeout(&self, timeout: Option<Duration>) -> Self {
        Self { client: self.client.with_timeout(timeout), facts: self.facts.clone() }
    }

    /// The reference mesh.
    ///
    /// # Errors
    /// Those of any call.
    pub async fn mesh(&self) -> Result<Mesh, Error> {
        let request =
            v1::GetSetupRequest { setup_id: self.id.clone(), include_mesh: true, ..Default::default() };
        convert::mesh(self.client.setup_parts(request, self.client.deadline()).await?.mesh)
    }

    /// The control points of the baseline, metres.
    ///
    /// # Errors
    /// Those of any call.
    pub async fn control_points(&self) -> Result<ControlPoints, Error> {
        let request = v1::GetSetupRequest {
            setup_id: self.id.clone(),
            include_control_points: true,
            ..Default::default()
        };
        let response = self.client.setup_parts(request, self.client.deadline()).await?;
        convert::control_points(&response.control_points)
    }

    /// Changes who else may use a set-up of the caller's own; `shared_with` names tenants with [`Visibility::Tenants`].
    ///
    /// # Errors
    /// [`Code::NotFound`] or [`Code::PermissionDenied`] if it is not the caller's own.
    pub async fn share(&mut self, visibility: Visibility, shared_with: &[&str]) -> Result<(), Error> {
        let request = v1::ShareSetupRequest {
            setup_id: self.id.clone(),
            visibility: convert::visibility(visibility).into(),
            shared_with: shared_with.iter().map(|&tenant| tenant.to_owned()).collect(),
        };
        let response =
            self.client.connection.call(self.client.deadline(), request, |mut stub, request| async move {
                stub.share_setup(request).await
            });
        let access = convert::access(response.await?.access);
        Arc::make_mut(&mut self.facts).access = access;
        Ok(())
    }

    /// Gives up a set-up of the caller's own. Sessions open on it go on; whoever else uploaded the same content keeps it.
    ///
    /// # Errors
    /// Those of any call.
    pub async fn delete(&self) -> Result<(), Error> {
        let request = v1::DeleteSetupRequest { setup_id: self.id.clone() };
        let response =
            self.client.connection.call(self.client.deadline(), request, |mut stub, request| async move {
                stub.delete_setup(request).await
            });
        gone(response.await.map(drop))
    }

    /// Opens a session with a label for people, which may be empty.
    ///
    /// # Errors
    /// Those of any call.
    pub async fn session(&self, label: &str) -> Result<Session, Error> {
        self.session_as(label, None).await
    }

    /// Opens a session by a request that is named, so that a retry is recognised.
    ///
    /// # Errors
    /// [`Code::AlreadyExists`] if the id named a request with other content before.
    pub async fn session_as(&self, label: &str, request: Option<String>) -> Result<Session, Error> {
        let request = v1::OpenSessionRequest {
            setup_id: self.id.clone(),
            request_id: request_id(request),
            label: label.to_owned(),
        };
        let response =
            self.client.connection.call(self.client.deadline(), request, |mut stub, request| async move {
                stub.open_session(request).await
            });
        Ok(Session { setup: self.clone(), state: convert::session_state(response.await?.session)? })
    }
}

/// Work on one set-up, apart from all other sessions.
///
/// The server keeps it, with the design that was stored last, over restarts and until it is closed: an optimizer stores
/// where it has got to ([`Session::update`]), and goes on from there ([`Client::resume`]) when it was interrupted itself.
#[derive(Clone, Debug)]
pub struct Session {
    setup: Setup,
    state: SessionState,
}

impl Session {
    /// Its set-up.
    pub fn setup(&self) -> &Setup {
        &self.setup
    }

    /// The session as it was stored when it was last opened, resumed, updated or refreshed here.
    pub fn state(&self) -> &SessionState {
        &self.state
    }

    /// The same, with another limit for the time of each call.
    #[must_use]
    pub fn with_timeout(&self, timeout: Option<Duration>) -> Self {
        Self { setup: self.setup.with_timeout(timeout), state: self.state.clone() }
    }

    /// Stores the session's design, label or both. When it returns, it is durable.
    ///
    /// # Errors
    /// [`Code::Aborted`] if the session has been updated elsewhere since: [`Session::refresh`] reads what is there now.
    pub async fn update(&mut self, update: &SessionUpdate) -> Result<(), Error> {
        let request = v1::UpdateSessionRequest {
            session_id: self.state.id.clone(),
            expected_generation: self.state.generation,
            design: update.design.as_ref().map(convert::design_point),
            label: update.label.clone(),
            request_id: request_id(None),
        };
        let response = self.connection().call(self.deadline(), request, |mut stub, request| async move {
            stub.update_session(request).await
        });
        self.state = convert::session_state(response.await?.session)?;
        Ok(())
    }

    /// Reads the state from the server again.
    ///
    /// # Errors
    /// [`Code::NotFound`] if it has been closed.
    pub async fn refresh(&mut self) -> Result<(), Error> {
        self.state = self.setup.client.get_session(&self.state.id, self.deadline()).await?;
        Ok(())
    }

    /// The mesh at a design. A pure function: the same design gives the same bytes.
    ///
    /// # Errors
    /// [`Code::InvalidArgument`] naming the entry that is wrong, [`Code::FailedPrecondition`] if the mesh cannot follow.
    pub async fn deform(&self, point: impl Into<DesignPoint>) -> Result<Deformation, Error> {
        self.deform_measured(point, false).await
    }

    /// As [`Session::deform`], with the measures of every cell if they are wanted.
    ///
    /// # Errors
    /// As there.
    pub async fn deform_measured(
        &self,
        point: impl Into<DesignPoint>,
        cell_quality: bool,
    ) -> Result<Deformation, Error> {
        let point = point.into();
        let request = convert::deform_request(self.state.id.clone(), &point, cell_quality);
        let response = self
            .connection()
            .call(self.deadline(), request, |mut stub, request| async move { stub.deform(request).await });
        convert::deformation(response.await?, point)
    }

    /// How the outputs change along directions of the inputs: `J v`, exactly.
    ///
    /// # Errors
    /// [`Code::InvalidArgument`] naming the entry that is wrong, [`Code::NotFound`] for a bare id of a linearisation that
    /// the server does not hold any more.
    pub async fn jvp(&self, directions: &Directions, at: impl Into<At>) -> Result<Tangents, Error> {
        let deadline = self.deadline();
        let at = convert::at(&at.into());
        let count = directions.count;
        let mut tangents = Tangents { count, ..Tangents::default() };
        for piece in pieces(&self.setup, count)? {
            let mut control_points = Vec::new();
            for (component, vectors) in &directions.control_points {
                control_points.push(v1::ControlPointVectors {
                    component: component.clone(),
                    vectors: block(vectors.as_flattened(), count, &piece, 3, "control_points")?,
                });
            }
            let request = v1::ApplyJacobianVectorRequest {
                session_id: self.state.id.clone(),
                at: Some(at.clone()),
                design: block(&directions.design, count, &piece, 1, "design")?,
                control_points,
            };
            let response = self.connection().call(deadline, request, |mut stub, request| async move {
                stub.apply_jacobian_vector(request).await
            });
            let response = response.await?;
            tangents.vertices.append(&mut convert::points(response.vertices.as_ref())?);
            tangents.functions.append(&mut convert::numbers(response.functions.as_ref())?);
            tangents.timings += convert::timings(response.timings);
        }
        Ok(tangents)
    }

    /// Gradients of weighted sums of the outputs by the inputs: `J^T w`, exactly.
    ///
    /// # Errors
    /// As [`Session::jvp`].
    pub async fn vjp(&self, seeds: &Seeds, at: impl Into<At>) -> Result<Gradients, Error> {
        let deadline = self.deadline();
        let at = convert::at(&at.into());
        let count = seeds.count;
        let mut gradients = Gradients { count, ..Gradients::default() };
        for piece in pieces(&self.setup, count)? {
            let request = v1::ApplyAdjointRequest {
                session_id: self.state.id.clone(),
                at: Some(at.clone()),
                vertices: block(seeds.vertices.as_flattened(), count, &piece, 3, "vertices")?,
                functions: block(&seeds.functions, count, &piece, 1, "functions")?,
                include_design: seeds.by_design,
                control_points_of: seeds.by_control_points.clone(),
            };
            let response = self.connection().call(deadline, request, |mut stub, request| async move {
                stub.apply_adjoint(request).await
            });
            let response = response.await?;
            if seeds.by_design {
                gradients.design.append(&mut convert::numbers(response.design.as_ref())?);
            }
            for each in response.control_points {
                let points = &mut convert::points(each.vectors.as_ref())?;
                gradients.control_points.entry(each.component).or_default().append(points);
            }
            gradients.timings += convert::timings(response.timings);
        }
        Ok(gradients)
    }

    /// Derivatives of all outputs by all design variables, exactly; received in blocks, of which `progress` is told.
    ///
    /// # Errors
    /// As [`Session::jvp`].
    pub async fn jacobian(&self, at: impl Into<At>, progress: Option<Tell>) -> Result<Jacobian, Error> {
        let request =
            v1::JacobianRequest { session_id: self.state.id.clone(), at: Some(convert::at(&at.into())) };
        let columns = self.setup.variables.len();
        let progress = progress.as_deref();
        let attempt = |mut stub: crate::connection::Stub, empty: tonic::Request<()>| {
            let request = empty.map(|()| request.clone());
            async move {
                let mut jacobian = Jacobian {
                    vertices: Vec::with_capacity(columns * self.setup.vertex_count),
                    functions: Vec::with_capacity(columns * self.setup.functions.len()),
                    timings: Timings::default(),
                };
                let mut received = 0;
                let mut parts = stub.jacobian(request).await?.into_inner();
                while let Some(part) = parts.message().await? {
                    if part.first as usize != received {
                        return Err(Error::internal("the server sent columns that do not follow each other"));
                    }
                    let shape = part.vertices.as_ref().and_then(|vertices| vertices.shape.first());
                    received += shape.copied().unwrap_or_default() as usize;
                    jacobian.vertices.append(&mut convert::points(part.vertices.as_ref())?);
                    jacobian.functions.append(&mut convert::numbers(part.functions.as_ref())?);
                    jacobian.timings += convert::timings(part.timings);
                    if let Some(tell) = progress {
                        tell(Progress {
                            stage: "jacobian".to_owned(),
                            fraction: received as f64 / columns as f64,
                            message: format!("column {received} of {columns}"),
                        });
                    }
                }
                match received == columns {
                    true => Ok(jacobian),
                    false => Err(Error::internal("the server ended before the last column")),
                }
            }
        };
        self.connection().attempts(self.deadline(), attempt).await
    }

    /// Closes the session for good; closing it again does nothing.
    ///
    /// # Errors
    /// Those of any call.
    pub async fn close(&self) -> Result<(), Error> {
        let request = v1::CloseSessionRequest { session_id: self.state.id.clone() };
        let response = self.connection().call(self.deadline(), request, |mut stub, request| async move {
            stub.close_session(request).await
        });
        gone(response.await.map(drop))
    }

    fn connection(&self) -> &Connection {
        &self.setup.client.connection
    }

    fn deadline(&self) -> Deadline {
        self.setup.client.deadline()
    }
}

fn request_id(given: Option<String>) -> String {
    given.unwrap_or_else(|| Uuid::new_v4().simple().to_string())
}

/// What is not there has been removed already, perhaps by an attempt whose answer was lost.
fn gone(removed: Result<(), Error>) -> Result<(), Error> {
    match removed {
        Err(error) if error.code == Code::NotFound => Ok(()),
        other => other,
    }
}

/// Ranges of vectors that fit one request.
fn pieces(
    setup: &SetupFacts,
    count: usize,
) -> Result<impl Iterator<Item = Range<usize>> + Send + use<>, Error> {
    if count == 0 {
        return Err(Error::client("there is nothing to multiply with: `count` is 0"));
    }
    let points = setup.vertex_count + setup.control_point_counts.iter().sum::<usize>();
    let step = (MOST_BYTES / (size_of::<Point>() * points.max(1))).clamp(1, MOST_VECTORS);
    Ok((0..count).step_by(step).map(move |first| first..count.min(first + step)))
}

/// Some of `count` vectors, whose entries have `width` numbers; nothing if there are no values.
fn block(
    values: &[f64],
    count: usize,
    piece: &Range<usize>,
    width: usize,
    name: &str,
) -> Result<Option<v1::Array>, Error> {
    if values.is_empty() {
        return Ok(None);
    }
    if !values.len().is_multiple_of(count * width) {
        let values = values.len() / width;
        let message =
            format!("{name} has {values} entries, which are not {count} vectors of the same length");
        return Err(Error::client(message));
    }
    let length = values.len() / count;
    let shape = [piece.len(), length / width, width];
    let shape = if width == 1 { &shape[..2] } else { &shape };
    Ok(Some(convert::array(&values[piece.start * length..piece.end * length], shape)))
}

impl AddAssign for Timings {
    fn add_assign(&mut self, other: Self) {
        self.queue += other.queue;
        self.engine += other.engine;
    }
}
