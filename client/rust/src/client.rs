//! Client, set-ups and sessions of the mesh service.

use std::{fmt, ops::Deref, path::Path, sync::Arc, time::Duration};

use moldline_proto::v1::{self, mesh_service_client::MeshServiceClient};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::Channel;
use uuid::Uuid;

use crate::{
    At, Check, Code, ControlPoints, Deformation, Design, DesignPoint, Directions, Error, Gradients, Jacobian,
    Mesh, Options, Progress, Seeds, SessionState, SessionUpdate, SetupFacts, SetupSummary, Status, Tangents,
    Tell, Timings, Visibility,
    blocks::{pieces, vectors},
    check,
    connection::{self, Deadline},
    convert,
    progress::{self, Event},
    upload,
};

type Stub = MeshServiceClient<Channel>;
type Connection = connection::Connection<Stub>;

/// Options of [`Client::create_setup`].
#[derive(Default)]
pub struct CreateOptions {
    /// The file that describes the set-up; the server's usual names if empty.
    pub setup_file: String,
    /// Who else may use it. If absent, nobody if it is new, else unchanged.
    pub visibility: Option<Visibility>,
    /// Names of tenants, with [`Visibility::Tenants`].
    pub shared_with: Vec<String>,
    /// Callback for progress.
    pub progress: Option<Tell>,
    /// Name of this request, by which a retry is recognised; random if absent.
    pub request_id: Option<String>,
    /// Timeout over all attempts; no limit if absent.
    pub timeout: Option<Duration>,
}

impl fmt::Debug for CreateOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("CreateOptions").field("setup_file", &self.setup_file).finish_non_exhaustive()
    }
}

/// Options of [`Setup::check`].
pub struct CheckOptions {
    /// Number of designs: the baseline, then random ones far from it.
    pub designs: u32,
    /// The only design to check at, in their place.
    pub design: Option<Design>,
    /// Names of variables or of groups of them whose derivatives are compared with dual numbers and central differences;
    /// all if empty.
    pub variables: Vec<String>,
    /// Seed of the random designs and vectors.
    pub seed: u64,
    /// Callback for progress.
    pub progress: Option<Tell>,
    /// Timeout over all attempts; no limit if absent. A check of a large set-up takes minutes.
    pub timeout: Option<Duration>,
}

impl Default for CheckOptions {
    fn default() -> Self {
        Self { designs: 1, design: None, variables: Vec::new(), seed: 1, progress: None, timeout: None }
    }
}

impl fmt::Debug for CheckOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { designs, design, variables, seed, .. } = self;
        let mut fields = f.debug_struct("CheckOptions");
        fields.field("designs", designs).field("design", design).field("variables", variables);
        fields.field("seed", seed).finish_non_exhaustive()
    }
}

/// A connection to a mesh service. Clones share it, as do set-ups and sessions.
#[derive(Clone, Debug)]
pub struct Client {
    connection: Arc<Connection>,
    timeout: Option<Duration>,
}

impl Client {
    /// A client of the server at an address such as `127.0.0.1:50051`, in plain text; connects on first use.
    ///
    /// # Errors
    /// [`Code::Client`] if the address is invalid.
    pub fn new(address: &str) -> Result<Self, Error> {
        Self::with(address, &Options::default())
    }

    /// A client of the server at an address such as `127.0.0.1:50051`; connects on first use.
    ///
    /// # Errors
    /// [`Code::Client`] if the address is invalid, or a file of the options cannot be used.
    pub fn with(address: &str, options: &Options) -> Result<Self, Error> {
        Ok(Self { connection: Arc::new(Connection::new(address, options)?), timeout: options.timeout })
    }

    /// The same connection with another timeout of each call.
    #[must_use]
    pub fn with_timeout(&self, timeout: Option<Duration>) -> Self {
        Self { connection: self.connection.clone(), timeout }
    }

    /// Uploads and builds a set-up; identical content returns the existing set-up. `path` is its folder, or an archive of
    /// it (.tar, .tar.gz, .tgz, .zip).
    ///
    /// # Errors
    /// [`Code::InvalidArgument`] naming every wrong field.
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
        let attempt = |mut stub: Stub, request: tonic::Request<()>| {
            let (header, files) = (header.clone(), files.clone());
            async move {
                let (sender, receiver) = mpsc::channel(4);
                let upload = tokio::task::spawn_blocking(move || upload::upload(header, &files, &sender));
                let request = request.map(|()| ReceiverStream::new(receiver));
                let answer = async {
                    let events = stub.create_setup(request).await?.into_inner();
                    let event = |message: v1::CreateSetupResponse| {
                        message.event.map(|event| match event {
                            v1::create_setup_response::Event::Progress(progress) => Event::Progress(progress),
                            v1::create_setup_response::Event::Created(setup) => Event::Result(setup),
                        })
                    };
                    progress::result(events, progress, event).await
                };
                let answer = answer.await;
                // A file that could not be read explains why the server received too little.
                match upload.await {
                    Ok(Err(error)) => Err(error),
                    _ => answer,
                }
            }
        };
        let created = self.connection.attempts(Deadline::after(options.timeout), attempt).await?;
        Ok(Setup::new(self, convert::setup_facts(created.setup, created.built)?))
    }

    /// The set-up with this id.
    ///
    /// # Errors
    /// [`Code::NotFound`] if the caller can see no such set-up.
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

    /// The set-ups that the caller may use (its own, shared and public ones), ordered by id.
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

    /// The open session with this id, on whichever server of the store it was opened.
    ///
    /// # Errors
    /// [`Code::NotFound`] if the caller can see no such session.
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

    /// The caller's open sessions without their designs, ordered by id.
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

    /// Load, caches and store of the server: the caller's tenant's share, or all of it for administrators.
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

    /// The same with another timeout of each call.
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

    /// Control points of all components at the baseline, metres.
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

    /// Changes who else may use a set-up that the caller owns; `shared_with` names tenants with [`Visibility::Tenants`].
    ///
    /// # Errors
    /// [`Code::NotFound`] or [`Code::PermissionDenied`] if the caller does not own it.
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

    /// Gives up the caller's ownership of the set-up. Its open sessions continue, and other owners of the same content keep
    /// it.
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

    /// Checks the derivatives: products against their transposes, dual numbers and central differences.
    ///
    /// # Errors
    /// [`Code::InvalidArgument`] naming the wrong field, [`Code::ResourceExhausted`] while other checks are running.
    pub async fn check(&self, options: CheckOptions) -> Result<Check, Error> {
        let at = match &options.design {
            None => Some(v1::check_request::At::Designs(options.designs)),
            Some(design) => convert::design(design).map(Into::into),
        };
        let request = v1::CheckRequest {
            setup_id: self.id.clone(),
            at,
            seed: options.seed,
            variables: options.variables,
        };
        let progress = options.progress.as_deref();
        let attempt = |mut stub: Stub, empty: tonic::Request<()>| {
            let request = empty.map(|()| request.clone());
            async move {
                let events = stub.check(request).await?.into_inner();
                let event = |message: v1::CheckResponse| {
                    message.event.map(|event| match event {
                        v1::check_response::Event::Progress(progress) => Event::Progress(progress),
                        v1::check_response::Event::Report(report) => Event::Result(report),
                    })
                };
                progress::result(events, progress, event).await
            }
        };
        let deadline = Deadline::after(options.timeout);
        check::check(self.client.connection.attempts(deadline, attempt).await?)
    }

    /// Opens a session with a descriptive label, which may be empty.
    ///
    /// # Errors
    /// Those of any call.
    pub async fn session(&self, label: &str) -> Result<Session, Error> {
        self.session_as(label, None).await
    }

    /// Opens a session by a request with an id, by which a retry is recognised.
    ///
    /// # Errors
    /// [`Code::AlreadyExists`] if an earlier request with other content had this id.
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

/// A session: work on one set-up, isolated from all other sessions.
///
/// The server keeps it with the design stored last, across restarts and until it is closed: an optimizer stores its
/// accepted designs ([`Session::update`]), and continues from the last one after an interruption ([`Client::resume`]).
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

    /// The stored state, as of the last opening, resumption, update or refresh here.
    pub fn state(&self) -> &SessionState {
        &self.state
    }

    /// The same with another timeout of each call.
    #[must_use]
    pub fn with_timeout(&self, timeout: Option<Duration>) -> Self {
        Self { setup: self.setup.with_timeout(timeout), state: self.state.clone() }
    }

    /// Stores the session's design, label or both, durably.
    ///
    /// # Errors
    /// [`Code::Aborted`] if the session has been updated elsewhere since: [`Session::refresh`] reads the current state.
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
    /// [`Code::InvalidArgument`] naming the wrong entry, [`Code::FailedPrecondition`] if the mesh cannot follow.
    pub async fn deform(&self, point: impl Into<DesignPoint>) -> Result<Deformation, Error> {
        self.deform_measured(point, false).await
    }

    /// The same, optionally with the quality measures of every cell.
    ///
    /// # Errors
    /// As [`Session::deform`].
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

    /// Jacobian-vector products `J v`, exactly: changes of the outputs along directions of the inputs.
    ///
    /// # Errors
    /// [`Code::InvalidArgument`] naming the wrong entry, [`Code::NotFound`] for a bare id of a linearisation that the
    /// server no longer holds.
    pub async fn jvp(&self, directions: &Directions, at: impl Into<At>) -> Result<Tangents, Error> {
        let deadline = self.deadline();
        let at = convert::at(&at.into());
        let count = directions.count;
        let mut tangents = Tangents { count, ..Tangents::default() };
        for piece in pieces(points(&self.setup), count)? {
            let mut control_points = Vec::new();
            for (component, points) in &directions.control_points {
                control_points.push(v1::ControlPointVectors {
                    component: component.clone(),
                    vectors: vectors(points, count, &piece, "control_points")?,
                });
            }
            let request = v1::ApplyJacobianVectorRequest {
                session_id: self.state.id.clone(),
                at: Some(at.clone()),
                design: vectors(&directions.design, count, &piece, "design")?,
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

    /// Vector-Jacobian products `J^T w`, exactly: gradients of weighted sums of the outputs with respect to the inputs.
    ///
    /// # Errors
    /// As [`Session::jvp`].
    pub async fn vjp(&self, seeds: &Seeds, at: impl Into<At>) -> Result<Gradients, Error> {
        let deadline = self.deadline();
        let at = convert::at(&at.into());
        let count = seeds.count;
        let mut gradients = Gradients { count, ..Gradients::default() };
        for piece in pieces(points(&self.setup), count)? {
            let request = v1::ApplyAdjointRequest {
                session_id: self.state.id.clone(),
                at: Some(at.clone()),
                vertices: vectors(&seeds.vertices, count, &piece, "vertices")?,
                functions: vectors(&seeds.functions, count, &piece, "functions")?,
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

    /// The Jacobian, exactly: derivatives of all outputs with respect to all design variables. Blocks are reported to
    /// `progress` as they are received.
    ///
    /// # Errors
    /// As [`Session::jvp`].
    pub async fn jacobian(&self, at: impl Into<At>, progress: Option<Tell>) -> Result<Jacobian, Error> {
        let request =
            v1::JacobianRequest { session_id: self.state.id.clone(), at: Some(convert::at(&at.into())) };
        let columns = self.setup.variables.len();
        let progress = progress.as_deref();
        let attempt = |mut stub: Stub, empty: tonic::Request<()>| {
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

/// Success if there is nothing to remove: an earlier attempt whose answer was lost may have removed it.
fn gone(removed: Result<(), Error>) -> Result<(), Error> {
    match removed {
        Err(error) if error.code == Code::NotFound => Ok(()),
        other => other,
    }
}

/// Points that belong to one vector of inputs or outputs.
fn points(setup: &SetupFacts) -> usize {
    setup.vertex_count + setup.control_point_counts.iter().sum::<usize>()
}
