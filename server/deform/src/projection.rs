//! Projection onto the smooth outer mold line (sec. III.F of the paper, eq. 18).
//!
//! `x <- x - Phi g / (|g|^2 + eps)`, `g = grad Phi`, until `|Phi|` is within tolerance. A component takes part only where
//! its weight can be felt: farther than [`SmoothUnion::reach`] behind
//! the nearest one it is skipped (below 1e-17).

use moldline_geometry::{Body, Location, SmoothUnion};
use moldline_spline::Vector3;

/// The paper's eps: keeps the step finite where the gradients of opposite surfaces cancel.
const EPSILON: f64 = 1e-12;

/// The projection for one state of the components.
pub struct SmoothProjection<'a> {
    /// The deformed components.
    pub bodies: &'a [Body],
    /// Their smooth union.
    pub union: SmoothUnion,
    /// Steps at most.
    pub steps: usize,
    /// `|Phi|` to reach, m.
    pub tolerance: f64,
}

/// A vertex after its projection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projected {
    /// Where it is, m.
    pub position: Vector3,
    /// `Phi` there, m.
    pub value: f64,
    /// Steps taken.
    pub steps: usize,
}

impl SmoothProjection<'_> {
    /// Projects one vertex. `known` are parameters near its foot points on some components: they keep it on its own sheet
    /// of a thin body. `fix` puts an intermediate position back onto the constraints.
    pub fn eval(
        &self,
        start: Vector3,
        known: &[(u32, Location)],
        fix: impl Fn(Vector3) -> Vector3,
    ) -> Projected {
        let mut feet = Feet { known: known.to_vec(), values: Vec::new(), weights: Vec::new() };
        let mut position = start;
        let mut steps = 0;
        loop {
            feet.find(self, &position);
            feet.weights.resize(feet.values.len(), 0.0);
            let union = self.union.eval(&feet.values, &mut feet.weights);
            if union.phi.abs() <= self.tolerance || steps == self.steps || feet.values.is_empty() {
                return Projected { position, value: union.phi, steps };
            }
            let g = union.gradient;
            position = fix(position - g * (union.phi / (g.norm_squared() + EPSILON)));
            steps += 1;
        }
    }
}

/// Distances and normals of the components that take part, and the foot points they were found at.
struct Feet {
    known: Vec<(u32, Location)>,
    values: Vec<(f64, Vector3)>,
    weights: Vec<f64>,
}

impl Feet {
    fn find(&mut self, projection: &SmoothProjection, x: &Vector3) {
        self.values.clear();
        let mut least = f64::INFINITY;
        for slot in 0..self.known.len() {
            let (component, hint) = self.known[slot];
            let body = &projection.bodies[component as usize];
            let foot = body.closest_point_near(x, &hint).unwrap_or_else(|| body.closest_point(x));
            self.known[slot].1 = foot.location;
            least = least.min(foot.distance);
            self.values.push((foot.distance, foot.normal));
        }
        let reach = projection.union.reach();
        for (component, body) in (0u32..).zip(projection.bodies) {
            if self.known.iter().any(|&(c, _)| c == component) {
                continue;
            }
            let within = least.clamp(0.0, f64::MAX) + reach;
            if body.bounds().distance(x) > within {
                continue;
            }
            if let Some(foot) = body.closest_point_within(x, within) {
                self.known.push((component, foot.location));
                least = least.min(foot.distance);
                self.values.push((foot.distance, foot.normal));
            }
        }
    }
}
