//! Projection onto the smooth outer mold line (sec. III.F of the paper, eq. 18), and its derivative (section 7 of the
//! derivation notes).
//!
//! `x <- x - Phi g / (|g|^2 + eps)`, `g = grad Phi`, until `|Phi|` is within tolerance. A component takes part only where
//! its weight can be felt: farther than [`SmoothUnion::reach`] behind the nearest one it is skipped (below 1e-17).

use moldline_geometry::{
    Block, Body, FootChange, Location, SignedDistance, SignedDistanceDerivative, SmoothUnion,
    block::{add_vector, vector},
};
use moldline_spline::Vector3;

/// The paper's eps: keeps the step finite where the gradients of opposite surfaces cancel.
const EPSILON: f64 = 1e-12;

/// The projection for one state of the components.
#[derive(Clone, Copy)]
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
#[derive(Clone, Debug, PartialEq)]
pub struct Projected {
    /// Where it is, m.
    pub position: Vector3,
    /// `Phi` there, m.
    pub value: f64,
    /// The steps taken.
    pub steps: Vec<Step>,
}

/// One step of the projection: what its derivative needs.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// Where it starts, m.
    pub from: Vector3,
    /// The components that take part, with the foot points on them.
    pub feet: Vec<(u32, Location)>,
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
        let mut feet = Feet { known: known.to_vec(), ..Feet::default() };
        let mut position = start;
        let mut steps = Vec::new();
        loop {
            feet.find(self, &position);
            feet.weights.resize(feet.values.len(), 0.0);
            let union = self.union.eval(&feet.values, &mut feet.weights);
            let done = union.phi.abs() <= self.tolerance;
            if done || steps.len() == self.steps || feet.values.is_empty() {
                return Projected { position, value: union.phi, steps };
            }
            steps.push(Step { from: position, feet: feet.known.clone() });
            let g = union.gradient;
            position = fix(position - g * (union.phi / (g.norm_squared() + EPSILON)));
        }
    }

    /// The tangent of a vertex through the steps that its projection took; `tangent` holds that of the start (a vector a
    /// direction) and receives that of the end. `fix` is linear.
    pub fn jvp(
        &self,
        steps: &[Step],
        control_points: &[Block],
        tangent: &mut [f64],
        fix: impl Fn(Vector3) -> Vector3,
    ) {
        let k = tangent.len() / 3;
        for step in steps {
            let at = self.derivative(step);
            let surfaces: Vec<Block> = step
                .feet
                .iter()
                .map(|(component, location)| {
                    let mut rows = Block::zeros(3, tangent.len());
                    let body = &self.bodies[*component as usize];
                    body.basis(location).point_jvp(&control_points[*component as usize], &mut rows);
                    rows
                })
                .collect();
            for d in 0..k {
                let dx = vector(tangent, d);
                let changes: Vec<(f64, Vector3)> = at
                    .feet
                    .iter()
                    .zip(&surfaces)
                    .map(|(foot, rows)| {
                        let s_uv = [rows.vector(1, d), rows.vector(2, d)];
                        foot.jvp(&FootChange { x: dx, s: rows.vector(0, d), s_uv })
                    })
                    .collect();
                let gradients = at.feet.iter().map(|foot| foot.normal);
                let (d_phi, d_g) = self.union.jvp(&at.weights, gradients, &changes);
                let (phi, g, h) = (at.phi, &at.g, at.h);
                let step = (g * d_phi + d_g * phi) / h - g * (2.0 * phi * g.dot(&d_g) / (h * h));
                tangent[3 * d..3 * d + 3].copy_from_slice(fix(dx - step).as_slice());
            }
        }
    }

    /// The transpose of [`jvp`](Self::jvp): `seed` holds that of the end and receives that of the start; adds to those of the
    /// control points.
    pub fn vjp(
        &self,
        steps: &[Step],
        seed: &mut [f64],
        control_points: &mut [Block],
        fix: impl Fn(Vector3) -> Vector3,
    ) {
        let k = seed.len() / 3;
        for step in steps.iter().rev() {
            let at = self.derivative(step);
            let mut surfaces: Vec<Block> = step.feet.iter().map(|_| Block::zeros(3, seed.len())).collect();
            for d in 0..k {
                let mut x = fix(vector(seed, d));
                let (phi, g, h) = (at.phi, &at.g, at.h);
                let along = g.dot(&x);
                let d_phi = -along / h;
                let d_g = x * (-phi / h) + g * (2.0 * phi * along / (h * h));
                for ((foot, weight), rows) in at.feet.iter().zip(&at.weights).zip(&mut surfaces) {
                    let (phi, n) = self.union.vjp(*weight, &foot.normal, g, d_phi, &d_g);
                    let change = foot.vjp(phi, &n);
                    x += change.x;
                    add_vector(rows.row_mut(0), d, &change.s);
                    add_vector(rows.row_mut(1), d, &change.s_uv[0]);
                    add_vector(rows.row_mut(2), d, &change.s_uv[1]);
                }
                seed[3 * d..3 * d + 3].copy_from_slice(x.as_slice());
            }
            for ((component, location), rows) in step.feet.iter().zip(&surfaces) {
                let component = *component as usize;
                self.bodies[component].basis(location).point_vjp(rows, &mut control_points[component]);
            }
        }
    }

    fn derivative(&self, step: &Step) -> StepDerivative {
        let feet: Vec<SignedDistanceDerivative> = step
            .feet
            .iter()
            .map(|(component, location)| {
                let body = &self.bodies[*component as usize];
                SignedDistance::new(body).derivative(&step.from, &body.foot_point(&step.from, location))
            })
            .collect();
        let values: Vec<(f64, Vector3)> = feet.iter().map(|foot| (foot.phi, foot.normal)).collect();
        let mut weights = vec![0.0; feet.len()];
        let union = self.union.eval(&values, &mut weights);
        let h = union.gradient.norm_squared() + EPSILON;
        StepDerivative { feet, weights, phi: union.phi, g: union.gradient, h }
    }
}

/// The values that a step's derivative is made of.
struct StepDerivative {
    feet: Vec<SignedDistanceDerivative>,
    weights: Vec<f64>,
    phi: f64,
    g: Vector3,
    /// `|g|^2 + eps`.
    h: f64,
}

/// Distances and gradients of the components that take part, and the foot points they were found at.
#[derive(Default)]
struct Feet {
    known: Vec<(u32, Location)>,
    values: Vec<(f64, Vector3)>,
    weights: Vec<f64>,
    /// Components that were searched in vain, from where, and a lower bound of their distance from there, m.
    clear: Vec<(u32, Vector3, f64)>,
}

/// How much farther than needed a component is searched, as a fraction of the reach: the vertex may then move that far
/// before it has to be searched again.
const AHEAD: f64 = 0.1;

impl Feet {
    fn find(&mut self, projection: &SmoothProjection, x: &Vector3) {
        self.values.clear();
        let mut least = f64::INFINITY;
        for slot in 0..self.known.len() {
            let (component, hint) = self.known[slot];
            let at = SignedDistance::new(&projection.bodies[component as usize]).eval_near(x, &hint);
            self.known[slot].1 = at.foot.location;
            least = least.min(at.phi);
            self.values.push((at.phi, at.normal));
        }
        let reach = projection.union.reach();
        for (component, body) in (0u32..).zip(projection.bodies) {
            if self.known.iter().any(|&(c, _)| c == component) {
                continue;
            }
            let within = least.clamp(0.0, f64::MAX) + reach;
            let clear = self.clear.iter().position(|&(c, _, _)| c == component);
            let farther = |k: usize| self.clear[k].2 - (x - self.clear[k].1).norm() > within;
            if clear.is_some_and(farther) || body.bounds().distance(x) > within {
                continue;
            }
            let searched = within + AHEAD * reach;
            let foot = body.closest_point_within(x, searched);
            if let Some(foot) = foot.filter(|foot| foot.distance.abs() <= within) {
                let at = SignedDistance::new(body).at(x, foot);
                self.known.push((component, foot.location));
                least = least.min(at.phi);
                self.values.push((at.phi, at.normal));
                continue;
            }
            let entry = (component, *x, foot.map_or(searched, |foot| foot.distance.abs()));
            match clear {
                Some(k) => self.clear[k] = entry,
                None => self.clear.push(entry),
            }
        }
    }
}
