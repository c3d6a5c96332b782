//! Data model of the mesh service: arguments and results.

use std::{
    collections::BTreeMap,
    ops::AddAssign,
    time::{Duration, SystemTime},
};

/// x, y and z of a vertex or a control point, metres; or a derivative with respect to it, per metre.
pub type Point = [f64; 3];

/// Control points by component, patch after patch, the second parameter fastest.
pub type ControlPoints = BTreeMap<String, Vec<Point>>;

/// Progress of a long call.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// Name of the stage: of a set-up, `receive`, `read`, `queue`, then the engine's stages; of a Jacobian, `jacobian`.
    pub stage: String,
    /// Fraction of the stage that is done, 0 to 1.
    pub fraction: f64,
    /// Description for display.
    pub message: String,
}

/// One scalar design variable.
#[derive(Clone, Debug, PartialEq)]
pub struct Variable {
    /// Such as `wing.twist[3]`.
    pub name: String,
    /// Unit of its values and bounds, such as `m` or `deg`.
    pub unit: String,
    /// Value at the reference geometry.
    pub baseline: f64,
    /// Lower bound; may be infinite.
    pub lower: f64,
    /// Upper bound; may be infinite.
    pub upper: f64,
}

/// Variables that were declared together.
#[derive(Clone, Debug, PartialEq)]
pub struct VariableGroup {
    /// Name as declared.
    pub name: String,
    /// Index of the first variable in a design; the others follow, the last axis of `shape` fastest.
    pub first: usize,
    /// Shape of the group; empty for a scalar.
    pub shape: Vec<usize>,
}

/// A scalar output besides the vertices.
#[derive(Clone, Debug, PartialEq)]
pub struct Function {
    /// Such as `wing.wetted_area`.
    pub name: String,
    /// Such as `m^2`.
    pub unit: String,
    /// Value for the reference mesh.
    pub value: f64,
}

/// Who may use a set-up besides its owner.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Visibility {
    /// Nobody.
    #[default]
    Private,
    /// Named tenants.
    Tenants,
    /// Every tenant of the server.
    Public,
}

/// Access of the caller, and of others, to a set-up.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SetupAccess {
    /// Whether the caller has uploaded it.
    pub owned: bool,
    /// For the owner, the chosen visibility; for others, the one that gives them access: `Tenants` or `Public`.
    pub visibility: Visibility,
    /// Names of tenants; shown to the owner only.
    pub shared_with: Vec<String>,
}

/// Description of a set-up.
#[derive(Clone, Debug, PartialEq)]
pub struct SetupFacts {
    /// Hash of its content.
    pub id: String,
    /// Whether the call that returned this created the set-up for the caller.
    pub built: bool,
    /// Title given by its author.
    pub name: String,
    /// Who may use it.
    pub access: SetupAccess,
    /// Report of the build, as text.
    pub report_text: String,
    /// Report of the build, as a JSON document.
    pub report_json: String,
    /// Design variables, in the order of a design's entries.
    pub variables: Vec<Variable>,
    /// Groups of variables, as declared.
    pub groups: Vec<VariableGroup>,
    /// Names of the components.
    pub components: Vec<String>,
    /// Number of control points of each component.
    pub control_point_counts: Vec<usize>,
    /// The scalar outputs besides the vertices.
    pub functions: Vec<Function>,
    /// Number of vertices of the mesh.
    pub vertex_count: usize,
    /// Number of cells of the mesh.
    pub cell_count: usize,
    /// Cells of closed pieces that pointed inwards and were turned.
    pub turned_cell_count: usize,
    /// Parts of the mesh file that are not in the mesh.
    pub left_out: LeftOut,
    /// Time that the engine took to build it.
    pub build_time: Duration,
}

/// Parts of a mesh file that are not in the mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LeftOut {
    /// Nodes that no triangle or quadrilateral uses.
    pub nodes: usize,
    /// Nodes that were merged into others.
    pub merged_nodes: usize,
    /// Cells other than triangles and quadrilaterals.
    pub other_cells: usize,
    /// Cells that collapsed when nodes were merged.
    pub collapsed_cells: usize,
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
    /// Title given by its author.
    pub name: String,
    /// Number of vertices of the mesh.
    pub vertex_count: usize,
    /// Number of cells of the mesh.
    pub cell_count: usize,
    /// Number of design variables.
    pub variable_count: usize,
    /// Time of the first upload.
    pub created: SystemTime,
    /// Who may use it.
    pub access: SetupAccess,
}

/// A surface mesh of triangles and quadrilaterals.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// Vertices, metres.
    pub vertices: Vec<Point>,
    /// Vertices of each cell, counter-clockwise from outside; a triangle's fourth is [`Mesh::NO_VERTEX`].
    pub cells: Vec<[u32; 4]>,
    /// Index of the component that owns each cell.
    pub cell_owner: Vec<u32>,
    /// Whether each vertex lies on a seam of two components.
    pub seam: Vec<bool>,
}

impl Mesh {
    /// Fourth vertex of a triangle.
    pub const NO_VERTEX: u32 = u32::MAX;
}

/// Values of the design variables.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Design {
    /// Values of the reference geometry.
    #[default]
    Baseline,
    /// All in order, each in its variable's unit.
    Vector(Vec<f64>),
    /// By name; all others stay at their baseline.
    Named(BTreeMap<String, f64>),
}

impl Design {
    /// A design by names.
    pub fn named<'a>(values: impl IntoIterator<Item = (&'a str, f64)>) -> Self {
        Self::Named(values.into_iter().map(|(name, value)| (name.to_owned(), value)).collect())
    }
}

/// A design, and external control points that replace those of their components.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DesignPoint {
    /// Values of the design variables.
    pub design: Design,
    /// External control points by component, metres.
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

/// Stored state of a session.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionState {
    /// Id of the session.
    pub id: String,
    /// Id of its set-up.
    pub setup_id: String,
    /// Grows by one with each update.
    pub generation: u64,
    /// The design stored last: all variables in order, and external control points. Absent in lists.
    pub design: Option<DesignPoint>,
    /// Descriptive label.
    pub label: String,
    /// Time of opening.
    pub created: SystemTime,
    /// Time of the last update.
    pub updated: SystemTime,
}

/// Update of a session; absent fields stay unchanged.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SessionUpdate {
    /// The new design.
    pub design: Option<DesignPoint>,
    /// The new label.
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

/// Quality measures of a set of cells.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct QualitySummary {
    /// Number of cells.
    pub cells: usize,
    /// Verdict's aspect ratio.
    pub aspect_ratio: Distribution,
    /// Longest over shortest edge.
    pub edge_ratio: Distribution,
    /// Smallest scaled Jacobian with respect to the owner surface's current normal; 1 at best, negative where a corner is
    /// inverted.
    pub min_scaled_jacobian: f64,
    /// Smallest interior angle, degrees.
    pub min_angle: f64,
    /// Largest interior angle, degrees.
    pub max_angle: f64,
    /// 95th percentile of the equiangle skew, 0 at best.
    pub skew_p95: f64,
    /// Largest equiangle skew.
    pub skew_max: f64,
    /// Cells whose area vector points against their owner's normal.
    pub folded: usize,
    /// Cells with a corner whose normal points against their owner's normal.
    pub inverted: usize,
}

/// Quality measures of all cells, and of the cells of each component.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct QualityReport {
    /// All cells.
    pub total: QualitySummary,
    /// Cells of each component, by name.
    pub components: BTreeMap<String, QualitySummary>,
}

/// Quality measures of every cell.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CellQuality {
    /// Verdict's aspect ratio.
    pub aspect_ratio: Vec<f64>,
    /// Longest over shortest edge.
    pub edge_ratio: Vec<f64>,
    /// Scaled Jacobian with respect to the owner surface's current normal.
    pub scaled_jacobian: Vec<f64>,
    /// Equiangle skew.
    pub skew: Vec<f64>,
}

/// Residuals of the constraints on a deformed mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Residuals {
    /// Largest distance of a seam vertex from one of its components before the smooth projection, metres.
    pub seam: f64,
    /// Largest distance of a protected or stationary vertex from a component that it lies on, metres.
    pub held: f64,
    /// Largest final |Phi| of an active vertex, metres; 0 for a sharp outer mold line.
    pub projection: f64,
    /// Largest number of projection steps of a vertex.
    pub projection_steps: u32,
    /// Pairs of cells that pass through each other and did not in the set-up's mesh, at most 1000 (option `on_event`).
    pub crossing_pairs: u32,
}

/// Time that requests took on the server.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timings {
    /// Time in the queue.
    pub queue: Duration,
    /// Time in the engine.
    pub engine: Duration,
}

impl AddAssign for Timings {
    fn add_assign(&mut self, other: Self) {
        self.queue += other.queue;
        self.engine += other.engine;
    }
}

/// Point of linearisation: the id of a linearisation on the server, and the design to recompute it from.
#[derive(Clone, Debug, PartialEq)]
pub struct Linearisation {
    /// Determined by set-up and design: the same on every server.
    pub id: String,
    /// The requested design.
    pub point: DesignPoint,
}

/// A deformed mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct Deformation {
    /// Vertices in the order of the set-up's mesh, metres.
    pub vertices: Vec<Point>,
    /// Scalar outputs in the set-up's order, each in its unit.
    pub functions: Vec<f64>,
    /// For derivatives at this design.
    pub linearisation: Linearisation,
    /// Quality of the deformed mesh.
    pub quality: QualityReport,
    /// Quality of every cell, if requested.
    pub cell_quality: Option<CellQuality>,
    /// Residuals of the constraints.
    pub residuals: Residuals,
    /// Time in the engine and in its queue.
    pub timings: Timings,
}

/// Point of linearisation: a deformation, which is best since the server holds its linearisation, or a design.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum At {
    /// A linearisation that the server may hold, with the design to recompute it from.
    Linearisation(Linearisation),
    /// A design; the baseline by default.
    Point(DesignPoint),
    /// The id of a linearisation alone; `NotFound` if the server no longer holds it.
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

/// k directions of the inputs; empty blocks are zero.
#[derive(Clone, Debug, PartialEq)]
pub struct Directions {
    /// Number of directions or sums, k.
    pub count: usize,
    /// (k, number of variables), the last axis fastest, each entry in its variable's unit.
    pub design: Vec<f64>,
    /// By component: (k, number of its control points), metres, in addition to the effect of `design` on them.
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
    /// Number of directions or sums, k.
    pub count: usize,
    /// (k, number of vertices), metres.
    pub vertices: Vec<Point>,
    /// (k, number of functions), each in its unit.
    pub functions: Vec<f64>,
    /// Total of all requests.
    pub timings: Timings,
}

/// Weights of k sums of the outputs (empty blocks are zero), and the inputs that their gradients are taken with respect to.
#[derive(Clone, Debug, PartialEq)]
pub struct Seeds {
    /// Number of directions or sums, k.
    pub count: usize,
    /// (k, number of vertices): weights of the vertices' coordinates, such as the gradient of an objective with respect to
    /// them.
    pub vertices: Vec<Point>,
    /// (k, number of functions): weights of the functions.
    pub functions: Vec<f64>,
    /// Whether to take gradients with respect to the design variables.
    pub by_design: bool,
    /// Components whose control points to take gradients with respect to.
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
    /// Number of directions or sums, k.
    pub count: usize,
    /// (k, number of variables), per unit of the variable; empty if not requested.
    pub design: Vec<f64>,
    /// By requested component: (k, number of its control points), per metre.
    pub control_points: ControlPoints,
    /// Total of all requests.
    pub timings: Timings,
}

/// Derivatives of all outputs with respect to all design variables.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Jacobian {
    /// (number of variables, number of vertices), metres per unit of the variable.
    pub vertices: Vec<Point>,
    /// (number of variables, number of functions).
    pub functions: Vec<f64>,
    /// Time in the engine and in its queue.
    pub timings: Timings,
}

/// Usage of a cache of the server.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CacheStatus {
    /// Number of entries.
    pub entries: u64,
    /// Bytes in use.
    pub bytes: u64,
    /// Budget in bytes, of all tenants together.
    pub budget_bytes: u64,
    /// Hits since the start of the server; 0 unless the caller is an administrator.
    pub hits: u64,
    /// Misses, likewise.
    pub misses: u64,
    /// Evictions, likewise.
    pub evictions: u64,
}

/// A request that is computing or queued.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Work {
    /// Kind, such as `build`, `deform`, `jvp`, `vjp`, `jacobian`.
    pub kind: String,
    /// Tenant of the caller.
    pub tenant: String,
    /// Id of its set-up; empty if it has none (yet).
    pub setup_id: String,
    /// Id of its session; empty if it has none.
    pub session_id: String,
    /// Whether it is computing; otherwise it is queued.
    pub running: bool,
    /// Time since its arrival.
    pub age: Duration,
    /// Time since its computation began.
    pub running_for: Duration,
    /// Name of the current stage, where known.
    pub stage: String,
    /// Fraction of the stage that is done.
    pub fraction: f64,
}

/// Load, caches and store of a server.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Status {
    /// Version of the server.
    pub version: String,
    /// Time since its start.
    pub uptime: Duration,
    /// Whether the figures cover all tenants (for administrators), or the caller's only.
    pub all_tenants: bool,
    /// Requests that are computing.
    pub running: u64,
    /// Requests in the queue.
    pub queued: u64,
    /// Largest number of computing requests.
    pub running_limit: u64,
    /// Largest length of the queue.
    pub queued_limit: u64,
    /// Open sessions.
    pub sessions: u64,
    /// Set-ups in memory.
    pub setups_resident: u64,
    /// Set-ups in the store.
    pub setups_stored: u64,
    /// Bytes in the store.
    pub stored_bytes: u64,
    /// Cache of set-ups.
    pub setup_cache: CacheStatus,
    /// Cache of linearisations.
    pub linearisation_cache: CacheStatus,
    /// Requests that are computing or queued, oldest first.
    pub work: Vec<Work>,
}
