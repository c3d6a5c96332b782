//! Giving all cells of a surface one orientation.

use thiserror::Error;

use crate::{Cell, Topology};

/// Why cells cannot be oriented alike.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum OrientationError {
    /// A one-sided surface, such as a Moebius band.
    #[error("cells {cells:?} cannot be oriented alike across edge {edge:?}: the surface has one side only")]
    OneSided {
        /// The edge where both orientations met, as vertices.
        edge: [u32; 2],
        /// The cells at it.
        cells: [u32; 2],
    },
}

/// Flips cells so that neighbours across every edge with two cells agree; in each such connected patch the orientation of
/// the majority stays. Edges with three or more cells separate patches. Returns which cells were flipped.
///
/// # Errors
/// [`OrientationError::OneSided`]; the cells are then left as they were.
pub fn orient(cells: &mut [Cell], topology: &Topology) -> Result<Vec<bool>, OrientationError> {
    let _ = (cells, topology);
    todo!()
}

/// As [`orient`], then turns every closed patch outwards (positive enclosed volume).
///
/// # Errors
/// As [`orient`].
pub fn orient_outwards(
    vertices: &[[f64; 3]],
    cells: &mut [Cell],
    topology: &Topology,
) -> Result<Vec<bool>, OrientationError> {
    let _ = (vertices, cells, topology);
    todo!()
}
