//! How far long work has come, told in few and orderly words.

use std::sync::{Mutex, PoisonError};

use moldline_deform::{Monitor, Stage};

use crate::cancel::Cancellation;

/// One step of long work.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// Name of the stage.
    pub stage: &'static str,
    /// Share of the stage that is done, 0 to 1; never falls within a stage.
    pub fraction: f64,
    /// For people.
    pub message: String,
}

impl Progress {
    /// `stage` has come to `fraction`; what it does is said in a message for people.
    pub fn of_stage(stage: Stage, fraction: f64) -> Self {
        Self { stage: stage.name(), fraction, message: describe(stage).to_owned() }
    }
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

/// A [`Monitor`] that passes progress on, thinned out and in order, and asks a [`Cancellation`].
#[derive(Debug)]
pub struct Reporter<F> {
    cancellation: Cancellation,
    /// What was told last.
    last: Mutex<Option<(Stage, f64)>>,
    tell: F,
}

impl<F: Fn(Progress) + Sync> Reporter<F> {
    /// Tells `tell`, which is called by one thread at a time.
    pub fn new(cancellation: Cancellation, tell: F) -> Self {
        Self { cancellation, last: Mutex::new(None), tell }
    }
}

impl<F: Fn(Progress) + Sync> Monitor<Stage> for Reporter<F> {
    fn progress(&self, stage: Stage, fraction: f64) {
        /// Smaller steps within a stage are not told.
        const STEP: f64 = 0.01;
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        // Threads report as they come: what is behind the last step is not news.
        let news = match *last {
            None => true,
            Some((told, at)) if told == stage => fraction >= at + STEP || (fraction >= 1.0 && at < 1.0),
            Some((told, _)) => stage > told,
        };
        if news {
            *last = Some((stage, fraction));
            (self.tell)(Progress::of_stage(stage, fraction));
        }
    }

    fn cancelled(&self) -> bool {
        self.cancellation.requested()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_that_come_late_or_are_small_are_left_out() {
        let told = Mutex::new(Vec::new());
        let reporter = Reporter::new(Cancellation::default(), |progress: Progress| {
            told.lock().unwrap().push((progress.stage, progress.fraction));
        });
        for (stage, fraction) in [
            (Stage::Mesh, 0.0),
            (Stage::Mesh, 0.5),
            (Stage::Mesh, 0.4),
            (Stage::Mesh, 0.505),
            (Stage::Mesh, 1.0),
            (Stage::Mesh, 1.0),
            (Stage::Seams, 0.0),
            (Stage::Mesh, 0.9),
            (Stage::Seams, 1.0),
        ] {
            reporter.progress(stage, fraction);
        }
        drop(reporter);
        let expected = [("mesh", 0.0), ("mesh", 0.5), ("mesh", 1.0), ("seams", 0.0), ("seams", 1.0)];
        assert_eq!(told.into_inner().unwrap(), expected);
    }
}
