//! Cells, groups and the validated surface mesh.

use moldline_foundation::Failure;
use thiserror::Error;

/// Marks the missing fourth vertex of a triangle.
const NONE: u32 = u32::MAX;

/// A triangle or a quadrilateral: indices of its vertices, counter-clockwise seen from outside.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Cell([u32; 4]);

impl Cell {
    /// The triangle `a b c`.
    pub const fn triangle(a: u32, b: u32, c: u32) -> Self {
        Self([a, b, c, NONE])
    }

    /// The quadrilateral `a b c d`.
    pub const fn quad(a: u32, b: u32, c: u32, d: u32) -> Self {
        Self([a, b, c, d])
    }

    /// The vertices in order, three or four.
    pub fn vertices(&self) -> &[u32] {
        if self.is_triangle() { &self.0[..3] } else { &self.0 }
    }

    /// True for three vertices.
    pub const fn is_triangle(&self) -> bool {
        self.0[3] == NONE
    }

    /// The directed edges in order: `[v_0, v_1]`, `[v_1, v_2]`, ..., back to `v_0`.
    pub fn edges(&self) -> impl ExactSizeIterator<Item = [u32; 2]> + '_ {
        let vertices = self.vertices();
        (0..vertices.len()).map(move |k| [vertices[k], vertices[(k + 1) % vertices.len()]])
    }

    /// The same cell seen from its other side; its first vertex stays first.
    pub const fn flipped(&self) -> Self {
        let [a, b, c, d] = self.0;
        if self.is_triangle() { Self([a, c, b, NONE]) } else { Self([a, d, c, b]) }
    }

    /// The cell with each vertex `v` replaced by `map(v)`.
    pub fn map(&self, mut map: impl FnMut(u32) -> u32) -> Self {
        let [a, b, c, d] = self.0;
        Self([map(a), map(b), map(c), if self.is_triangle() { NONE } else { map(d) }])
    }
}

impl std::fmt::Debug for Cell {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.vertices().fmt(f)
    }
}

/// A named set of cells or of vertices. Names serve the user's constraints; which component a cell belongs to is
/// never taken from them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Group {
    /// The user's name, unique among the groups of its kind.
    pub name: String,
    /// Cells or vertices, increasing.
    pub indices: Vec<u32>,
}

/// Limits on a mesh, so that a request cannot exhaust the machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Number of vertices.
    pub vertices: usize,
    /// Number of cells.
    pub cells: usize,
    /// Number of cell groups, and of vertex groups.
    pub groups: usize,
    /// Bytes of a group's name.
    pub name: usize,
    /// Absolute value of a coordinate.
    pub coordinate: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { vertices: 20_000_000, cells: 20_000_000, groups: 10_000, name: 256, coordinate: 1e12 }
    }
}

/// Why a surface mesh is rejected.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum MeshError {
    /// No vertices or no cells.
    #[error("the mesh has no {what}")]
    Empty {
        /// `vertices` or `cells`.
        what: &'static str,
    },
    /// More than the limits allow.
    #[error("{count} {what} are more than the limit of {limit}; raise the limit or send a coarser mesh")]
    TooMany {
        /// What is counted.
        what: &'static str,
        /// Their number.
        count: usize,
        /// Largest number allowed.
        limit: usize,
    },
    /// A coordinate is NaN, infinite or larger than the limit.
    #[error("vertices[{vertex}][{axis}] = {value} is not a finite number within +-{limit}")]
    Coordinate {
        /// Index of the vertex.
        vertex: usize,
        /// 0, 1, 2 for x, y, z.
        axis: usize,
        /// The value found.
        value: f64,
        /// Largest absolute value allowed.
        limit: f64,
    },
    /// A cell names a vertex that does not exist.
    #[error("cells[{cell}][{corner}] = {vertex} is outside 0..{count}")]
    VertexOutOfRange {
        /// Index of the cell.
        cell: usize,
        /// Position within the cell.
        corner: usize,
        /// The vertex named.
        vertex: u32,
        /// Number of vertices.
        count: usize,
    },
    /// A cell names one vertex twice.
    #[error(
        "cells[{cell}] = {vertices:?} names vertex {vertex} more than once; a collapsed quad is written as a triangle"
    )]
    RepeatedVertex {
        /// Index of the cell.
        cell: usize,
        /// The vertex named twice.
        vertex: u32,
        /// All vertices of the cell.
        vertices: Cell,
    },
    /// Vertices that belong to no cell.
    #[error("{count} vertices belong to no cell, the first is vertices[{first}]; remove them")]
    UnusedVertices {
        /// Number of such vertices.
        count: usize,
        /// Index of the first.
        first: usize,
    },
    /// The name of a group is too long.
    #[error(
        "the name of a {kind} group has {length} bytes, more than the limit of {limit}; it begins with `{start}`"
    )]
    LongName {
        /// `cell` or `vertex`.
        kind: &'static str,
        /// Its first characters.
        start: String,
        /// Its length, bytes.
        length: usize,
        /// Largest length allowed.
        limit: usize,
    },
    /// A group names a cell or vertex that does not exist.
    #[error("{kind} group `{group}`: indices[{position}] = {index} is outside 0..{count}")]
    GroupIndexOutOfRange {
        /// `cell` or `vertex`.
        kind: &'static str,
        /// Name of the group.
        group: String,
        /// Position within the group.
        position: usize,
        /// The index found.
        index: u32,
        /// Number of cells or vertices.
        count: usize,
    },
    /// Two groups of the same kind and name.
    #[error("there are two {kind} groups named `{group}`; merge or rename them")]
    DuplicateGroup {
        /// `cell` or `vertex`.
        kind: &'static str,
        /// The name.
        group: String,
    },
}

impl Failure for MeshError {
    fn field(&self) -> Option<String> {
        Some(match self {
            Self::Empty { what } | Self::TooMany { what, .. } => what.replace(' ', "_"),
            Self::Coordinate { vertex, axis, .. } => format!("vertices[{vertex}][{axis}]"),
            Self::VertexOutOfRange { cell, corner, .. } => format!("cells[{cell}][{corner}]"),
            Self::RepeatedVertex { cell, .. } => format!("cells[{cell}]"),
            Self::UnusedVertices { first, .. } => format!("vertices[{first}]"),
            Self::GroupIndexOutOfRange { kind, .. }
            | Self::DuplicateGroup { kind, .. }
            | Self::LongName { kind, .. } => format!("{kind}_groups"),
        })
    }
}

/// A surface mesh whose indices and coordinates have been checked.
///
/// The fields are public for reading and for moving vertices; [`SurfaceMesh::validate`] repeats the checks.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceMesh {
    /// Positions.
    pub vertices: Vec<[f64; 3]>,
    /// Triangles and quadrilaterals, mixed in any order.
    pub cells: Vec<Cell>,
    /// Named sets of cells.
    pub cell_groups: Vec<Group>,
    /// Named sets of vertices.
    pub vertex_groups: Vec<Group>,
}

impl SurfaceMesh {
    /// A mesh within the default [`Limits`].
    ///
    /// # Errors
    /// The first fault found, see [`MeshError`].
    pub fn new(
        vertices: Vec<[f64; 3]>,
        cells: Vec<Cell>,
        cell_groups: Vec<Group>,
        vertex_groups: Vec<Group>,
    ) -> Result<Self, MeshError> {
        Self::with_limits(vertices, cells, cell_groups, vertex_groups, &Limits::default())
    }

    /// A mesh within the given limits.
    ///
    /// # Errors
    /// The first fault found, see [`MeshError`].
    pub fn with_limits(
        vertices: Vec<[f64; 3]>,
        cells: Vec<Cell>,
        cell_groups: Vec<Group>,
        vertex_groups: Vec<Group>,
        limits: &Limits,
    ) -> Result<Self, MeshError> {
        let mesh = Self { vertices, cells, cell_groups, vertex_groups };
        mesh.validate(limits)?;
        Ok(mesh)
    }

    /// Checks counts, coordinates, indices, and that each vertex is used.
    ///
    /// # Errors
    /// The first fault found, see [`MeshError`].
    pub fn validate(&self, limits: &Limits) -> Result<(), MeshError> {
        check_count("vertices", self.vertices.len(), limits.vertices)?;
        check_count("cells", self.cells.len(), limits.cells)?;
        for (vertex, position) in self.vertices.iter().enumerate() {
            for (axis, &value) in position.iter().enumerate() {
                // False for NaN, too.
                let within = value.abs() <= limits.coordinate;
                if !within {
                    return Err(MeshError::Coordinate { vertex, axis, value, limit: limits.coordinate });
                }
            }
        }
        let mut used = vec![false; self.vertices.len()];
        for (cell, &vertices) in self.cells.iter().enumerate() {
            let indices = vertices.vertices();
            for (corner, &vertex) in indices.iter().enumerate() {
                match used.get_mut(vertex as usize) {
                    Some(used) => *used = true,
                    None => {
                        let count = self.vertices.len();
                        return Err(MeshError::VertexOutOfRange { cell, corner, vertex, count });
                    }
                }
                if indices[..corner].contains(&vertex) {
                    return Err(MeshError::RepeatedVertex { cell, vertex, vertices });
                }
            }
        }
        if let Some(first) = used.iter().position(|used| !used) {
            let count = used.iter().filter(|used| !**used).count();
            return Err(MeshError::UnusedVertices { count, first });
        }
        check_groups("cell", &self.cell_groups, self.cells.len(), limits)?;
        check_groups("vertex", &self.vertex_groups, self.vertices.len(), limits)
    }

    /// The cell group of that name.
    pub fn cell_group(&self, name: &str) -> Option<&Group> {
        self.cell_groups.iter().find(|group| group.name == name)
    }

    /// The vertex group of that name.
    pub fn vertex_group(&self, name: &str) -> Option<&Group> {
        self.vertex_groups.iter().find(|group| group.name == name)
    }

    /// Smallest and largest coordinates, as two corners.
    pub fn bounds(&self) -> [[f64; 3]; 2] {
        let mut bounds = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
        for position in &self.vertices {
            for axis in 0..3 {
                bounds[0][axis] = bounds[0][axis].min(position[axis]);
                bounds[1][axis] = bounds[1][axis].max(position[axis]);
            }
        }
        bounds
    }
}

fn check_count(what: &'static str, count: usize, limit: usize) -> Result<(), MeshError> {
    // Indices are 32 bits, and the largest marks a triangle.
    let limit = limit.min(NONE as usize);
    match count {
        0 => Err(MeshError::Empty { what }),
        _ if count > limit => Err(MeshError::TooMany { what, count, limit }),
        _ => Ok(()),
    }
}

fn check_groups(
    kind: &'static str,
    groups: &[Group],
    count: usize,
    limits: &Limits,
) -> Result<(), MeshError> {
    let limit = limits.groups;
    if groups.len() > limit {
        let what = if kind == "cell" { "cell groups" } else { "vertex groups" };
        return Err(MeshError::TooMany { what, count: groups.len(), limit });
    }
    let mut names = std::collections::HashSet::new();
    for group in groups {
        let (length, limit) = (group.name.len(), limits.name);
        if length > limit {
            let start = group.name.chars().take(32).collect();
            return Err(MeshError::LongName { kind, start, length, limit });
        }
        if !names.insert(group.name.as_str()) {
            return Err(MeshError::DuplicateGroup { kind, group: group.name.clone() });
        }
        for (position, &index) in group.indices.iter().enumerate() {
            if index as usize >= count {
                let group = group.name.clone();
                return Err(MeshError::GroupIndexOutOfRange { kind, group, position, index, count });
            }
        }
    }
    Ok(())
}
