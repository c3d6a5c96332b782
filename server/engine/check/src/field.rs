//! Radial basis functions a second time: the saddle-point system as it stands in eq. 16 and 17, dense, by LU decomposition,
//! entries and sums in double-double arithmetic.

use faer::{Mat, linalg::solvers::Solve};
use moldline_deform::{Kernel, Options, chain::field::Field};
use moldline_mesh::Plane;
use rayon::prelude::*;

use crate::{
    double_double::{DoubleDouble, product_error, split, two_sum},
    dual::{LANES, Real, Vector, constant, eps, number},
};

/// Columns: three axes, value and derivatives.
const COLUMNS: usize = 3 * (1 + LANES);
/// Refinements of a solution.
const REFINEMENTS: usize = 3;

/// The factorised system of a field.
pub struct System {
    kernel: Kernel,
    /// c^2 of the multiquadric.
    shape_squared: f64,
    /// What is added to the diagonal.
    regularisation: f64,
    /// A power of two, so that nothing is rounded.
    scale: f64,
    centres: Vec<Real>,
    factor: faer::linalg::solvers::PartialPivLu<f64>,
}

/// A row of the solution: weights of one centre in all columns, or the coefficients of one affine function.
#[derive(Clone)]
struct Row {
    high: [f64; COLUMNS],
    /// Veltkamp's halves of `high`.
    upper: [f64; COLUMNS],
    lower: [f64; COLUMNS],
    low: [f64; COLUMNS],
}

impl Row {
    fn new(high: [f64; COLUMNS], low: [f64; COLUMNS]) -> Self {
        let halves = high.map(split);
        Self { high, upper: halves.map(|[upper, _]| upper), lower: halves.map(|[_, lower]| lower), low }
    }
}

impl System {
    /// The system over the centres of a field. `positions`: reference vertices, m.
    pub fn new(field: &Field, positions: &[Real], options: &Options) -> Self {
        let mut centres: Vec<Real> = field.training().iter().map(|t| positions[t.vertex as usize]).collect();
        for &i in field.images() {
            centres.push(Plane::y_zero().mirror(&centres[i as usize].into()).into());
        }
        let low = centres.iter().fold(Real::repeat(f64::INFINITY), |low, c| low.inf(c));
        let high = centres.iter().fold(Real::repeat(f64::NEG_INFINITY), |high, c| high.sup(c));
        let extent = (high - low).max();
        // Centres in units of about their extent: the entries stay near one. The interpolant does not depend on the scale.
        let scale = 2_f64.powi(-extent.log2().round() as i32);
        let n = centres.len();
        let mut system = Self {
            kernel: options.kernel(),
            shape_squared: field.shape_squared() * (extent * scale).powi(2),
            regularisation: 0.0,
            scale,
            centres: centres.iter().map(|c| c * scale).collect(),
            factor: Mat::<f64>::identity(0, 0).partial_piv_lu(),
        };
        let between = |i: usize, j: usize| system.psi(&system.centres[i], j).high;
        let pairs = (0..n).flat_map(|i| (0..i).map(move |j| (i, j)));
        let mean = pairs.map(|(i, j)| between(i, j).abs()).sum::<f64>() / (0.5 * (n * (n - 1)) as f64);
        system.regularisation = options.regularisation * mean;
        let mut matrix = Mat::<f64>::zeros(n + 4, n + 4);
        for i in 0..n + 4 {
            system.row(i).iter().enumerate().for_each(|(j, x)| matrix[(i, j)] = x.high);
        }
        system.factor = matrix.partial_piv_lu();
        system
    }

    fn psi(&self, x: &Real, centre: usize) -> DoubleDouble {
        let c = &self.centres[centre];
        let d = [0, 1, 2].map(|axis| two_sum(x[axis], -c[axis]));
        let squared = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
        match self.kernel {
            Kernel::Multiquadric => DoubleDouble::default() - (squared + self.shape_squared.into()).sqrt(),
            Kernel::Cubic => squared * squared.sqrt(),
        }
    }

    /// The values at a scaled point of the functions that weights and affine coefficients multiply.
    fn functions(&self, x: &Real) -> Vec<DoubleDouble> {
        let radial = (0..self.centres.len()).map(|j| self.psi(x, j));
        radial.chain([1.0, x.x, x.y, x.z].map(DoubleDouble::from)).collect()
    }

    /// A row of the saddle-point matrix.
    fn row(&self, i: usize) -> Vec<DoubleDouble> {
        let n = self.centres.len();
        match i.checked_sub(n) {
            None => {
                let mut row = self.functions(&self.centres[i]);
                row[i] = row[i] + self.regularisation.into();
                row
            }
            Some(k) => {
                let affine = |c: &Real| if k == 0 { 1.0 } else { c[k - 1] };
                let zeros = std::iter::repeat_n(0.0, 4);
                self.centres.iter().map(affine).chain(zeros).map(DoubleDouble::from).collect()
            }
        }
    }

    /// The interpolant of `data`, one datum for each training vertex and image, at `points`.
    pub fn interpolate(&self, data: &[Vector], points: &[Real]) -> Vec<Vector> {
        let solution = self.solve(&Mat::from_fn(self.centres.len() + 4, COLUMNS, |i, column| {
            let (axis, part) = (column % 3, column / 3);
            match (data.get(i), part) {
                (None, _) => 0.0,
                (Some(datum), 0) => datum[axis].re,
                (Some(datum), _) => eps(&datum[axis], part - 1),
            }
        }));
        points
            .par_iter()
            .map(|x| {
                let values = product(&self.functions(&(x * self.scale)), &solution);
                Vector::from_fn(|axis, _| number(values[axis].high, |k| values[3 * (k + 1) + axis].high))
            })
            .collect()
    }

    fn solve(&self, right: &Mat<f64>) -> Vec<Row> {
        let numbers = |matrix: &Mat<f64>, i: usize| std::array::from_fn(|column| matrix[(i, column)]);
        let start = self.factor.solve(right);
        let mut solution: Vec<Row> =
            (0..right.nrows()).map(|i| Row::new(numbers(&start, i), [0.0; COLUMNS])).collect();
        for _ in 0..REFINEMENTS {
            let made: Vec<[DoubleDouble; COLUMNS]> =
                (0..right.nrows()).into_par_iter().map(|i| product(&self.row(i), &solution)).collect();
            let residual = Mat::from_fn(right.nrows(), COLUMNS, |i, column| {
                (DoubleDouble::from(right[(i, column)]) - made[i][column]).high
            });
            let correction = self.factor.solve(&residual);
            for (i, row) in solution.iter_mut().enumerate() {
                let better: [DoubleDouble; COLUMNS] = std::array::from_fn(|column| {
                    two_sum(row.high[column], row.low[column]) + correction[(i, column)].into()
                });
                *row = Row::new(better.map(|x| x.high), better.map(|x| x.low));
            }
        }
        solution
    }
}

/// A row of a matrix times a solution.
fn product(row: &[DoubleDouble], solution: &[Row]) -> [DoubleDouble; COLUMNS] {
    let (mut high, mut low) = ([0.0; COLUMNS], [0.0; COLUMNS]);
    for (entry, of) in row.iter().zip(solution) {
        let a = entry.high;
        let halves = split(a);
        for column in 0..COLUMNS {
            let term = a * of.high[column];
            let off = product_error(term, halves, [of.upper[column], of.lower[column]]);
            let next = two_sum(high[column], term);
            high[column] = next.high;
            low[column] += next.low + (off + (a * of.low[column] + entry.low * of.high[column]));
        }
    }
    std::array::from_fn(|column| two_sum(high[column], low[column]))
}

/// The data of a field: combinations of the motions of the seams and of the component.
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
