//! Dual numbers with several directions at once, and vectors of them.

use num_dual::{Derivative, DualSVec64};

/// Directions carried along by one evaluation.
pub const LANES: usize = 15;

/// A value with its derivatives along [`LANES`] directions.
pub type Dual = DualSVec64<LANES>;

/// A vector of dual numbers.
pub type Vector = nalgebra::Vector3<Dual>;

/// A vector of plain numbers.
pub type Real = nalgebra::Vector3<f64>;

/// A number that does not depend on the directions.
pub fn constant(value: f64) -> Dual {
    Dual::from_re(value)
}

/// A number with its derivatives: `eps(k)` along direction `k`.
pub fn number(value: f64, eps: impl Fn(usize) -> f64) -> Dual {
    Dual::new(value, Derivative::some(nalgebra::SVector::from_fn(|k, _| eps(k))))
}

/// The derivative along a direction.
pub fn eps(x: &Dual, direction: usize) -> f64 {
    x.eps.0.as_ref().map_or(0.0, |eps| eps[direction])
}

/// A vector that does not depend on the directions.
pub fn constants(x: &Real) -> Vector {
    x.map(constant)
}

/// Values.
pub fn real(x: &Vector) -> Real {
    x.map(|x| x.re)
}

/// Derivatives along a direction.
pub fn tangent(x: &Vector, direction: usize) -> Real {
    x.map(|x| eps(&x, direction))
}

/// The length of a vector that is not zero.
pub fn length(x: &Vector) -> Dual {
    num_dual::DualNum::sqrt(&x.dot(x))
}
