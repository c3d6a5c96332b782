//! The choice of a solver, and solutions to one tolerance whichever it is.

use moldline_mesh::Vector3;

use super::{
    block_jacobi::{BLOCK, BlockJacobi},
    gmres::{ITERATIONS, Preconditioned},
    lu::Factor,
    matrix::Matrix,
    operator::{Operator, Solved},
    refinement::refine,
};
use crate::{Monitor, PanelError, Solver, Stage};

/// Unknowns up to which the automatic choice factorises in double precision.
const DOUBLE: usize = 3000;
/// Unknowns up to which it factorises at all.
const SINGLE: usize = 12_000;

impl Solver {
    /// The choice for so many unknowns.
    pub(crate) fn resolve(self, unknowns: usize) -> Self {
        match self {
            Self::Automatic if unknowns <= DOUBLE => Self::Double,
            Self::Automatic if unknowns <= SINGLE => Self::Single,
            Self::Automatic => Self::Iterative,
            chosen => chosen,
        }
    }

    /// Bytes of matrix and factors.
    pub(crate) fn bytes(self, unknowns: usize) -> u64 {
        let entries = unknowns as u64 * unknowns as u64;
        Matrix::bytes(unknowns)
            + match self.resolve(unknowns) {
                Self::Double => 8 * entries,
                Self::Single => 4 * entries,
                _ => 8 * unknowns as u64 * (BLOCK + ITERATIONS + 1) as u64,
            }
    }
}

/// A linear system, ready to be solved for any right-hand side.
#[derive(Debug)]
pub(crate) struct System {
    operator: Matrix,
    method: Method,
}

#[derive(Debug)]
enum Method {
    Double(Factor<f64>),
    Single(Factor<f32>),
    Iterative(BlockJacobi),
}

impl System {
    /// `centres` has a point of every row: rows of near points are nearly coupled.
    pub fn new(
        operator: Matrix,
        solver: Solver,
        centres: &[Vector3],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Self, PanelError> {
        let report = |fraction: f64| {
            monitor.progress(Stage::Factorisation, fraction);
            !monitor.cancelled()
        };
        let method = match solver.resolve(operator.size()) {
            Solver::Double | Solver::Automatic => {
                Method::Double(Factor::new(operator.to_dense(|x| x), report)?)
            }
            Solver::Single => Method::Single(Factor::new(operator.to_dense(|x| x as f32), report)?),
            Solver::Iterative => Method::Iterative(BlockJacobi::new(&operator, centres, monitor)?),
        };
        monitor.progress(Stage::Factorisation, 1.0);
        Ok(Self { operator, method })
    }

    /// Solves `A x = b`, or `A^T x = b`, for every column b.
    ///
    /// # Errors
    /// [`PanelError::NotConverged`] if a residual stays above `tolerance`; cancelled.
    pub fn solve(
        &self,
        right: &[Vec<f64>],
        transposed: bool,
        tolerance: f64,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Solved, PanelError> {
        let operator = &self.operator;
        let solved = match &self.method {
            Method::Double(factor) => refine(operator, factor, right, transposed, tolerance, monitor)?,
            Method::Single(factor) => refine(operator, factor, right, transposed, tolerance, monitor)?,
            Method::Iterative(inverse) => {
                Preconditioned { operator, inverse, transposed }.gmres(right, tolerance, monitor)?
            }
        };
        monitor.progress(Stage::Solution, 1.0);
        if solved.residual <= tolerance {
            Ok(solved)
        } else {
            Err(PanelError::NotConverged { residual: solved.residual, rounds: solved.rounds, tolerance })
        }
    }
}
