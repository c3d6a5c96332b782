//! Iterative refinement (Wilkinson): corrections by an inverse that is exact but for rounding, with residuals in double precision.

use super::operator::{Inverse, Operator, Solved, maximum};
use crate::{Monitor, PanelError, Stage, progress::poll};

/// Rounds at most.
const ROUNDS: usize = 10;

/// Refines until the residual has reached `tolerance` and is down to rounding errors, or falls no more.
pub(super) fn refine(
    operator: &dyn Operator,
    inverse: &dyn Inverse,
    right: &[Vec<f64>],
    transposed: bool,
    tolerance: f64,
    monitor: &dyn Monitor<Stage>,
) -> Result<Solved, PanelError> {
    let sizes: Vec<f64> = right.iter().map(|b| maximum(b)).collect();
    let mut columns = vec![vec![0.0; operator.size()]; right.len()];
    let mut residuals = right.to_vec();
    let mut least = f64::INFINITY;
    let mut round = 0;
    loop {
        let residual = residuals
            .iter()
            .zip(&sizes)
            .map(|(r, size)| if *size > 0.0 { maximum(r) / size } else { 0.0 })
            .fold(0.0, f64::max);
        if round > 0 {
            monitor.residual(round, residual);
        }
        monitor.progress(Stage::Solution, round as f64 / ROUNDS as f64);
        // One round more than the tolerance needs costs little and leaves rounding errors only.
        let settled = residual <= tolerance && (residual > 0.1 * least || residual <= 0.01 * tolerance);
        if settled || residual.is_nan() || round == ROUNDS || (residual > 0.5 * least && round > 0) {
            return Ok(Solved { columns, residual, rounds: round });
        }
        poll(monitor)?;
        least = residual;
        let corrections = inverse.solve(&residuals, transposed, monitor);
        poll(monitor)?;
        for (x, dx) in columns.iter_mut().zip(corrections) {
            x.iter_mut().zip(dx).for_each(|(x, dx)| *x += dx);
        }
        let products = operator.times(&columns, transposed);
        for ((r, b), p) in residuals.iter_mut().zip(right).zip(products) {
            r.iter_mut().zip(b.iter().zip(p)).for_each(|(r, (b, p))| *r = b - p);
        }
        round += 1;
    }
}
