//! The radial functions: their values, derivatives and sums. What differs between kernels is decided here only.

use crate::{
    Vector3,
    coefficients::Part,
    points::Points,
    sum::{Sums, cubic, multiquadric},
};

/// c of the multiquadric, as a fraction of the extent of the centres ...
const SHAPE: f64 = 0.002;
/// ... but not more than this many times the least distance between centres, which keeps the matrix well conditioned.
const SHAPE_OVER_SEPARATION: f64 = 4.0;

/// Radial function `psi(r)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kernel {
    /// Multiquadric, `psi(r) = -sqrt(r^2 + c^2)`: between data the field keeps nearly to their range. The shape parameter c
    /// is small, 0.002 times the extent of the centres or less, so that this is nearly `-r`; it rounds off the cones that `-r`
    /// has at the centres, which turn cells over at the end of a seam.
    Multiquadric,
    /// `psi(r) = r^3`: twice continuously differentiable, follows trends beyond the data.
    Cubic,
}

impl Kernel {
    /// `psi(r)` from `r^2`; `shape_squared` is `c^2` of the multiquadric.
    #[inline(always)]
    pub fn value(self, squared: f64, shape_squared: f64) -> f64 {
        match self {
            Self::Multiquadric => multiquadric::value(squared, shape_squared),
            Self::Cubic => squared * squared.sqrt(),
        }
    }

    /// `psi'(r)` from `r^2`; `shape_squared` is `c^2` of the multiquadric, not zero.
    pub fn derivative(self, squared: f64, shape_squared: f64) -> f64 {
        match self {
            Self::Multiquadric => -(squared / (squared + shape_squared)).sqrt(),
            Self::Cubic => 3.0 * squared,
        }
    }

    /// `sum_j psi(|t - s_j|) w_j + a . [1, t]`: a row for each target `t`, a column for each column of coefficients.
    pub(crate) fn sum(
        self,
        shape_squared: f64,
        targets: &[Vector3],
        sources: &Points,
        leading: &Part,
        remainder: Option<&Part>,
    ) -> Sums {
        match self {
            Self::Multiquadric => multiquadric::sum(targets, sources, leading, shape_squared),
            Self::Cubic => cubic::sum(targets, sources, leading, remainder),
        }
    }

    /// `sum_j w_j [1, s_j]`, a row for each affine function: the transpose of the affine part of [`sum`](Self::sum).
    pub(crate) fn moments(self, sources: &Points, leading: &Part, remainder: Option<&Part>) -> Sums {
        match self {
            Self::Multiquadric => multiquadric::moments(sources, leading),
            Self::Cubic => cubic::moments(sources, leading, remainder),
        }
    }

    /// Whether sums have more digits than a double, with which solutions are refined.
    pub(crate) fn is_refined(self) -> bool {
        self == Self::Cubic
    }
}

/// The square of the multiquadric's shape parameter for centres in the unit box; `separation_squared` is that of the least distance
/// between them.
pub(crate) fn shape_squared(separation_squared: f64) -> f64 {
    (SHAPE * SHAPE).min(SHAPE_OVER_SEPARATION * SHAPE_OVER_SEPARATION * separation_squared)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_are_those_of_the_values() {
        for kernel in [Kernel::Multiquadric, Kernel::Cubic] {
            for r in [0.0, 1e-3, 0.4, 2.0] {
                // The values are even functions of r.
                let value = |r: f64| kernel.value(r * r, 0.25);
                let h = 1e-5;
                let difference = (value(r + h) - value((r - h).abs())) / (2.0 * h);
                let odd = if r < h { 0.0 } else { difference };
                assert!((kernel.derivative(r * r, 0.25) - odd).abs() < 1e-9, "{kernel:?} {r}");
            }
        }
    }
}
