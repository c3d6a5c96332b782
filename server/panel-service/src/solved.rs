//! Solutions: what is kept of the flow over one geometry at one Mach number.

use std::sync::Arc;

use moldline_panel::Solution;
use moldline_service::{Cancellation, Progress, ServiceError};

use crate::{
    configuration::{Configuration, points},
    memory::Claim,
    refusal::refused,
    reporter::Reporter,
};

/// The flow over one geometry at one Mach number, for every angle of attack.
#[derive(Debug)]
pub struct Solved {
    /// Hash of configuration, vertices and Mach number.
    pub id: String,
    /// The solution with its factored system.
    pub solution: Arc<Solution>,
    /// Residual after each round.
    pub residuals: Vec<f64>,
    _claim: Claim,
}

/// The name of a solution. The same on every machine.
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
        let reporter = Reporter::new(cancellation.clone(), tell);
        let solution = configuration.setup.solve(vertices, mach, &reporter).map_err(refused)?;
        claim.shrink(solution.bytes());
        Ok(Self { id, solution: Arc::new(solution), residuals: reporter.residuals(), _claim: claim })
    }
}
