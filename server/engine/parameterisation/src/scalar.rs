//! The numbers in which the map is evaluated.

use nalgebra::{RealField, Vector3};

/// A real number that the map can be evaluated in: `f64`, or a number that carries derivatives along with such a value
/// (a dual number).
pub trait Scalar: RealField + Copy {}

impl<T: RealField + Copy> Scalar for T {}

/// Adds `step` to `point` so that a vanishing step keeps its bits, -0.0 included.
pub(crate) fn shift<T: Scalar>(point: &mut Vector3<T>, step: Vector3<T>) {
    for axis in 0..3 {
        let (at, by) = (point[axis], step[axis]);
        // A dual number compares by its value, but its derivative is added all the same: -0.0 is kept by the order of
        // signs, not by leaving out the sum.
        let keeps_sign = by == T::zero() && at.is_sign_negative();
        point[axis] = if keeps_sign { -(-at - by) } else { at + by };
    }
}
