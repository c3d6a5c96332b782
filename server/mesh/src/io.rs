//! Readers and writers of mesh formats, on byte slices: no file is opened here.
//!
//! Readers check each count against the bytes that are left before they allocate, and return errors with the line or the
//! byte offset where the file is wrong. What is not a triangle or a quadrilateral is left out and counted.

pub mod msh;
pub mod stl;
pub mod vtu;

use std::fmt;

use thiserror::Error;

use crate::{MeshError, SurfaceMesh};

/// A mesh as read, and what was left out.
#[derive(Clone, Debug, PartialEq)]
pub struct Imported {
    /// The surface.
    pub mesh: SurfaceMesh,
    /// The name each vertex has in the file: its node tag (MSH), its index (VTU), its first corner (STL).
    pub vertex_ids: Vec<u64>,
    /// Vertices of the file that belong to no triangle or quadrilateral, and were left out.
    pub ignored_vertices: usize,
    /// Cells that were left out: volume cells, and triangles that collapse when STL vertices are merged.
    pub ignored_cells: usize,
}

/// Where in a file.
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

/// Why a file is refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ReadError {
    /// Something else stands where a value or word is due.
    #[error("{place}: expected {expected}, found `{found}`")]
    Unexpected {
        /// Where.
        place: Place,
        /// What is due.
        expected: String,
        /// What is there, shortened.
        found: String,
    },
    /// The file ends too early.
    #[error("{place}: the file ends where {expected} is expected")]
    Truncated {
        /// Where.
        place: Place,
        /// What is due.
        expected: String,
    },
    /// A count that the rest of the file, or the limit, cannot hold.
    #[error("{place}: {count} {what} are more than the {limit} that the file's length or the limits allow")]
    TooMany {
        /// Where.
        place: Place,
        /// What is counted.
        what: &'static str,
        /// The count that the file states.
        count: u64,
        /// How many there can be.
        limit: u64,
    },
    /// Valid, but not read here.
    #[error("{place}: {what} is not supported; {advice}")]
    Unsupported {
        /// Where.
        place: Place,
        /// What.
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
        /// Which.
        what: &'static str,
    },
    /// The file is read, but what it holds is not a valid mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
}
