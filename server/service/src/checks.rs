//! Checks of derivatives: whether what the engine gives for a set-up is right, on request.

use std::sync::{Mutex, PoisonError};

use moldline_check::{Designs, Observer, Request};
use moldline_parameterisation::Parameterisation;

use crate::{
    cancel::Cancellation,
    error::ServiceError,
    limits::Limits,
    linearisation::{Design, Resolved, Values},
    progress::Progress,
};

/// Where derivatives are to be checked.
#[derive(Clone, Debug, PartialEq)]
pub enum CheckAt {
    /// At the baseline and at random designs far from it, so many in all.
    Number(usize),
    /// At this design.
    Design(Values),
}

/// What is to be checked.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckRequest {
    /// Where.
    pub at: CheckAt,
    /// Seed of the random designs and vectors.
    pub seed: u64,
    /// Names of variables or of groups of them; all if empty.
    pub variables: Vec<String>,
}

impl CheckRequest {
    /// # Errors
    /// `InvalidArgument` naming what does not fit.
    pub(crate) fn resolve(
        self,
        parameterisation: &Parameterisation,
        limits: &Limits,
    ) -> Result<Request, ServiceError> {
        let Self { at, seed, variables } = self;
        let most = limits.check_designs.max(1);
        let designs = match at {
            CheckAt::Number(count) if (1..=most).contains(&count) => Designs::Number(count),
            CheckAt::Number(count) => {
                return Err(ServiceError::invalid(
                    "designs",
                    format!("{count} designs are outside 1..={most}"),
                ));
            }
            CheckAt::Design(values) => {
                let design = Design { values, control_points: Vec::new() };
                Designs::Given(Resolved::new(parameterisation, design)?.into_vector())
            }
        };
        let request = Request { designs, seed, variables };
        request.variables(parameterisation)?;
        Ok(request)
    }
}

/// Passes on what a check tells, thinned out and in order.
pub(crate) struct Watcher<F> {
    cancellation: Cancellation,
    /// What was told last.
    last: Mutex<f64>,
    tell: F,
}

impl<F: Fn(Progress) + Sync> Watcher<F> {
    pub fn new(cancellation: Cancellation, tell: F) -> Self {
        Self { cancellation, last: Mutex::new(f64::NEG_INFINITY), tell }
    }
}

impl<F: Fn(Progress) + Sync> Observer for Watcher<F> {
    fn progress(&self, fraction: f64, at: &str) {
        /// Smaller steps are not told.
        const STEP: f64 = 0.005;
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        if fraction >= *last + STEP {
            *last = fraction;
            (self.tell)(Progress { stage: "check", fraction, message: at.to_owned() });
        }
    }

    fn cancelled(&self) -> bool {
        self.cancellation.requested()
    }
}
