//! Data model of the panel service: arguments and results.

use std::{collections::BTreeMap, sync::Arc};

use moldline_proto::v1;

use crate::{Point, Timings, blocks::Entry};

/// Vertices of a cell, counter-clockwise from outside; a triangle's fourth is [`crate::Mesh::NO_VERTEX`].
pub type Cell = [u32; 4];

/// Cells or vertices by name.
pub type IndexGroups = BTreeMap<String, Vec<u32>>;

/// Symmetry with respect to the plane y = 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Symmetry {
    /// Found from the reference positions.
    #[default]
    Automatic,
    /// Every cell is solved; the flow may have sideslip.
    None,
    /// The mesh is one half, open on the plane.
    Half,
    /// The mesh has both halves, and one is solved.
    Mirror,
}

/// Solver of the linear system.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Solver {
    /// Chosen by the number of unknowns.
    #[default]
    Automatic,
    /// LU in double precision.
    Double,
    /// LU in single precision, refined in double precision.
    Single,
    /// GMRES with a block preconditioner.
    Iterative,
}

/// What becomes of an answer that a check finds wrong.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OnDoubt {
    /// Refused beyond the check's second limit; a warning beyond its first.
    #[default]
    Refuse,
    /// A warning only.
    Warn,
}

/// A reason to doubt a configuration or an answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning {
    /// Of a configuration `no_wake` or `left_out`; of an answer `near_pass`, `lift`, `drag`, `span_efficiency`, `stagnation` or `circulation`.
    pub kind: String,
    /// What is wrong, where, and the way out.
    pub text: String,
}

/// A line of edges that looks like a trailing edge, but was not taken as one.
#[derive(Clone, Debug, PartialEq)]
pub struct LineLeftOut {
    /// Its vertices in order.
    pub vertices: Vec<u32>,
    /// Length, m.
    pub length: f64,
    /// Length as seen along the flow, m.
    pub width: f64,
    /// Angle by which the outward normal turns across it, degrees: the mean.
    pub turn: f64,
    /// `flat`, `smooth`, `along_the_flow`, `base` or `not_named`.
    pub reason: String,
}

/// Trailing edges, where wakes leave the surface.
#[derive(Clone, Debug, PartialEq)]
pub enum TrailingEdges {
    /// None: bodies without lift.
    None,
    /// Pairs of vertices.
    Edges(Vec<[u32; 2]>),
    /// Edges with both vertices in one of these vertex groups.
    Groups(Vec<String>),
    /// Edges that point downstream and across which the outward normal turns by at least this angle, degrees (60 to 180).
    Angle(f64),
}

impl Default for TrailingEdges {
    fn default() -> Self {
        Self::Angle(120.0)
    }
}

/// Options of [`super::Client::create_configuration`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ConfigurationOptions {
    /// Parts of the surface, for forces; [`super::parts`] makes them from a mesh.
    pub cell_groups: IndexGroups,
    /// Vertices by name, for trailing edges.
    pub vertex_groups: IndexGroups,
    /// Symmetry of the mesh.
    pub symmetry: Symmetry,
    /// Trailing edges.
    pub trailing_edges: TrailingEdges,
    /// Cell groups whose forces are returned; all if absent.
    pub components: Option<Vec<String>>,
    /// Solver of the linear system.
    pub solver: Solver,
    /// Residual relative to the right-hand side; 1e-12 if absent.
    pub tolerance: Option<f64>,
    /// Distance within which vertices become one, at their mean, m; none if absent. All arrays keep the vertices given.
    pub merge_tolerance: Option<f64>,
    /// What becomes of answers that contradict themselves.
    pub on_doubt: OnDoubt,
}

/// Description of a configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct ConfigurationFacts {
    /// Hash of its content.
    pub id: String,
    /// Number of vertices.
    pub vertex_count: usize,
    /// Number of cells.
    pub cell_count: usize,
    /// Unknowns of the linear system.
    pub unknowns: usize,
    /// Whether one half is solved for both.
    pub symmetric: bool,
    /// Trailing edges of the solved half, as pairs of vertices in the order of section loads.
    pub trailing_edges: Vec<[u32; 2]>,
    /// Vertices where a trailing edge ends on a body, across which its circulation continues.
    pub roots: Vec<u32>,
    /// For each of them the vertex at the body's aft end where its circulation leaves the body.
    pub aft_ends: Vec<u32>,
    /// What looks like a trailing edge, but was not taken as one; the longest of each reason first.
    pub left_out: Vec<LineLeftOut>,
    /// Reasons to doubt the configuration.
    pub warnings: Vec<Warning>,
    /// Solver of the linear system.
    pub solver: Solver,
    /// Approximate peak memory of an analysis, bytes.
    pub memory: u64,
    /// Names of the parts whose forces are returned.
    pub components: Vec<String>,
}

/// Direction of the wind.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wind {
    /// Angle of attack, rad.
    pub alpha: f64,
    /// Sideslip, rad; positive if the wind comes from starboard.
    pub sideslip: f64,
}

/// Reference values of the coefficients: of the whole aircraft, also for a half model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference {
    /// Reference area, m^2.
    pub area: f64,
    /// Reference length of the pitching moment, m.
    pub chord: f64,
    /// Reference length of rolling and yawing moment, m.
    pub span: f64,
    /// Moment reference point, m.
    pub point: Point,
}

impl Default for Reference {
    fn default() -> Self {
        Self { area: 1.0, chord: 1.0, span: 1.0, point: [0.0; 3] }
    }
}

/// Mach number, wind and reference values.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Flow {
    /// Mach number, below 1.
    pub mach: f64,
    /// Direction of the wind.
    pub wind: Wind,
    /// Reference values.
    pub reference: Reference,
}

/// Declares the scalar outputs once: the struct, their names, their order in blocks, and their message.
macro_rules! coefficients {
    ($($(#[$documentation:meta])* $name:ident,)*) => {
        /// Scalar outputs, their changes along a direction, or their weights in a sum.
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub struct Coefficients {
            $($(#[$documentation])* pub $name: f64,)*
        }

        impl Coefficients {
            /// Names, in the order of the protocol.
            pub const NAMES: [&str; [$(stringify!($name)),*].len()] = [$(stringify!($name)),*];

            /// Values in the same order.
            pub fn to_array(&self) -> [f64; Self::NAMES.len()] {
                [$(self.$name),*]
            }
        }

        impl From<[f64; Self::NAMES.len()]> for Coefficients {
            fn from([$($name),*]: [f64; Self::NAMES.len()]) -> Self {
                Self { $($name),* }
            }
        }

        impl From<v1::FlowCoefficients> for Coefficients {
            fn from(message: v1::FlowCoefficients) -> Self {
                Self { $($name: message.$name),* }
            }
        }
    };
}

coefficients! {
    /// Lift from the circulation of the wakes.
    lift,
    /// Induced drag from the Trefftz plane.
    induced_drag,
    /// Lift from the pressure.
    pressure_lift,
    /// Drag from the pressure.
    pressure_drag,
    /// Pitching moment from the pressure, nose up positive.
    moment,
    /// Derivative of `lift` with respect to the angle of attack, 1/rad.
    lift_slope,
    /// Derivative of `moment` with respect to the angle of attack, 1/rad.
    moment_slope,
    /// Derivative of `pressure_lift` with respect to the angle of attack, 1/rad.
    pressure_lift_slope,
    /// x of the neutral point, m; not a number without lift.
    neutral_point,
}

impl Entry for Coefficients {
    const AXIS: Option<usize> = Some(Self::NAMES.len());

    fn numbers(entries: &[Self]) -> Vec<f64> {
        entries.iter().flat_map(Self::to_array).collect()
    }
}

/// Force and moment coefficients of a part of the surface, from the pressure.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Loads {
    /// Force along x, y, z over dynamic pressure and reference area.
    pub force: Point,
    /// Moment about x, y, z over dynamic pressure, reference area, and span, chord and span; the second is nose up.
    pub moment: Point,
    /// Lift coefficient.
    pub lift: f64,
    /// Drag coefficient.
    pub drag: f64,
}

/// Loads along the trailing edges of the solved half.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sections {
    /// The trailing edges, as pairs of vertices.
    pub edges: Vec<[u32; 2]>,
    /// Their midpoints, m.
    pub middles: Vec<Point>,
    /// y and z of the vector from first to second vertex, m.
    pub spans: Vec<[f64; 2]>,
    /// Section lift coefficient times chord, m.
    pub loads: Vec<f64>,
}

/// Point of linearisation: vertices and flow.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AnalysisPoint {
    /// Positions of the vertices, m; the reference positions if absent.
    pub vertices: Option<Arc<[Point]>>,
    /// Mach number, wind and reference values.
    pub flow: Flow,
}

/// The flow in one wind.
#[derive(Clone, Debug, PartialEq)]
pub struct Analysis {
    /// Determined by configuration, vertices and Mach number: the same in every wind.
    pub id: String,
    /// The requested vertices and flow.
    pub point: AnalysisPoint,
    /// Scalar outputs.
    pub coefficients: Coefficients,
    /// Lift coefficient of the wakes: the part of the circulation's lift that acts on them and not on the body.
    pub wake_lift: f64,
    /// A measure of the discretisation error: lift from the pressure and on the wakes, over the lift that momentum requires
    /// for the circulation, minus one.
    pub disagreement: f64,
    /// Reasons to doubt the answer.
    pub warnings: Vec<Warning>,
    /// Loads on the whole surface.
    pub total: Loads,
    /// Loads on each part, by name.
    pub components: BTreeMap<String, Loads>,
    /// Loads along the trailing edges.
    pub sections: Sections,
    /// Pressure coefficient of every cell; empty if not requested.
    pub cp: Vec<f64>,
    /// Pressure coefficient at every vertex; empty if not requested.
    pub vertex_cp: Vec<f64>,
    /// Number of cells where the flow would be supersonic.
    pub supercritical_cells: usize,
    /// Residual of the linear system relative to its right-hand side.
    pub residual: f64,
    /// The same after each round of refinement, or iteration.
    pub residuals: Vec<f64>,
    /// Number of rounds of refinement, or iterations.
    pub rounds: usize,
    /// Whether the server had the solution already.
    pub reused: bool,
    /// Time in the engine and in its queue.
    pub timings: Timings,
}

/// Point of linearisation: an analysis, which is best since the server holds its factored system, or vertices and flow.
#[derive(Clone, Debug, PartialEq)]
pub struct At {
    pub(super) id: String,
    pub(super) point: AnalysisPoint,
}

impl From<&Analysis> for At {
    fn from(analysis: &Analysis) -> Self {
        Self { id: analysis.id.clone(), point: analysis.point.clone() }
    }
}

impl From<AnalysisPoint> for At {
    fn from(point: AnalysisPoint) -> Self {
        Self { id: String::new(), point }
    }
}

/// k directions of the inputs; empty blocks are zero.
#[derive(Clone, Debug, PartialEq)]
pub struct Directions {
    /// Number of directions, k.
    pub count: usize,
    /// (k, number of vertices), m.
    pub vertices: Vec<Point>,
    /// (k), rad.
    pub alpha: Vec<f64>,
    /// (k), rad.
    pub sideslip: Vec<f64>,
    /// (k).
    pub mach: Vec<f64>,
    /// (k), m^2.
    pub area: Vec<f64>,
    /// (k), m.
    pub chord: Vec<f64>,
    /// (k), m.
    pub point: Vec<Point>,
}

impl Default for Directions {
    fn default() -> Self {
        Self {
            count: 1,
            vertices: Vec::new(),
            alpha: Vec::new(),
            sideslip: Vec::new(),
            mach: Vec::new(),
            area: Vec::new(),
            chord: Vec::new(),
            point: Vec::new(),
        }
    }
}

/// Changes of the outputs along k directions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tangents {
    /// Number of directions, k.
    pub count: usize,
    /// (k).
    pub coefficients: Vec<Coefficients>,
    /// (k, number of sections), m.
    pub section_loads: Vec<f64>,
    /// (k, number of cells).
    pub cp: Vec<f64>,
    /// Total of all requests.
    pub timings: Timings,
}

/// Weights of k sums of the outputs; empty blocks are zero.
#[derive(Clone, Debug, PartialEq)]
pub struct Seeds {
    /// Number of sums, k.
    pub count: usize,
    /// (k).
    pub coefficients: Vec<Coefficients>,
    /// (k, number of sections).
    pub section_loads: Vec<f64>,
    /// (k, number of cells).
    pub cp: Vec<f64>,
}

impl Default for Seeds {
    fn default() -> Self {
        Self { count: 1, coefficients: Vec::new(), section_loads: Vec::new(), cp: Vec::new() }
    }
}

/// Gradients of k weighted sums with respect to the inputs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gradients {
    /// Number of sums, k.
    pub count: usize,
    /// (k, number of vertices), per metre.
    pub vertices: Vec<Point>,
    /// (k), per radian.
    pub alpha: Vec<f64>,
    /// (k), per radian.
    pub sideslip: Vec<f64>,
    /// (k).
    pub mach: Vec<f64>,
    /// (k), per square metre.
    pub area: Vec<f64>,
    /// (k), per metre.
    pub chord: Vec<f64>,
    /// (k), per metre.
    pub point: Vec<Point>,
    /// Total of all requests.
    pub timings: Timings,
}
