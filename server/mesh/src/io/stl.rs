//! STL triangles, ASCII and binary.

use super::{Imported, ReadError};
use crate::Limits;

/// Reads ASCII or binary STL and merges vertices: equal ones, and those within `tolerance` (m, 0 for equal only) of one
/// that came before. Triangles that collapse are left out and counted. Named solids of an ASCII file become cell groups.
///
/// # Errors
/// [`ReadError`], with a line or byte offset.
pub fn read(bytes: &[u8], tolerance: f64, limits: &Limits) -> Result<Imported, ReadError> {
    let _ = (bytes, tolerance, limits);
    todo!()
}
