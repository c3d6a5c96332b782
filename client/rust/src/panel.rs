//! Client of the panel service: subsonic flow over surface meshes by a panel method, with exact derivatives.
//!
//! ```no_run
//! use moldline_client::panel::{Client, Coefficients, ConfigurationOptions, Flow, Reference, Seeds, Wind, parts};
//!
//! # async fn run(setup: moldline_client::Setup, moved: moldline_client::Deformation) -> Result<(), moldline_client::Error> {
//! let panels = Client::new("127.0.0.1:50052")?;
//! let mesh = setup.mesh().await?;
//! let cell_groups = parts(&mesh, &setup.components)?;
//! let options = ConfigurationOptions { cell_groups, ..Default::default() };
//! let configuration = panels.create_configuration(&mesh.vertices, &mesh.cells, &options).await?;
//! let flow = Flow {
//!     mach: 0.7,
//!     wind: Wind { alpha: 0.02, sideslip: 0.0 },
//!     reference: Reference { area: 68.2, chord: 3.42, span: 23.8, point: [14.0, 0.0, 0.95] },
//! };
//! let analysis = configuration.analyze(Some(&moved.vertices), &flow, Default::default()).await?;
//! let lift = Coefficients { lift: 1.0, ..Default::default() };
//! let seeds = Seeds { coefficients: vec![lift], ..Default::default() };
//! let gradient = configuration.vjp(&seeds, &analysis).await?.vertices;
//! # Ok(()) }
//! ```
//!
//! Axes: x aft, y starboard, z up; metres and radians. The service stores nothing durably: a configuration or an analysis
//! that it has dropped is sent again, with the same results to the last bit.

mod convert;
mod model;

use std::{fmt, ops::Deref, sync::Arc, time::Duration};

use moldline_proto::v1::{self, panel_service_client::PanelServiceClient};
use tonic::transport::Channel;

pub use model::{
    Analysis, AnalysisPoint, At, Cell, Coefficients, ConfigurationFacts, ConfigurationOptions, Directions,
    Flow, Gradients, IndexGroups, LineLeftOut, Loads, OnDoubt, Reference, Sections, Seeds, Solver, Symmetry,
    Tangents, TrailingEdges, Warning, Wind,
};

use crate::{
    Code, Error, Mesh, Options, Point, Tell,
    blocks::{entries, pieces, vectors},
    connection::{self, Deadline},
    convert::{numbers, points, timings},
    progress::{self, Event},
};

type Stub = PanelServiceClient<Channel>;
type Connection = connection::Connection<Stub>;

/// Options of [`Configuration::analyze`] and [`Configuration::sweep`].
pub struct AnalyzeOptions {
    /// Whether to return the pressures of cells and vertices.
    pub pressures: bool,
    /// Callback for progress.
    pub progress: Option<Tell>,
}

impl Default for AnalyzeOptions {
    fn default() -> Self {
        Self { pressures: true, progress: None }
    }
}

impl fmt::Debug for AnalyzeOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("AnalyzeOptions").field("pressures", &self.pressures).finish_non_exhaustive()
    }
}

/// A connection to a panel service (`moldline panel serve`). Clones share it, as do configurations.
#[derive(Clone, Debug)]
pub struct Client {
    connection: Arc<Connection>,
    timeout: Option<Duration>,
}

impl Client {
    /// A client of the server at an address such as `127.0.0.1:50052`, in plain text; connects on first use.
    ///
    /// # Errors
    /// [`Code::Client`] if the address is invalid.
    pub fn new(address: &str) -> Result<Self, Error> {
        Self::with(address, &Options::default())
    }

    /// A client of the server at an address such as `127.0.0.1:50052`; connects on first use.
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

    /// Checks a mesh and finds everything that does not depend on the positions of its vertices; identical content returns
    /// the same configuration. `vertices` are the reference positions, where symmetry, trailing edges and wakes are found.
    ///
    /// # Errors
    /// [`Code::InvalidArgument`] naming the wrong cell or edge, [`Code::ResourceExhausted`] if an analysis would need more
    /// memory than the server allows.
    pub async fn create_configuration(
        &self,
        vertices: &[Point],
        cells: &[Cell],
        options: &ConfigurationOptions,
    ) -> Result<Configuration, Error> {
        let request = convert::configuration_request(vertices, cells, options);
        let facts = self.create(&request, Deadline::after(self.timeout)).await?;
        Ok(Configuration { client: self.clone(), facts: facts.into(), request: Some(request.into()) })
    }

    /// The configuration with this id.
    ///
    /// # Errors
    /// [`Code::NotFound`] if the server does not hold it, or no longer.
    pub async fn get_configuration(&self, id: &str) -> Result<Configuration, Error> {
        let request = v1::GetConfigurationRequest { configuration_id: id.to_owned() };
        let deadline = Deadline::after(self.timeout);
        let response = self.connection.call(deadline, request, |mut stub, request| async move {
            stub.get_configuration(request).await
        });
        let facts = convert::facts(response.await?.configuration)?;
        Ok(Configuration { client: self.clone(), facts: facts.into(), request: None })
    }

    async fn create(
        &self,
        request: &v1::CreateConfigurationRequest,
        deadline: Deadline,
    ) -> Result<ConfigurationFacts, Error> {
        let response = self.connection.call(deadline, request.clone(), |mut stub, request| async move {
            stub.create_configuration(request).await
        });
        convert::facts(response.await?.configuration)
    }
}

/// A mesh prepared for analyses on the server. Immutable; valid for all positions of its vertices.
#[derive(Clone, Debug)]
pub struct Configuration {
    client: Client,
    facts: Arc<ConfigurationFacts>,
    /// Sent again if the server has dropped the configuration; absent if another client created it.
    request: Option<Arc<v1::CreateConfigurationRequest>>,
}

impl Deref for Configuration {
    type Target = ConfigurationFacts;

    fn deref(&self) -> &ConfigurationFacts {
        &self.facts
    }
}

impl Configuration {
    /// The same with another timeout of each call.
    #[must_use]
    pub fn with_timeout(&self, timeout: Option<Duration>) -> Self {
        Self { client: self.client.with_timeout(timeout), ..self.clone() }
    }

    /// The flow over the mesh with its vertices at given positions, or at the reference positions if absent. A pure
    /// function: the same input gives the same bytes.
    ///
    /// # Errors
    /// [`Code::InvalidArgument`] naming the wrong field, [`Code::FailedPrecondition`] if the method fails on these vertices,
    /// such as a wake that cuts the body.
    pub async fn analyze(
        &self,
        vertices: Option<&[Point]>,
        flow: &Flow,
        options: AnalyzeOptions,
    ) -> Result<Analysis, Error> {
        let mut analyses = self.sweep(vertices, flow.mach, &[flow.wind], &flow.reference, options).await?;
        analyses.pop().ok_or_else(|| convert::missing("an analysis"))
    }

    /// Analyses in several winds at little more than the cost of one.
    ///
    /// # Errors
    /// As [`Configuration::analyze`].
    pub async fn sweep(
        &self,
        vertices: Option<&[Point]>,
        mach: f64,
        winds: &[Wind],
        reference: &Reference,
        options: AnalyzeOptions,
    ) -> Result<Vec<Analysis>, Error> {
        let request = v1::AnalyzeRequest {
            configuration_id: self.id.clone(),
            vertices: vertices.map(convert::vertices),
            mach,
            flows: winds.iter().map(convert::wind).collect(),
            reference: Some(convert::reference(reference)),
            without_pressures: !options.pressures,
        };
        let progress = options.progress.as_deref();
        let attempt = |mut stub: Stub, empty: tonic::Request<()>| {
            let request = empty.map(|()| request.clone());
            async move {
                let events = stub.analyze(request).await?.into_inner();
                let event = |message: v1::AnalyzeResponse| {
                    message.event.map(|event| match event {
                        v1::analyze_response::Event::Progress(progress) => Event::Progress(progress),
                        v1::analyze_response::Event::Analysis(analysis) => Event::Result(analysis),
                    })
                };
                progress::result(events, progress, event).await
            }
        };
        let deadline = self.deadline();
        let answer = self.again(deadline, || self.client.connection.attempts(deadline, attempt)).await?;
        let vertices: Option<Arc<[Point]>> = vertices.map(Into::into);
        let point = |&wind| AnalysisPoint {
            vertices: vertices.clone(),
            flow: Flow { mach, wind, reference: *reference },
        };
        convert::analyses(answer, winds.iter().map(point).collect())
    }

    /// Jacobian-vector products `J v`, exactly: changes of the outputs along directions of the inputs.
    ///
    /// # Errors
    /// As [`Configuration::analyze`].
    pub async fn jvp(&self, directions: &Directions, at: impl Into<At>) -> Result<Tangents, Error> {
        let deadline = self.deadline();
        let at = convert::at(&at.into());
        let count = directions.count;
        let mut tangents = Tangents { count, ..Tangents::default() };
        for piece in pieces(self.points(), count)? {
            let scalars = |values: &[f64], name: &str| entries(values, count, &piece, name);
            let inputs = v1::FlowInputs {
                vertices: vectors(&directions.vertices, count, &piece, "vertices")?,
                alpha: scalars(&directions.alpha, "alpha")?,
                sideslip: scalars(&directions.sideslip, "sideslip")?,
                mach: scalars(&directions.mach, "mach")?,
                area: scalars(&directions.area, "area")?,
                chord: scalars(&directions.chord, "chord")?,
                point: entries(&directions.point, count, &piece, "point")?,
            };
            let request = v1::PanelServiceApplyJacobianVectorRequest {
                configuration_id: self.id.clone(),
                at: Some(at.clone()),
                directions: Some(inputs),
            };
            let call = || {
                self.client.connection.call(deadline, request.clone(), |mut stub, request| async move {
                    stub.apply_jacobian_vector(request).await
                })
            };
            let response = self.again(deadline, call).await?;
            let changes = response.changes.unwrap_or_default();
            tangents.coefficients.append(&mut convert::coefficients(changes.coefficients.as_ref())?);
            tangents.section_loads.append(&mut numbers(changes.section_loads.as_ref())?);
            tangents.cp.append(&mut numbers(changes.cp.as_ref())?);
            tangents.timings += timings(response.timings);
        }
        Ok(tangents)
    }

    /// Vector-Jacobian products `J^T w`, exactly: gradients of weighted sums of the outputs with respect to the inputs.
    /// Several sums share one pass.
    ///
    /// # Errors
    /// As [`Configuration::analyze`].
    pub async fn vjp(&self, seeds: &Seeds, at: impl Into<At>) -> Result<Gradients, Error> {
        let deadline = self.deadline();
        let at = convert::at(&at.into());
        let count = seeds.count;
        let mut gradients = Gradients { count, ..Gradients::default() };
        for piece in pieces(self.points(), count)? {
            let request = v1::PanelServiceApplyAdjointRequest {
                configuration_id: self.id.clone(),
                at: Some(at.clone()),
                seeds: Some(v1::FlowOutputs {
                    coefficients: entries(&seeds.coefficients, count, &piece, "coefficients")?,
                    section_loads: vectors(&seeds.section_loads, count, &piece, "section_loads")?,
                    cp: vectors(&seeds.cp, count, &piece, "cp")?,
                }),
            };
            let call = || {
                self.client.connection.call(deadline, request.clone(), |mut stub, request| async move {
                    stub.apply_adjoint(request).await
                })
            };
            let response = self.again(deadline, call).await?;
            let inputs = response.gradients.unwrap_or_default();
            gradients.vertices.append(&mut points(inputs.vertices.as_ref())?);
            gradients.alpha.append(&mut numbers(inputs.alpha.as_ref())?);
            gradients.sideslip.append(&mut numbers(inputs.sideslip.as_ref())?);
            gradients.mach.append(&mut numbers(inputs.mach.as_ref())?);
            gradients.area.append(&mut numbers(inputs.area.as_ref())?);
            gradients.chord.append(&mut numbers(inputs.chord.as_ref())?);
            gradients.point.append(&mut points(inputs.point.as_ref())?);
            gradients.timings += timings(response.timings);
        }
        Ok(gradients)
    }

    /// Calls; if the server has dropped the configuration, sends it again and repeats the call.
    async fn again<A, F: Future<Output = Result<A, Error>>>(
        &self,
        deadline: Deadline,
        call: impl Fn() -> F,
    ) -> Result<A, Error> {
        let error = match call().await {
            Err(error) if error.code == Code::NotFound => error,
            answer => return answer,
        };
        let dropped = error.violations.iter().any(|violation| violation.field == "configuration_id");
        let Some(request) = self.request.as_ref().filter(|_| dropped) else {
            return Err(error);
        };
        if self.client.create(request, deadline).await?.id != self.id {
            return Err(Error::internal("the server gives the same configuration another id"));
        }
        call().await
    }

    /// Points that belong to one vector of inputs or outputs, at most.
    fn points(&self) -> usize {
        self.vertex_count.max(self.cell_count)
    }

    fn deadline(&self) -> Deadline {
        Deadline::after(self.client.timeout)
    }
}

/// The cells of each component of a mesh, by name: cell groups of a configuration.
///
/// # Errors
/// [`Code::Client`] if a cell's owner is not among the components.
pub fn parts(mesh: &Mesh, components: &[String]) -> Result<IndexGroups, Error> {
    let mut groups = IndexGroups::new();
    for (cell, &owner) in (0..).zip(&mesh.cell_owner) {
        let component = components.get(owner as usize).ok_or_else(|| {
            Error::client(format!("cell {cell} belongs to component {owner} of {}", components.len()))
        })?;
        groups.entry(component.clone()).or_default().push(cell);
    }
    Ok(groups)
}
