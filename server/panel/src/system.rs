//! Solving with the matrix and with its transpose, to one tolerance whatever the method.

use faer::Mat;
use moldline_mesh::Vector3;
use rayon::prelude::*;

use crate::{Monitor, PanelError, Solver, Stage, lu::Factor, matrix::Matrix, topology::bisect};

/// Unknowns up to which the automatic choice factorises in double precision.
const DOUBLE: usize = 3000;
/// Unknowns up to which it factorises at all.
const SINGLE: usize = 12_000;
/// Rounds of refinement.
const ROUNDS: usize = 10;
/// Iterations of GMRES.
const ITERATIONS: usize = 200;
/// Panels of a block of the preconditioner at most.
const BLOCK: usize = 400;

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

/// A matrix, and what solves with it.
#[derive(Debug)]
pub(crate) struct System {
    matrix: Matrix,
    factor: Factors,
}

#[derive(Debug)]
enum Factors {
    Double(Factor<f64>),
    Single(Factor<f32>),
    Blocks(Blocks),
}

/// Solutions, and how good they are.
#[derive(Debug)]
pub(crate) struct Solved {
    pub columns: Vec<Vec<f64>>,
    /// Largest residual of a column relative to its right-hand side (maximum norms).
    pub residual: f64,
    /// Rounds of refinement, or iterations, of the slowest column.
    pub rounds: usize,
}

impl System {
    pub fn new(
        matrix: Matrix,
        solver: Solver,
        centres: &[Vector3],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Self, PanelError> {
        let report = |fraction: f64| {
            monitor.progress(Stage::Factorisation, fraction);
            !monitor.cancelled()
        };
        let factor = match solver.resolve(matrix.size()) {
            Solver::Double | Solver::Automatic => {
                Factors::Double(Factor::new(matrix.to_dense(|x| x), report)?)
            }
            Solver::Single => Factors::Single(Factor::new(matrix.to_dense(|x| x as f32), report)?),
            Solver::Iterative => Factors::Blocks(Blocks::new(&matrix, centres)?),
        };
        monitor.progress(Stage::Factorisation, 1.0);
        Ok(Self { matrix, factor })
    }

    /// Solves `A x = b`, or `A^T x = b`, for every column.
    pub fn solve(
        &self,
        right: &[Vec<f64>],
        transposed: bool,
        tolerance: f64,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Solved, PanelError> {
        let solved = match &self.factor {
            Factors::Blocks(blocks) => self.gmres(blocks, right, transposed, tolerance, monitor)?,
            _ => self.refine(right, transposed, tolerance, monitor)?,
        };
        monitor.progress(Stage::Solution, 1.0);
        if solved.residual <= tolerance {
            Ok(solved)
        } else {
            Err(PanelError::NotConverged { residual: solved.residual, rounds: solved.rounds, tolerance })
        }
    }

    fn times(&self, columns: &[Vec<f64>], transposed: bool) -> Vec<Vec<f64>> {
        if transposed { self.matrix.transposed_times(columns) } else { self.matrix.times(columns) }
    }

    fn refine(
        &self,
        right: &[Vec<f64>],
        transposed: bool,
        tolerance: f64,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Solved, PanelError> {
        let sizes: Vec<f64> = right.iter().map(|b| largest(b)).collect();
        let mut columns = vec![vec![0.0; self.matrix.size()]; right.len()];
        let mut residuals = right.to_vec();
        let mut least = f64::INFINITY;
        for round in 0..=ROUNDS {
            let residual = residuals
                .iter()
                .zip(&sizes)
                .map(|(r, size)| if *size > 0.0 { largest(r) / size } else { 0.0 })
                .fold(0.0, f64::max);
            if round > 0 {
                monitor.residual(round, residual);
            }
            monitor.progress(Stage::Solution, round as f64 / ROUNDS as f64);
            // One round more than the tolerance asks for costs little and leaves rounding errors only.
            let settled = residual <= tolerance && (residual > 0.1 * least || residual <= 0.01 * tolerance);
            if settled || residual.is_nan() || round == ROUNDS || (residual > 0.5 * least && round > 0) {
                return Ok(Solved { columns, residual, rounds: round });
            }
            if monitor.cancelled() {
                return Err(PanelError::Cancelled);
            }
            least = residual;
            let corrections = self.factor.solve(&residuals, transposed);
            for (x, dx) in columns.iter_mut().zip(corrections) {
                x.iter_mut().zip(dx).for_each(|(x, dx)| *x += dx);
            }
            let products = self.times(&columns, transposed);
            for ((r, b), p) in residuals.iter_mut().zip(right).zip(products) {
                r.iter_mut().zip(b.iter().zip(p)).for_each(|(r, (b, p))| *r = b - p);
            }
        }
        unreachable!("the last round returns")
    }

    /// GMRES (Saad and Schultz), preconditioned from the right, column by column.
    fn gmres(
        &self,
        blocks: &Blocks,
        right: &[Vec<f64>],
        transposed: bool,
        tolerance: f64,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Solved, PanelError> {
        let mut solved = Solved { columns: Vec::with_capacity(right.len()), residual: 0.0, rounds: 0 };
        for b in right {
            let size = largest(b);
            let mut x = vec![0.0; b.len()];
            let mut r = b.clone();
            let mut iterations = 0;
            let mut residual = if size > 0.0 { 1.0 } else { 0.0 };
            // The estimate of one cycle is in the Euclidean norm: cycles until the true residual agrees.
            while residual > tolerance && iterations < ITERATIONS {
                let aim = 0.3 * tolerance * size;
                let dx = self.cycle(blocks, &r, transposed, aim, &mut iterations, monitor)?;
                x.iter_mut().zip(dx).for_each(|(x, dx)| *x += dx);
                let product = self.times(std::slice::from_ref(&x), transposed).swap_remove(0);
                r.iter_mut().zip(b.iter().zip(product)).for_each(|(r, (b, p))| *r = b - p);
                let before = residual;
                residual = largest(&r) / size;
                if residual.is_nan() || residual > 0.5 * before {
                    break;
                }
            }
            solved.residual = solved.residual.max(residual);
            solved.rounds = solved.rounds.max(iterations);
            solved.columns.push(x);
        }
        Ok(solved)
    }

    /// One cycle of GMRES from zero.
    fn cycle(
        &self,
        blocks: &Blocks,
        b: &[f64],
        transposed: bool,
        aim: f64,
        iterations: &mut usize,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<f64>, PanelError> {
        let norm = dot(b, b).sqrt();
        let mut basis = vec![b.iter().map(|x| x / norm).collect::<Vec<f64>>()];
        // Columns of the Hessenberg matrix, rotated to a triangle; the rotations; the rotated right-hand side.
        let mut triangle: Vec<Vec<f64>> = Vec::new();
        let mut rotations: Vec<[f64; 2]> = Vec::new();
        let mut rotated = vec![norm];
        while rotated[rotated.len() - 1].abs() > aim && *iterations < ITERATIONS {
            if monitor.cancelled() {
                return Err(PanelError::Cancelled);
            }
            let z = blocks.solve(&basis[basis.len() - 1], transposed);
            let mut v = self.times(&[z], transposed).swap_remove(0);
            let mut column = Vec::with_capacity(basis.len() + 1);
            // Gram-Schmidt twice: orthogonal to rounding.
            for pass in 0..2 {
                for (k, q) in basis.iter().enumerate() {
                    let h = dot(q, &v);
                    v.iter_mut().zip(q).for_each(|(v, q)| *v -= h * q);
                    if pass == 0 { column.push(h) } else { column[k] += h }
                }
            }
            let next = dot(&v, &v).sqrt();
            for (k, [c, s]) in rotations.iter().enumerate() {
                let (one, two) = (column[k], column[k + 1]);
                (column[k], column[k + 1]) = (c * one + s * two, c * two - s * one);
            }
            let last = column.len() - 1;
            let length = column[last].hypot(next);
            let [c, s] = if length > 0.0 { [column[last] / length, next / length] } else { [1.0, 0.0] };
            column[last] = length;
            rotations.push([c, s]);
            triangle.push(column);
            let g = rotated[last];
            rotated[last] = c * g;
            rotated.push(-s * g);
            *iterations += 1;
            monitor.residual(*iterations, (s * g).abs() / norm);
            if next <= 0.0 {
                break;
            }
            basis.push(v.into_iter().map(|x| x / next).collect());
        }
        let count = triangle.len();
        let mut y = rotated;
        for k in (0..count).rev() {
            let known: f64 = (k + 1..count).map(|j| triangle[j][k] * y[j]).sum();
            y[k] = (y[k] - known) / triangle[k][k];
        }
        let mut sum = vec![0.0; b.len()];
        for (q, y) in basis.iter().zip(&y[..count]) {
            sum.iter_mut().zip(q).for_each(|(s, q)| *s += y * q);
        }
        Ok(blocks.solve(&sum, transposed))
    }
}

impl Factors {
    fn solve(&self, right: &[Vec<f64>], transposed: bool) -> Vec<Vec<f64>> {
        match self {
            Self::Double(factor) => {
                let mut columns = Mat::from_fn(right[0].len(), right.len(), |i, j| right[j][i]);
                if transposed {
                    factor.solve_transposed(&mut columns)
                } else {
                    factor.solve(&mut columns)
                }
                (0..right.len()).map(|j| columns.col_as_slice(j).to_vec()).collect()
            }
            Self::Single(factor) => {
                // Scaled, so that a small residual does not underflow.
                let scales: Vec<f64> =
                    right.iter().map(|b| largest(b)).map(|s| if s > 0.0 { s } else { 1.0 }).collect();
                let mut columns =
                    Mat::from_fn(right[0].len(), right.len(), |i, j| (right[j][i] / scales[j]) as f32);
                if transposed {
                    factor.solve_transposed(&mut columns)
                } else {
                    factor.solve(&mut columns)
                }
                let column =
                    |j: usize| columns.col_as_slice(j).iter().map(|x| f64::from(*x) * scales[j]).collect();
                (0..right.len()).map(column).collect()
            }
            Self::Blocks(blocks) => right.iter().map(|b| blocks.solve(b, transposed)).collect(),
        }
    }
}

/// Exact factors of the blocks of panels that lie near each other.
#[derive(Debug)]
struct Blocks {
    members: Vec<Vec<u32>>,
    factors: Vec<Factor<f64>>,
}

impl Blocks {
    fn new(matrix: &Matrix, centres: &[Vector3]) -> Result<Self, PanelError> {
        let mut members = Vec::new();
        bisect((0..centres.len() as u32).collect(), centres, BLOCK, &mut members);
        let factors: Vec<Result<Factor<_>, PanelError>> = members
            .par_iter()
            .map(|m| {
                let block = Mat::from_fn(m.len(), m.len(), |i, j| matrix.get(m[i] as usize, m[j] as usize));
                Factor::new(block, |_| true)
            })
            .collect();
        Ok(Self { members, factors: factors.into_iter().collect::<Result<_, _>>()? })
    }

    fn solve(&self, b: &[f64], transposed: bool) -> Vec<f64> {
        let parts: Vec<Mat<f64>> = self
            .members
            .par_iter()
            .zip(&self.factors)
            .map(|(members, factor)| {
                let mut part = Mat::from_fn(members.len(), 1, |i, _| b[members[i] as usize]);
                if transposed {
                    factor.solve_transposed(&mut part)
                } else {
                    factor.solve(&mut part)
                }
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

fn largest(x: &[f64]) -> f64 {
    x.iter().fold(0.0, |m, x| if x.is_nan() { f64::NAN } else { f64::max(m, x.abs()) })
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
