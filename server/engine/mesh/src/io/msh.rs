//! Gmsh's MSH format: versions 2.0 to 2.2, 4.0 and 4.1, ASCII and binary.

mod read;
mod write;

pub use write::write;

use self::read::Reader;
use super::{Imported, ReadError, cursor::Coding};
use crate::Limits;

/// A version to write, as ASCII.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Version {
    /// 2.2.
    V2,
    /// 4.1.
    V4,
}

/// Reads versions 2.0, 2.1, 2.2, 4.0 and 4.1, ASCII or binary. Physical surfaces become cell groups, physical curves and points vertex
/// groups, by name, or by `physical <tag>` if they have none; entities of partitions belong to the groups of both the part and the
/// whole.
///
/// # Errors
/// [`ReadError`], with a line in ASCII parts and a byte offset in binary ones.
pub fn read(bytes: &[u8], limits: &Limits) -> Result<Imported, ReadError> {
    read_merged(bytes, 0.0, limits)
}

/// As [`read`], with nodes merged within `tolerance`, in the file's unit.
///
/// # Errors
/// As [`read`]; [`ReadError::MergeTolerance`] if the tolerance is too large.
pub fn read_merged(bytes: &[u8], tolerance: f64, limits: &Limits) -> Result<Imported, ReadError> {
    Reader::read(bytes, limits)?.finish(tolerance)
}

/// The same file with other positions of some nodes, given by tag in the file's unit; all else stays as it is, to the last byte.
///
/// # Errors
/// As [`read`].
pub fn with_positions(
    bytes: &[u8],
    position: impl Fn(u64) -> Option<[f64; 3]>,
    limits: &Limits,
) -> Result<Vec<u8>, ReadError> {
    let reader = Reader::read(bytes, limits)?;
    let mut out = Vec::with_capacity(bytes.len());
    let mut done = 0;
    for (tag, span, coding) in reader.positions() {
        let Some(x) = position(tag) else { continue };
        out.extend_from_slice(&bytes[done..span.start]);
        match coding {
            Coding::Ascii => out.extend_from_slice(write::coordinates(&x).as_bytes()),
            Coding::LittleEndian => out.extend(x.iter().flat_map(|x| x.to_le_bytes())),
            Coding::BigEndian => out.extend(x.iter().flat_map(|x| x.to_be_bytes())),
        }
        done = span.end;
    }
    out.extend_from_slice(&bytes[done..]);
    Ok(out)
}

/// Element types by their numbers.
mod element {
    pub(super) const LINE: i32 = 1;
    pub(super) const TRIANGLE: i32 = 2;
    pub(super) const QUAD: i32 = 3;
    pub(super) const POINT: i32 = 15;

    /// Number of nodes of types 1 to 31.
    const NODES: [u8; 31] = [
        2, 3, 4, 4, 8, 6, 5, 3, 6, 9, 10, 27, 18, 14, 1, 8, 20, 15, 13, 9, 10, 12, 15, 15, 21, 4, 5, 6, 20,
        35, 56,
    ];

    pub(super) fn nodes(kind: i32) -> Option<usize> {
        let index = usize::try_from(kind).ok()?.checked_sub(1)?;
        NODES.get(index).map(|&nodes| usize::from(nodes))
    }

    pub(super) fn is_curved_surface(kind: i32) -> bool {
        matches!(kind, 9 | 10 | 16 | 20..=25)
    }
}
