//! Checks of a set-up's derivatives against an independent evaluation, on request.

use std::sync::{Arc, Mutex, PoisonError};

use moldline_check::{Designs, Observer, Report, Request};
use moldline_host::{
    Cancellation, Completed, Joined, Principal, Product, Progress, Reports, Role, ServiceError, Task, Ticket,
    Timing,
};
use moldline_parameterisation::Parameterisation;

use crate::{
    limits::Limits,
    linearisation::{Design, Resolved, Values},
    service::Service,
    setups::SetupView,
};

/// The designs at which derivatives are checked.
#[derive(Clone, Debug, PartialEq)]
pub enum CheckAt {
    /// The baseline and random designs far from it: their total number.
    Number(usize),
    /// One design.
    Design(Values),
}

/// A request for a check.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckRequest {
    /// The designs.
    pub at: CheckAt,
    /// Seed of the random designs and vectors.
    pub seed: u64,
    /// Names of variables or of groups of them; all if empty.
    pub variables: Vec<String>,
}

impl CheckRequest {
    /// # Errors
    /// `InvalidArgument` naming the invalid field.
    fn resolve(self, parameterisation: &Parameterisation, limits: &Limits) -> Result<Request, ServiceError> {
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

impl Service {
    /// Checks the derivatives of a set-up. Concurrent requests for the same check share it. Dropping the future abandons it;
    /// the check ends when nobody waits for it.
    ///
    /// # Errors
    /// `NotFound`, `InvalidArgument` naming the invalid field, `FailedPrecondition` if the engine cannot reach a design,
    /// `ResourceExhausted` if other checks are in progress or the queue is full.
    pub async fn check(
        &self,
        caller: &Principal,
        setup_id: &str,
        request: CheckRequest,
        tell: impl FnMut(Progress),
    ) -> Result<Arc<Product<Report>>, ServiceError> {
        caller.need(Role::User)?;
        let SetupView { setup, .. } = self.get_setup(caller, setup_id).await?;
        let request = request.resolve(setup.engine.parameterisation(), &self.limits)?;
        let key = (setup.id.clone(), format!("{request:?}"));
        let id = Some(setup.id.to_string());
        // Dual numbers of all steps, besides what the linearisation takes.
        let memory = 4 * setup.engine.deformation_memory();
        let task = Task { kind: "check", tenant: caller.tenant.clone(), setup: id, session: None, memory };
        let work = |reports: Reports<Product<Report>>| {
            let place = self.check_places.take(&caller.tenant, "the check", 1);
            let pool = Arc::clone(&self.pool);
            async move {
                let _place = place?;
                let work = move |ticket: &Ticket| {
                    let reporter = CheckReporter::new(ticket.cancellation().clone(), |progress| {
                        ticket.progress(&progress);
                        reports.tell(progress);
                    });
                    Ok(Report::new(&setup.engine, &request, &reporter)?)
                };
                let Completed { value, queued, ran } = pool.run(task, work).await?;
                Ok(Product { value, timing: Timing { queued, engine: ran } })
            }
        };
        match self.checks.join(key, || None, work, |_| {}) {
            Joined::Found(report) => Ok(report),
            Joined::Following(follower) | Joined::Started(follower) => follower.wait(tell).await,
        }
    }
}

/// Passes on the progress of a check, thinned out and in order.
struct CheckReporter<F> {
    cancellation: Cancellation,
    /// Fraction of the last report.
    last: Mutex<f64>,
    tell: F,
}

impl<F: Fn(Progress) + Sync> CheckReporter<F> {
    pub fn new(cancellation: Cancellation, tell: F) -> Self {
        Self { cancellation, last: Mutex::new(f64::NEG_INFINITY), tell }
    }
}

impl<F: Fn(Progress) + Sync> Observer for CheckReporter<F> {
    fn progress(&self, fraction: f64, at: &str) {
        /// Smaller steps are not reported.
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
