//! Radial basis functions once more: the saddle-point system as it stands in eq. 16 and 17, dense, by LU decomposition.

use faer::{Mat, linalg::solvers::Solve};
use moldline_deform::{Kernel, Options, field::Field};
use moldline_mesh::Plane;
use rayon::prelude::*;

use crate::dual::{LANES, Real, Vector, constant, eps, number};

/// Points evaluated by one product.
const TILE: usize = 256;
/// Columns: three axes, value and derivatives.
const COLUMNS: usize = 3 * (1 + LANES);

/// The factorised system of a field.
pub struct System {
    kernel: Kernel,
    rounding: f64,
    centres: Vec<Real>,
    matrix: Mat<f64>,
    factor: faer::linalg::solvers::PartialPivLu<f64>,
}

/// `rounding`: c^2 of the linear kernel.
fn psi(kernel: Kernel, rounding: f64, r: f64) -> f64 {
    match kernel {
        Kernel::Linear => -(r * r + rounding).sqrt(),
        Kernel::Cubic => r.powi(3),
    }
}

impl System {
    /// The system over the centres of a field. `positions`: reference vertices, m.
    pub fn new(field: &Field, positions: &[Real], options: &Options) -> Self {
        let mut centres: Vec<Real> = field.training().iter().map(|t| positions[t.vertex as usize]).collect();
        for &i in field.images() {
            centres.push(Plane::y_zero().mirror(&centres[i as usize].into()).into());
        }
        // Centres in units of the whole: the entries stay near one. The interpolant does not depend on it.
        let low = centres.iter().fold(Real::repeat(f64::INFINITY), |low, c| low.inf(c));
        let high = centres.iter().fold(Real::repeat(f64::NEG_INFINITY), |high, c| high.sup(c));
        let scale = (high - low).max();
        let (kernel, n) = (options.kernel(), centres.len());
        let rounding = field.rounding();
        let between = |i: usize, j: usize| psi(kernel, rounding, (centres[i] - centres[j]).norm() / scale);
        let pairs = (0..n).flat_map(|i| (0..i).map(move |j| (i, j)));
        let mean = pairs.map(|(i, j)| between(i, j).abs()).sum::<f64>() / (0.5 * (n * (n - 1)) as f64);
        let scaled: Vec<Real> = centres.iter().map(|c| (c - 0.5 * (low + high)) / scale).collect();
        let affine = |i: usize, k: usize| if k == 0 { 1.0 } else { scaled[i][k - 1] };
        let matrix = Mat::from_fn(n + 4, n + 4, |i, j| match (i < n, j < n) {
            (true, true) if i == j => psi(kernel, rounding, 0.0) + options.regularisation * mean,
            (true, true) => between(i, j),
            (true, false) => affine(i, j - n),
            (false, true) => affine(j, i - n),
            (false, false) => 0.0,
        });
        let factor = matrix.partial_piv_lu();
        Self { kernel, rounding, centres, matrix, factor }
    }

    /// The interpolant of `data`, one datum for each training vertex and image, at `points`.
    pub fn interpolate(&self, data: &[Vector], points: &[Real]) -> Vec<Vector> {
        let n = self.centres.len();
        let right = Mat::from_fn(n + 4, COLUMNS, |i, column| {
            let (axis, part) = (column % 3, column / 3);
            match (data.get(i), part) {
                (None, _) => 0.0,
                (Some(datum), 0) => datum[axis].re,
                (Some(datum), _) => eps(&datum[axis], part - 1),
            }
        });
        let mut weights = self.factor.solve(&right);
        // One refinement: the residual of a system with close centres is rounded twice otherwise.
        let residual = &right - &self.matrix * &weights;
        weights += self.factor.solve(&residual);

        let low = self.centres.iter().fold(Real::repeat(f64::INFINITY), |low, c| low.inf(c));
        let high = self.centres.iter().fold(Real::repeat(f64::NEG_INFINITY), |high, c| high.sup(c));
        let (scale, middle) = ((high - low).max(), 0.5 * (low + high));
        points
            .par_chunks(TILE)
            .flat_map_iter(|points| {
                let rows = Mat::from_fn(points.len(), n + 4, |i, j| match j.checked_sub(n) {
                    None => psi(self.kernel, self.rounding, (points[i] - self.centres[j]).norm() / scale),
                    Some(0) => 1.0,
                    Some(k) => (points[i][k - 1] - middle[k - 1]) / scale,
                });
                let values = &rows * &weights;
                (0..points.len())
                    .map(|i| {
                        Vector::from_fn(|axis, _| {
                            number(values[(i, axis)], |k| values[(i, 3 * (k + 1) + axis)])
                        })
                    })
                    .collect::<Vec<_>>()
            })
            .collect()
    }
}

/// The data of a field: combinations of what the seams do and what the component does.
pub fn data(field: &Field, motions: &[Vector], follow: impl Fn(u32) -> Vector) -> Vec<Vector> {
    let mut data: Vec<Vector> = field
        .training()
        .iter()
        .map(|t| {
            let seams =
                t.seams.iter().fold(Vector::zeros(), |sum, &(k, w)| sum + motions[k as usize] * constant(w));
            let rest = 1.0 - t.alpha();
            if rest == 0.0 { seams } else { seams + follow(t.vertex) * constant(rest) }
        })
        .collect();
    for &i in field.images() {
        let image = data[i as usize];
        let sign = |axis: usize| field.mirror_signs().get(axis).copied().unwrap_or(0.0);
        data.push(Vector::from_fn(|axis, _| image[axis] * sign(axis)));
    }
    data
}
