//! Rate-limited progress reports, in order.

use std::sync::{Mutex, MutexGuard, PoisonError};

use moldline_foundation::Monitor;

use crate::cancel::Cancellation;

/// A progress report of long work.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// Name of the stage.
    pub stage: &'static str,
    /// Share of the stage that is done, 0 to 1; never decreases within a stage.
    pub fraction: f64,
    /// Description for people.
    pub message: String,
}

/// A [`Monitor`] that passes on progress reports, thinned out and in order, and cancels the work through a [`Cancellation`].
#[derive(Debug)]
pub struct Reporter<S, F> {
    cancellation: Cancellation,
    describe: fn(S, f64) -> Progress,
    /// The stage whose iterations have residuals.
    iterating: Option<S>,
    state: Mutex<State<S>>,
    tell: F,
}

#[derive(Debug)]
struct State<S> {
    /// Stage and fraction of the last report.
    last: Option<(S, f64)>,
    residuals: Vec<f64>,
}

impl<S: Copy + Ord, F: Fn(Progress) + Sync> Reporter<S, F> {
    /// Reports to `tell`, which is called by one thread at a time. `describe`: the report of a stage and its fraction.
    pub fn new(cancellation: Cancellation, describe: fn(S, f64) -> Progress, tell: F) -> Self {
        let state = Mutex::new(State { last: None, residuals: Vec::new() });
        Self { cancellation, describe, iterating: None, state, tell }
    }

    /// Also reports the residuals of an iterative solver, as progress of `stage`.
    #[must_use]
    pub fn iterating(self, stage: S) -> Self {
        Self { iterating: Some(stage), ..self }
    }

    /// Residuals of all rounds.
    pub fn residuals(self) -> Vec<f64> {
        self.state.into_inner().unwrap_or_else(PoisonError::into_inner).residuals
    }

    fn lock(&self) -> MutexGuard<'_, State<S>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<S: Copy + Ord + Send + Sync, F: Fn(Progress) + Sync> Monitor<S> for Reporter<S, F> {
    fn progress(&self, stage: S, fraction: f64) {
        /// Smaller steps within a stage are not reported.
        const STEP: f64 = 0.01;
        let mut state = self.lock();
        // Threads report in any order: what is behind the last report is dropped.
        let news = match state.last {
            None => true,
            Some((last, at)) if last == stage => fraction >= at + STEP || (fraction >= 1.0 && at < 1.0),
            Some((last, _)) => stage > last,
        };
        if news {
            state.last = Some((stage, fraction));
            (self.tell)((self.describe)(stage, fraction));
        }
    }

    fn residual(&self, round: usize, residual: f64) {
        let Some(stage) = self.iterating else { return };
        let mut state = self.lock();
        state.residuals.push(residual);
        let fraction = match state.last {
            Some((last, fraction)) if last == stage => fraction,
            _ => 0.0,
        };
        let mut report = (self.describe)(stage, fraction);
        report.message += &format!(", round {round}: residual {residual:.1e}");
        (self.tell)(report);
    }

    fn cancelled(&self) -> bool {
        self.cancellation.requested()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
    enum Stage {
        First,
        Second,
    }

    fn describe(stage: Stage, fraction: f64) -> Progress {
        let name = if stage == Stage::First { "first" } else { "second" };
        Progress { stage: name, fraction, message: format!("doing the {name}") }
    }

    #[test]
    fn late_and_small_steps_are_dropped() {
        let told = Mutex::new(Vec::new());
        let reporter = Reporter::new(Cancellation::default(), describe, |progress| {
            told.lock().unwrap().push((progress.stage, progress.fraction));
        });
        for (stage, fraction) in [
            (Stage::First, 0.0),
            (Stage::First, 0.5),
            (Stage::First, 0.4),
            (Stage::First, 0.505),
            (Stage::First, 1.0),
            (Stage::First, 1.0),
            (Stage::Second, 0.0),
            (Stage::First, 0.9),
            (Stage::Second, 1.0),
        ] {
            reporter.progress(stage, fraction);
        }
        reporter.residual(1, 0.5);
        drop(reporter);
        let expected = [("first", 0.0), ("first", 0.5), ("first", 1.0), ("second", 0.0), ("second", 1.0)];
        assert_eq!(told.into_inner().unwrap(), expected);
    }

    #[test]
    fn residuals_are_reported_within_their_stage() {
        let told = Mutex::new(Vec::new());
        let reporter = Reporter::new(Cancellation::default(), describe, |progress| {
            told.lock().unwrap().push((progress.stage, progress.fraction, progress.message));
        })
        .iterating(Stage::Second);
        reporter.progress(Stage::First, 0.5);
        reporter.progress(Stage::First, 0.4);
        reporter.progress(Stage::Second, 0.0);
        reporter.progress(Stage::First, 1.0);
        reporter.residual(1, 1e-7);
        reporter.progress(Stage::Second, 0.5);
        reporter.residual(2, 1e-13);
        assert_eq!(reporter.residuals(), [1e-7, 1e-13]);
        let told = told.into_inner().unwrap();
        let places: Vec<_> = told.iter().map(|&(stage, fraction, _)| (stage, fraction)).collect();
        let expected = [("first", 0.5), ("second", 0.0), ("second", 0.0), ("second", 0.5), ("second", 0.5)];
        assert_eq!(places, expected);
        assert_eq!(told[2].2, "doing the second, round 1: residual 1.0e-7");
    }
}
