//! Errors of set-ups and solutions: what is wrong, where, and the way out.

use moldline_foundation::{Class, Failure, Outside, short};
use moldline_mesh::MeshError;
use thiserror::Error;

use crate::{LeftOut, TrailingEdges, Warning};

/// How a rule finds trailing edges.
fn found_by(rule: &TrailingEdges) -> String {
    match rule {
        TrailingEdges::None => "by no rule".to_owned(),
        TrailingEdges::Angle { degrees } => {
            format!("where the surface turns by {degrees} degrees or more and the flow runs off both sides")
        }
        TrailingEdges::Groups(names) => format!("in the vertex groups {names:?}"),
        TrailingEdges::Edges(_) => "in the list of edges".to_owned(),
    }
}

/// The longest of the lines that were left out.
fn but_left_out(lines: &[LeftOut]) -> String {
    let Some(longest) = lines.iter().max_by(|one, two| one.line.length.total_cmp(&two.line.length)) else {
        return String::new();
    };
    format!(" (lines left out: {}; the longest: {}: {})", lines.len(), longest.line, longest.reason)
}

/// An error of the panel method.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PanelError {
    /// The mesh itself is not valid.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// An option names a group that the mesh does not have.
    #[error("options.{field} names `{name}`, which the mesh does not have; it has {known:?}")]
    UnknownGroup {
        /// Path of the field.
        field: String,
        /// The name given.
        name: String,
        /// The names there are.
        known: Vec<String>,
    },
    /// A number is out of its range, NaN or infinite.
    #[error("{field} = {} {}", short(*value), Outside { low: *low, high: *high })]
    OutOfRange {
        /// Path of the field.
        field: String,
        /// The value given.
        value: f64,
        /// Least value allowed.
        low: f64,
        /// Largest value allowed.
        high: f64,
    },
    /// A vector of another length than the set-up needs.
    #[error("{field} has {got} entries, the set-up needs {expected}")]
    Length {
        /// Path of the field.
        field: String,
        /// Entries given.
        got: usize,
        /// Entries needed.
        expected: usize,
    },
    /// The surface has a hole.
    #[error(
        "{count} edges have one cell only, the first is edge {edge:?} of cells[{cell}]; the panel method needs closed bodies \
         (or halves that end on the plane y = 0)"
    )]
    Open {
        /// How many.
        count: usize,
        /// Vertices of the first.
        edge: [u32; 2],
        /// Its cell.
        cell: u32,
    },
    /// Cracks between double vertices.
    #[error(
        "{count} open edges coincide pairwise, since their vertices are double (up to {distance:.1e} m apart), the first is edge {edge:?} at \
         {position:?} m; set `merge_tolerance` to a little more, such as {tolerance:e} m"
    )]
    Crack {
        /// How many edges.
        count: usize,
        /// Vertices of the first.
        edge: [u32; 2],
        /// Where it is, m.
        position: [f64; 3],
        /// Largest distance between double vertices, m.
        distance: f64,
        /// A tolerance that merges them, m.
        tolerance: f64,
    },
    /// Three cells or more at an edge.
    #[error("edge {edge:?} has {} cells: {cells:?}; a surface has two", cells.len())]
    NonManifold {
        /// Vertices of the edge.
        edge: [u32; 2],
        /// The cells at it.
        cells: Vec<u32>,
    },
    /// Neighbours with opposite orientations.
    #[error("cells {cells:?} run through edge {edge:?} in the same direction; orient all cells outwards")]
    Inconsistent {
        /// Vertices of the edge.
        edge: [u32; 2],
        /// The cells.
        cells: Vec<u32>,
    },
    /// A closed piece whose cells point inwards.
    #[error("the piece of cells[{cell}] encloses a volume of {volume} m^3; orient its cells outwards")]
    Inwards {
        /// A cell of the piece.
        cell: u32,
        /// The signed volume.
        volume: f64,
    },
    /// A cell without area, or folded onto itself.
    #[error("cells[{cell}] has an area of {area} m^2, which is nothing beside its edges")]
    ZeroArea {
        /// The cell.
        cell: u32,
        /// Its area.
        area: f64,
    },
    /// An edge without length.
    #[error("edge {edge:?} of cells[{cell}] has no length; write the cell as a triangle")]
    ZeroEdge {
        /// Its vertices.
        edge: [u32; 2],
        /// A cell at it.
        cell: u32,
    },
    /// The mesh is not symmetric about y = 0.
    #[error("the mesh is not symmetric about y = 0: {0}")]
    NotSymmetric(String),
    /// No edge is a trailing edge.
    #[error(
        "no trailing edge is found {}{}; name its edges or a vertex group of it, ask for another angle, or say that the body has no trailing \
         edges",
        found_by(rule),
        but_left_out(left_out)
    )]
    NoTrailingEdge {
        /// By which rule.
        rule: TrailingEdges,
        /// What looks like a trailing edge.
        left_out: Vec<LeftOut>,
    },
    /// A pair of vertices that is not an edge with two cells.
    #[error("trailing_edges[{index}] = {edge:?} is not an edge between two cells")]
    NotAnEdge {
        /// Position in the list.
        index: usize,
        /// The vertices given.
        edge: [u32; 2],
    },
    /// More than two trailing edges meet.
    #[error("{} trailing edges meet at vertex {vertex}: {edges:?}; a wake leaves a line", edges.len())]
    BranchedTrailingEdge {
        /// The vertex.
        vertex: u32,
        /// The edges at it.
        edges: Vec<[u32; 2]>,
    },
    /// The surface is smooth at a trailing edge.
    #[error(
        "trailing edge {edge:?} turns by {angle} degrees only, less than {least}; no wake leaves a smooth surface"
    )]
    BluntTrailingEdge {
        /// Its vertices.
        edge: [u32; 2],
        /// Angle between the normals of its cells.
        angle: f64,
        /// Least angle allowed.
        least: f64,
    },
    /// A wake that passes through a cell.
    #[error(
        "the wake of trailing edge {edge:?} meets cells[{cell}] at x = {x} m; move the surfaces apart (wakes run straight along x)"
    )]
    WakeCutsBody {
        /// Vertices of the trailing edge.
        edge: [u32; 2],
        /// The cell.
        cell: u32,
        /// Where.
        x: f64,
    },
    /// A wake root whose body has no way to its aft end.
    #[error("the wake that leaves the body at vertex {vertex} finds no path of edges to the body's aft end")]
    NoCarryOver {
        /// The vertex where the trailing edge meets the body.
        vertex: u32,
    },
    /// The neighbours of a cell do not span a plane.
    #[error(
        "cells[{cell}] has too few neighbours beside trailing edges for a surface gradient; refine there"
    )]
    Gradient {
        /// The cell.
        cell: u32,
    },
    /// The answer contradicts itself.
    #[error(
        "the answer is wrong: {}; check the mesh and its trailing edges, or ask for warnings instead (`on_doubt`)",
        .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
    )]
    Doubtful(Vec<Warning>),
    /// More memory than allowed.
    #[error("{unknowns} unknowns need {needed} bytes, the limit is {limit}; {advice}")]
    Memory {
        /// Number of unknowns.
        unknowns: usize,
        /// Bytes needed.
        needed: u64,
        /// Bytes allowed.
        limit: u64,
        /// The way out.
        advice: &'static str,
    },
    /// The flow at sideslip over a half model.
    #[error("sideslip = {sideslip} rad needs both halves; this set-up solves one half with a symmetry plane")]
    Sideslip {
        /// The angle given.
        sideslip: f64,
    },
    /// The influence of a panel is not a number: a collocation point lies on an edge.
    #[error(
        "the influence on cells[{cell}] is not finite; its centre lies on an edge of another cell, or cells overlap"
    )]
    Singular {
        /// The cell.
        cell: u32,
    },
    /// Refinement or iterations did not reach the tolerance.
    #[error(
        "the residual is {residual:e} after {rounds} rounds, above the tolerance {tolerance:e}; cells may overlap"
    )]
    NotConverged {
        /// Relative residual.
        residual: f64,
        /// Rounds made.
        rounds: usize,
        /// The tolerance.
        tolerance: f64,
    },
    /// Results beyond the range of double precision.
    #[error(
        "{what} would be infinite or not a number; reference values, directions or seeds are too large or too \
         small (products are linear in them, so scale them), or nothing depends on the angle of attack"
    )]
    Overflow {
        /// The part of the result.
        what: &'static str,
    },
    /// The monitor has cancelled the computation.
    #[error("cancelled")]
    Cancelled,
}

/// Paths in mesh and options, or in the arguments of an analysis.
impl Failure for PanelError {
    fn class(&self) -> Class {
        match self {
            // A valid mesh whose vertices have moved to where the method fails.
            Self::ZeroArea { .. }
            | Self::ZeroEdge { .. }
            | Self::WakeCutsBody { .. }
            | Self::Gradient { .. }
            | Self::Singular { .. }
            | Self::NotConverged { .. }
            | Self::Overflow { .. }
            | Self::Doubtful(_) => Class::Computation,
            Self::Memory { .. } => Class::Memory,
            Self::Cancelled => Class::Cancelled,
            _ => Class::Input,
        }
    }

    fn field(&self) -> Option<String> {
        Some(match self {
            Self::Mesh(error) => return error.field(),
            Self::Memory { .. } | Self::Overflow { .. } | Self::Cancelled => return None,
            Self::UnknownGroup { field, .. } => format!("options.{field}"),
            Self::OutOfRange { field, .. } | Self::Length { field, .. } => field.clone(),
            Self::Open { cell, .. } | Self::Inwards { cell, .. } => format!("cells[{cell}]"),
            Self::NonManifold { cells, .. } | Self::Inconsistent { cells, .. } => match cells.first() {
                Some(cell) => format!("cells[{cell}]"),
                None => "cells".to_owned(),
            },
            Self::Crack { edge, .. } => format!("vertices[{}]", edge[0]),
            Self::NotAnEdge { index, .. } => format!("options.trailing_edges[{index}]"),
            Self::NoTrailingEdge { .. }
            | Self::BranchedTrailingEdge { .. }
            | Self::BluntTrailingEdge { .. }
            | Self::NoCarryOver { .. } => "options.trailing_edges".to_owned(),
            Self::Sideslip { .. } => "sideslip".to_owned(),
            Self::NotSymmetric(_)
            | Self::ZeroArea { .. }
            | Self::ZeroEdge { .. }
            | Self::WakeCutsBody { .. }
            | Self::Gradient { .. }
            | Self::Singular { .. }
            | Self::NotConverged { .. }
            | Self::Doubtful(_) => "vertices".to_owned(),
        })
    }
}
