//! Points of components, and weighted sums of them.

use moldline_geometry::{Body, Component, Location};
use moldline_spline::Vector3;

use super::gradient::{At, FunctionGradient};

/// A point of a component by the parameters of one of the user's patches.
#[derive(Clone, Debug, PartialEq)]
pub struct ComponentPoint {
    /// Index of the component.
    pub component: usize,
    /// Index of the patch, as the user gave them.
    pub patch: usize,
    /// First parameter.
    pub u: f64,
    /// Second parameter.
    pub v: f64,
}

/// The weighted sum of points, m.
pub(super) fn eval(points: &[(At, f64)], bodies: &[Body]) -> Vector3 {
    points.iter().map(|(p, w)| bodies[p.component].position(&p.location) * *w).sum()
}

/// The gradients of its three coordinates.
pub(super) fn gradients(points: &[(At, f64)], bodies: &[Body]) -> [FunctionGradient; 3] {
    [0, 1, 2].map(|axis| {
        let mut gradient = FunctionGradient::default();
        for (point, weight) in points {
            gradient.add_point(point, &Vector3::ith(axis, *weight), bodies);
        }
        gradient
    })
}

impl ComponentPoint {
    /// The point by its internal parameters. The error says why there is none.
    pub(super) fn locate<C: AsRef<Component>>(&self, components: &[C]) -> Result<At, String> {
        let count = components.len();
        let component = components
            .get(self.component)
            .ok_or_else(|| format!("component {} of {count}", self.component))?
            .as_ref();
        let (u, v) = (self.u, self.v);
        let within = |x: f64, (low, high): (f64, f64)| low <= x && x <= high;
        let of_patch = (0u32..).zip(component.patches()).filter(|(_, p)| p.source == self.patch);
        let mut ranges = [(f64::INFINITY, f64::NEG_INFINITY); 2];
        for (patch, description) in of_patch {
            let [du, dv] = description.surface.domain();
            if within(u, du) && within(v, dv) {
                let location = Location { patch, u, v };
                return Ok(At { component: self.component, location });
            }
            for (range, (low, high)) in ranges.iter_mut().zip([du, dv]) {
                *range = (range.0.min(low), range.1.max(high));
            }
        }
        let [(u0, u1), (v0, v1)] = ranges;
        Err(format!(
            "(u, v) = ({u}, {v}) is not on patch {} of `{}`, whose parameters are in [{u0}, {u1}] x [{v0}, {v1}]",
            self.patch,
            component.name()
        ))
    }
}
