//! Radial basis functions with an affine term (eq. 16 and 17 of the paper): factorised once, then solved and evaluated.
//!
//! The interpolant is `d(x) = sum_j psi(|x - c_j|) w_j + A^T p(x)`, `p = [1, x]`, with `P^T w = 0`. Both kernels are
//! conditionally positive definite (linear: `psi = -sqrt(r^2 + c^2)` with a small c, order 1; cubic: `psi = r^3`, order 2;
//! Wendland, Scattered Data Approximation, sec. 8.1), so with `P = Q [R; 0]` the block `(Q^T Psi Q)_22` is positive definite and Cholesky
//! applies. The saddle-point matrix is symmetric: the same factor serves the adjoint.
//!
//! Close centres with different data have weights that are much larger than the data and cancel in the sum; with `r^3` a
//! million times and more. Sums over cubic functions are therefore exact in their leading digits, and weights keep twice the digits,
//! refined with residuals from such sums (module `cubic`).

mod cubic;
mod triangular;

use faer::{
    Accum, Mat, MatMut, MatRef, Par, Spec,
    dyn_stack::{MemBuffer, MemStack},
    linalg::{cholesky::llt, matmul::matmul},
};
use moldline_foundation::simd::widest;
use moldline_geometry::Block;
use moldline_spline::Vector3;
use rayon::prelude::*;

use triangular::Tiles;

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
    #[error("centre {centre} coincides with another one, or is too near to it")]
    Coincident {
        /// Its index; where the factorisation finds it, that of the pivot.
        centre: usize,
    },
}

/// Lanes of the evaluation; sums are per lane and then across lanes in order, whatever the processor.
const LANES: usize = 8;
/// Points evaluated by one task.
const TILE: usize = 128;
/// Centres whose kernel values are formed at once when there are many columns.
const PANEL: usize = 256;
/// Columns up to which kernel values are formed and used in registers, and rows of triangular systems are shared out.
const FEW: usize = 3;
/// Columns solved by one task.
const COLUMNS: usize = 16;
/// Refinements of a solution with the cubic kernel, at most: each leaves a ten-thousandth or less.
const REFINEMENTS: usize = 3;
/// One that changes a solution by no more than this part is the last: of what doubles round, sums keep this part about, and the next
/// one would leave no less.
const REFINED: f64 = 1.0 / (1 << 20) as f64;
/// c of the linear kernel, as a fraction of the extent of the centres ...
pub const ROUNDING: f64 = 0.002;
/// ... but not more than this many times the least distance between centres, which keeps the matrix well conditioned.
const ROUNDING_OVER_SEPARATION: f64 = 4.0;
/// Distance below which centres are the same, as a fraction of their extent.
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
    centres: Cloud,
    /// Householder vectors of `P = Q [R; 0]`, unit norm.
    reflectors: Vec<Vec<f64>>,
    /// `R`, upper triangular.
    triangle: [[f64; AFFINE]; AFFINE],
    /// The first four rows of `Q^T Psi Q`.
    top: Mat<f64>,
    /// Cholesky factor of the rest.
    factor: Mat<f64>,
    /// What is added to the diagonal.
    regularisation: f64,
}

/// What takes time to find of a [`RadialBasis`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Factors {
    /// c^2 of the linear kernel, scaled.
    pub rounding: f64,
    /// What is added to the diagonal.
    pub regularisation: f64,
    /// The first four rows of `Q^T Psi Q`, column after column.
    pub top: Vec<f64>,
    /// The lower triangle of the Cholesky factor of the rest, column after column.
    pub lower: Vec<f64>,
}

impl Factors {
    fn lower_length(size: usize) -> usize {
        size * (size + 1) / 2
    }
}

/// Scaled points, one array a coordinate, padded to whole lanes.
#[derive(Clone, Debug)]
struct Cloud {
    coordinates: [Vec<f64>; 3],
    count: usize,
}

impl Cloud {
    fn new(points: &[Vector3]) -> Self {
        let padded = points.len().next_multiple_of(LANES);
        let coordinates = std::array::from_fn(|axis| {
            let mut values: Vec<f64> = points.iter().map(|p| p[axis]).collect();
            values.resize(padded, 0.0);
            values
        });
        Self { coordinates, count: points.len() }
    }

    fn padded(&self) -> usize {
        self.coordinates[0].len()
    }

    fn get(&self, i: usize) -> Vector3 {
        Vector3::new(self.coordinates[0][i], self.coordinates[1][i], self.coordinates[2][i])
    }

    fn points(&self) -> Vec<Vector3> {
        (0..self.count).map(|i| self.get(i)).collect()
    }
}

/// Weights and affine parts of a number of interpolants (columns) over the same centres; or seeds of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Coefficients {
    leading: Part,
    /// What the leading part is rounded by; with the cubic kernel only.
    rest: Option<Part>,
}

/// Numbers for the centres and for the affine functions.
#[derive(Clone, Debug, PartialEq)]
struct Part {
    /// `w_j`, column after column, each padded to whole lanes with zeros.
    weights: Vec<f64>,
    /// Rows 1, x, y, z in scaled coordinates, one number a column.
    affine: Block,
}

impl Part {
    fn columns(&self) -> usize {
        self.affine.width()
    }

    fn weights_of(&self, column: usize) -> &[f64] {
        let padded = self.weights.len() / self.columns();
        &self.weights[column * padded..(column + 1) * padded]
    }

    /// The largest weight of each column, without its sign.
    fn largest_weights(&self) -> impl Iterator<Item = f64> {
        (0..self.columns()).map(|column| largest(self.weights_of(column)))
    }

    fn numbers(&self) -> impl Iterator<Item = &f64> {
        self.weights.iter().chain(self.affine.data())
    }

    fn numbers_mut(&mut self) -> impl Iterator<Item = &mut f64> {
        self.weights.iter_mut().chain(self.affine.data_mut())
    }

    /// From rows: a row for each centre.
    fn from_rows(affine: Block, rows: &Block, padded: usize) -> Self {
        let columns = rows.width();
        let mut weights = vec![0.0; padded * columns];
        for i in 0..rows.data().len() / columns.max(1) {
            for (column, value) in rows.row(i).iter().enumerate() {
                weights[column * padded + i] = *value;
            }
        }
        Self { weights, affine }
    }

    /// The first `count` weights of each column, a row for each.
    fn rows(&self, count: usize) -> Block {
        let mut rows = Block::zeros(count, self.columns());
        for column in 0..self.columns() {
            let weights = self.weights_of(column);
            (0..count).for_each(|i| rows.row_mut(i)[column] = weights[i]);
        }
        rows
    }
}

impl RadialBasis {
    /// Factorises the system over `centres` (metres). `regularisation` times the mean size of the kernel is added to
    /// the diagonal: the field then minimises the squared misfit plus that multiple of its native energy.
    ///
    /// # Errors
    /// [`RbfError`] if centres coincide or lie in one plane.
    pub fn new(kernel: Kernel, centres: &[Vector3], regularisation: f64) -> Result<Self, RbfError> {
        let mut basis = Self::unfactorised(kernel, centres)?;
        let count = centres.len();
        let scaled: Vec<Vector3> = (0..count).map(|i| basis.centres.get(i)).collect();
        let mut matrix = Mat::<f64>::zeros(count, count);
        let mut least = f64::INFINITY;
        for j in 0..count {
            for i in j + 1..count {
                let squared = (scaled[i] - scaled[j]).norm_squared();
                least = least.min(squared);
                matrix[(i, j)] = squared;
            }
        }
        if least <= COINCIDENT * COINCIDENT {
            let twin = |i: &usize| (0..*i).any(|j| (scaled[*i] - scaled[j]).norm() <= COINCIDENT);
            let centre = (1..count).find(twin).unwrap_or(0);
            return Err(RbfError::Coincident { centre });
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
        let regularisation = regularisation * mean;
        for i in 0..count {
            matrix[(i, i)] = psi(kernel, rounding, 0.0) + regularisation;
        }
        reflect_both_sides(&mut matrix, &basis.reflectors);
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
        (basis.rounding, basis.regularisation) = (rounding, regularisation);
        (basis.top, basis.factor) = (top, factor);
        Ok(basis)
    }

    /// All but what takes time.
    fn unfactorised(kernel: Kernel, centres: &[Vector3]) -> Result<Self, RbfError> {
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
        let centres = Cloud::new(&scaled);
        let (top, factor) = (Mat::new(), Mat::new());
        Ok(Self {
            kernel,
            rounding: 0.0,
            origin,
            scale,
            centres,
            reflectors,
            triangle,
            top,
            factor,
            regularisation: 0.0,
        })
    }

    /// What took time.
    pub fn factors(&self) -> Factors {
        let mut top = Vec::with_capacity(AFFINE * self.centres.count);
        (0..self.centres.count).for_each(|j| top.extend_from_slice(self.top.col_as_slice(j)));
        let size = self.factor.ncols();
        let mut lower = Vec::with_capacity(Factors::lower_length(size));
        (0..size).for_each(|j| lower.extend_from_slice(&self.factor.col_as_slice(j)[j..]));
        Factors { rounding: self.rounding, regularisation: self.regularisation, top, lower }
    }

    /// The same basis as [`new`](Self::new) gives, from what that found; `None` if it is not of these centres.
    ///
    /// # Errors
    /// [`RbfError`] if the centres lie in one plane.
    pub fn restore(kernel: Kernel, centres: &[Vector3], factors: &Factors) -> Result<Option<Self>, RbfError> {
        let mut basis = Self::unfactorised(kernel, centres)?;
        let size = centres.len() - AFFINE;
        if factors.top.len() != AFFINE * centres.len() || factors.lower.len() != Factors::lower_length(size) {
            return Ok(None);
        }
        (basis.rounding, basis.regularisation) = (factors.rounding, factors.regularisation);
        basis.top = Mat::from_fn(AFFINE, centres.len(), |k, j| factors.top[AFFINE * j + k]);
        basis.factor = Mat::zeros(size, size);
        let mut rest = factors.lower.as_slice();
        for j in 0..size {
            let (column, others) = rest.split_at(size - j);
            basis.factor.col_as_slice_mut(j)[j..].copy_from_slice(column);
            rest = others;
        }
        Ok(Some(basis))
    }

    /// Number of centres.
    pub fn centre_count(&self) -> usize {
        self.centres.count
    }

    /// c^2 of the linear kernel, in units of the extent of the centres.
    pub fn rounding(&self) -> f64 {
        self.rounding
    }

    /// Bytes held, for budgets.
    pub fn bytes(&self) -> usize {
        let size = self.centres.count.saturating_sub(AFFINE);
        8 * (size * size + 2 * AFFINE * self.centres.count + 3 * self.centres.padded())
    }

    /// The interpolants through `data`: a row for each centre, a column for each interpolant. Linear in the data.
    ///
    /// # Panics
    /// If there is not one row for each centre.
    pub fn fit(&self, data: &Block) -> Coefficients {
        assert_eq!(data.data().len(), self.centres.count * data.width(), "one row for each centre");
        let moments = Block::zeros(AFFINE, data.width());
        self.solve(&Coefficients { leading: self.part(moments, data), rest: None })
    }

    /// The transpose of [`fit`](Self::fit): seeds of the data for seeds of the coefficients. The system is symmetric.
    pub fn fit_vjp(&self, seeds: &Coefficients) -> Block {
        self.solve(seeds).leading.rows(self.centres.count)
    }

    fn part(&self, affine: Block, rows: &Block) -> Part {
        Part::from_rows(affine, rows, self.centres.padded())
    }

    /// Solves `[[Psi, P], [P^T, 0]] [w; a] = [data; moments]`.
    fn solve(&self, right: &Coefficients) -> Coefficients {
        let leading = self.solve_in_doubles(&right.leading);
        match self.kernel {
            Kernel::Linear => Coefficients { leading, rest: None },
            Kernel::Cubic => self.refine(right, leading),
        }
    }

    /// The same as exactly as the factor is.
    fn solve_in_doubles(&self, right: &Part) -> Part {
        let (count, padded) = (self.centres.count, self.centres.padded());
        let mut solution = right.clone();
        let parts: Vec<Vec<[f64; AFFINE]>> = solution
            .weights
            .par_chunks_mut(padded * COLUMNS)
            .enumerate()
            .map(|(chunk, weights)| {
                let first = COLUMNS * chunk;
                let width = weights.len() / padded;
                let mut data = Mat::<f64>::from_fn(count, width, |i, c| weights[c * padded + i]);
                let moments: Vec<[f64; AFFINE]> =
                    (first..first + width).map(|c| std::array::from_fn(|k| right.affine.row(k)[c])).collect();
                let affine = self.solve_columns(&moments, &mut data);
                for (column, weights) in weights.chunks_mut(padded).enumerate() {
                    weights[..count].copy_from_slice(data.col_as_slice(column));
                }
                affine
            })
            .collect();
        for (column, part) in parts.iter().flatten().enumerate() {
            (0..AFFINE).for_each(|k| solution.affine.row_mut(k)[column] = part[k]);
        }
        solution
    }

    /// Improves a solution by those for what it leaves, until they change it little.
    fn refine(&self, right: &Coefficients, start: Part) -> Coefficients {
        let centres = self.centres.points();
        let (mut solution, mut rest) = (start.clone(), start);
        rest.numbers_mut().for_each(|x| *x = 0.0);
        for _ in 0..REFINEMENTS {
            let residual = self.residual(right, &centres, &solution, &rest);
            let correction = self.solve_in_doubles(&residual);
            let change =
                correction.largest_weights().zip(solution.largest_weights()).map(|(step, x)| step / x);
            // Where both are zero there is nothing to refine.
            let change = change.fold(0.0, f64::max);
            for ((x, rest), step) in solution.numbers_mut().zip(rest.numbers_mut()).zip(correction.numbers())
            {
                let (sum, rounded) = cubic::two_sum(*x, *step);
                (*x, *rest) = cubic::two_sum(sum, *rest + rounded);
            }
            if change <= REFINED {
                break;
            }
        }
        Coefficients { leading: solution, rest: Some(rest) }
    }

    /// `right` less what the system makes of `leading + rest`.
    fn residual(&self, right: &Coefficients, centres: &[Vector3], leading: &Part, rest: &Part) -> Part {
        let (rows, rows_rest) = cubic::sums(centres, &self.centres, leading, Some(rest)).pair();
        let (affine, affine_rest) = cubic::moments(&self.centres, leading, Some(rest)).pair();
        let (made, made_rest) = (self.part(affine, &rows), self.part(affine_rest, &rows_rest));
        let mut residual = right.leading.clone();
        for ((r, made), made_rest) in residual.numbers_mut().zip(made.numbers()).zip(made_rest.numbers()) {
            *r = (*r - made) - made_rest;
        }
        if let Some(rest) = &right.rest {
            residual.numbers_mut().zip(rest.numbers()).for_each(|(r, rest)| *r += rest);
        }
        if self.regularisation != 0.0 {
            let weights = leading.weights.iter().zip(&rest.weights);
            for (r, (w, rest)) in residual.weights.iter_mut().zip(weights) {
                let (product, rounded) = cubic::two_product(self.regularisation, *w);
                *r = (*r - product) - (rounded + self.regularisation * rest);
            }
        }
        residual
    }

    /// [`solve_in_doubles`](Self::solve_in_doubles) in place, column by column; returns the affine parts.
    fn solve_columns(&self, moments: &[[f64; AFFINE]], data: &mut Mat<f64>) -> Vec<[f64; AFFINE]> {
        // In the basis Q: w_1 = R^-T moments, A_22 w_2 = d_2 - A_21 w_1, a = R^-1 (d_1 - A_11 w_1 - A_12 w_2).
        let count = self.centres.count;
        reflect_rows(data, &self.reflectors, false);
        let mut affine = Vec::with_capacity(moments.len());
        for (column, moments) in moments.iter().enumerate() {
            let mut first = *moments;
            for i in 0..AFFINE {
                let known: f64 = (0..i).map(|k| self.triangle[k][i] * first[k]).sum();
                first[i] = (first[i] - known) / self.triangle[i][i];
            }
            let column = data.col_as_slice_mut(column);
            affine.push(std::array::from_fn(|k| column[k]));
            column[..AFFINE].copy_from_slice(&first);
            for i in AFFINE..count {
                column[i] -= (0..AFFINE).map(|k| self.top[(k, i)] * first[k]).sum::<f64>();
            }
        }
        self.solve_factor(data);
        for (column, affine) in affine.iter_mut().enumerate() {
            let column = data.col_as_slice(column);
            for k in (0..AFFINE).rev() {
                let known: f64 = (0..count).map(|i| self.top[(k, i)] * column[i]).sum();
                let later: f64 = (k + 1..AFFINE).map(|l| self.triangle[k][l] * affine[l]).sum();
                affine[k] = (affine[k] - known - later) / self.triangle[k][k];
            }
        }
        reflect_rows(data, &self.reflectors, true);
        affine
    }

    /// Solves with the Cholesky factor, for rows beyond the first four.
    fn solve_factor(&self, data: &mut Mat<f64>) {
        let (size, width) = (self.factor.nrows(), data.ncols());
        // Of the longer sums rounding leaves a little more, which is refined away.
        if self.kernel == Kernel::Cubic && width <= FEW {
            let mut tiles = Tiles::zeros(size, width);
            for column in 0..width {
                let data = &data.col_as_slice(column)[AFFINE..];
                data.iter().enumerate().for_each(|(row, x)| *tiles.get_mut(row, column) = *x);
            }
            triangular::solve(&self.factor, &mut tiles);
            for column in 0..width {
                let data = &mut data.col_as_slice_mut(column)[AFFINE..];
                data.iter_mut().enumerate().for_each(|(row, x)| *x = *tiles.get_mut(row, column));
            }
            return;
        }
        let mut memory = MemBuffer::new(llt::solve::solve_in_place_scratch::<f64>(size, width, Par::Seq));
        let rows = data.get_mut(AFFINE.., ..);
        llt::solve::solve_in_place(self.factor.as_ref(), rows, Par::Seq, MemStack::new(&mut memory));
    }

    /// The fields at `points` (metres), one row a point. In parallel over tiles of points; each value is summed in one
    /// fixed order.
    pub fn evaluate(&self, coefficients: &Coefficients, points: &[Vector3]) -> Block {
        let scaled = self.scaled(points);
        let Part { weights, affine } = &coefficients.leading;
        if self.kernel == Kernel::Cubic {
            let sums = cubic::sums(&scaled, &self.centres, &coefficients.leading, coefficients.rest.as_ref());
            return sums.total();
        }
        let columns = affine.width();
        let mut out = Block::zeros(points.len(), columns);
        tiled(&scaled, &self.centres, weights, self.rounding, &mut out);
        let rows = out.data_mut().chunks_mut(columns.max(1));
        for (row, x) in rows.zip(&scaled) {
            for (k, p) in monomials(x).into_iter().enumerate() {
                row.iter_mut().zip(affine.row(k)).for_each(|(out, a)| *out += a * p);
            }
        }
        out
    }

    /// The transpose of [`evaluate`](Self::evaluate): seeds of the coefficients for seeds of the values. Points and
    /// centres change their roles.
    pub fn evaluate_vjp(&self, points: &[Vector3], seeds: &Block) -> Coefficients {
        let columns = seeds.width();
        let scaled = self.scaled(points);
        let cloud = Cloud::new(&scaled);
        let seeds = Part::from_rows(Block::zeros(AFFINE, columns), seeds, cloud.padded());
        let centres = self.centres.points();
        if self.kernel == Kernel::Cubic {
            let (affine, affine_rest) = cubic::moments(&cloud, &seeds, None).pair();
            let (rows, rows_rest) = cubic::sums(&centres, &cloud, &seeds, None).pair();
            return Coefficients {
                leading: self.part(affine, &rows),
                rest: Some(self.part(affine_rest, &rows_rest)),
            };
        }
        let mut affine = Block::zeros(AFFINE, columns);
        for column in 0..columns {
            let seeds = seeds.weights_of(column);
            for (x, seed) in scaled.iter().zip(seeds) {
                for (k, p) in monomials(x).into_iter().enumerate() {
                    affine.row_mut(k)[column] += p * seed;
                }
            }
        }
        let mut out = Block::zeros(centres.len(), columns);
        tiled(&centres, &cloud, &seeds.weights, self.rounding, &mut out);
        Coefficients { leading: self.part(affine, &out), rest: None }
    }

    fn scaled(&self, points: &[Vector3]) -> Vec<Vector3> {
        points.iter().map(|p| (p - self.origin) / self.scale).collect()
    }
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |largest, x| x.abs().max(largest))
}

/// Constant and linear functions.
fn monomials(x: &Vector3) -> [f64; AFFINE] {
    [1.0, x.x, x.y, x.z]
}

/// `out[i] = sum_j psi(|targets_i - sources_j|) weights_j` of the linear kernel, tiles of targets in parallel. `rounding`
/// is c^2.
fn tiled(targets: &[Vector3], sources: &Cloud, weights: &[f64], rounding: f64, out: &mut Block) {
    let columns = out.width();
    if columns == 0 {
        return;
    }
    let tiles = targets.par_chunks(TILE).zip(out.data_mut().par_chunks_mut(TILE * columns));
    if columns <= FEW {
        tiles.for_each(|(targets, out)| {
            widest(
                #[inline(always)]
                || match columns {
                    1 => few::<1>(targets, sources, weights, rounding, out),
                    2 => few::<2>(targets, sources, weights, rounding, out),
                    _ => few::<3>(targets, sources, weights, rounding, out),
                },
            );
        });
    } else {
        tiles.for_each_init(
            || vec![0.0; TILE * PANEL],
            |panel, (targets, out)| {
                for first in (0..sources.count).step_by(PANEL) {
                    let last = (first + PANEL).min(sources.count);
                    widest(
                        #[inline(always)]
                        || kernel_panel(targets, sources, first..last, rounding, panel),
                    );
                    let (rows, width) = (targets.len(), last - first);
                    let panel = MatRef::from_column_major_slice_with_stride(panel, rows, width, TILE);
                    let weights = MatRef::from_column_major_slice_with_stride(
                        &weights[first..],
                        width,
                        columns,
                        sources.padded(),
                    );
                    let out = MatMut::from_row_major_slice_mut(out, rows, columns);
                    matmul(out, Accum::Add, panel, weights, 1.0, Par::Seq);
                }
            },
        );
    }
}

/// Sums of one tile for up to [`FEW`] columns.
#[inline(always)]
fn few<const N: usize>(
    targets: &[Vector3],
    sources: &Cloud,
    weights: &[f64],
    rounding: f64,
    out: &mut [f64],
) {
    let [x, y, z] = sources.coordinates.each_ref().map(|c| c.as_chunks::<LANES>().0);
    let padded = sources.padded();
    let weights: [&[[f64; LANES]]; N] =
        std::array::from_fn(|k| weights[k * padded..(k + 1) * padded].as_chunks::<LANES>().0);
    for (target, out) in targets.iter().zip(out.chunks_exact_mut(N)) {
        let mut sums = [[0.0; LANES]; N];
        for chunk in 0..x.len() {
            for lane in 0..LANES {
                let dx = target.x - x[chunk][lane];
                let dy = target.y - y[chunk][lane];
                let dz = target.z - z[chunk][lane];
                let value = psi(Kernel::Linear, rounding, dx * dx + dy * dy + dz * dz);
                for k in 0..N {
                    sums[k][lane] += value * weights[k][chunk][lane];
                }
            }
        }
        for (out, lanes) in out.iter_mut().zip(&sums) {
            *out = lanes.iter().sum();
        }
    }
}

/// Kernel values between the targets of a tile and some sources, source after source.
#[inline(always)]
fn kernel_panel(
    targets: &[Vector3],
    sources: &Cloud,
    range: std::ops::Range<usize>,
    rounding: f64,
    panel: &mut [f64],
) {
    let mut tile = [[0.0; TILE]; 3];
    for (i, target) in targets.iter().enumerate() {
        (0..3).for_each(|axis| tile[axis][i] = target[axis]);
    }
    for (column, j) in panel.chunks_exact_mut(TILE).zip(range) {
        let source = sources.get(j);
        for i in 0..TILE {
            let dx = tile[0][i] - source.x;
            let dy = tile[1][i] - source.y;
            let dz = tile[2][i] - source.z;
            column[i] = psi(Kernel::Linear, rounding, dx * dx + dy * dy + dz * dz);
        }
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
        let columns = 0..coefficients.leading.columns();
        let sums = columns.map(|c| coefficients.leading.weights_of(c).iter().map(|w| w.abs()).sum::<f64>());
        100.0 * f64::EPSILON * (1.0 + sums.fold(0.0, f64::max))
    }

    fn block(vectors: &[Vector3]) -> Block {
        let mut block = Block::zeros(vectors.len(), 3);
        vectors.iter().enumerate().for_each(|(i, v)| block.row_mut(i).copy_from_slice(v.as_slice()));
        block
    }

    #[test]
    fn interpolates_its_data() {
        for kernel in [Kernel::Linear, Kernel::Cubic] {
            let centres = scattered(203, 1);
            let data: Vec<Vector3> =
                centres.iter().map(|c| Vector3::new(c.x.sin(), c.y * c.z, (c.x * c.y).cos())).collect();
            let basis = RadialBasis::new(kernel, &centres, 0.0).unwrap();
            let coefficients = basis.fit(&block(&data));
            let out = basis.evaluate(&coefficients, &centres);
            let bound = rounding(&coefficients);
            for (i, datum) in data.iter().enumerate() {
                let value = out.vector(i, 0);
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
            let out = basis.evaluate(&basis.fit(&block(&data)), &points);
            for (i, point) in points.iter().enumerate() {
                assert!((out.vector(i, 0) - affine(point)).norm() < 1e-10);
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
        let out = basis.evaluate(&basis.fit(&block(&data)), &points);
        for (i, expected) in expected.into_iter().enumerate() {
            assert!((out.vector(i, 0) - Vector3::from(expected)).norm() < 1e-11, "{expected:?}");
        }
    }

    /// Close centres with opposite data, whose weights are up to 8e5: values and gradients computed with 80 digits (LU decomposition
    /// of the saddle-point matrix in Python's `decimal`). All coordinates are binary fractions, nothing is rounded before.
    #[test]
    fn cubic_sums_that_cancel_keep_their_digits() {
        let corners = [
            (-4, -2, -1),
            (4, -2, -1),
            (-4, 2, -1),
            (-4, -2, 1),
            (4, 2, 1),
            (4, -2, 1),
            (-4, 2, 1),
            (4, 2, -1),
        ];
        let mut centres: Vec<Vector3> =
            corners.map(|(x, y, z)| Vector3::new(f64::from(x), f64::from(y), f64::from(z))).to_vec();
        centres.extend(
            [
                [0.5, 0.25, 0.125],
                [0.515625, 0.25, 0.125],
                [-1.5, 1.0, -0.25],
                [-1.5, 1.015625, -0.25],
                [2.0, -1.0, 0.5],
                [2.0, -1.0, 0.515625],
            ]
            .map(Vector3::from),
        );
        let data = [
            0.0,
            0.841796875,
            0.9091796875,
            0.1416015625,
            -0.7568359375,
            -0.958984375,
            -0.279296875,
            0.6572265625,
            1.0,
            -1.0,
            1.0,
            -1.0,
            1.0,
            -1.0,
        ];
        let points =
            [[0.5, 0.25, 0.25], [-1.5, 1.0078125, -0.25], [3.0, 0.5, -0.5], [0.0; 3]].map(Vector3::from);
        let values = [-6.662619220663289, -0.0004831712851260907, -24.16930042995386, 77.64441307918997];
        let seeds = [1.0, -0.5, 2.0, 0.25];
        let gradient = [
            -0.04045955233460522,
            0.16168700023519553,
            0.0063328539318617235,
            -0.01675162627817605,
            0.11235443419214948,
            -0.03115630956806893,
            0.01119494208828839,
            0.6580898995826636,
            -59.5227778827112,
            61.173945449505936,
            9.575692365475271,
            -9.927366110647815,
            32.83963945978009,
            -32.250424923251586,
        ];
        let column = |values: &[f64], width: usize| {
            let mut block = Block::zeros(values.len(), width);
            values.iter().enumerate().for_each(|(i, x)| block.row_mut(i).fill(*x));
            block
        };
        let basis = RadialBasis::new(Kernel::Cubic, &centres, 0.0).unwrap();
        for width in [1, 3, 12] {
            let out = basis.evaluate(&basis.fit(&column(&data, width)), &points);
            let back = basis.fit_vjp(&basis.evaluate_vjp(&points, &column(&seeds, width)));
            for (found, expected) in [(&out, &column(&values, width)), (&back, &column(&gradient, width))] {
                for (found, expected) in found.data().iter().zip(expected.data()) {
                    assert!(
                        (found - expected).abs() <= 1e-15 * expected.abs().max(1.0),
                        "{found} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn solves_the_saddle_point_system() {
        let centres = scattered(37, 4);
        let basis = RadialBasis::new(Kernel::Cubic, &centres, 0.0).unwrap();
        let scaled: Vec<Vector3> = centres.iter().map(|c| (c - basis.origin) / basis.scale).collect();
        let mut data = Block::zeros(37, 3);
        data.data_mut().iter_mut().enumerate().for_each(|(i, x)| *x = (i as f64).sin());
        let mut moments = Block::zeros(AFFINE, 3);
        (0..AFFINE).for_each(|k| moments.row_mut(k).copy_from_slice(&[k as f64, 1.0, -0.3]));
        let right = basis.part(moments.clone(), &data);
        let solution = basis.solve(&Coefficients { leading: right, rest: None });
        for axis in 0..3 {
            let w = solution.leading.weights_of(axis);
            for i in 0..37 {
                let radial: f64 = (0..37)
                    .map(|j| psi(Kernel::Cubic, 0.0, (scaled[i] - scaled[j]).norm_squared()) * w[j])
                    .sum();
                let p = [1.0, scaled[i].x, scaled[i].y, scaled[i].z];
                let affine: f64 = (0..AFFINE).map(|k| p[k] * solution.leading.affine.row(k)[axis]).sum();
                assert!((radial + affine - data.row(i)[axis]).abs() < rounding(&solution));
            }
            assert!((w[..37].iter().sum::<f64>() - moments.row(0)[axis]).abs() < rounding(&solution));
            let first: f64 = (0..37).map(|j| w[j] * scaled[j].x).sum();
            assert!((first - moments.row(1)[axis]).abs() < rounding(&solution));
        }
    }

    #[test]
    fn regularisation_trades_misfit_for_energy() {
        let centres = scattered(60, 5);
        let data: Vec<Vector3> =
            (0..60).map(|i| Vector3::repeat(if i % 2 == 0 { 1.0 } else { -1.0 })).collect();
        let misfit = |regularisation: f64| {
            let basis = RadialBasis::new(Kernel::Cubic, &centres, regularisation).unwrap();
            let out = basis.evaluate(&basis.fit(&block(&data)), &centres);
            (0..60).map(|i| (out.vector(i, 0) - data[i]).norm_squared()).sum::<f64>()
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
                let one = basis.evaluate(&basis.fit(&block(&centres)), &points);
                let many = basis.evaluate(&basis.fit(&columns(&centres, 40)), &points);
                let seeds = basis.fit_vjp(&basis.evaluate_vjp(&points, &many));
                (one, many, seeds)
            })
        };
        assert_eq!(run(1), run(2));
    }

    /// Every centre with so many different numbers.
    fn columns(centres: &[Vector3], width: usize) -> Block {
        let mut block = Block::zeros(centres.len(), width);
        for (i, c) in centres.iter().enumerate() {
            block.row_mut(i).iter_mut().enumerate().for_each(|(k, x)| *x = (c.x + k as f64 * c.y).sin());
        }
        block
    }

    #[test]
    fn columns_are_independent() {
        let (centres, points) = (scattered(600, 10), scattered(500, 11));
        for kernel in [Kernel::Linear, Kernel::Cubic] {
            let basis = RadialBasis::new(kernel, &centres, 0.0).unwrap();
            let data = columns(&centres, 20);
            let coefficients = basis.fit(&data);
            let all = basis.evaluate(&coefficients, &points);
            let bound = rounding(&coefficients);
            for column in 0..20 {
                let mut single = Block::zeros(600, 1);
                (0..600).for_each(|i| single.row_mut(i)[0] = data.row(i)[column]);
                let one = basis.evaluate(&basis.fit(&single), &points);
                for i in 0..points.len() {
                    assert!((one.row(i)[0] - all.row(i)[column]).abs() < bound);
                }
            }
        }
    }

    #[test]
    fn transposes_agree() {
        let (centres, points) = (scattered(150, 12), scattered(400, 13));
        let dot = |a: &Block, b: &Block| -> f64 { a.data().iter().zip(b.data()).map(|(a, b)| a * b).sum() };
        for kernel in [Kernel::Linear, Kernel::Cubic] {
            let basis = RadialBasis::new(kernel, &centres, 0.0).unwrap();
            for width in [1, 2, 3, 12, 45] {
                let (data, seeds) = (columns(&centres, width), columns(&points, width));
                let coefficients = basis.fit(&data);
                let forward = dot(&seeds, &basis.evaluate(&coefficients, &points));
                let backward = dot(&basis.fit_vjp(&basis.evaluate_vjp(&points, &seeds)), &data);
                let bound = 400.0 * width as f64 * rounding(&coefficients);
                assert!((forward - backward).abs() < bound, "{forward} {backward} {bound:e}");
            }
        }
    }
}
