//! Gmsh's MSH format: versions 2.2 and 4.1, ASCII and binary.

use super::{Imported, ReadError};
use crate::{Limits, SurfaceMesh};

/// A version to write, as ASCII.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Version {
    /// 2.2.
    V2,
    /// 4.1.
    V4,
}

/// Reads version 2.2 or 4.1, ASCII or binary. Physical surfaces become cell groups, physical curves and points vertex
/// groups, by name, or by `physical <tag>` if they have none.
///
/// # Errors
/// [`ReadError`], with a line in ASCII parts and a byte offset in binary ones.
pub fn read(bytes: &[u8], limits: &Limits) -> Result<Imported, ReadError> {
    let _ = (bytes, limits);
    todo!()
}

/// Writes ASCII. Vertex groups become physical curves (edges with both ends in the group) and physical points (the rest)
/// of the same name; coordinates read back to the same bits.
pub fn write(mesh: &SurfaceMesh, version: Version) -> Vec<u8> {
    let _ = (mesh, version);
    todo!()
}
