//! Options of a set-up, chosen once for a mesh.

use crate::OnDoubt;

/// Choices of a set-up.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Whether one half is solved for both halves.
    pub symmetry: Symmetry,
    /// Where wakes leave the surface.
    pub trailing_edges: TrailingEdges,
    /// Cell groups whose forces are reported one by one; `None`: all cell groups of the mesh.
    pub components: Option<Vec<String>>,
    /// How the linear system is solved.
    pub solver: Solver,
    /// Residual of the solution, relative to the right-hand side.
    pub tolerance: f64,
    /// What becomes of an answer that contradicts itself.
    pub on_doubt: OnDoubt,
    /// Limit on the memory of a solution, bytes.
    pub memory_limit: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            symmetry: Symmetry::Automatic,
            trailing_edges: TrailingEdges::Angle { degrees: 120.0 },
            components: None,
            solver: Solver::Automatic,
            tolerance: 1e-12,
            on_doubt: OnDoubt::Refuse,
            memory_limit: 4 << 30,
        }
    }
}

/// Use of the plane of symmetry y = 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Symmetry {
    /// [`Half`](Self::Half) if the mesh is open on y = 0 only, [`Mirror`](Self::Mirror) if it is its own mirror image, else
    /// [`None`](Self::None).
    Automatic,
    /// Every cell is solved; the flow may have sideslip.
    None,
    /// The mesh is one half, open on y = 0.
    Half,
    /// The mesh has both halves; one is solved, at the mean of both.
    Mirror,
}

/// How trailing edges are found.
#[derive(Clone, Debug, PartialEq)]
pub enum TrailingEdges {
    /// None: bodies without lift.
    None,
    /// Pairs of vertices.
    Edges(Vec<[u32; 2]>),
    /// Edges with both vertices in one of these vertex groups, between cells whose normals differ by 60 degrees or more.
    Groups(Vec<String>),
    /// Edges across which the outward normal turns by at least so much, and off both sides of which the flow runs.
    Angle {
        /// Degrees, between 60 and 180.
        degrees: f64,
    },
}

/// How the linear system is solved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Solver {
    /// [`Double`](Self::Double) up to 3,000 unknowns, [`Single`](Self::Single) up to 12,000, else [`Iterative`](Self::Iterative).
    Automatic,
    /// LU in double precision.
    Double,
    /// LU in single precision, refined in double precision.
    Single,
    /// GMRES, preconditioned with the exact factors of blocks of near panels.
    Iterative,
}
