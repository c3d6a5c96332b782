//! The signed distance of a component as an operation (section 1 of the derivation notes).

use crate::{Body, FootPoint, Location, Vector3};

/// The operation `x -> phi, n` for one body.
#[derive(Debug, Clone, Copy)]
pub struct SignedDistance<'a> {
    /// The body.
    pub body: &'a Body,
}

/// Signed distance and its gradient at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SignedDistancePoint {
    /// `phi`, metres, negative inside.
    pub phi: f64,
    /// `n = grad phi`: the surface's outward normal at a foot point inside a face; `(x - y) / phi` where the foot point
    /// `y` is on a sharp edge or at a corner.
    pub normal: Vector3,
    /// The foot point.
    pub foot: FootPoint,
}

impl<'a> SignedDistance<'a> {
    /// The operation for a body.
    pub fn new(body: &'a Body) -> Self {
        Self { body }
    }

    /// Value and gradient at `x`, from the globally nearest point.
    pub fn eval(&self, x: &Vector3) -> SignedDistancePoint {
        self.at(x, self.body.closest_point(x))
    }

    /// Value and gradient at `x` for the sheet that `hint` is on; falls back on the globally nearest point.
    pub fn eval_near(&self, x: &Vector3, hint: &Location) -> SignedDistancePoint {
        let foot = self.body.closest_point_near(x, hint);
        self.at(x, foot.unwrap_or_else(|| self.body.closest_point(x)))
    }

    fn at(&self, x: &Vector3, foot: FootPoint) -> SignedDistancePoint {
        let phi = foot.distance;
        let off_face = foot.feature != crate::Feature::Face && phi.abs() > 1e-12 * self.body.size();
        let normal = if off_face { (x - foot.position) / phi } else { foot.normal };
        SignedDistancePoint { phi, normal, foot }
    }
}
