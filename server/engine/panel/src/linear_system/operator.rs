//! Linear operators and their inverses, as the solvers see them.

use faer::Mat;

use crate::{Monitor, Stage};

/// A square linear operator A.
pub(crate) trait Operator {
    /// Number of rows.
    fn size(&self) -> usize;

    /// `A x`, or `A^T x`, for several x.
    fn times(&self, columns: &[Vec<f64>], transposed: bool) -> Vec<Vec<f64>>;

    /// The entries of some rows and the same columns.
    fn block(&self, members: &[u32]) -> Mat<f64>;
}

/// The inverse of an operator, exact up to rounding or approximate.
pub(crate) trait Inverse {
    /// Solves `A x = b`, or `A^T x = b`, for every column b; anything once `monitor` has cancelled, which callers look at.
    fn solve(&self, right: &[Vec<f64>], transposed: bool, monitor: &dyn Monitor<Stage>) -> Vec<Vec<f64>>;
}

/// Solutions and their quality.
#[derive(Debug)]
pub(crate) struct Solved {
    pub columns: Vec<Vec<f64>>,
    /// Largest residual of a column relative to its right-hand side (maximum norms).
    pub residual: f64,
    /// Rounds of refinement, or iterations, of the slowest column.
    pub rounds: usize,
}

/// Maximum norm; NaN if a component is NaN.
pub(super) fn maximum(x: &[f64]) -> f64 {
    x.iter().fold(0.0, |m, x| if x.is_nan() { f64::NAN } else { f64::max(m, x.abs()) })
}
