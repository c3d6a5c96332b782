//! How the patches of a component join: edges and vertices.

use crate::location::{Location, Side};
use crate::patch::Patch;

/// A piece of a patch's side as part of an edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeSide {
    /// Patch index.
    pub patch: u32,
    /// The side.
    pub side: Side,
    /// Parameter along the side at the edge's first and at its last vertex; decreasing if the edge runs against it.
    pub range: (f64, f64),
}

impl EdgeSide {
    /// The location at a fraction (0 to 1) of the piece.
    pub(crate) fn at(&self, patches: &[Patch], fraction: f64) -> Location {
        let t = self.range.0 + fraction * (self.range.1 - self.range.0);
        patches[self.patch as usize].on_side(self.patch, self.side, t)
    }

    /// Whether the edge runs counter-clockwise around the patch's parameter rectangle.
    pub(crate) fn counter_clockwise(&self) -> bool {
        (self.range.1 >= self.range.0) == self.side.counter_clockwise()
    }
}

/// A curve in which patches meet or end, or a side collapsed into a point.
#[derive(Debug, Clone, PartialEq)]
pub struct Edge {
    /// The one or two pieces of patch sides that lie on it.
    pub sides: Vec<EdgeSide>,
    /// First and last vertex.
    pub vertices: [u32; 2],
    /// The normals of its two sides differ by more than the component's sharp angle somewhere, or it is a boundary.
    pub sharp: bool,
    /// It has no length: a pole.
    pub collapsed: bool,
    /// Its two sides have the same points at the same fractions of their ranges.
    pub(crate) affine: bool,
}

impl Edge {
    /// A boundary of an open shell.
    pub fn is_boundary(&self) -> bool {
        self.sides.len() == 1 && !self.collapsed
    }

    /// Whether its two sides have the same points at the same fractions of their ranges.
    pub fn is_affine(&self) -> bool {
        self.affine
    }
}

/// The feature that a foot point at a vertex lies on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VertexKind {
    /// Every edge that ends here is smooth: an ordinary point of a face.
    Smooth,
    /// A sharp edge passes through without a kink: an ordinary point of that edge.
    OnEdge {
        /// One of the two sharp edges.
        edge: u32,
    },
    /// A pole, or sharp edges that meet at an angle.
    Corner,
}

/// The contact of a patch with a vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Incidence {
    /// A corner of its parameter rectangle.
    Corner {
        /// The corner.
        location: Location,
    },
    /// An inner point of a side.
    OnSide {
        /// The point.
        location: Location,
    },
    /// A whole side that is collapsed.
    Pole {
        /// The patch.
        patch: u32,
        /// Its side.
        side: Side,
    },
}

/// A point where edges end.
#[derive(Debug, Clone, PartialEq)]
pub struct Vertex {
    /// The feature that a foot point here lies on.
    pub kind: VertexKind,
    pub(crate) incidences: Vec<Incidence>,
}

impl Vertex {
    /// The contacts of patches with it.
    pub fn incidences(&self) -> &[Incidence] {
        &self.incidences
    }
}

/// A side's pieces in increasing order of the parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Piece {
    pub low: f64,
    pub high: f64,
    pub edge: u32,
    /// Index in the edge's `sides`.
    pub index: u8,
}

#[derive(Debug, Clone)]
pub(crate) struct Topology {
    pub edges: Vec<Edge>,
    pub vertices: Vec<Vertex>,
    /// Pieces by patch and side.
    pub pieces: Vec<[Vec<Piece>; 4]>,
    /// Whether a patch's `S_u x S_v` points inwards.
    pub flipped: Vec<bool>,
}
