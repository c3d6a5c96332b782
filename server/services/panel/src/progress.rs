//! Descriptions of the panel method's stages.

use moldline_host::{Cancellation, Progress, Reporter};
use moldline_panel::Stage;

/// A monitor for the panel method that reports progress and residuals to `tell`, thinned out and in order.
pub fn reporter<F: Fn(Progress) + Sync>(cancellation: Cancellation, tell: F) -> Reporter<Stage, F> {
    Reporter::new(cancellation, progress, tell).iterating(Stage::Solution)
}

fn progress(stage: Stage, fraction: f64) -> Progress {
    Progress { stage: stage.name(), fraction, message: describe(stage).to_owned() }
}

fn describe(stage: Stage) -> &'static str {
    match stage {
        Stage::Influence => "computing the influence of all panels",
        Stage::Factorisation => "factorising",
        Stage::Solution => "solving",
        Stage::Derivative => "differentiating",
    }
}
