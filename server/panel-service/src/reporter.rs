//! How far a solution has come, told in few and orderly words.

use std::sync::{Mutex, MutexGuard, PoisonError};

use moldline_panel::{Monitor, Stage};
use moldline_service::{Cancellation, Progress};

/// A [`Monitor`] that passes progress and residuals on, thinned out and in order, and asks a [`Cancellation`].
#[derive(Debug)]
pub struct Reporter<F> {
    cancellation: Cancellation,
    told: Mutex<Told>,
    tell: F,
}

#[derive(Debug, Default)]
struct Told {
    last: Option<(Stage, f64)>,
    residuals: Vec<f64>,
}

impl<F: Fn(Progress) + Sync> Reporter<F> {
    /// Tells `tell`, which is called by one thread at a time.
    pub fn new(cancellation: Cancellation, tell: F) -> Self {
        Self { cancellation, told: Mutex::default(), tell }
    }

    /// The residual after each round.
    pub fn residuals(self) -> Vec<f64> {
        self.told.into_inner().unwrap_or_else(PoisonError::into_inner).residuals
    }

    fn told(&self) -> MutexGuard<'_, Told> {
        self.told.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<F: Fn(Progress) + Sync> Monitor<Stage> for Reporter<F> {
    fn progress(&self, stage: Stage, fraction: f64) {
        /// Smaller steps within a stage are not told.
        const STEP: f64 = 0.01;
        let mut told = self.told();
        // Threads report as they come: what is behind the last step is not news.
        let news = match told.last {
            None => true,
            Some((last, at)) if last == stage => fraction >= at + STEP || (fraction >= 1.0 && at < 1.0),
            Some((last, _)) => stage > last,
        };
        if news {
            told.last = Some((stage, fraction));
            (self.tell)(Progress { stage: stage.name(), fraction, message: describe(stage).to_owned() });
        }
    }

    fn residual(&self, round: usize, residual: f64) {
        let mut told = self.told();
        told.residuals.push(residual);
        let fraction = match told.last {
            Some((Stage::Solution, fraction)) => fraction,
            _ => 0.0,
        };
        let message = format!("solving, round {round}: residual {residual:.1e}");
        (self.tell)(Progress { stage: Stage::Solution.name(), fraction, message });
    }

    fn cancelled(&self) -> bool {
        self.cancellation.requested()
    }
}

fn describe(stage: Stage) -> &'static str {
    match stage {
        Stage::Influence => "computing the influence of all panels",
        Stage::Factorisation => "factorising",
        Stage::Solution => "solving",
        Stage::Derivative => "differentiating",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_come_in_order_and_residuals_within_the_solution() {
        let told = Mutex::new(Vec::new());
        let reporter = Reporter::new(Cancellation::default(), |progress: Progress| {
            told.lock().unwrap().push((progress.stage, progress.fraction));
        });
        reporter.progress(Stage::Influence, 0.5);
        reporter.progress(Stage::Influence, 0.4);
        reporter.progress(Stage::Solution, 0.0);
        reporter.progress(Stage::Influence, 1.0);
        reporter.residual(1, 1e-7);
        reporter.progress(Stage::Solution, 0.5);
        reporter.residual(2, 1e-13);
        assert_eq!(reporter.residuals(), [1e-7, 1e-13]);
        let expected =
            [("influence", 0.5), ("solution", 0.0), ("solution", 0.0), ("solution", 0.5), ("solution", 0.5)];
        assert_eq!(told.into_inner().unwrap(), expected);
    }
}
