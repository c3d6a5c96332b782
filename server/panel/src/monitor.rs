//! Progress and cancellation of long work, seen from the solver.

/// Told how far the work has come, and asked whether to go on.
pub trait Monitor: Sync {
    /// `stage` has come to `fraction` (0..=1) of its work.
    fn progress(&self, stage: Stage, fraction: f64);

    /// A round of refinement or of the iterative solver has left this residual, relative to the right-hand side.
    fn residual(&self, _round: usize, _residual: f64) {}

    /// Whether the caller has lost interest. Polled inside loops; work then ends with a `Cancelled` error.
    fn cancelled(&self) -> bool {
        false
    }
}

/// Reports nothing and is never cancelled.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Monitor for Silent {
    fn progress(&self, _: Stage, _: f64) {}
}

/// What is being done, in the order in which it is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// Influence of all panels on all collocation points.
    Influence,
    /// Factorisation, or the preconditioner.
    Factorisation,
    /// Solution with refinement, or iterations.
    Solution,
    /// Products with the derivative: the pass over all pairs.
    Derivative,
}

impl Stage {
    /// A word for people and protocols.
    pub fn name(self) -> &'static str {
        match self {
            Self::Influence => "influence",
            Self::Factorisation => "factorisation",
            Self::Solution => "solution",
            Self::Derivative => "derivative",
        }
    }
}

impl std::fmt::Display for Stage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}
