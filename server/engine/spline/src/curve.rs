//! Curves: one-parameter splines with homogeneous control points.

use crate::rational::{Homogeneous, add_scaled, any_weight, first, second, value, xyz};
use crate::{KnotVector, Vector3};

/// A curve's point with its first and second derivative.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CurveJet {
    /// The point.
    pub position: Vector3,
    /// First derivative.
    pub d: Vector3,
    /// Second derivative.
    pub dd: Vector3,
}

/// A spline curve's basis.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    knots: KnotVector,
    rational: bool,
}

impl Curve {
    /// A curve whose control points all have weight 1.
    pub fn new(knots: KnotVector) -> Self {
        Self { knots, rational: false }
    }

    /// A curve whose control points may have any positive weights.
    pub fn rational(knots: KnotVector) -> Self {
        Self { knots, rational: true }
    }

    /// Rational exactly if one of these control points has a weight other than 1.
    pub fn for_control_points(knots: KnotVector, control_points: &[[f64; 4]]) -> Self {
        Self { knots, rational: any_weight(control_points) }
    }

    /// The knot vector.
    pub fn knots(&self) -> &KnotVector {
        &self.knots
    }

    /// First and last parameter.
    pub fn domain(&self) -> (f64, f64) {
        self.knots.domain()
    }

    /// Whether weights are taken into account.
    pub fn is_rational(&self) -> bool {
        self.rational
    }

    fn sums(&self, control_points: &[Homogeneous], u: f64, order: usize) -> [Homogeneous; 3] {
        let b = self.knots.basis(u, order);
        let mut sums = [[0.0; 4]; 3];
        for (i, c) in control_points[b.first..b.first + b.count].iter().enumerate() {
            for (sum, values) in sums.iter_mut().zip(&b.values).take(order + 1) {
                add_scaled(sum, values[i], c);
            }
        }
        sums
    }

    /// The point at `u` (clamped to the domain).
    pub fn position(&self, control_points: &[[f64; 4]], u: f64) -> Vector3 {
        let [p, ..] = self.sums(control_points, u, 0);
        if self.rational { value(&p) } else { xyz(&p) }
    }

    /// The point with both derivatives.
    pub fn jet(&self, control_points: &[[f64; 4]], u: f64) -> CurveJet {
        let [p, a, aa] = self.sums(control_points, u, 2);
        if self.rational {
            let position = value(&p);
            let d = first(&p, &a, &position);
            CurveJet { position, d, dd: second(&p, (&a, &d), (&a, &d), &aa, &position) }
        } else {
            CurveJet { position: xyz(&p), d: xyz(&a), dd: xyz(&aa) }
        }
    }
}
