//! Progress and cancellation of long work, seen from the engine.

/// The observer of a long computation whose stages are `S`: it receives progress and can cancel.
pub trait Monitor<S>: Sync {
    /// The computation has done `fraction` (0..=1) of `stage`.
    fn progress(&self, stage: S, fraction: f64);

    /// A round of an iterative solver has left `residual`, relative to the right-hand side.
    fn residual(&self, _round: usize, _residual: f64) {}

    /// Whether the computation should stop. Loops poll this; the computation then ends with a `Cancelled` error.
    fn cancelled(&self) -> bool {
        false
    }
}

/// The monitor that ignores progress and never cancels.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoMonitor;

impl<S> Monitor<S> for NoMonitor {
    fn progress(&self, _: S, _: f64) {}
}
