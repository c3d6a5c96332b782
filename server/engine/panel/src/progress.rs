//! Progress and cancellation of a parallel loop.

use std::sync::atomic::{AtomicUsize, Ordering};

use crate::{Monitor, PanelError, Stage};

/// Ends a loop whose steps are short, if it has been cancelled.
///
/// # Errors
/// [`PanelError::Cancelled`].
pub(crate) fn poll(monitor: &dyn Monitor<Stage>) -> Result<(), PanelError> {
    if monitor.cancelled() { Err(PanelError::Cancelled) } else { Ok(()) }
}

/// Reports a loop makes, at most.
const REPORTS: usize = 20;

/// The counter of a parallel loop's finished steps.
pub(crate) struct Progress<'a> {
    monitor: &'a dyn Monitor<Stage>,
    stage: Stage,
    total: usize,
    done: AtomicUsize,
}

impl<'a> Progress<'a> {
    pub fn new(monitor: &'a dyn Monitor<Stage>, stage: Stage, total: usize) -> Self {
        monitor.progress(stage, 0.0);
        Self { monitor, stage, total, done: AtomicUsize::new(0) }
    }

    /// Whether the remaining steps should be skipped.
    pub fn cancelled(&self) -> bool {
        self.monitor.cancelled()
    }

    /// Counts one step.
    pub fn step(&self) {
        let before = self.done.fetch_add(1, Ordering::Relaxed);
        let step = self.total.div_ceil(REPORTS);
        if before / step != (before + 1) / step {
            self.monitor.progress(self.stage, (before + 1) as f64 / self.total as f64);
        }
    }

    /// Ends the loop.
    ///
    /// # Errors
    /// [`PanelError::Cancelled`] if steps have been skipped.
    pub fn finish(&self) -> Result<(), PanelError> {
        if self.done.load(Ordering::Relaxed) < self.total {
            return Err(PanelError::Cancelled);
        }
        self.monitor.progress(self.stage, 1.0);
        Ok(())
    }
}
