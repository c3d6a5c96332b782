//! Limits on a file, checked before memory is taken.

/// Limits on an aircraft file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImportLimits {
    /// Bytes of the file.
    pub bytes: usize,
    /// Entity instances (STEP) or directory entries (IGES).
    pub entities: usize,
    /// Patches of all components together.
    pub patches: usize,
    /// Control points of all patches together, before knots are removed.
    pub control_points: usize,
}

impl Default for ImportLimits {
    fn default() -> Self {
        Self { bytes: 512 << 20, entities: 10_000_000, patches: 20_000, control_points: 5_000_000 }
    }
}
