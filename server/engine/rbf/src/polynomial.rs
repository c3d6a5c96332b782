//! The affine functions of the interpolant, and the QR decomposition of their values at the centres.

use faer::Mat;

use crate::Vector3;

/// Dimension of the space of affine functions.
pub(crate) const AFFINE: usize = 4;
/// Columns of `P` are dependent if what is left of one is less than this, as a root mean square in the unit box.
const DEPENDENT: f64 = 1e-9;

/// The affine functions `[1, x]` at a point.
pub(crate) fn monomials(x: &Vector3) -> [f64; AFFINE] {
    [1.0, x.x, x.y, x.z]
}

/// `P = Q [R; 0]` of the matrix `P` whose rows are [`monomials`], by Householder reflections: `Q` is their product in order.
#[derive(Clone, Debug)]
pub(crate) struct AffineQr {
    /// Householder vectors, of unit norm.
    reflectors: Vec<Vec<f64>>,
    /// `R`, upper triangular.
    triangle: [[f64; AFFINE]; AFFINE],
}

impl AffineQr {
    /// `None` if the columns of `P` are dependent: points in one plane.
    pub fn new(points: &[Vector3]) -> Option<Self> {
        let mut columns: Vec<Vec<f64>> = vec![vec![1.0; points.len()]];
        columns.extend((0..3).map(|axis| points.iter().map(|c| c[axis]).collect()));
        let mut reflectors: Vec<Vec<f64>> = Vec::with_capacity(AFFINE);
        let mut triangle = [[0.0; AFFINE]; AFFINE];
        for k in 0..AFFINE {
            let column = &mut columns[k];
            for v in &reflectors {
                reflect(v, column);
            }
            let norm = column[k..].iter().map(|x| x * x).sum::<f64>().sqrt();
            if norm <= DEPENDENT * (points.len() as f64).sqrt() {
                return None;
            }
            let diagonal = if column[k] > 0.0 { -norm } else { norm };
            let mut v = vec![0.0; points.len()];
            v[k..].copy_from_slice(&column[k..]);
            v[k] -= diagonal;
            let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
            v.iter_mut().for_each(|x| *x /= length);
            for i in 0..k {
                triangle[i][k] = column[i];
            }
            triangle[k][k] = diagonal;
            reflectors.push(v);
        }
        Some(Self { reflectors, triangle })
    }

    /// `Q^T M` in place.
    pub fn apply_transpose(&self, matrix: &mut Mat<f64>) {
        for column in 0..matrix.ncols() {
            let values = matrix.col_as_slice_mut(column);
            self.reflectors.iter().for_each(|v| reflect(v, values));
        }
    }

    /// `Q M` in place.
    pub fn apply(&self, matrix: &mut Mat<f64>) {
        for column in 0..matrix.ncols() {
            let values = matrix.col_as_slice_mut(column);
            self.reflectors.iter().rev().for_each(|v| reflect(v, values));
        }
    }

    /// `Q^T M Q` of a symmetric matrix, in place: `M - v q^T - q v^T` for each reflector.
    pub fn conjugate(&self, matrix: &mut Mat<f64>) {
        let size = matrix.nrows();
        for v in &self.reflectors {
            let mut q: Vec<f64> = (0..size)
                .map(|j| 2.0 * matrix.col_as_slice(j).iter().zip(v).map(|(m, v)| m * v).sum::<f64>())
                .collect();
            let along = q.iter().zip(v).map(|(q, v)| q * v).sum::<f64>();
            q.iter_mut().zip(v).for_each(|(q, v)| *q -= along * v);
            for j in 0..size {
                let (v_j, q_j) = (v[j], q[j]);
                for (m, (v_i, q_i)) in matrix.col_as_slice_mut(j).iter_mut().zip(v.iter().zip(&q)) {
                    *m -= v_i * q_j + q_i * v_j;
                }
            }
        }
    }

    /// Solves `R^T y = b`.
    pub fn solve_transpose(&self, b: [f64; AFFINE]) -> [f64; AFFINE] {
        let mut y = b;
        for i in 0..AFFINE {
            let known: f64 = (0..i).map(|k| self.triangle[k][i] * y[k]).sum();
            y[i] = (y[i] - known) / self.triangle[i][i];
        }
        y
    }

    /// Solves `R y = b`.
    pub fn solve(&self, b: [f64; AFFINE]) -> [f64; AFFINE] {
        let mut y = b;
        for k in (0..AFFINE).rev() {
            let later: f64 = (k + 1..AFFINE).map(|l| self.triangle[k][l] * y[l]).sum();
            y[k] = (y[k] - later) / self.triangle[k][k];
        }
        y
    }
}

/// `(I - 2 v v^T) x` in place, for `v` of unit norm.
fn reflect(v: &[f64], x: &mut [f64]) {
    let twice = 2.0 * v.iter().zip(&*x).map(|(a, b)| a * b).sum::<f64>();
    x.iter_mut().zip(v).for_each(|(x, v)| *x -= twice * v);
}
