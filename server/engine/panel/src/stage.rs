//! Stages of an analysis, for progress reports.

/// A stage of a computation, in the order in which they run.
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
    /// Its name in reports and protocols.
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
