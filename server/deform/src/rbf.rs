//! Radial basis functions with an affine term (eq. 16 and 17 of the paper): factorised once, then solved and evaluated.
//!
//! The interpolant is `d(x) = sum_j psi(|x - c_j|) w_j + A^T p(x)`, `p = [1, x]`, with `P^T w = 0`. Both kernels are
//! conditionally positive definite (linear: `psi = -sqrt(r^2 + c^2)` with a small c, order 1; cubic: `psi = r^3`, order 2;
//! Wendland, Scattered Data Approximation, sec. 8.1), so with `P = Q [R; 0]` the block `(Q^T Psi Q)_22` is positive definite and Cholesky
//! applies. The saddle-point matrix is symmetric: the same factor serves the adjoint.

use faer::{
    Mat, Par, Spec,
    dyn_stack::{MemBuffer, MemStack},
    linalg::cholesky::llt,
    reborrow::ReborrowMut,
};
use moldline_spline::Vector3;
use pulp::Arch;
use rayon::prelude::*;

/// Radial function.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kernel {
    /// `psi(r) = -sqrt(r^2 + c^2)`: between data the field keeps nearly to their range. c is small ([`ROUNDING`]): it rounds
    /// the cones that `-r` has at the centres, which turn cells over at the end of a seam.
    Linear,
    /// `psi(r) = r^3`: twice continuously differentiable, follows trends beyond the data.
    Cubic,
}

/// Why a system cannot be factorised.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RbfError {
    /// Too few centres, or all of them in a plane.
    #[error("the {centres} centres lie in one plane; an affine field needs centres all around")]
    Planar {
        /// Number of centres.
        centres: usize,
    },
    /// Two centres coincide, or nearly so.
    #[error("centre {centre} coincides with another one (non-positive pivot)")]
    Coincident {
        /// Index of the pivot's centre, as ordered by the elimination.
        centre: usize,
    },
}

/// Lanes of the evaluation; sums are per lane and then across lanes in order, whatever the processor.
const LANES: usize = 8;
/// Points evaluated by one task.
const TILE: usize = 128;
/// c of the linear kernel, as a fraction of the extent of the centres ...
pub const ROUNDING: f64 = 0.002;
/// ... but not more than this many times the least distance between centres, which keeps the matrix well conditioned.
const ROUNDING_OVER_SEPARATION: f64 = 4.0;
/// Distance, as a fraction of the extent, at which two centres are one.
const COINCIDENT: f64 = 1e-12;
/// Dimension of the affine space.
const AFFINE: usize = 4;

/// A factorised interpolation system over fixed centres.
#[derive(Clone, Debug)]
pub struct RadialBasis {
    kernel: Kernel,
    /// c^2 of the linear kernel, scaled.
    rounding: f64,
    /// Moves and scales the centres into the unit box.
    origin: Vector3,
    scale: f64,
    /// Scaled centres, one array a coordinate, padded to whole lanes.
    centres: [Vec<f64>; 3],
    count: usize,
    /// Householder vectors of `P = Q [R; 0]`, unit norm.
    reflectors: Vec<Vec<f64>>,
    /// `R`, upper triangular.
    triangle: [[f64; AFFINE]; AFFINE],
    /// The first four rows of `Q^T Psi Q`.
    top: Mat<f64>,
    /// Cholesky factor of the rest.
    factor: Mat<f64>,
}

/// Weights and affine part of one vector-valued interpolant.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Coefficients {
    /// `w_j`, one array a component, padded to whole lanes with zeros.
    weights: [Vec<f64>; 3],
    /// Rows: 1, x, y, z in scaled coordinates.
    affine: [Vector3; AFFINE],
}

impl RadialBasis {
    /// Factorises the system over `centres` (metres). `regularisation` times the mean size of the kernel is added to
    /// the diagonal: the field then minimises the squared misfit plus that multiple of its native energy.
    ///
    /// # Errors
    /// [`RbfError`] if centres coincide or lie in one plane.
    pub fn new(kernel: Kernel, centres: &[Vector3], regularisation: f64) -> Result<Self, RbfError> {
        let count = centres.len();
        let (low, high) = bounds(centres);
        let origin = 0.5 * (low + high);
        let scale = (high - low).max().max(f64::MIN_POSITIVE);
        let scaled: Vec<Vector3> = centres.iter().map(|c| (c - origin) / scale).collect();
        let planar = || RbfError::Planar { centres: count };
        if count <= AFFINE {
            return Err(planar());
        }
        let (reflectors, triangle) = orthogonalise(&scaled).ok_or_else(planar)?;

        let mut matrix = Mat::<f64>::zeros(count, count);
        let mut least = f64::INFINITY;
        for j in 0..count {
            for i in j + 1..count {
                let squared = (scaled[i] - scaled[j]).norm_squared();
                if squared <= COINCIDENT * COINCIDENT {
                    return Err(RbfError::Coincident { centre: i });
                }
                least = least.min(squared);
                matrix[(i, j)] = squared;
            }
        }
        let rounding = (ROUNDING * ROUNDING).min(ROUNDING_OVER_SEPARATION * ROUNDING_OVER_SEPARATION * least);
        let mut total = 0.0;
        for j in 0..count {
            for i in j + 1..count {
                let value = psi(kernel, rounding, matrix[(i, j)]);
                total += value.abs();
                matrix[(i, j)] = value;
                matrix[(j, i)] = value;
            }
        }
        let mean = total / (0.5 * (count * (count - 1)) as f64);
        for i in 0..count {
            matrix[(i, i)] = psi(kernel, rounding, 0.0) + regularisation * mean;
        }
        reflect_both_sides(&mut matrix, &reflectors);
        let top = matrix.get(..AFFINE, ..).to_owned();
        let mut factor = matrix.get(AFFINE.., AFFINE..).to_owned();
        let size = count - AFFINE;
        let parameters = Spec::default();
        let mut memory =
            MemBuffer::new(llt::factor::cholesky_in_place_scratch::<f64>(size, Par::Seq, parameters));
        // Sequential: the order of the sums must not depend on the number of threads.
        llt::factor::cholesky_in_place(
            factor.as_mut(),
            Default::default(),
            Par::Seq,
            MemStack::new(&mut memory),
            parameters,
        )
        .map_err(|llt::factor::LltError::NonPositivePivot { index }| RbfError::Coincident {
            centre: index + AFFINE,
        })?;
        let padded = count.next_multiple_of(LANES);
        let centres = std::array::from_fn(|axis| {
            let mut values: Vec<f64> = scaled.iter().map(|c| c[axis]).collect();
            values.resize(padded, 0.0);
            values
        });
        Ok(Self { kernel, rounding, origin, scale, centres, count, reflectors, triangle, top, factor })
    }

    /// Number of centres.
    pub fn centre_count(&self) -> usize {
        self.count
    }

    /// Bytes held, for budgets.
    pub fn bytes(&self) -> usize {
        let size = self.count.saturating_sub(AFFINE);
        8 * (size * size + 2 * AFFINE * self.count + 3 * self.centres[0].len())
    }

    /// The interpolant through `data`, one vector a centre.
    ///
    /// # Panics
    /// If there is not one datum for each centre.
    pub fn fit(&self, data: &[Vector3]) -> Coefficients {
        assert_eq!(data.len(), self.count, "one datum for each centre");
        let mut right = Mat::<f64>::from_fn(self.count, 3, |i, axis| data[i][axis]);
        self.solve([[0.0; 3]; AFFINE], &mut right)
    }

    /// Solves `[[Psi, P], [P^T, 0]] [w; a] = [data; moments]`; `data` is overwritten with `w`.
    fn solve(&self, moments: [[f64; 3]; AFFINE], data: &mut Mat<f64>) -> Coefficients {
        // In the basis Q: w_1 = R^-T moments, A_22 w_2 = d_2 - A_21 w_1, a = R^-1 (d_1 - A_11 w_1 - A_12 w_2).
        reflect_rows(data, &self.reflectors, false);
        let mut first = moments;
        for axis in 0..3 {
            for i in 0..AFFINE {
                let known: f64 = (0..i).map(|k| self.triangle[k][i] * first[k][axis]).sum();
                first[i][axis] = (first[i][axis] - known) / self.triangle[i][i];
            }
        }
        let mut affine_right = [[0.0; 3]; AFFINE];
        for axis in 0..3 {
            for k in 0..AFFINE {
                affine_right[k][axis] = data[(k, axis)];
                data[(k, axis)] = first[k][axis];
                for i in AFFINE..self.count {
                    data[(i, axis)] -= self.top[(k, i)] * first[k][axis];
                }
            }
        }
        let mut rest = data.get_mut(AFFINE.., ..);
        let mut memory =
            MemBuffer::new(llt::solve::solve_in_place_scratch::<f64>(self.count - AFFINE, 3, Par::Seq));
        llt::solve::solve_in_place(self.factor.as_ref(), rest.rb_mut(), Par::Seq, MemStack::new(&mut memory));
        let mut affine = [Vector3::zeros(); AFFINE];
        for axis in 0..3 {
            for k in (0..AFFINE).rev() {
                let known: f64 = (0..self.count).map(|i| self.top[(k, i)] * data[(i, axis)]).sum();
                let later: f64 = (k + 1..AFFINE).map(|l| self.triangle[k][l] * affine[l][axis]).sum();
                affine[k][axis] = (affine_right[k][axis] - known - later) / self.triangle[k][k];
            }
        }
        reflect_rows(data, &self.reflectors, true);
        let padded = self.centres[0].len();
        let weights = std::array::from_fn(|axis| {
            let mut column: Vec<f64> = (0..self.count).map(|i| data[(i, axis)]).collect();
            column.resize(padded, 0.0);
            column
        });
        Coefficients { weights, affine }
    }

    /// The field at `points` (metres), in parallel over tiles of points; each value is summed in one fixed order.
    ///
    /// # Panics
    /// If `points` and `out` differ in length.
    pub fn evaluate(&self, coefficients: &Coefficients, points: &[Vector3], out: &mut [Vector3]) {
        assert_eq!(points.len(), out.len(), "one value for each point");
        let arch = Arch::new();
        points.par_chunks(TILE).zip(out.par_chunks_mut(TILE)).for_each(|(points, out)| {
            // The dispatch compiles the loop for the widest vectors that the processor has.
            arch.dispatch(
                #[inline(always)]
                || {
                    for (point, out) in points.iter().zip(out) {
                        // Matched here, so that the loop inside has no branch.
                        *out = match self.kernel {
                            Kernel::Linear => {
                                self.value(coefficients, point, |s| psi(Kernel::Linear, self.rounding, s))
                            }
                            Kernel::Cubic => self.value(coefficients, point, |s| psi(Kernel::Cubic, 0.0, s)),
                        };
                    }
                },
            );
        });
    }

    #[inline(always)]
    fn value(&self, coefficients: &Coefficients, point: &Vector3, psi: impl Fn(f64) -> f64) -> Vector3 {
        let x = (point - self.origin) / self.scale;
        let [centres_x, centres_y, centres_z] = self.centres.each_ref().map(|c| c.as_chunks::<LANES>().0);
        let [weights_x, weights_y, weights_z] =
            coefficients.weights.each_ref().map(|w| w.as_chunks::<LANES>().0);
        let mut sums = [[0.0; LANES]; 3];
        for (((((cx, cy), cz), wx), wy), wz) in
            centres_x.iter().zip(centres_y).zip(centres_z).zip(weights_x).zip(weights_y).zip(weights_z)
        {
            for lane in 0..LANES {
                let (dx, dy, dz) = (x.x - cx[lane], x.y - cy[lane], x.z - cz[lane]);
                let value = psi(dx * dx + dy * dy + dz * dz);
                sums[0][lane] += value * wx[lane];
                sums[1][lane] += value * wy[lane];
                sums[2][lane] += value * wz[lane];
            }
        }
        let radial = Vector3::from_iterator(sums.iter().map(|lanes| lanes.iter().sum()));
        let [constant, a_x, a_y, a_z] = coefficients.affine;
        radial + constant + a_x * x.x + a_y * x.y + a_z * x.z
    }
}

/// The kernel by r^2, with `rounding` = c^2.
#[inline(always)]
fn psi(kernel: Kernel, rounding: f64, squared: f64) -> f64 {
    match kernel {
        Kernel::Linear => -(squared + rounding).sqrt(),
        Kernel::Cubic => squared * squared.sqrt(),
    }
}

fn bounds(points: &[Vector3]) -> (Vector3, Vector3) {
    let start = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    points.iter().fold(start, |(low, high), p| (low.inf(p), high.sup(p)))
}

/// Householder vectors and triangle of `P = [1, x]`; `None` if its columns are dependent.
#[allow(clippy::type_complexity)]
fn orthogonalise(scaled: &[Vector3]) -> Option<(Vec<Vec<f64>>, [[f64; AFFINE]; AFFINE])> {
    let mut columns: Vec<Vec<f64>> = vec![vec![1.0; scaled.len()]];
    columns.extend((0..3).map(|axis| scaled.iter().map(|c| c[axis]).collect()));
    let mut reflectors: Vec<Vec<f64>> = Vec::with_capacity(AFFINE);
    let mut triangle = [[0.0; AFFINE]; AFFINE];
    for k in 0..AFFINE {
        let column = &mut columns[k];
        for v in &reflectors {
            reflect(v, column);
        }
        let norm = column[k..].iter().map(|x| x * x).sum::<f64>().sqrt();
        if norm <= 1e-9 * (scaled.len() as f64).sqrt() {
            return None;
        }
        let diagonal = if column[k] > 0.0 { -norm } else { norm };
        let mut v = vec![0.0; scaled.len()];
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
    Some((reflectors, triangle))
}

fn reflect(v: &[f64], x: &mut [f64]) {
    let twice = 2.0 * v.iter().zip(&*x).map(|(a, b)| a * b).sum::<f64>();
    x.iter_mut().zip(v).for_each(|(x, v)| *x -= twice * v);
}

/// `Q^T M` (or `Q M` if `inverse`) on the columns of `M`.
fn reflect_rows(matrix: &mut Mat<f64>, reflectors: &[Vec<f64>], inverse: bool) {
    for column in 0..matrix.ncols() {
        let values = matrix.col_as_slice_mut(column);
        if inverse {
            reflectors.iter().rev().for_each(|v| reflect(v, values));
        } else {
            reflectors.iter().for_each(|v| reflect(v, values));
        }
    }
}

/// `Q^T M Q` of a symmetric matrix: `M - v q^T - q v^T` for each reflector.
fn reflect_both_sides(matrix: &mut Mat<f64>, reflectors: &[Vec<f64>]) {
    let size = matrix.nrows();
    for v in reflectors {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn scattered(count: usize, seed: u64) -> Vec<Vector3> {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        (0..count).map(|_| Vector3::new(30.0 * next(), 10.0 * next() - 5.0, 4.0 * next())).collect()
    }

    /// What a backward stable solution leaves: the rounding of the sums over weights that are much larger than the data,
    /// here neighbours with opposite data, times a modest factor.
    fn rounding(coefficients: &Coefficients) -> f64 {
        let sums = coefficients.weights.iter().map(|w| w.iter().map(|w| w.abs()).sum::<f64>());
        100.0 * f64::EPSILON * (1.0 + sums.fold(0.0, f64::max))
    }

    #[test]
    fn interpolates_its_data() {
        for kernel in [Kernel::Linear, Kernel::Cubic] {
            let centres = scattered(203, 1);
            let data: Vec<Vector3> =
                centres.iter().map(|c| Vector3::new(c.x.sin(), c.y * c.z, (c.x * c.y).cos())).collect();
            let basis = RadialBasis::new(kernel, &centres, 0.0).unwrap();
            let mut out = vec![Vector3::zeros(); centres.len()];
            let coefficients = basis.fit(&data);
            basis.evaluate(&coefficients, &centres, &mut out);
            let bound = rounding(&coefficients);
            for (value, datum) in out.iter().zip(&data) {
                assert!(
                    (value - datum).norm() < bound,
                    "{kernel:?}: {value} is not {datum} within {bound:e}"
                );
            }
        }
    }

    #[test]
    fn reproduces_affine_fields() {
        let affine = |x: &Vector3| Vector3::new(1.0 + 2.0 * x.x, x.y - 3.0 * x.z, 0.5 * x.x + x.y + x.z);
        for kernel in [Kernel::Linear, Kernel::Cubic] {
            let centres = scattered(50, 2);
            let data: Vec<Vector3> = centres.iter().map(affine).collect();
            let basis = RadialBasis::new(kernel, &centres, 0.0).unwrap();
            let points = scattered(1000, 3);
            let mut out = vec![Vector3::zeros(); points.len()];
            basis.evaluate(&basis.fit(&data), &points, &mut out);
            for (point, value) in points.iter().zip(&out) {
                assert!((value - affine(point)).norm() < 1e-10);
            }
        }
    }

    /// SciPy 1.17: `RBFInterpolator(c, d, kernel="multiquadric", epsilon=1/0.02, degree=1)`, 0.02 being c for these centres.
    #[test]
    fn linear_is_rounded_as_a_multiquadric_is() {
        let centres = [
            [0.0, 0.0, 0.0],
            [10.0, 0.0, 0.0],
            [0.0, 4.0, 0.0],
            [0.0, 0.0, 3.0],
            [10.0, 4.0, 3.0],
            [5.0, 2.0, 1.0],
            [5.0, 2.05, 1.0],
            [2.0, 3.0, 2.5],
            [7.0, 1.0, 0.5],
        ]
        .map(Vector3::from);
        let data: Vec<Vector3> = (0..9)
            .map(|i| Vector3::new(f64::from(i).sin(), f64::from(2 * i).cos(), f64::from(i * i % 5)))
            .collect();
        let points = [[5.0, 2.01, 1.005], [3.0, 1.0, 2.0], [12.0, -1.0, 0.5]].map(Vector3::from);
        let expected = [
            [-0.8437161631113225, -0.545992727626138, 0.1714953055246908],
            [-0.1828866161836063, 0.0020732151699347, 1.9551067453418252],
            [0.40993477891222, -0.4014301668440798, -0.0932814998178346],
        ];
        let basis = RadialBasis::new(Kernel::Linear, &centres, 0.0).unwrap();
        let mut out = [Vector3::zeros(); 3];
        basis.evaluate(&basis.fit(&data), &points, &mut out);
        for (value, expected) in out.iter().zip(expected) {
            assert!((value - Vector3::from(expected)).norm() < 1e-11, "{value} {expected:?}");
        }
    }

    #[test]
    fn solves_the_saddle_point_system() {
        let centres = scattered(37, 4);
        let basis = RadialBasis::new(Kernel::Cubic, &centres, 0.0).unwrap();
        let scaled: Vec<Vector3> = centres.iter().map(|c| (c - basis.origin) / basis.scale).collect();
        let data = Mat::<f64>::from_fn(37, 3, |i, j| ((3 * i + j) as f64).sin());
        let moments: [[f64; 3]; AFFINE] = std::array::from_fn(|k| [k as f64, 1.0, -0.3]);
        let mut right = data.clone();
        let solution = basis.solve(moments, &mut right);
        for axis in 0..3 {
            let w = &solution.weights[axis];
            for i in 0..37 {
                let radial: f64 = (0..37)
                    .map(|j| psi(Kernel::Cubic, 0.0, (scaled[i] - scaled[j]).norm_squared()) * w[j])
                    .sum();
                let p = [1.0, scaled[i].x, scaled[i].y, scaled[i].z];
                let affine: f64 = (0..AFFINE).map(|k| p[k] * solution.affine[k][axis]).sum();
                assert!((radial + affine - data[(i, axis)]).abs() < rounding(&solution));
            }
            assert!((w[..37].iter().sum::<f64>() - moments[0][axis]).abs() < rounding(&solution));
            let first: f64 = (0..37).map(|j| w[j] * scaled[j].x).sum();
            assert!((first - moments[1][axis]).abs() < rounding(&solution));
        }
    }

    #[test]
    fn regularisation_trades_misfit_for_energy() {
        let centres = scattered(60, 5);
        let data: Vec<Vector3> =
            (0..60).map(|i| Vector3::repeat(if i % 2 == 0 { 1.0 } else { -1.0 })).collect();
        let misfit = |regularisation: f64| {
            let basis = RadialBasis::new(Kernel::Cubic, &centres, regularisation).unwrap();
            let mut out = vec![Vector3::zeros(); 60];
            basis.evaluate(&basis.fit(&data), &centres, &mut out);
            out.iter().zip(&data).map(|(a, b)| (a - b).norm_squared()).sum::<f64>()
        };
        let misfits = [misfit(0.0), misfit(1e-3), misfit(1e-1)];
        assert!(misfits[0] < 1e-18 && misfits[0] < misfits[1] && misfits[1] < misfits[2], "{misfits:?}");
    }

    #[test]
    fn refuses_planes_and_coincident_centres() {
        let planar: Vec<Vector3> = scattered(20, 6).iter().map(|c| Vector3::new(c.x, c.y, 1.0)).collect();
        assert_eq!(
            RadialBasis::new(Kernel::Cubic, &planar, 0.0).err(),
            Some(RbfError::Planar { centres: 20 })
        );
        let mut twice = scattered(20, 7);
        twice.push(twice[3]);
        for kernel in [Kernel::Linear, Kernel::Cubic] {
            assert!(matches!(RadialBasis::new(kernel, &twice, 0.0), Err(RbfError::Coincident { .. })));
        }
    }

    #[test]
    fn bits_do_not_depend_on_threads() {
        let centres = scattered(300, 8);
        let points = scattered(3000, 9);
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let basis = RadialBasis::new(Kernel::Cubic, &centres, 0.0).unwrap();
                let mut out = vec![Vector3::zeros(); points.len()];
                basis.evaluate(&basis.fit(&centres), &points, &mut out);
                out
            })
        };
        assert_eq!(run(1), run(2));
    }
}
