//! Projection onto the smooth outer mold line (sec. III.F of the paper, eq. 18).
//!
//! `x <- x - Phi g / (|g|^2 + eps)`, `g = grad Phi`, until `|Phi|` is within tolerance. A component takes part only where
//! its weight can be felt: farther than [`SmoothUnion::reach`] behind the nearest one it is skipped (below 1e-17).
//!
//! The derivative goes through the steps taken, each with `dPhi` and `dg` of the smooth union.

use std::sync::Arc;

use moldline_geometry::{
    Block, Body, FootChange, Location, SignedDistance, SignedDistanceDerivative, SmoothUnion,
    block::{add_vector, vector},
};
use moldline_spline::Vector3;
use rayon::prelude::*;

use super::{
    foot::Placed,
    parallel::gather,
    seams::{SeamPoint, SeamSolver},
};
use crate::{
    DeformError, Monitor, Options, OuterMoldLine, Stage,
    error::{LISTED, VertexDistance},
    ownership::{Freedom, Ownership},
    symmetry::InPlane,
};

/// The paper's eps: keeps the step finite where the gradients of opposite surfaces cancel.
const EPSILON: f64 = 1e-12;

/// The projection of a set-up.
#[derive(Clone, Debug)]
pub(crate) struct Projection {
    outer_mold_line: OuterMoldLine,
    /// The smooth union of the components.
    union: SmoothUnion,
    /// Steps at most.
    steps: usize,
    /// `|Phi|` to reach, m.
    tolerance: f64,
    /// Whether a vertex is projected: no constraint protects or holds it.
    active: Vec<bool>,
    ownership: Arc<Ownership>,
    in_plane: InPlane,
}

/// All vertices after the projection.
#[derive(Debug)]
pub(crate) struct Projected {
    /// Where they are, m.
    pub vertices: Vec<[f64; 3]>,
    /// The largest `|Phi|` of an active vertex, m.
    pub residual: f64,
    /// The steps of the vertices that took any.
    steps: Vec<(u32, Vec<Step>)>,
}

/// The steps of the vertices that took any.
#[derive(Clone, Debug)]
pub(crate) struct ProjectionDerivative(Vec<(u32, Vec<Step>)>);

/// A vertex after its projection.
struct ProjectedVertex {
    position: Vector3,
    /// `Phi` there, m.
    value: f64,
    steps: Vec<Step>,
}

/// One step of a vertex.
#[derive(Clone, Debug, PartialEq)]
struct Step {
    /// Where it starts, m.
    from: Vector3,
    /// The components that take part, with the foot points on them.
    feet: Vec<(u32, Location)>,
}

impl Projection {
    /// The projection for the options. `length`: the reference length, m. `stationary`: the vertices that stay where they are in
    /// space.
    pub fn new(
        options: &Options,
        length: f64,
        union: SmoothUnion,
        stationary: &[bool],
        ownership: Arc<Ownership>,
        in_plane: InPlane,
    ) -> Self {
        let on_surface = |v: u32| ownership.of(v).iter().all(|a| a.freedom == Freedom::Surface);
        let vertices = ownership.vertices().zip(stationary);
        Self {
            outer_mold_line: options.outer_mold_line,
            union,
            steps: options.projection_steps,
            tolerance: options.projection_tolerance * length,
            active: vertices.map(|(v, stationary)| !stationary && on_surface(v)).collect(),
            ownership,
            in_plane,
        }
    }

    /// Whether the smooth projection moves a vertex: nothing protects or holds it.
    pub fn is_active(&self, vertex: u32) -> bool {
        self.active[vertex as usize]
    }

    /// The smooth union that makes the outer mold line.
    pub fn union(&self) -> SmoothUnion {
        self.union
    }

    /// All active vertices onto the zero set of `Phi`, if the outer mold line is smooth.
    ///
    /// # Errors
    /// [`DeformError::NotProjected`] naming vertices that the steps do not bring there.
    pub fn eval(
        &self,
        placed: &[Placed],
        seams: &SeamSolver,
        points: &[SeamPoint],
        bodies: &[Body],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Projected, DeformError> {
        if self.outer_mold_line == OuterMoldLine::Sharp {
            let vertices = placed.iter().map(|p| p.position.into()).collect();
            return Ok(Projected { vertices, residual: 0.0, steps: Vec::new() });
        }
        let mut known: Vec<Vec<(u32, Location)>> = self
            .ownership
            .vertices()
            .zip(placed)
            .map(|(v, p)| vec![(self.ownership.first(v).component, p.location)])
            .collect();
        for (seam, point) in seams.vertices.iter().zip(points) {
            known[seam.vertex as usize] =
                seam.owners.iter().copied().zip(point.locations.iter().copied()).collect();
        }
        let projected: Vec<ProjectedVertex> = self
            .ownership
            .vertices()
            .into_par_iter()
            .zip(placed.par_iter().zip(&known))
            .map(|(v, (p, known))| {
                if !self.is_active(v) || monitor.cancelled() {
                    return ProjectedVertex { position: p.position, value: 0.0, steps: Vec::new() };
                }
                self.eval_vertex(v, p.position, known, bodies)
            })
            .collect();
        if monitor.cancelled() {
            return Err(DeformError::Cancelled);
        }
        let off: Vec<VertexDistance> = (0u32..)
            .zip(&projected)
            .filter(|(_, p)| p.value.is_nan() || p.value.abs() > self.tolerance)
            .map(|(vertex, p)| VertexDistance { vertex, distance: p.value.abs() })
            .collect();
        if !off.is_empty() {
            let count = off.len();
            let worst = off.into_iter().take(LISTED).collect();
            return Err(DeformError::NotProjected { count, steps: self.steps, worst });
        }
        let residual = projected.iter().map(|p| p.value.abs()).fold(0.0, f64::max);
        let vertices = projected.iter().map(|p| p.position.into()).collect();
        let steps = (0u32..).zip(projected).filter(|(_, p)| !p.steps.is_empty());
        Ok(Projected { vertices, residual, steps: steps.map(|(v, p)| (v, p.steps)).collect() })
    }

    /// The derivative at vertices that [`eval`](Self::eval) found.
    pub fn linearise(&self, projected: &Projected) -> ProjectionDerivative {
        ProjectionDerivative(projected.steps.clone())
    }

    /// Projects one vertex. `known` are parameters near its foot points on some components: they keep it on its own sheet
    /// of a thin body.
    fn eval_vertex(
        &self,
        vertex: u32,
        start: Vector3,
        known: &[(u32, Location)],
        bodies: &[Body],
    ) -> ProjectedVertex {
        let mut feet = Feet { known: known.to_vec(), ..Feet::default() };
        let mut position = start;
        let mut steps = Vec::new();
        loop {
            feet.find(bodies, self.union.reach(), &position);
            feet.weights.resize(feet.values.len(), 0.0);
            let union = self.union.eval(&feet.values, &mut feet.weights);
            let done = union.phi.abs() <= self.tolerance;
            if done || steps.len() == self.steps || feet.values.is_empty() {
                return ProjectedVertex { position, value: union.phi, steps };
            }
            steps.push(Step { from: position, feet: feet.known.clone() });
            let g = union.gradient;
            let next = position - g * (union.phi / (g.norm_squared() + EPSILON));
            position = self.in_plane.project(vertex, next);
        }
    }

    /// Tangents of the vertices after the steps that their projection took, for those before and of the internal control points.
    pub fn jvp(
        &self,
        derivative: &ProjectionDerivative,
        bodies: &[Body],
        mut vertices: Block,
        control_points: &[Block],
    ) -> Block {
        let moved: Vec<Vec<f64>> = derivative
            .0
            .par_iter()
            .map(|(v, steps)| {
                let mut row = vertices.row(*v as usize).to_vec();
                self.jvp_vertex(*v, steps, bodies, control_points, &mut row);
                row
            })
            .collect();
        for ((v, _), row) in derivative.0.iter().zip(moved) {
            vertices.row_mut(*v as usize).copy_from_slice(&row);
        }
        vertices
    }

    /// The transpose of [`jvp`](Self::jvp): seeds of the vertices before; adds to those of the internal control points.
    pub fn vjp(
        &self,
        derivative: &ProjectionDerivative,
        bodies: &[Body],
        mut vertices: Block,
        control_points: &mut [Block],
    ) -> Block {
        let moved = gather(derivative.0.len(), control_points, |range, control_points| {
            derivative.0[range]
                .iter()
                .map(|(v, steps)| {
                    let mut seed = vertices.row(*v as usize).to_vec();
                    self.vjp_vertex(*v, steps, bodies, &mut seed, control_points);
                    seed
                })
                .collect::<Vec<_>>()
        });
        for ((v, _), seed) in derivative.0.iter().zip(moved.iter().flatten()) {
            vertices.row_mut(*v as usize).copy_from_slice(seed);
        }
        vertices
    }

    fn jvp_vertex(
        &self,
        vertex: u32,
        steps: &[Step],
        bodies: &[Body],
        control_points: &[Block],
        tangent: &mut [f64],
    ) {
        let k = tangent.len() / 3;
        for step in steps {
            let at = self.derivative(step, bodies);
            let surfaces: Vec<Block> = step
                .feet
                .iter()
                .map(|(component, location)| {
                    let mut rows = Block::zeros(3, tangent.len());
                    let body = &bodies[*component as usize];
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
                tangent[3 * d..3 * d + 3]
                    .copy_from_slice(self.in_plane.project(vertex, dx - step).as_slice());
            }
        }
    }

    fn vjp_vertex(
        &self,
        vertex: u32,
        steps: &[Step],
        bodies: &[Body],
        seed: &mut [f64],
        control_points: &mut [Block],
    ) {
        let k = seed.len() / 3;
        for step in steps.iter().rev() {
            let at = self.derivative(step, bodies);
            let mut surfaces: Vec<Block> = step.feet.iter().map(|_| Block::zeros(3, seed.len())).collect();
            for d in 0..k {
                let mut x = self.in_plane.project(vertex, vector(seed, d));
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
                bodies[component].basis(location).point_vjp(rows, &mut control_points[component]);
            }
        }
    }

    fn derivative(&self, step: &Step, bodies: &[Body]) -> StepDerivative {
        let feet: Vec<SignedDistanceDerivative> = step
            .feet
            .iter()
            .map(|(component, location)| {
                let body = &bodies[*component as usize];
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

impl Projected {
    /// The most steps that a vertex took.
    pub fn most_steps(&self) -> usize {
        self.steps.iter().map(|(_, steps)| steps.len()).max().unwrap_or(0)
    }
}

impl ProjectionDerivative {
    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let step = |s: &Step| size_of::<Step>() + s.feet.len() * size_of::<(u32, Location)>();
        self.0.iter().flat_map(|(_, steps)| steps).map(step).sum()
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
    fn find(&mut self, bodies: &[Body], reach: f64, x: &Vector3) {
        self.values.clear();
        let mut least = f64::INFINITY;
        for slot in 0..self.known.len() {
            let (component, hint) = self.known[slot];
            let at = SignedDistance::new(&bodies[component as usize]).eval_near(x, &hint);
            self.known[slot].1 = at.foot.location;
            least = least.min(at.phi);
            self.values.push((at.phi, at.normal));
        }
        for (component, body) in (0u32..).zip(bodies) {
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
