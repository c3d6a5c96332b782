//! Readers and writers of mesh formats, on byte slices: no file is opened here.
//!
//! Readers check each count against the remaining bytes before they allocate, and return errors with the line or the
//! byte offset of the fault. Cells other than triangles and quadrilaterals are left out and counted.

mod cursor;
#[cfg(test)]
mod linear;
pub mod msh;
pub mod stl;
pub mod vtu;

use std::{collections::HashMap, fmt};

use thiserror::Error;

use crate::{Cell, Group, Limits, MeshError, SurfaceMesh};

/// A mesh as read, with counts of what was left out.
#[derive(Clone, Debug, PartialEq)]
pub struct Imported {
    /// The surface.
    pub mesh: SurfaceMesh,
    /// Each vertex's identifier in the file: its node tag (MSH), its index (VTU), its first corner (STL).
    pub vertex_ids: Vec<u64>,
    /// Vertices of the file that belong to no triangle or quadrilateral, and were left out.
    pub ignored_vertices: usize,
    /// Cells that were left out: volume cells, and triangles that collapse when STL vertices are merged.
    pub ignored_cells: usize,
}

/// A position in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Line, from 1.
    Line(usize),
    /// Byte, from 0.
    Byte(usize),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}"),
            Self::Byte(byte) => write!(f, "byte {byte}"),
        }
    }
}

/// Why a file is rejected.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ReadError {
    /// Something other than the expected value or word.
    #[error("{place}: expected {expected}, found `{found}`")]
    Unexpected {
        /// Where.
        place: Place,
        /// The value or word expected.
        expected: String,
        /// The text found, shortened.
        found: String,
    },
    /// The file ends too early.
    #[error("{place}: the file ends where {expected} is expected")]
    Truncated {
        /// Where.
        place: Place,
        /// The value or word expected.
        expected: String,
    },
    /// A count that exceeds the rest of the file, or the limit.
    #[error("{place}: {count} {what} are more than the {limit} that the file's length or the limits allow")]
    TooMany {
        /// Where.
        place: Place,
        /// What is counted.
        what: &'static str,
        /// The count that the file states.
        count: u64,
        /// Largest count possible.
        limit: u64,
    },
    /// A valid feature that is not supported.
    #[error("{place}: {what} is not supported; {advice}")]
    Unsupported {
        /// Where.
        place: Place,
        /// The feature.
        what: String,
        /// The way out.
        advice: &'static str,
    },
    /// A cell names a node that the file does not have.
    #[error("{place}: node {node} is not in the file")]
    UnknownNode {
        /// Where.
        place: Place,
        /// The tag or index.
        node: u64,
    },
    /// A part is missing.
    #[error("the file has no {what}")]
    Missing {
        /// The missing part.
        what: &'static str,
    },
    /// The file is well-formed, but its mesh is not valid.
    #[error(transparent)]
    Mesh(#[from] MeshError),
}

impl ReadError {
    fn unexpected(place: Place, expected: impl Into<String>, found: &[u8]) -> Self {
        const SHOWN: usize = 40;
        let mut found = String::from_utf8_lossy(&found[..found.len().min(SHOWN)]).into_owned();
        found.retain(|c| !c.is_control());
        Self::Unexpected { place, expected: expected.into(), found }
    }
}

/// Notes that a reader has looked at so many bytes or entries. Tests compare the sum with the length of the input.
fn looked_at(count: usize) {
    #[cfg(test)]
    linear::LOOKED_AT.with(|sum| sum.set(sum.get() + count));
    #[cfg(not(test))]
    let _ = count;
}

/// A reader's raw result: nodes that cells may or may not use, and groups whose indices may repeat.
#[derive(Default)]
struct Draft {
    ids: Vec<u64>,
    positions: Vec<[f64; 3]>,
    /// Cells, as indices of `positions`.
    cells: Vec<Cell>,
    cell_groups: Groups,
    vertex_groups: Groups,
    ignored_cells: usize,
}

/// Groups in order of appearance, found by name.
#[derive(Default)]
struct Groups {
    list: Vec<Group>,
    numbers: HashMap<String, usize>,
}

impl Groups {
    /// Adds indices to the group of that name, which may be new.
    fn add(&mut self, name: &str, indices: impl IntoIterator<Item = u32>) {
        looked_at(1 + name.len());
        let number = match self.numbers.get(name) {
            Some(&number) => number,
            None => {
                self.numbers.insert(name.to_owned(), self.list.len());
                self.list.push(Group { name: name.to_owned(), indices: Vec::new() });
                self.list.len() - 1
            }
        };
        self.list[number].indices.extend(indices);
    }
}

impl Draft {
    /// Leaves out nodes that no cell uses, sorts the groups, and validates.
    fn finish(mut self, limits: &Limits) -> Result<Imported, ReadError> {
        const UNUSED: u32 = u32::MAX;
        let mut number = vec![UNUSED; self.positions.len()];
        for vertex in self.cells.iter().flat_map(|cell| cell.vertices()) {
            number[*vertex as usize] = 0;
        }
        let mut used = 0;
        for number in number.iter_mut().filter(|number| **number != UNUSED) {
            *number = used;
            used += 1;
        }
        let ignored_vertices = number.len() - used as usize;
        let mut keep = number.iter().map(|&number| number != UNUSED);
        self.positions.retain(|_| keep.next() == Some(true));
        let mut keep = number.iter().map(|&number| number != UNUSED);
        self.ids.retain(|_| keep.next() == Some(true));
        for cell in &mut self.cells {
            *cell = cell.map(|vertex| number[vertex as usize]);
        }
        for group in &mut self.vertex_groups.list {
            for index in &mut group.indices {
                *index = number[*index as usize];
            }
            group.indices.retain(|&index| index != UNUSED);
        }
        for group in self.vertex_groups.list.iter_mut().chain(&mut self.cell_groups.list) {
            group.indices.sort_unstable();
            group.indices.dedup();
        }
        let Self { ids, positions, cells, cell_groups, vertex_groups, ignored_cells } = self;
        let mesh = SurfaceMesh::with_limits(positions, cells, cell_groups.list, vertex_groups.list, limits)?;
        Ok(Imported { mesh, vertex_ids: ids, ignored_vertices, ignored_cells })
    }
}
