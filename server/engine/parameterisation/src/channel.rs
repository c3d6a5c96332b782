//! Channels: how an operation reads its variables out of the design vector.

use std::ops::Range;

use nalgebra::convert;

use crate::scalar::Scalar;

/// Additive variables: the effect is `(value - baseline) * si`.
#[derive(Clone, Debug)]
pub(crate) struct Additive {
    /// Place of the coefficients in the design vector.
    pub(crate) range: Range<usize>,
    pub(crate) baseline: f64,
    /// Metres, radians or ratio per unit.
    pub(crate) si: f64,
}

impl Additive {
    pub(crate) fn value<T: Scalar>(&self, design: &[T], i: usize) -> T {
        (design[self.range.start + i] - convert(self.baseline)) * convert(self.si)
    }

    pub(crate) fn jvp(&self, direction: &[f64], i: usize) -> f64 {
        direction[self.range.start + i] * self.si
    }

    pub(crate) fn vjp(&self, seed: f64, i: usize, gradient: &mut [f64]) {
        gradient[self.range.start + i] += seed * self.si;
    }
}

/// A multiplicative variable: the effect is `value / baseline`, exactly 1 at the baseline whatever the unit.
#[derive(Clone, Debug)]
pub(crate) struct Relative {
    pub(crate) index: usize,
    pub(crate) baseline: f64,
}

impl Relative {
    pub(crate) fn value<T: Scalar>(&self, design: &[T]) -> T {
        design[self.index] / convert(self.baseline)
    }

    pub(crate) fn jvp(&self, direction: &[f64]) -> f64 {
        direction[self.index] / self.baseline
    }

    pub(crate) fn vjp(&self, seed: f64, gradient: &mut [f64]) {
        gradient[self.index] += seed / self.baseline;
    }
}
