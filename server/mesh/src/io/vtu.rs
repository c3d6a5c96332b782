//! VTK's XML unstructured grid (`.vtu`).

use super::{Imported, ReadError};
use crate::{Limits, SurfaceMesh};

/// A data array to write beside the mesh.
#[derive(Clone, Copy, Debug)]
pub struct Array<'a> {
    /// Name as shown in ParaView.
    pub name: &'a str,
    /// Numbers per point or cell.
    pub components: usize,
    /// Values, `components` for each point or cell.
    pub values: Values<'a>,
}

/// Values of an [`Array`].
#[derive(Clone, Copy, Debug)]
pub enum Values<'a> {
    /// Double precision.
    Float64(&'a [f64]),
    /// Signed 32 bits.
    Int32(&'a [i32]),
    /// Unsigned 8 bits.
    UInt8(&'a [u8]),
}

/// Reads ASCII, inline base64 and appended (raw or base64) data, compressed with zlib or not, of either byte order.
/// Integer arrays named `group:NAME` become cell and vertex groups: members have a value other than 0.
///
/// # Errors
/// [`ReadError`], with a line or byte offset.
pub fn read(bytes: &[u8], limits: &Limits) -> Result<Imported, ReadError> {
    let _ = (bytes, limits);
    todo!()
}

/// Writes appended raw little-endian data with the given arrays and the mesh's groups.
///
/// # Panics
/// If an array's length is not `components` times the number of points or cells.
pub fn write(mesh: &SurfaceMesh, point_data: &[Array<'_>], cell_data: &[Array<'_>]) -> Vec<u8> {
    let _ = (mesh, point_data, cell_data);
    todo!()
}
