//! Errors of set-ups and deformations: what is wrong, where, and the way out.

use std::fmt;

use moldline_foundation::{Class, Failure, Outside, short};
use moldline_geometry::ComponentError;
use moldline_mesh::{MeshError, symmetry::SymmetryError};
use moldline_parameterisation::{DesignError, ParameterisationError};
use moldline_rbf::RbfError;
use thiserror::Error;

use crate::Misfit;

/// Number of offending vertices that an error lists.
pub const LISTED: usize = 6;

/// A vertex with the length that is too large.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VertexDistance {
    /// Index of the vertex.
    pub vertex: u32,
    /// Metres.
    pub distance: f64,
}

fn list(offenders: &[VertexDistance]) -> String {
    offenders
        .iter()
        .map(|o| format!("vertices[{}]: {:.3e} m", o.vertex, o.distance))
        .collect::<Vec<_>>()
        .join(", ")
}

/// The constraint that holds a vertex.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Constraint {
    /// It stays where it is in space.
    Stationary,
    /// It keeps to a sharp edge, or to its place on the component.
    Protected,
}

impl fmt::Display for Constraint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Stationary => "stationary",
            Self::Protected => "protected",
        })
    }
}

/// Where control points come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The set-up, at its baseline.
    Setup,
    /// The design.
    Design,
    /// The caller gave them.
    Given,
}

/// Why control points do not fit the components of a set-up.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ControlPointsError {
    /// Another number of components.
    #[error("control_points has {found} components, the set-up has {expected}")]
    Components {
        /// How many there are.
        found: usize,
        /// How many the set-up has.
        expected: usize,
    },
    /// Another number of points.
    #[error("control_points[{component}] (`{name}`) has {found} points, its patches have {expected}")]
    Points {
        /// Index of the component.
        component: usize,
        /// Its name.
        name: String,
        /// How many points there are.
        found: usize,
        /// How many its patches have.
        expected: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("control_points[{component}][{point}][{axis}] = {value} is not finite")]
    NotFinite {
        /// Index of the component.
        component: usize,
        /// Index of the point.
        point: usize,
        /// x, y or z.
        axis: usize,
        /// The coordinate.
        value: f64,
    },
    /// A control point lies absurdly far outside.
    #[error(
        "control_points[{component}] (`{name}`): point {point} at {position:?} m is farther than {limit:.3e} m (1000 \
         reference lengths) from the middle of the mesh; {}",
        match moved_by {
            Source::Setup => "give the mesh and its components in the same unit and about the same origin",
            Source::Design => "take smaller values of the design variables that move this component",
            Source::Given => "check its unit (metres) and its origin",
        }
    )]
    Far {
        /// Index of the component.
        component: usize,
        /// Its name.
        name: String,
        /// Index of the point.
        point: usize,
        /// Where it is, m.
        position: [f64; 3],
        /// The largest distance allowed, m.
        limit: f64,
        /// What put it there.
        moved_by: Source,
    },
}

/// Why a set-up is refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SetupError {
    /// An option is out of its range.
    #[error("options.{field} = {} {}", short(*value), Outside { low: *low, high: *high })]
    Option {
        /// Path of the field.
        field: String,
        /// The value given.
        value: f64,
        /// Least value allowed.
        low: f64,
        /// Largest value allowed.
        high: f64,
    },
    /// An option names something that does not exist.
    #[error("options.{field} names `{name}`, which the set-up does not have; it has {known:?}")]
    UnknownName {
        /// Path of the field.
        field: String,
        /// The name given.
        name: String,
        /// The names that exist.
        known: Vec<String>,
    },
    /// No component at all.
    #[error("components: there are none")]
    NoComponents,
    /// Two components of one name.
    #[error("components: the name `{name}` is used twice")]
    DuplicateComponent {
        /// The name.
        name: String,
    },
    /// The parameterisation has no control points at its baseline.
    #[error("components: {0}")]
    Baseline(DesignError),
    /// The control points at the baseline do not fit the components.
    #[error("components: {0}")]
    ControlPoints(ControlPointsError),
    /// The components are far outside the mesh, for a reason that can be told.
    #[error("mesh: {misfit}. components: {error}")]
    Misfit {
        /// What is probably wrong.
        misfit: Misfit,
        /// A control point that is far outside.
        error: ControlPointsError,
    },
    /// A component is not a valid surface.
    #[error("components[{index}] (`{name}`): {source}")]
    Component {
        /// Index of the component.
        index: usize,
        /// Its name.
        name: String,
        /// What is wrong with it.
        source: ComponentError,
    },
    /// The mesh is not valid.
    #[error("mesh: {0}")]
    Mesh(#[from] MeshError),
    /// The parameterisation is not valid.
    #[error("parameterisation: {0}")]
    Parameterisation(#[from] ParameterisationError),
    /// Cells that are there twice.
    #[error(
        "mesh: {count} cells have the same corners as another one, the first are cells[{}] and cells[{}] at {position:?} m; \
         write every surface once (a shell or a group may have been exported twice)", first[0], first[1]
    )]
    RepeatedCells {
        /// How many cells.
        count: usize,
        /// The first one, and the cell that it repeats.
        first: [u32; 2],
        /// Where they are, m.
        position: [f64; 3],
    },
    /// The mesh has holes.
    #[error(
        "mesh: {count} edges have a cell on one side only, the first joins vertices[{}] and vertices[{}] at {position:?} m; \
         close the mesh, or set `open_mesh = true` if it is meant to be open", first[0], first[1]
    )]
    OpenMesh {
        /// How many edges.
        count: usize,
        /// The first one's vertices.
        first: [u32; 2],
        /// Where it is, m.
        position: [f64; 3],
    },
    /// The mesh has cracks between double vertices.
    #[error(
        "mesh: {edges} open edges coincide pairwise, since their vertices are double (up to {distance:.1e} m apart); the first \
         joins vertices[{}] and vertices[{}] at {position:?} m; set `merge_tolerance` of the mesh to a little more, such as \
         {tolerance:e} m (in the unit of the mesh)", first[0], first[1]
    )]
    DoubleVertices {
        /// How many edges.
        edges: usize,
        /// Largest distance between double vertices, m.
        distance: f64,
        /// A tolerance that merges them, m.
        tolerance: f64,
        /// The first edge's vertices.
        first: [u32; 2],
        /// Where it is, m.
        position: [f64; 3],
    },
    /// The border of a half model is not in the plane of symmetry.
    #[error(
        "mesh: the border of this half model ({count} edges) lies up to {distance:.3e} m off the plane of symmetry y = 0 (tolerance \
         {tolerance:.3e} m), farthest at vertices[{vertex}], {position:?} m; put the border on y = 0, or raise \
         `surface_tolerance`"
    )]
    BorderOffPlane {
        /// How many open edges.
        count: usize,
        /// The farthest vertex.
        vertex: u32,
        /// Where it is, m.
        position: [f64; 3],
        /// Its distance from the plane, m.
        distance: f64,
        /// The tolerance, m.
        tolerance: f64,
    },
    /// More than two cells meet at an edge.
    #[error(
        "mesh: {count} edges have more than two cells, the first joins vertices[{}] and vertices[{}] at {position:?} m; walls \
         inside the bodies, as boolean fragments leave them, have to go: fuse the bodies and mesh only their outer surface",
        first[0], first[1]
    )]
    NonManifold {
        /// How many edges.
        count: usize,
        /// The first one's vertices.
        first: [u32; 2],
        /// Where it is, m.
        position: [f64; 3],
    },
    /// Neighbours point to opposite sides.
    #[error(
        "mesh: neighbours point to opposite sides at {count} edges, the first are cells[{}] and cells[{}] at the edge of \
         vertices[{}] and vertices[{}], {position:?} m; orient the cells of each surface alike, outwards",
        cells[0], cells[1], first[0], first[1]
    )]
    MixedOrientation {
        /// How many edges.
        count: usize,
        /// The cells at the first one.
        cells: [u32; 2],
        /// Its vertices.
        first: [u32; 2],
        /// Where it is, m.
        position: [f64; 3],
    },
    /// Vertices of one component's mesh are inside another component.
    #[error(
        "mesh: {count} vertices of other components lie inside `{component}`, the deepest at {position:?} m: {}{}; the bodies pass \
         through each other untrimmed: fuse them (boolean union), so that the mesh ends where they meet",
        list(worst), if *count > worst.len() { ", ..." } else { "" }
    )]
    Inside {
        /// The component that they are in.
        component: String,
        /// How many vertices.
        count: usize,
        /// Where the deepest is, m.
        position: [f64; 3],
        /// The deepest ones with their depth, deepest first.
        worst: Vec<VertexDistance>,
    },
    /// Vertices that lie on no component.
    #[error(
        "mesh: {}{count} vertices are farther than {tolerance:.3e} m from every component: {}{}; put the mesh \
         on the components, or raise `surface_tolerance`",
        misfit.map_or_else(String::new, |misfit| format!("{misfit}. ")),
        list(worst), if *count > worst.len() { ", ..." } else { "" }
    )]
    OffSurface {
        /// How many vertices.
        count: usize,
        /// The tolerance, m.
        tolerance: f64,
        /// What is probably wrong, if the mesh as a whole does not fit.
        misfit: Option<Misfit>,
        /// The farthest ones, farthest first.
        worst: Vec<VertexDistance>,
    },
    /// Cells whose vertices have no component in common.
    #[error(
        "mesh: {count} cells have vertices on different components with no common one (no row of vertices follows the \
         seam there), the first are {}; remesh so that edges follow the seams",
        first.iter().map(|cell| format!("cells[{cell}]")).collect::<Vec<_>>().join(", ")
    )]
    CellAcrossSeam {
        /// How many cells.
        count: usize,
        /// Indices of the first few.
        first: Vec<u32>,
    },
    /// A component owns no cell.
    #[error(
        "components[{index}] (`{name}`) has no cell of the mesh on it; remove the component or mend the mesh"
    )]
    UnusedComponent {
        /// Index of the component.
        index: usize,
        /// Its name.
        name: String,
    },
    /// The mesh is not symmetric though the options say so.
    #[error("options.symmetric = true, but {0}")]
    NotSymmetric(SymmetryError),
    /// A seam vertex for which no search line crosses the other component.
    #[error(
        "mesh: seam vertex {vertex} on `{reference}` and `{target}`: no parametric line of either component crosses \
         the other (best transversality {transversality:.1e}); the components touch without crossing there"
    )]
    TangentSeam {
        /// Index of the vertex.
        vertex: u32,
        /// One component.
        reference: String,
        /// The other.
        target: String,
        /// |n . S_a| / |S_a| of the best line.
        transversality: f64,
    },
    /// A seam vertex that cannot follow its seam.
    #[error(
        "mesh: seam vertex {vertex} on `{reference}` and `{target}` is held on `{holder}` (a corner or pole of it, or a \
         protected group), so that it cannot follow the seam; take it out of `protected_groups`, or let the seam pass \
         beside the corner"
    )]
    HeldSeam {
        /// Index of the vertex.
        vertex: u32,
        /// One component.
        reference: String,
        /// The other.
        target: String,
        /// The component that it is held on.
        holder: String,
    },
    /// The search line ends at the seam.
    #[error(
        "mesh: seam vertex {vertex}: the search line on `{reference}` to `{target}` ends at the vertex, so that the seam \
         could not move that way; let `{reference}` go on beyond the seam"
    )]
    SeamAtEnd {
        /// Index of the vertex.
        vertex: u32,
        /// The component that carries the line.
        reference: String,
        /// The component to be met.
        target: String,
    },
    /// The search line does not change sides at the seam.
    #[error(
        "mesh: seam vertex {vertex}: the search line on `{reference}` crosses `{target}` at an angle (sine \
         {transversality:.1e}), but lies {} it both {near:.1e} m before and behind the vertex: `{target}` is thinner or \
         more strongly curved than that there; make it thicker, or leave it out",
        if *inside { "inside" } else { "outside" }
    )]
    SeamSides {
        /// Index of the vertex.
        vertex: u32,
        /// The component that carries the line.
        reference: String,
        /// The component to be met.
        target: String,
        /// |n . S_a| / |S_a| of the line.
        transversality: f64,
        /// Distance of the points from the vertex, m.
        near: f64,
        /// Whether it is inside the target on both sides.
        inside: bool,
    },
    /// The seam search does not reproduce the reference mesh.
    #[error("the reference seams cannot be reproduced: {0}")]
    ReferenceSeam(Box<DeformError>),
    /// Cells pass through each other all over the mesh.
    #[error(
        "mesh: more than {limit} pairs of cells pass through each other, the first, cells[{}] and cells[{}], at {position:.4?} m; \
         fuse the bodies and remesh", cells[0], cells[1]
    )]
    Crossings {
        /// As many pairs are accepted.
        limit: usize,
        /// The first pair.
        cells: [u32; 2],
        /// Where its first vertex is, m.
        position: [f64; 3],
    },
    /// The radial basis system cannot be factorised.
    #[error("radial basis functions of {field}: {reason}")]
    Factorisation {
        /// Which field.
        field: String,
        /// What is wrong.
        reason: RbfError,
    },
    /// An output is declared wrongly.
    #[error("output `{name}`: {reason}")]
    Output {
        /// Its name.
        name: String,
        /// What is wrong.
        reason: String,
    },
    /// The caller has cancelled.
    #[error("cancelled")]
    Cancelled,
}

/// Why a deformation fails.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum DeformError {
    /// The design is not acceptable.
    #[error(transparent)]
    Design(#[from] DesignError),
    /// Control points given from outside do not fit the set-up.
    #[error(transparent)]
    ControlPoints(#[from] ControlPointsError),
    /// Seam vertices without a root on their line.
    #[error(
        "the seam of `{reference}` with `{target}` left its brackets at {count} vertices ({}{}); the lines are \
         followed to the end of the component, so the components no longer cross there: take a smaller step, or \
         set up again from a mesh of this shape", list(worst), if *count > worst.len() { ", ..." } else { "" }
    )]
    SeamLost {
        /// Component that is followed.
        reference: String,
        /// Component that is to be met.
        target: String,
        /// How many vertices.
        count: usize,
        /// The first ones, with their distance to the target where the search ended.
        worst: Vec<VertexDistance>,
    },
    /// A held vertex is off its component.
    #[error(
        "{count} {constraint} vertices are farther than {tolerance:.1e} m from their components ({}{}): the components have \
         moved away from them; hold only what stays on its component (and keep the components symmetric where the \
         mesh is)", list(worst), if *count > worst.len() { ", ..." } else { "" }
    )]
    Held {
        /// The constraint that holds them.
        constraint: Constraint,
        /// How many vertices.
        count: usize,
        /// The tolerance, m.
        tolerance: f64,
        /// The first ones, with their distance.
        worst: Vec<VertexDistance>,
    },
    /// The projection did not converge.
    #[error(
        "the projection onto the smooth outer mold line left {count} vertices off it after {steps} steps ({}{}); \
         reduce the fillet, take a smaller step, or raise `projection_steps`",
        list(worst), if *count > worst.len() { ", ..." } else { "" }
    )]
    NotProjected {
        /// How many vertices.
        count: usize,
        /// Steps taken.
        steps: usize,
        /// The worst ones with |Phi|.
        worst: Vec<VertexDistance>,
    },
    /// Vertices without a foot point on their component.
    #[error(
        "{count} vertices of `{component}` could not be put back onto it ({}{}); take a smaller step", list(worst),
        if *count > worst.len() { ", ..." } else { "" }
    )]
    FootPoint {
        /// The component.
        component: String,
        /// How many vertices.
        count: usize,
        /// The first ones, with their last distance.
        worst: Vec<VertexDistance>,
    },
    /// Cells pass through each other.
    #[error(
        "{count} pairs of cells pass through each other, and did not in the set-up's mesh; the first at {position:.4?} m: {} \
         (vertices {vertices:?}); take a smaller step, or set `on_event` to `report` or `ignore`",
        match (cells, components) {
            ([one, two], _) if one == two => format!("cells[{one}] and its mirror image"),
            ([one, two], [a, b]) if a == b => format!("cells[{one}] and cells[{two}] of `{a}`"),
            ([one, two], [a, b]) => format!("cells[{one}] of `{a}` and cells[{two}] of `{b}`"),
        }
    )]
    Collision {
        /// How many pairs, at most 1000.
        count: usize,
        /// The first pair; a cell and its mirror image have one index.
        cells: [u32; 2],
        /// The components on which they lie.
        components: [String; 2],
        /// Their vertices.
        vertices: Vec<u32>,
        /// Where the first vertex is, m.
        position: [f64; 3],
    },
    /// A seed of the adjoint does not fit the set-up.
    #[error("seeds[{index}] has {found} {what}, the set-up has {expected}")]
    SeedSize {
        /// Which seed.
        index: usize,
        /// Vertices or functions.
        what: &'static str,
        /// How many it has.
        found: usize,
        /// How many the set-up has.
        expected: usize,
    },
    /// The caller has cancelled.
    #[error("cancelled")]
    Cancelled,
}

impl Failure for SetupError {
    fn class(&self) -> Class {
        match self {
            Self::Cancelled => Class::Cancelled,
            _ => Class::Input,
        }
    }

    fn field(&self) -> Option<String> {
        Some(match self {
            Self::Cancelled => return None,
            Self::Option { field, .. } | Self::UnknownName { field, .. } => format!("options.{field}"),
            Self::NotSymmetric(_) => "options.symmetric".to_owned(),
            Self::NoComponents
            | Self::DuplicateComponent { .. }
            | Self::Baseline(_)
            | Self::ControlPoints(_) => "components".to_owned(),
            Self::Component { index, .. } | Self::UnusedComponent { index, .. } => {
                format!("components[{index}]")
            }
            Self::Parameterisation(error) => return error.field(),
            Self::Factorisation { field, .. } => field.clone(),
            Self::Output { name, .. } => format!("outputs[\"{name}\"]"),
            Self::Mesh(error) => return error.field().map(|field| format!("mesh.{field}")),
            Self::OffSurface { worst, .. } => match worst.first() {
                Some(worst) => format!("mesh.vertices[{}]", worst.vertex),
                None => "mesh.vertices".to_owned(),
            },
            Self::CellAcrossSeam { first, .. } => match first.first() {
                Some(cell) => format!("mesh.cells[{cell}]"),
                None => "mesh.cells".to_owned(),
            },
            Self::TangentSeam { vertex, .. }
            | Self::HeldSeam { vertex, .. }
            | Self::SeamAtEnd { vertex, .. }
            | Self::SeamSides { vertex, .. } => format!("mesh.vertices[{vertex}]"),
            Self::Inside { worst, .. } => match worst.first() {
                Some(worst) => format!("mesh.vertices[{}]", worst.vertex),
                None => "mesh.vertices".to_owned(),
            },
            Self::BorderOffPlane { vertex, .. } => format!("mesh.vertices[{vertex}]"),
            Self::RepeatedCells { first: cells, .. }
            | Self::MixedOrientation { cells, .. }
            | Self::Crossings { cells, .. } => {
                format!("mesh.cells[{}]", cells[1])
            }
            Self::DoubleVertices { .. } => "mesh.merge_tolerance".to_owned(),
            Self::Misfit { .. } => "mesh".to_owned(),
            Self::OpenMesh { .. } | Self::NonManifold { .. } | Self::ReferenceSeam(_) => "mesh".to_owned(),
        })
    }
}

impl Failure for DeformError {
    fn class(&self) -> Class {
        match self {
            Self::Design(_) | Self::ControlPoints(_) | Self::SeedSize { .. } => Class::Input,
            Self::SeamLost { .. }
            | Self::NotProjected { .. }
            | Self::Held { .. }
            | Self::FootPoint { .. }
            | Self::Collision { .. } => Class::Computation,
            Self::Cancelled => Class::Cancelled,
        }
    }

    fn field(&self) -> Option<String> {
        Some(match self {
            Self::Design(error) => return error.field(),
            Self::Cancelled => return None,
            Self::ControlPoints(ControlPointsError::Far { moved_by: Source::Design, .. }) => {
                "design".to_owned()
            }
            Self::ControlPoints(ControlPointsError::Far { component, .. }) => {
                format!("control_points[{component}]")
            }
            Self::ControlPoints(_) => "control_points".to_owned(),
            Self::SeamLost { .. }
            | Self::NotProjected { .. }
            | Self::Held { .. }
            | Self::FootPoint { .. }
            | Self::Collision { .. } => "design".to_owned(),
            Self::SeedSize { index, what, .. } => format!("{what}[{index}]"),
        })
    }
}
