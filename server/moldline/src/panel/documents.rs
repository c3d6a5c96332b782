//! What requests say in JSON, as messages of the protocol; and what travels beside arrays in the query.

use std::collections::BTreeMap;

use moldline_proto::v1::{self, Array, trailing_edges::Rule};
use moldline_service::ServiceError;
use moldline_transport::media::Numbers;
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};

use crate::{convert::arrays::index_array, http::arrays::Arrays};

/// A mesh made ready for the panel method.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = CreateConfigurationRequest)]
pub struct CreateConfiguration {
    /// Three or four vertices of each cell, counter-clockwise from outside.
    #[serde(default)]
    cells: Vec<Vec<u32>>,
    /// Reference positions `[x, y, z]`, m.
    #[schema(value_type = Option<Vec<Vec<f64>>>, nullable = false)]
    #[serde(default)]
    vertices: Option<Numbers>,
    /// Parts of the surface by name.
    #[serde(default)]
    cell_groups: BTreeMap<String, Vec<u32>>,
    /// Vertices by name, for trailing edges.
    #[serde(default)]
    vertex_groups: BTreeMap<String, Vec<u32>>,
    /// Choices.
    #[serde(default)]
    options: Options,
}

/// Choices of a configuration.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = RequestPanelOptions)]
pub struct Options {
    /// The plane y = 0; as the reference positions are if absent.
    #[schema(nullable = false)]
    #[serde(default)]
    symmetry: Option<Symmetry>,
    /// Where wakes leave the surface; by an angle of 120 degrees if absent.
    #[schema(nullable = false)]
    #[serde(default)]
    trailing_edges: Option<TrailingEdges>,
    /// Cell groups whose forces are told; all if absent.
    #[schema(nullable = false)]
    #[serde(default)]
    components: Option<Vec<String>>,
    /// How the system is solved; by its size if absent.
    #[schema(nullable = false)]
    #[serde(default)]
    solver: Option<Solver>,
    /// Residual relative to the right-hand side; 1e-12 if absent.
    #[schema(nullable = false)]
    #[serde(default)]
    tolerance: Option<f64>,
}

/// The plane y = 0.
#[derive(Clone, Copy, Debug, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = RequestPanelSymmetry)]
pub enum Symmetry {
    /// Every cell is solved.
    None,
    /// The mesh is one half.
    Half,
    /// The mesh has both halves; one is solved.
    Mirror,
}

/// How the system is solved.
#[derive(Clone, Copy, Debug, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = RequestPanelSolver)]
pub enum Solver {
    /// LU in double precision.
    Double,
    /// LU in single precision, refined.
    Single,
    /// GMRES.
    Iterative,
}

/// Where wakes leave the surface.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = RequestTrailingEdges)]
pub enum TrailingEdges {
    /// Nowhere.
    None {},
    /// At these pairs of vertices.
    Edges(Vec<[u32; 2]>),
    /// At edges between vertices of these groups.
    Groups(Vec<String>),
    /// At edges across which the normal turns by at least so many degrees.
    Angle(f64),
}

fn indices(list: &[u32]) -> Array {
    index_array(&[list.len()], list)
}

impl From<Options> for v1::PanelOptions {
    fn from(Options { symmetry, trailing_edges, components, solver, tolerance }: Options) -> Self {
        let symmetry = match symmetry {
            None => v1::PanelSymmetry::Unspecified,
            Some(Symmetry::None) => v1::PanelSymmetry::None,
            Some(Symmetry::Half) => v1::PanelSymmetry::Half,
            Some(Symmetry::Mirror) => v1::PanelSymmetry::Mirror,
        };
        let solver = match solver {
            None => v1::PanelSolver::Unspecified,
            Some(Solver::Double) => v1::PanelSolver::Double,
            Some(Solver::Single) => v1::PanelSolver::Single,
            Some(Solver::Iterative) => v1::PanelSolver::Iterative,
        };
        let rule = trailing_edges.map(|edges| match edges {
            TrailingEdges::None {} => Rule::None(v1::NoTrailingEdges {}),
            TrailingEdges::Edges(edges) => {
                Rule::Edges(Array { shape: vec![edges.len() as u64, 2], ..indices(edges.as_flattened()) })
            }
            TrailingEdges::Groups(names) => Rule::Groups(v1::NameList { names }),
            TrailingEdges::Angle(degrees) => Rule::Angle(degrees),
        });
        Self {
            symmetry: symmetry.into(),
            trailing_edges: rule.map(|rule| v1::TrailingEdges { rule: Some(rule) }),
            components: components.map(|names| v1::NameList { names }),
            solver: solver.into(),
            tolerance,
        }
    }
}

impl CreateConfiguration {
    pub fn message(self) -> Result<v1::CreateConfigurationRequest, ServiceError> {
        let mut corners = Vec::with_capacity(4 * self.cells.len());
        for (index, cell) in self.cells.iter().enumerate() {
            if !matches!(cell.len(), 3 | 4) {
                let description = format!("{} vertices, expected 3 or 4", cell.len());
                return Err(ServiceError::invalid(format!("cells[{index}]"), description));
            }
            corners.extend_from_slice(cell);
            if cell.len() == 3 {
                corners.push(u32::MAX);
            }
        }
        let cells = Array { shape: vec![self.cells.len() as u64, 4], ..indices(&corners) };
        let group = |(name, list): (String, Vec<u32>)| v1::IndexGroup { name, indices: Some(indices(&list)) };
        Ok(v1::CreateConfigurationRequest {
            cells: Some(cells),
            vertices: self.vertices.map(|numbers| numbers.0),
            cell_groups: self.cell_groups.into_iter().map(group).collect(),
            vertex_groups: self.vertex_groups.into_iter().map(group).collect(),
            options: Some(self.options.into()),
        })
    }

    /// The same from arrays: `cells`, `vertices`, `cell_groups.NAME`, `vertex_groups.NAME`.
    pub fn of_arrays(
        mut arrays: Arrays,
        options: Options,
    ) -> Result<v1::CreateConfigurationRequest, ServiceError> {
        let group = |(name, list)| v1::IndexGroup { name, indices: Some(list) };
        let request = v1::CreateConfigurationRequest {
            cells: arrays.take("cells"),
            vertices: arrays.take("vertices"),
            cell_groups: arrays.take_all("cell_groups.").into_iter().map(group).collect(),
            vertex_groups: arrays.take_all("vertex_groups.").into_iter().map(group).collect(),
            options: Some(options.into()),
        };
        arrays.end()?;
        Ok(request)
    }
}

/// The choices of a configuration that comes as arrays.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct OptionsQuery {
    /// The choices as JSON, as in a document.
    options: Option<String>,
}

impl OptionsQuery {
    pub fn options(&self) -> Result<Options, ServiceError> {
        let text = self.options.as_deref().unwrap_or("{}");
        serde_json::from_str(text).map_err(|error| ServiceError::invalid("options", error.to_string()))
    }
}

/// The wind.
#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = RequestFlowAngles)]
pub struct Angles {
    /// Angle of attack, rad.
    #[serde(default)]
    alpha: f64,
    /// Sideslip, rad.
    #[serde(default)]
    sideslip: f64,
}

/// What coefficients refer to.
#[derive(Clone, Copy, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = RequestFlowReference)]
pub struct Reference {
    /// m^2.
    area: f64,
    /// Of the pitching moment, m.
    chord: f64,
    /// Of rolling and yawing moment, m.
    span: f64,
    /// About which moments are taken, m; the origin if absent.
    #[serde(default)]
    point: [f64; 3],
}

impl From<Angles> for v1::FlowAngles {
    fn from(Angles { alpha, sideslip }: Angles) -> Self {
        Self { alpha, sideslip }
    }
}

impl From<Reference> for v1::FlowReference {
    fn from(Reference { area, chord, span, point }: Reference) -> Self {
        Self { area, chord, span, point: point.to_vec() }
    }
}

/// What to analyse.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = AnalyzeRequest)]
pub struct Analyze {
    /// `[x, y, z]`, m; the reference positions if absent.
    #[schema(value_type = Option<Vec<Vec<f64>>>, nullable = false)]
    #[serde(default)]
    vertices: Option<Numbers>,
    /// Mach number.
    #[serde(default)]
    mach: f64,
    /// One result for each.
    #[serde(default)]
    flows: Vec<Angles>,
    /// What coefficients refer to.
    #[schema(nullable = false)]
    #[serde(default)]
    reference: Option<Reference>,
    /// Leaves out the pressures of cells and vertices.
    #[serde(default)]
    without_pressures: bool,
}

impl Analyze {
    pub fn message(self, configuration_id: String) -> v1::AnalyzeRequest {
        v1::AnalyzeRequest {
            configuration_id,
            vertices: self.vertices.map(|numbers| numbers.0),
            mach: self.mach,
            flows: self.flows.into_iter().map(Into::into).collect(),
            reference: self.reference.map(Into::into),
            without_pressures: self.without_pressures,
        }
    }
}

/// Where a derivative is taken.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = RequestAnalysisPoint)]
pub struct At {
    /// As Analyze returned it.
    #[serde(default)]
    analysis_id: String,
    /// What it names; solved again if the server does not hold it any more.
    #[schema(nullable = false)]
    #[serde(default)]
    geometry: Option<Geometry>,
    /// The wind.
    #[schema(nullable = false)]
    #[serde(default)]
    flow: Option<Angles>,
    /// What coefficients refer to.
    #[schema(nullable = false)]
    #[serde(default)]
    reference: Option<Reference>,
}

/// Where the vertices are, and how fast the flow is.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = RequestAnalysisGeometry)]
pub struct Geometry {
    /// `[x, y, z]`, m; the reference positions if absent.
    #[schema(value_type = Option<Vec<Vec<f64>>>, nullable = false)]
    #[serde(default)]
    vertices: Option<Numbers>,
    /// Mach number.
    #[serde(default)]
    mach: f64,
}

impl From<At> for v1::AnalysisPoint {
    fn from(At { analysis_id, geometry, flow, reference }: At) -> Self {
        let geometry = geometry.map(|Geometry { vertices, mach }| v1::AnalysisGeometry {
            vertices: vertices.map(|numbers| numbers.0),
            mach,
        });
        Self { analysis_id, geometry, flow: flow.map(Into::into), reference: reference.map(Into::into) }
    }
}

/// Directions of the inputs; what is absent is zero. Parts that are given have as many rows.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = PanelServiceApplyJacobianVectorRequest)]
pub struct Jvp {
    /// Where the derivative is taken.
    #[serde(default)]
    at: At,
    /// Directions.
    #[serde(default)]
    directions: Inputs,
}

/// Blocks of inputs.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = RequestFlowInputs)]
pub struct Inputs {
    /// One list of `[x, y, z]` for each, m.
    #[schema(value_type = Option<Vec<Vec<Vec<f64>>>>, nullable = false)]
    #[serde(default)]
    vertices: Option<Numbers>,
    /// rad.
    #[schema(value_type = Option<Vec<f64>>, nullable = false)]
    #[serde(default)]
    alpha: Option<Numbers>,
    /// rad.
    #[schema(value_type = Option<Vec<f64>>, nullable = false)]
    #[serde(default)]
    sideslip: Option<Numbers>,
    /// Mach number.
    #[schema(value_type = Option<Vec<f64>>, nullable = false)]
    #[serde(default)]
    mach: Option<Numbers>,
    /// m^2.
    #[schema(value_type = Option<Vec<f64>>, nullable = false)]
    #[serde(default)]
    area: Option<Numbers>,
    /// m.
    #[schema(value_type = Option<Vec<f64>>, nullable = false)]
    #[serde(default)]
    chord: Option<Numbers>,
    /// `[x, y, z]`, m.
    #[schema(value_type = Option<Vec<Vec<f64>>>, nullable = false)]
    #[serde(default)]
    point: Option<Numbers>,
}

impl Jvp {
    pub fn message(self, configuration_id: String) -> v1::PanelServiceApplyJacobianVectorRequest {
        let of = |numbers: Option<Numbers>| numbers.map(|numbers| numbers.0);
        let Inputs { vertices, alpha, sideslip, mach, area, chord, point } = self.directions;
        let directions = v1::FlowInputs {
            vertices: of(vertices),
            alpha: of(alpha),
            sideslip: of(sideslip),
            mach: of(mach),
            area: of(area),
            chord: of(chord),
            point: of(point),
        };
        v1::PanelServiceApplyJacobianVectorRequest {
            configuration_id,
            at: Some(self.at.into()),
            directions: Some(directions),
        }
    }
}

/// Weights of the outputs; what is absent is zero. Parts that are given have as many rows.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = PanelServiceApplyAdjointRequest)]
pub struct Vjp {
    /// Where the derivative is taken.
    #[serde(default)]
    at: At,
    /// Weights.
    #[serde(default)]
    seeds: Outputs,
}

/// Blocks of outputs.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = RequestFlowOutputs)]
pub struct Outputs {
    /// One list for each: lift, induced_drag, pressure_lift, pressure_drag, moment, lift_slope, moment_slope,
    /// pressure_lift_slope, neutral_point.
    #[schema(value_type = Option<Vec<Vec<f64>>>, nullable = false)]
    #[serde(default)]
    coefficients: Option<Numbers>,
    /// One list of all sections for each, m.
    #[schema(value_type = Option<Vec<Vec<f64>>>, nullable = false)]
    #[serde(default)]
    section_loads: Option<Numbers>,
    /// One list of all cells for each.
    #[schema(value_type = Option<Vec<Vec<f64>>>, nullable = false)]
    #[serde(default)]
    cp: Option<Numbers>,
}

impl Vjp {
    pub fn message(self, configuration_id: String) -> v1::PanelServiceApplyAdjointRequest {
        let of = |numbers: Option<Numbers>| numbers.map(|numbers| numbers.0);
        let Outputs { coefficients, section_loads, cp } = self.seeds;
        let seeds =
            v1::FlowOutputs { coefficients: of(coefficients), section_loads: of(section_loads), cp: of(cp) };
        v1::PanelServiceApplyAdjointRequest { configuration_id, at: Some(self.at.into()), seeds: Some(seeds) }
    }
}

/// What a request with arrays says besides. (In JSON, fields of the document.)
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct FlowQuery {
    /// Extents of an `application/octet-stream` body, such as `14824,3`.
    pub shape: Option<String>,
    /// Of derivatives: as Analyze returned it.
    analysis_id: Option<String>,
    /// Mach number.
    mach: Option<f64>,
    /// Angles of attack, rad, separated by commas; of derivatives a single one.
    alpha: Option<String>,
    /// Sideslip, rad.
    #[serde(default)]
    sideslip: f64,
    /// Reference area, m^2.
    area: Option<f64>,
    /// Reference chord, m.
    chord: Option<f64>,
    /// Reference span, m.
    span: Option<f64>,
    /// Reference point `x,y,z`, m.
    point: Option<String>,
    /// Of analyses: leaves out the pressures of cells and vertices.
    #[serde(default)]
    without_pressures: bool,
}

impl FlowQuery {
    fn flows(&self) -> Result<Vec<v1::FlowAngles>, ServiceError> {
        let alphas = list("alpha", self.alpha.as_deref().unwrap_or("0"))?;
        Ok(alphas.into_iter().map(|alpha| v1::FlowAngles { alpha, sideslip: self.sideslip }).collect())
    }

    fn reference(&self) -> Result<v1::FlowReference, ServiceError> {
        let given =
            |name: &str, value: Option<f64>| value.ok_or_else(|| ServiceError::invalid(name, "is missing"));
        Ok(v1::FlowReference {
            area: given("area", self.area)?,
            chord: given("chord", self.chord)?,
            span: given("span", self.span)?,
            point: self.point.as_deref().map_or(Ok(Vec::new()), |point| list("point", point))?,
        })
    }

    fn at(&self, vertices: Option<Array>) -> Result<v1::AnalysisPoint, ServiceError> {
        let flows = self.flows()?;
        let [flow] = flows[..] else {
            return Err(ServiceError::invalid("alpha", "a derivative is taken at a single angle"));
        };
        let geometry = match (vertices, self.mach) {
            (None, None) => None,
            (vertices, mach) => Some(v1::AnalysisGeometry { vertices, mach: mach.unwrap_or(0.0) }),
        };
        Ok(v1::AnalysisPoint {
            analysis_id: self.analysis_id.clone().unwrap_or_default(),
            geometry,
            flow: Some(flow),
            reference: Some(self.reference()?),
        })
    }

    pub fn analyze(
        &self,
        mut arrays: Arrays,
        configuration_id: String,
    ) -> Result<v1::AnalyzeRequest, ServiceError> {
        if self.analysis_id.is_some() {
            return Err(ServiceError::invalid(
                "analysis_id",
                "is for derivatives; an analysis takes vertices",
            ));
        }
        let vertices = arrays.take("vertices");
        arrays.end()?;
        Ok(v1::AnalyzeRequest {
            configuration_id,
            vertices,
            mach: self.mach.unwrap_or(0.0),
            flows: self.flows()?,
            reference: Some(self.reference()?),
            without_pressures: self.without_pressures,
        })
    }

    pub fn jvp(
        &self,
        mut arrays: Arrays,
        configuration_id: String,
    ) -> Result<v1::PanelServiceApplyJacobianVectorRequest, ServiceError> {
        let at = Some(self.at(arrays.take("at.vertices"))?);
        let directions = v1::FlowInputs {
            vertices: arrays.take("vertices").map(crate::http::arrays::point_block),
            alpha: arrays.take("alpha"),
            sideslip: arrays.take("sideslip"),
            mach: arrays.take("mach"),
            area: arrays.take("area"),
            chord: arrays.take("chord"),
            point: arrays.take("point"),
        };
        arrays.end()?;
        Ok(v1::PanelServiceApplyJacobianVectorRequest { configuration_id, at, directions: Some(directions) })
    }

    pub fn vjp(
        &self,
        mut arrays: Arrays,
        configuration_id: String,
    ) -> Result<v1::PanelServiceApplyAdjointRequest, ServiceError> {
        use crate::http::arrays::block;
        let at = Some(self.at(arrays.take("at.vertices"))?);
        let seeds = v1::FlowOutputs {
            coefficients: arrays.take("coefficients").map(block),
            section_loads: arrays.take("section_loads").map(block),
            cp: arrays.take("cp").map(block),
        };
        arrays.end()?;
        Ok(v1::PanelServiceApplyAdjointRequest { configuration_id, at, seeds: Some(seeds) })
    }
}

fn list(field: &str, text: &str) -> Result<Vec<f64>, ServiceError> {
    let numbers: Result<_, _> = text.split(',').map(|number| number.trim().parse()).collect();
    numbers.map_err(|_| ServiceError::invalid(field, "is not a list of numbers separated by commas"))
}
