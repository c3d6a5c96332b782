//! Descriptions of the engine's stages.

use moldline_deform::Stage;
use moldline_host::{Cancellation, Progress, Reporter};

/// A monitor for the engine that reports to `tell`, thinned out and in order.
pub fn reporter<F: Fn(Progress) + Sync>(cancellation: Cancellation, tell: F) -> Reporter<Stage, F> {
    Reporter::new(cancellation, progress, tell)
}

/// The report that `stage` has reached `fraction`.
pub(crate) fn progress(stage: Stage, fraction: f64) -> Progress {
    Progress { stage: stage.name(), fraction, message: describe(stage).to_owned() }
}

fn describe(stage: Stage) -> &'static str {
    match stage {
        Stage::Mesh => "checking the mesh",
        Stage::Ownership => "projecting the vertices onto their components",
        Stage::Seams => "finding the seams and their search lines",
        Stage::Training => "choosing the training vertices",
        Stage::Factorisation => "factorising the radial basis functions",
        Stage::Report => "measuring the reference mesh",
        Stage::Geometry => "moving the control points",
        Stage::SeamSearch => "searching the deformed seams",
        Stage::Field => "spreading the displacements",
        Stage::Projection => "putting the vertices onto the outer mold line",
        Stage::Quality => "measuring the deformed mesh",
    }
}
