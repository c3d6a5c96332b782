//! GMRES (Saad and Schultz, SIAM J. Sci. Stat. Comput. 7, 1986), preconditioned from the right, column by column.

use super::operator::{Inverse, Operator, Solved, maximum};
use crate::{Monitor, PanelError, Stage, progress::poll};

/// Iterations of a column at most.
pub(super) const ITERATIONS: usize = 200;

/// An operator and the approximate inverse that makes its iterations converge.
pub(super) struct Preconditioned<'a> {
    pub operator: &'a dyn Operator,
    pub inverse: &'a dyn Inverse,
    pub transposed: bool,
}

impl Preconditioned<'_> {
    /// Solves for every column, in cycles.
    pub fn gmres(
        &self,
        right: &[Vec<f64>],
        tolerance: f64,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Solved, PanelError> {
        let mut solved = Solved { columns: Vec::with_capacity(right.len()), residual: 0.0, rounds: 0 };
        for b in right {
            let size = maximum(b);
            let mut x = vec![0.0; b.len()];
            let mut r = b.clone();
            let mut iterations = 0;
            let mut residual = if size > 0.0 { 1.0 } else { 0.0 };
            // The estimate of one cycle is in the Euclidean norm: cycles until the true residual agrees.
            while residual > tolerance && iterations < ITERATIONS {
                let dx = self.cycle(&r, 0.3 * tolerance * size, &mut iterations, monitor)?;
                x.iter_mut().zip(dx).for_each(|(x, dx)| *x += dx);
                let product = self.times(&x);
                r.iter_mut().zip(b.iter().zip(product)).for_each(|(r, (b, p))| *r = b - p);
                let before = residual;
                residual = maximum(&r) / size;
                if residual.is_nan() || residual > 0.5 * before {
                    break;
                }
            }
            solved.residual = solved.residual.max(residual);
            solved.rounds = solved.rounds.max(iterations);
            solved.columns.push(x);
        }
        poll(monitor)?;
        Ok(solved)
    }

    /// One cycle from zero, until the residual is down to `aim` in the Euclidean norm.
    fn cycle(
        &self,
        b: &[f64],
        aim: f64,
        iterations: &mut usize,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<f64>, PanelError> {
        let norm = dot(b, b).sqrt();
        let mut basis = vec![b.iter().map(|x| x / norm).collect::<Vec<f64>>()];
        let mut hessenberg = Hessenberg::new(norm);
        while hessenberg.residual() > aim && *iterations < ITERATIONS {
            poll(monitor)?;
            let mut v = self.times(&self.solve(&basis[basis.len() - 1], monitor));
            let column = orthogonalise(&mut v, &basis);
            let next = dot(&v, &v).sqrt();
            hessenberg.push(column, next);
            *iterations += 1;
            monitor.residual(*iterations, hessenberg.residual() / norm);
            if next <= 0.0 {
                break;
            }
            basis.push(v.into_iter().map(|x| x / next).collect());
        }
        let mut sum = vec![0.0; b.len()];
        for (q, y) in basis.iter().zip(hessenberg.solve()) {
            sum.iter_mut().zip(q).for_each(|(s, q)| *s += y * q);
        }
        Ok(self.solve(&sum, monitor))
    }

    fn times(&self, x: &Vec<f64>) -> Vec<f64> {
        self.operator.times(std::slice::from_ref(x), self.transposed).swap_remove(0)
    }

    fn solve(&self, b: &Vec<f64>, monitor: &dyn Monitor<Stage>) -> Vec<f64> {
        self.inverse.solve(std::slice::from_ref(b), self.transposed, monitor).swap_remove(0)
    }
}

/// Makes `v` orthogonal to the basis; its components along it. Gram and Schmidt twice: orthogonal to rounding.
fn orthogonalise(v: &mut [f64], basis: &[Vec<f64>]) -> Vec<f64> {
    let mut column = Vec::with_capacity(basis.len() + 1);
    for pass in 0..2 {
        for (k, q) in basis.iter().enumerate() {
            let h = dot(q, v);
            v.iter_mut().zip(q).for_each(|(v, q)| *v -= h * q);
            if pass == 0 { column.push(h) } else { column[k] += h }
        }
    }
    column
}

/// The least-squares problem of a Hessenberg matrix, kept triangular by Givens rotations.
struct Hessenberg {
    triangle: Vec<Vec<f64>>,
    /// Cosines and sines.
    rotations: Vec<[f64; 2]>,
    /// The rotated right-hand side; the last one is the residual.
    right: Vec<f64>,
}

impl Hessenberg {
    fn new(norm: f64) -> Self {
        Self { triangle: Vec::new(), rotations: Vec::new(), right: vec![norm] }
    }

    fn residual(&self) -> f64 {
        self.right[self.right.len() - 1].abs()
    }

    /// Adds a column whose entry below the diagonal is `next`.
    fn push(&mut self, mut column: Vec<f64>, next: f64) {
        for (k, [c, s]) in self.rotations.iter().enumerate() {
            let (one, two) = (column[k], column[k + 1]);
            (column[k], column[k + 1]) = (c * one + s * two, c * two - s * one);
        }
        let last = column.len() - 1;
        let length = column[last].hypot(next);
        let [c, s] = if length > 0.0 { [column[last] / length, next / length] } else { [1.0, 0.0] };
        column[last] = length;
        self.rotations.push([c, s]);
        self.triangle.push(column);
        let g = self.right[last];
        self.right[last] = c * g;
        self.right.push(-s * g);
    }

    /// The coefficients of the basis.
    fn solve(self) -> Vec<f64> {
        let count = self.triangle.len();
        let mut y = self.right;
        y.truncate(count);
        for k in (0..count).rev() {
            let known: f64 = (k + 1..count).map(|j| self.triangle[j][k] * y[j]).sum();
            y[k] = (y[k] - known) / self.triangle[k][k];
        }
        y
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
