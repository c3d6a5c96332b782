//! Readers and writers of mesh formats, on byte slices: no file is opened here.
//!
//! Readers check each count against the remaining bytes before they allocate, and return errors with the line or the
//! byte offset of the fault. Cells other than triangles and quadrilaterals are left out and counted.

mod cursor;
mod draft;
#[cfg(test)]
mod linear;
pub mod msh;
pub mod stl;
pub mod vtu;

use std::fmt;

use thiserror::Error;

use self::draft::Draft;
use crate::{Limits, MeshError, Numbering, Origin, SurfaceMesh};

/// A mesh as read, with the numbers that its parts have in the file.
#[derive(Clone, Debug, PartialEq)]
pub struct Imported {
    /// The surface.
    pub mesh: SurfaceMesh,
    /// Its numbers in the file, and counts of what was left out.
    pub origin: Origin,
}

/// The formats, by their endings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Gmsh's `.msh`.
    Msh,
    /// VTK's `.vtu`.
    Vtu,
    /// `.stl`.
    Stl,
}

impl Format {
    /// Their endings, for messages.
    pub const ENDINGS: &'static str = ".msh, .vtu or .stl";

    /// The format of a file of this name, by its ending; `None` for others.
    pub fn of_name(name: &str) -> Option<Self> {
        let (_, ending) = name.rsplit_once('.')?;
        match ending.to_ascii_lowercase().as_str() {
            "msh" => Some(Self::Msh),
            "vtu" => Some(Self::Vtu),
            "stl" => Some(Self::Stl),
            _ => None,
        }
    }

    /// Reads a mesh and merges its nodes within `tolerance`, in the file's unit; 0 merges none but the equal corners of STL, and
    /// the equal points at the borders of pieces of VTU.
    ///
    /// # Errors
    /// [`ReadError`], with a line or byte offset.
    pub fn read(self, bytes: &[u8], tolerance: f64, limits: &Limits) -> Result<Imported, ReadError> {
        match self {
            Self::Msh => msh::read_merged(bytes, tolerance, limits),
            Self::Vtu => vtu::read_merged(bytes, tolerance, limits),
            Self::Stl => stl::read(bytes, tolerance, limits),
        }
    }
}

/// A mesh from arrays with its vertices merged within `tolerance`, m.
///
/// # Errors
/// [`ReadError::MergeTolerance`] if the tolerance is too large.
pub fn merged(mesh: SurfaceMesh, tolerance: f64, limits: &Limits) -> Result<Imported, ReadError> {
    Draft::of_mesh(mesh).finish(Numbering::Arrays, Vec::new(), tolerance, limits)
}

/// The mark that some editors put before a text in UTF-8.
const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";

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
    /// A coordinate that is not a number, or infinite.
    #[error("{place}: coordinate {} of corner {corner} of facets[{facet}] is {value}, which is not a finite number", ["x", "y", "z"][*axis])]
    NotFinite {
        /// Where.
        place: Place,
        /// Number of the facet, from 0.
        facet: u64,
        /// Its corner, from 0.
        corner: usize,
        /// 0, 1, 2 for x, y, z.
        axis: usize,
        /// The value found.
        value: f64,
    },
    /// A file without triangles and quadrilaterals.
    #[error(
        "the file has no triangles or quadrilaterals ({nodes} nodes and {other_cells} cells of other kinds, such as volumes, were \
         left out); save the surfaces too (Gmsh: put them into a physical group, or set Mesh.SaveAll = 1)"
    )]
    NoSurface {
        /// Nodes.
        nodes: usize,
        /// Cells of other kinds.
        other_cells: usize,
    },
    /// Merging would take away visible parts of the surface.
    #[error(
        "merge_tolerance = {tolerance:e} collapses {count} of {cells} cells with {:.1} % of the area; take a smaller one, at \
         most the distance of double nodes",
        100.0 * loss
    )]
    MergeTolerance {
        /// The tolerance, in the file's unit.
        tolerance: f64,
        /// Cells that collapse.
        count: usize,
        /// All cells.
        cells: usize,
        /// Share of the area.
        loss: f64,
    },
    /// The file is well-formed, but its mesh is not valid.
    #[error("{message}")]
    Mesh {
        /// What is wrong, with indices of the mesh.
        error: MeshError,
        /// The same with the numbers of the file.
        message: String,
    },
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
