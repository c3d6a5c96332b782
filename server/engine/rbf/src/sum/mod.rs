//! Sums over radial functions at many targets.

pub(crate) mod cubic;
pub(crate) mod multiquadric;

use crate::Block;

/// Targets of one task.
const TILE: usize = 128;
/// Sources whose kernel values are formed at once when there are many columns.
const PANEL: usize = 256;

/// Sums, a row for each target and a column for each column of weights.
pub(crate) struct Sums {
    pub leading: Block,
    /// What the leading part is rounded by, where the kernel's sums have more digits than a double.
    pub remainder: Option<Block>,
}
