//! Solutions: the flow over one geometry at one Mach number.

use std::sync::Arc;

use moldline_host::{Cancellation, Claim, Progress, ServiceError};
use moldline_panel::Solution;

use crate::{
    configuration::{Configuration, points},
    progress::reporter,
};

/// The flow over one geometry at one Mach number, for every angle of attack.
#[derive(Debug)]
pub struct Solved {
    /// Hash of configuration, vertices and Mach number.
    pub id: String,
    /// Id of the configuration that it is a solution of.
    pub configuration: String,
    /// The solution with its factored system.
    pub solution: Arc<Solution>,
    /// Residual after each round of the solver.
    pub residuals: Vec<f64>,
    _claim: Claim,
}

/// The id of a solution. The same on every machine.
pub(crate) fn name(configuration: &Configuration, vertices: &[[f64; 3]], mach: f64) -> String {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"moldline panel analysis 1\n");
    hasher.update(configuration.id.as_bytes());
    hasher.update(&mach.to_le_bytes());
    points(&mut hasher, vertices);
    hasher.finalize().to_hex().to_string()
}

impl Solved {
    pub(crate) fn new(
        id: String,
        configuration: &Configuration,
        vertices: &[[f64; 3]],
        mach: f64,
        mut claim: Claim,
        cancellation: &Cancellation,
        tell: impl Fn(Progress) + Sync,
    ) -> Result<Self, ServiceError> {
        let reporter = reporter(cancellation.clone(), tell);
        let solution = match &configuration.merging {
            None => configuration.setup.solve(vertices, mach, &reporter)?,
            Some(merging) => {
                let merged = merging.positions(vertices)?;
                configuration.setup.solve(&merged, mach, &reporter).map_err(|error| merging.explain(error))?
            }
        };
        claim.shrink(solution.bytes());
        Ok(Self {
            id,
            configuration: configuration.id.clone(),
            solution: Arc::new(solution),
            residuals: reporter.residuals(),
            _claim: claim,
        })
    }
}
