//! The factorised interpolation system.

use faer::{
    Mat, Par, Spec,
    dyn_stack::{MemBuffer, MemStack},
    linalg::cholesky::llt,
};

use crate::{
    Kernel, RbfError, Vector3,
    kernel::shape_squared,
    points::{Points, bounds, nearest},
    polynomial::{AFFINE, AffineQr},
};

/// Distance below which centres are the same, as a fraction of their extent.
const COINCIDENT: f64 = 1e-12;

/// A factorised interpolation system over fixed centres.
#[derive(Clone, Debug)]
pub struct RadialBasis {
    pub(crate) kernel: Kernel,
    /// c^2 of the multiquadric, scaled.
    pub(crate) shape_squared: f64,
    /// Moves and scales the centres into the unit box.
    pub(crate) origin: Vector3,
    pub(crate) scale: f64,
    /// Scaled.
    pub(crate) centres: Points,
    /// `P = Q [R; 0]`.
    pub(crate) affine: AffineQr,
    /// The first four rows of `Q^T Psi Q`.
    pub(crate) top: Mat<f64>,
    /// Cholesky factor of the rest.
    pub(crate) factor: Mat<f64>,
    /// What is added to the diagonal.
    pub(crate) regularisation: f64,
}

/// The part of a [`RadialBasis`] that takes time to compute.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Factors {
    /// c^2 of the multiquadric, in units of the squared extent of the centres.
    pub shape_squared: f64,
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

impl RadialBasis {
    /// Factorises the system over `centres` (metres). `regularisation` times the mean size of the kernel is added to
    /// the diagonal: the field then minimises the squared misfit plus that multiple of its native energy.
    ///
    /// # Errors
    /// [`RbfError`] if centres coincide or lie in one plane, or if the matrix is not positive definite in double precision.
    pub fn new(kernel: Kernel, centres: &[Vector3], regularisation: f64) -> Result<Self, RbfError> {
        let mut basis = Self::unfactorised(kernel, centres)?;
        let count = centres.len();
        let scaled = basis.centres.to_vectors();
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
            let pairs = (0..count).flat_map(|i| (0..i).map(move |j| (i, j)));
            let (centre, other) = pairs.min_by(|a, b| matrix[*a].total_cmp(&matrix[*b])).unwrap_or_default();
            let distance = (centres[centre] - centres[other]).norm();
            return Err(RbfError::Coincident { centre, other, distance });
        }
        let shape_squared = shape_squared(least);
        let mut total = 0.0;
        for j in 0..count {
            for i in j + 1..count {
                let value = kernel.value(matrix[(i, j)], shape_squared);
                total += value.abs();
                matrix[(i, j)] = value;
                matrix[(j, i)] = value;
            }
        }
        let mean = total / (0.5 * (count * (count - 1)) as f64);
        let regularisation = regularisation * mean;
        for i in 0..count {
            matrix[(i, i)] = kernel.value(0.0, shape_squared) + regularisation;
        }
        basis.affine.conjugate(&mut matrix);
        let top = matrix.get(..AFFINE, ..).to_owned();
        let mut factor = matrix.get(AFFINE.., AFFINE..).to_owned();
        cholesky(&mut factor).map_err(|pivot| {
            let centre = pivot + AFFINE;
            let (nearest, distance) = nearest(centres, centre);
            RbfError::NotPositiveDefinite { centre, nearest, distance }
        })?;
        (basis.shape_squared, basis.regularisation) = (shape_squared, regularisation);
        (basis.top, basis.factor) = (top, factor);
        Ok(basis)
    }

    /// All but [`Factors`].
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
        let affine = AffineQr::new(&scaled).ok_or_else(planar)?;
        let centres = Points::new(&scaled);
        let (top, factor) = (Mat::new(), Mat::new());
        let (shape_squared, regularisation) = (0.0, 0.0);
        Ok(Self { kernel, shape_squared, origin, scale, centres, affine, top, factor, regularisation })
    }

    /// The factors, to be kept for [`restore`](Self::restore).
    pub fn factors(&self) -> Factors {
        let count = self.centres.count();
        let mut top = Vec::with_capacity(AFFINE * count);
        (0..count).for_each(|j| top.extend_from_slice(self.top.col_as_slice(j)));
        let size = self.factor.ncols();
        let mut lower = Vec::with_capacity(Factors::lower_length(size));
        (0..size).for_each(|j| lower.extend_from_slice(&self.factor.col_as_slice(j)[j..]));
        Factors { shape_squared: self.shape_squared, regularisation: self.regularisation, top, lower }
    }

    /// The basis that [`new`](Self::new) gave, from its factors; `None` if they are not of so many centres.
    ///
    /// # Errors
    /// [`RbfError`] if the centres lie in one plane.
    pub fn restore(kernel: Kernel, centres: &[Vector3], factors: &Factors) -> Result<Option<Self>, RbfError> {
        let mut basis = Self::unfactorised(kernel, centres)?;
        let size = centres.len() - AFFINE;
        if factors.top.len() != AFFINE * centres.len() || factors.lower.len() != Factors::lower_length(size) {
            return Ok(None);
        }
        (basis.shape_squared, basis.regularisation) = (factors.shape_squared, factors.regularisation);
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
        self.centres.count()
    }

    /// c^2 of the multiquadric, in units of the squared extent of the centres.
    pub fn shape_squared(&self) -> f64 {
        self.shape_squared
    }

    /// Bytes held, for budgets.
    pub fn bytes(&self) -> usize {
        let count = self.centres.count();
        let size = count.saturating_sub(AFFINE);
        8 * (size * size + 2 * AFFINE * count + 3 * self.centres.padded())
    }
}

/// The lower Cholesky factor in place; the index of the first pivot that is not positive, if there is one.
fn cholesky(matrix: &mut Mat<f64>) -> Result<(), usize> {
    let parameters = Spec::default();
    let scratch = llt::factor::cholesky_in_place_scratch::<f64>(matrix.nrows(), Par::Seq, parameters);
    let mut memory = MemBuffer::new(scratch);
    // Sequential: the order of the sums must not depend on the number of threads.
    llt::factor::cholesky_in_place(
        matrix.as_mut(),
        Default::default(),
        Par::Seq,
        MemStack::new(&mut memory),
        parameters,
    )
    .map(|_| ())
    .map_err(|llt::factor::LltError::NonPositivePivot { index }| index)
}
