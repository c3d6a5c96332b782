//! What the client asks with and is answered: plain data.

use std::{
    collections::BTreeMap,
    time::{Duration, SystemTime},
};

/// x, y and z: of a vertex or a control point, metres; of a derivative by it, per metre.
pub type Point = [f64; 3];

/// Control points by component, patch after patch, the second parameter fastest.
pub type ControlPoints = BTreeMap<String, Vec<Point>>;

/// How far something long has come.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// Of a set-up: `receive`, `read`, `queue`, and then the engine's stages. `jacobian` of a Jacobian.
    pub stage: String,
    /// Share of the stage, 0 to 1.
    pub fraction: f64,
    /// For people.
    pub message: String,
}

/// One scalar design variable.
#[derive(Clone, Debug, PartialEq)]
pub struct Variable {
    /// Such as `wing.twist[3]`.
    pub name: String,
    /// Of the three numbers and of its entry in a design, such as `m` or `deg`.
    pub unit: String,
    /// Of the reference geometry.
    pub baseline: f64,
    /// Least value; may be infinite.
    pub lower: f64,
    /// Greatest value; may be infinite.
    pub upper: f64,
}

/// Variables that were declared together.
#[derive(Clone, Debug, PartialEq)]
pub struct VariableGroup {
    /// As declared.
    pub name: String,
    /// Index of the first one's entry of a design; they follow each other, the last axis of `shape` fastest.
    pub first: usize,
    /// Empty for a scalar.
    pub shape: Vec<usize>,
}

/// A scalar output besides the vertices.
#[derive(Clone, Debug, PartialEq)]
pub struct Function {
    /// Such as `wing.wetted_area`.
    pub name: String,
    /// Such as `m^2`.
    pub unit: String,
    /// For the reference mesh.
    pub value: f64,
}

/// Who may use a set-up besides its owner.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Visibility {
    /// Nobody.
    #[default]
    Private,
    /// Tenants that are named.
    Tenants,
    /// Every tenant of the server.
    Public,
}

/// What a set-up is to the caller.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SetupAccess {
    /// Whether the caller has uploaded it.
    pub owned: bool,
    /// To the owner: what was chosen. To others: `Tenants` or `Public`, whichever lets them use it.
    pub visibility: Visibility,
    /// Tenants; to the owner only.
    pub shared_with: Vec<String>,
}

/// What is known of a set-up without asking the server again.
#[derive(Clone, Debug, PartialEq)]
pub struct SetupFacts {
    /// Hash of its content.
    pub id: String,
    /// Whether it was new to the caller when the call that returned this created it.
    pub built: bool,
    /// The title its author gave it.
    pub name: String,
    /// Who may use it.
    pub access: SetupAccess,
    /// What was found, for people.
    pub report_text: String,
    /// What was found, as a JSON document.
    pub report_json: String,
    /// In the order of a design's entries.
    pub variables: Vec<Variable>,
    /// As they were declared.
    pub groups: Vec<VariableGroup>,
    /// Names of the components.
    pub components: Vec<String>,
    /// How many control points each component has.
    pub control_point_counts: Vec<usize>,
    /// The scalar outputs besides the vertices.
    pub functions: Vec<Function>,
    /// How many vertices the mesh has.
    pub vertex_count: usize,
    /// How many cells it has.
    pub cell_count: usize,
    /// Of the engine, to build it.
    pub build_time: Duration,
}

impl SetupFacts {
    /// The design of the reference geometry.
    pub fn baseline(&self) -> Vec<f64> {
        self.variables.iter().map(|variable| variable.baseline).collect()
    }

    /// Index of a design variable by name.
    pub fn variable(&self, name: &str) -> Option<usize> {
        self.variables.iter().position(|variable| variable.name == name)
    }

    /// Index of a scalar output by name.
    pub fn function(&self, name: &str) -> Option<usize> {
        self.functions.iter().position(|function| function.name == name)
    }
}

/// A set-up in a list.
#[derive(Clone, Debug, PartialEq)]
pub struct SetupSummary {
    /// Hash of its content.
    pub id: String,
    /// The title its author gave it.
    pub name: String,
    /// Of the mesh.
    pub vertex_count: usize,
    /// Of the mesh.
    pub cell_count: usize,
    /// Of the design.
    pub variable_count: usize,
    /// When it was first uploaded.
    pub created: SystemTime,
    /// Who may use it.
    pub access: SetupAccess,
}

/// A surface mesh of triangles and quadrilaterals.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// In metres.
    pub vertices: Vec<Point>,
    /// Vertices of each cell, counter-clockwise from outside; a triangle's fourth is [`Mesh::NO_VERTEX`].
    pub cells: Vec<[u32; 4]>,
    /// By cell: index of the component that owns it.
    pub cell_owner: Vec<u32>,
    /// By vertex: whether it lies on a seam of two components.
    pub seam: Vec<bool>,
}

impl Mesh {
    /// Fourth vertex of a triangle.
    pub const NO_VERTEX: u32 = u32::MAX;
}

/// Values of the design variables.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Design {
    /// Those of the reference geometry.
    #[default]
    Baseline,
    /// All in order, each in its variable's unit.
    Vector(Vec<f64>),
    /// By name; those that are not named stay at their baseline.
    Named(BTreeMap<String, f64>),
}

impl Design {
    /// By name.
    pub fn named<'a>(values: impl IntoIterator<Item = (&'a str, f64)>) -> Self {
        Self::Named(values.into_iter().map(|(name, value)| (name.to_owned(), value)).collect())
    }
}

/// A design, and control points from elsewhere in place of what the design makes of their components.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DesignPoint {
    /// The variables.
    pub design: Design,
    /// By component, metres.
    pub control_points: ControlPoints,
}

impl From<Design> for DesignPoint {
    fn from(design: Design) -> Self {
        Self { design, control_points: ControlPoints::new() }
    }
}

impl From<Vec<f64>> for DesignPoint {
    fn from(values: Vec<f64>) -> Self {
        Design::Vector(values).into()
    }
}

/// A session as the server has stored it.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionState {
    /// Its name.
    pub id: String,
    /// Of its set-up.
    pub setup_id: String,
    /// Grows by one with each update.
    pub generation: u64,
    /// As stored last: all variables in order, and the control points that were given. Absent in lists.
    pub design: Option<DesignPoint>,
    /// For people.
    pub label: String,
    /// When it was opened.
    pub created: SystemTime,
    /// When it was stored last.
    pub updated: SystemTime,
}

/// What a session is to store; what is absent stays as it was.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SessionUpdate {
    /// Where the optimizer has got to.
    pub design: Option<DesignPoint>,
    /// For people.
    pub label: Option<String>,
}

/// Percentiles over cells.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distribution {
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest.
    pub max: f64,
    /// Share of the cells above 5, in percent.
    pub above_5_percent: f64,
}

/// Measures of some cells.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct QualitySummary {
    /// How many cells.
    pub cells: usize,
    /// Verdict's aspect ratio.
    pub aspect_ratio: Distribution,
    /// Longest over shortest edge.
    pub edge_ratio: Distribution,
    /// Against the owner surface's current normal; 1 at best, negative where a corner is inverted.
    pub min_scaled_jacobian: f64,
    /// Least interior angle, degrees.
    pub min_angle: f64,
    /// Greatest interior angle, degrees.
    pub max_angle: f64,
    /// 95th percentile of the equiangle skew, 0 at best.
    pub skew_p95: f64,
    /// Greatest equiangle skew.
    pub skew_max: f64,
    /// Cells whose area vector points against their owner's normal.
    pub folded: usize,
    /// Cells with a corner that is turned against the owner's normal.
    pub inverted: usize,
}

/// Measures of all cells and of each component's.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct QualityReport {
    /// Of all.
    pub total: QualitySummary,
    /// By component.
    pub components: BTreeMap<String, QualitySummary>,
}

/// Measures of every cell.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CellQuality {
    /// Verdict's aspect ratio.
    pub aspect_ratio: Vec<f64>,
    /// Longest over shortest edge.
    pub edge_ratio: Vec<f64>,
    /// Against the owner surface's current normal.
    pub scaled_jacobian: Vec<f64>,
    /// Equiangle skew.
    pub skew: Vec<f64>,
}

/// How exactly a mesh lies where it has to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Residuals {
    /// Largest distance of a seam vertex from one of its components before the smooth projection, metres.
    pub seam: f64,
    /// Largest distance of a protected or stationary vertex from a component that it lies on, metres.
    pub held: f64,
    /// Largest |Phi| of an active vertex at the end, metres; 0 for a sharp outer mold line.
    pub projection: f64,
    /// Most projection steps that a vertex took.
    pub projection_steps: u32,
}

/// How long requests took on the server.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timings {
    /// Waiting for the engine.
    pub queue: Duration,
    /// In the engine.
    pub engine: Duration,
}

/// Where a derivative is taken: what the server keeps of a deformation, and the design to make it again.
#[derive(Clone, Debug, PartialEq)]
pub struct Linearisation {
    /// The same for the same set-up and design, on any server.
    pub id: String,
    /// As it was asked for.
    pub point: DesignPoint,
}

/// A deformed mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct Deformation {
    /// In the set-up mesh's order, metres.
    pub vertices: Vec<Point>,
    /// The scalar outputs in the order of the set-up's, each in its unit.
    pub functions: Vec<f64>,
    /// For derivatives here.
    pub linearisation: Linearisation,
    /// Measures of the deformed mesh.
    pub quality: QualityReport,
    /// Only if asked for.
    pub cell_quality: Option<CellQuality>,
    /// How exactly it lies where it has to.
    pub residuals: Residuals,
    /// How long it took.
    pub timings: Timings,
}

/// Where a derivative is taken: a deformation, what is left of it, or a design. Best is a deformation: the server has it.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum At {
    /// What the server may hold, and the design to make it again.
    Linearisation(Linearisation),
    /// A design; the baseline by default.
    Point(DesignPoint),
    /// An id alone, which the server has to hold still; it is `NotFound` otherwise.
    Held(String),
    /// The reference geometry.
    #[default]
    Baseline,
}

impl From<&Deformation> for At {
    fn from(deformation: &Deformation) -> Self {
        Self::Linearisation(deformation.linearisation.clone())
    }
}

impl From<&Linearisation> for At {
    fn from(linearisation: &Linearisation) -> Self {
        Self::Linearisation(linearisation.clone())
    }
}

impl<T: Into<DesignPoint>> From<T> for At {
    fn from(point: T) -> Self {
        Self::Point(point.into())
    }
}

/// k directions of the inputs; what is empty is zero.
#[derive(Clone, Debug, PartialEq)]
pub struct Directions {
    /// k.
    pub count: usize,
    /// (k, number of variables), the last axis fastest: each entry in its variable's unit.
    pub design: Vec<f64>,
    /// By component: (k, number of its control points), on top of what `design` does to them.
    pub control_points: ControlPoints,
}

impl Default for Directions {
    fn default() -> Self {
        Self { count: 1, design: Vec::new(), control_points: ControlPoints::new() }
    }
}

/// Changes of the outputs along k directions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tangents {
    /// k.
    pub count: usize,
    /// (k, number of vertices), metres.
    pub vertices: Vec<Point>,
    /// (k, number of functions), each in its unit.
    pub functions: Vec<f64>,
    /// Of all requests together.
    pub timings: Timings,
}

/// k weighted sums of the outputs, and by which inputs their gradients are wanted; weights that are empty are zero.
#[derive(Clone, Debug, PartialEq)]
pub struct Seeds {
    /// k.
    pub count: usize,
    /// (k, number of vertices): weights of the vertices' coordinates, such as the derivative of an objective by them.
    pub vertices: Vec<Point>,
    /// (k, number of functions): weights of the functions.
    pub functions: Vec<f64>,
    /// Whether gradients by the design variables are wanted.
    pub by_design: bool,
    /// Components by whose control points gradients are wanted too.
    pub by_control_points: Vec<String>,
}

impl Default for Seeds {
    fn default() -> Self {
        Self {
            count: 1,
            vertices: Vec::new(),
            functions: Vec::new(),
            by_design: true,
            by_control_points: Vec::new(),
        }
    }
}

/// Gradients of k weighted sums.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gradients {
    /// k.
    pub count: usize,
    /// (k, number of variables), per its variable's unit; empty if not asked for.
    pub design: Vec<f64>,
    /// By component, if asked for: (k, number of its control points), per metre.
    pub control_points: ControlPoints,
    /// Of all requests together.
    pub timings: Timings,
}

/// Derivatives of all outputs by all design variables.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Jacobian {
    /// (number of variables, number of vertices), metres per the variable's unit.
    pub vertices: Vec<Point>,
    /// (number of variables, number of functions).
    pub functions: Vec<f64>,
    /// How long it took.
    pub timings: Timings,
}

/// Use of one of the server's caches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CacheStatus {
    /// How many things it holds.
    pub entries: u64,
    /// Their bytes.
    pub bytes: u64,
    /// The server's, for all tenants.
    pub budget_bytes: u64,
    /// Since the server started; for administrators, others see 0.
    pub hits: u64,
    /// As `hits`.
    pub misses: u64,
    /// As `hits`.
    pub evictions: u64,
}

/// A request that computes, or waits for it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Work {
    /// Such as `build`, `deform`, `jvp`, `vjp`, `jacobian`.
    pub kind: String,
    /// Whose.
    pub tenant: String,
    /// Empty where there is none (yet).
    pub setup_id: String,
    /// Empty where there is none.
    pub session_id: String,
    /// Whether it computes; otherwise it waits.
    pub running: bool,
    /// Since it came.
    pub age: Duration,
    /// Since it computes.
    pub running_for: Duration,
    /// How far it has come, where that is known.
    pub stage: String,
    /// Share of the stage.
    pub fraction: f64,
}

/// What the server does and holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Status {
    /// Of the server.
    pub version: String,
    /// Since it started.
    pub uptime: Duration,
    /// Whether the figures are those of all tenants (for administrators), or of the caller's only.
    pub all_tenants: bool,
    /// Requests that compute.
    pub running: u64,
    /// Requests that wait for it.
    pub queued: u64,
    /// How many may compute.
    pub running_limit: u64,
    /// How many may wait.
    pub queued_limit: u64,
    /// Open sessions.
    pub sessions: u64,
    /// Set-ups in memory.
    pub setups_resident: u64,
    /// Set-ups in the store.
    pub setups_stored: u64,
    /// Bytes in the store.
    pub stored_bytes: u64,
    /// Of set-ups.
    pub setup_cache: CacheStatus,
    /// Of linearisations.
    pub linearisation_cache: CacheStatus,
    /// Longest first.
    pub work: Vec<Work>,
}
