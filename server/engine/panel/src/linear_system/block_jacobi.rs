//! The block Jacobi preconditioner: exact factors of the blocks of panels that lie near each other.

use faer::Mat;
use moldline_mesh::Vector3;
use rayon::prelude::*;

use super::{
    lu::Factor,
    operator::{Inverse, Operator},
};
use crate::{Monitor, PanelError, Stage, clusters::bisect};

/// Panels of a block at most.
pub(super) const BLOCK: usize = 400;

/// Factors of the blocks.
#[derive(Debug)]
pub(super) struct BlockJacobi {
    members: Vec<Vec<u32>>,
    factors: Vec<Factor<f64>>,
}

impl BlockJacobi {
    /// `centres` has a point of every row.
    pub fn new(
        operator: &(dyn Operator + Sync),
        centres: &[Vector3],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Self, PanelError> {
        let mut members = Vec::new();
        bisect((0..centres.len() as u32).collect(), centres, BLOCK, &mut members);
        let factors: Vec<Result<Factor<_>, PanelError>> = members
            .par_iter()
            .map(|members| Factor::new(operator.block(members), |_| !monitor.cancelled()))
            .collect();
        Ok(Self { members, factors: factors.into_iter().collect::<Result<_, _>>()? })
    }

    fn solve_column(&self, b: &[f64], transposed: bool, monitor: &dyn Monitor<Stage>) -> Vec<f64> {
        let parts: Vec<Mat<f64>> = self
            .members
            .par_iter()
            .zip(&self.factors)
            .map(|(members, factor)| {
                let mut part = Mat::from_fn(members.len(), 1, |i, _| b[members[i] as usize]);
                factor.solve_in_place(&mut part, transposed, monitor);
                part
            })
            .collect();
        let mut x = vec![0.0; b.len()];
        for (members, part) in self.members.iter().zip(&parts) {
            members.iter().enumerate().for_each(|(i, m)| x[*m as usize] = part[(i, 0)]);
        }
        x
    }
}

impl Inverse for BlockJacobi {
    fn solve(&self, right: &[Vec<f64>], transposed: bool, monitor: &dyn Monitor<Stage>) -> Vec<Vec<f64>> {
        right.iter().map(|b| self.solve_column(b, transposed, monitor)).collect()
    }
}
