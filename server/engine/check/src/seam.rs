//! Seam points in dual numbers: the root of the distances along a line of the reference component, one or two Newton
//! steps from the engine's root.

use moldline_deform::chain::seams::{Junction, SeamLine, SeamPoint, SeamSearch, SeamSolver, SeamVertex};
use moldline_geometry::SmoothUnion;
use nalgebra::Matrix2;
use num_dual::DualNum;
use rayon::prelude::*;

use crate::{
    CheckError,
    body::{At, DualBody, Foot, STEPS, solve},
    dual::{Dual, Vector, constant, eps, number, real},
};

/// Samples of a line when the engine's root is sought on it.
const SAMPLES: usize = 512;

/// A seam vertex at its new position.
pub struct DualSeam {
    /// Position, m.
    pub position: Vector,
    /// Its parameters on each of its owners.
    pub at: Vec<At>,
}

/// The seams with the components in the reference and in the deformed state.
pub struct DualSeams<'a> {
    /// The search.
    pub solver: &'a SeamSolver,
    /// Reference state.
    pub reference: &'a [DualBody<'a>],
    /// Deformed.
    pub bodies: &'a [DualBody<'a>],
}

/// The value and gradient of a smooth union of distances.
pub fn union(rho: f64, feet: &[(Dual, Vector)]) -> (Dual, Vector) {
    let least = feet.iter().map(|(phi, _)| phi.re).fold(f64::INFINITY, f64::min);
    let nearest = feet.iter().find(|(phi, _)| phi.re == least).map_or(constant(least), |(phi, _)| *phi);
    let (mut sum, mut gradient) = (constant(0.0), Vector::zeros());
    for (phi, normal) in feet {
        let exponent = (*phi - nearest) * rho;
        // Below 1e-17 the engine leaves a component out.
        if exponent.re <= 40.0 {
            let weight = DualNum::exp(&(-exponent));
            sum += weight;
            gradient += normal * weight;
        }
    }
    (nearest - DualNum::ln(&sum) / rho, gradient / sum)
}

impl DualSeams<'_> {
    /// All seam points, given those that the engine found at the values.
    ///
    /// # Errors
    /// [`CheckError::Line`] if a point that the engine found is not on its line.
    pub fn eval(&self, found: &[SeamPoint]) -> Result<Vec<DualSeam>, CheckError> {
        let junctions: Vec<Option<DualSeam>> = self
            .solver
            .vertices
            .par_iter()
            .zip(found)
            .map(|(v, found)| match &v.search {
                SeamSearch::Junction(junction) => Some(self.junction(v, junction, found)),
                SeamSearch::Line(_) => None,
            })
            .collect();
        let lines: Vec<Result<Option<DualSeam>, CheckError>> = self
            .solver
            .vertices
            .par_iter()
            .zip(found)
            .map(|(v, found)| match &v.search {
                SeamSearch::Line(line) => self.line(v, line, found, &junctions).map(Some),
                SeamSearch::Junction(_) => Ok(None),
            })
            .collect();
        // Every vertex has exactly one of the two.
        let found = lines.into_iter().zip(junctions).map(|(line, junction)| Ok(line?.or(junction)));
        found.filter_map(Result::transpose).collect()
    }

    fn line(
        &self,
        vertex: &SeamVertex,
        line: &SeamLine,
        found: &SeamPoint,
        junctions: &[Option<DualSeam>],
    ) -> Result<DualSeam, CheckError> {
        let (reference, body) =
            (&self.reference[line.reference as usize], &self.bodies[line.reference as usize]);
        let start = self.carried(line, reference, junctions);
        let at = |lambda: Dual| reference.walk_both(&start, line.direction.map(|d| lambda * d));
        let own = vertex.owners.iter().position(|&o| o == line.reference).unwrap_or(0);
        let lambda = self.lambda(vertex, line, reference, &start, found, own)?;
        // The derivative with respect to lambda, along the first direction.
        let fixed = At::fixed(&start.location());
        let moving = number(lambda, |k| if k == 0 { 1.0 } else { 0.0 });
        let along = reference.walk_both(&fixed, line.direction.map(|d| moving * d));
        let speed = along.mu.map(|mu| eps(&mu, 0));
        let mut lambda = constant(lambda);
        for _ in 0..STEPS {
            let mu = at(lambda);
            let (x, tangents) = body.point(&mu);
            let (g, gradient) = self.distance(&line.targets, &x);
            let slope = real(&gradient).dot(&(real(&tangents[0]) * speed[0] + real(&tangents[1]) * speed[1]));
            lambda -= g / slope;
        }
        Ok(self.found(vertex, line.reference, at(lambda), found))
    }

    /// Signed distance to the union of some components, and its gradient.
    fn distance(&self, targets: &[u32], x: &Vector) -> (Dual, Vector) {
        let feet: Vec<Foot> = targets.iter().map(|&t| self.bodies[t as usize].nearest(x)).collect();
        if let [foot] = feet[..] {
            return (foot.distance, foot.normal);
        }
        let rho = SmoothUnion::from_fillet(self.solver.options.fillet * self.solver.length).rho;
        union(rho, &feet.iter().map(|f| (f.distance, f.normal)).collect::<Vec<_>>())
    }

    /// The value of lambda at which the engine found the root.
    fn lambda(
        &self,
        vertex: &SeamVertex,
        line: &SeamLine,
        reference: &DualBody<'_>,
        start: &At,
        found: &SeamPoint,
        own: usize,
    ) -> Result<f64, CheckError> {
        let start = At::fixed(&start.location());
        let goal = real(&reference.position(&At::fixed(&found.locations[own])));
        let at = |lambda: Dual| reference.walk_both(&start, line.direction.map(|d| lambda * d));
        let miss = |lambda: f64| (real(&reference.position(&at(constant(lambda)))) - goal).norm();
        let [low, high] = line.limits;
        let sample = |k: usize| low + (high - low) * k as f64 / SAMPLES as f64;
        let best = (0..=SAMPLES).map(sample).min_by(|&a, &b| miss(a).total_cmp(&miss(b)));
        let mut lambda = best.unwrap_or(0.0);
        let mut distance = miss(lambda);
        for _ in 0..40 {
            let moving = number(lambda, |k| if k == 0 { 1.0 } else { 0.0 });
            let x = reference.position(&at(moving));
            let (r, tangent) = (real(&x) - goal, crate::dual::tangent(&x, 0));
            let step = r.dot(&tangent) / tangent.norm_squared();
            let mut scale = 1.0;
            let next = loop {
                let next = lambda - scale * step;
                if miss(next) < distance || scale < 1e-3 {
                    break next;
                }
                scale *= 0.5;
            };
            if miss(next).is_nan() || miss(next) >= distance {
                break;
            }
            (lambda, distance) = (next, miss(next));
        }
        let tolerance = 1e-9 * self.solver.length;
        if distance <= tolerance {
            Ok(lambda)
        } else {
            Err(CheckError::Line { vertex: vertex.vertex, distance })
        }
    }

    /// The start of a line, shifted with the junctions at the ends of the seam.
    fn carried(&self, line: &SeamLine, reference: &DualBody<'_>, junctions: &[Option<DualSeam>]) -> At {
        let mut shift = [constant(0.0); 2];
        for &(junction, weight) in &line.carried {
            let vertex = &self.solver.vertices[junction as usize];
            let Some(point) = &junctions[junction as usize] else { continue };
            let Some(k) = vertex.owners.iter().position(|&o| o == line.reference) else { continue };
            let (before, after) = (vertex.locations[k], point.at[k]);
            if before.patch == after.patch {
                let domain = reference.body.component().patches()[after.patch as usize].surface.domain();
                for (axis, before) in [before.u, before.v].into_iter().enumerate() {
                    let range = domain[axis].1 - domain[axis].0;
                    let mut way = after.mu[axis] - before;
                    if way.re.abs() > 0.5 * range {
                        way -= range.copysign(way.re);
                    }
                    shift[axis] += way * weight;
                }
            }
        }
        reference.walk_both(&At::fixed(&line.start), shift)
    }

    fn junction(&self, vertex: &SeamVertex, junction: &Junction, found: &SeamPoint) -> DualSeam {
        let body = &self.bodies[junction.reference as usize];
        let own = vertex.owners.iter().position(|&o| o == junction.reference).unwrap_or(0);
        let mut at = At::fixed(&found.locations[own]);
        for _ in 0..STEPS {
            let (x, tangents) = body.point(&at);
            let feet = junction.targets.map(|t| self.bodies[t as usize].nearest(&x));
            let slope = |f: usize, a: usize| real(&feet[f].normal).dot(&real(&tangents[a]));
            let matrix = Matrix2::new(slope(0, 0), slope(0, 1), slope(1, 0), slope(1, 1));
            let step = solve(&matrix, &feet.map(|f| f.distance));
            at.mu[0] -= step[0];
            at.mu[1] -= step[1];
        }
        self.found(vertex, junction.reference, at, found)
    }

    /// Parameters on every owner.
    fn found(&self, vertex: &SeamVertex, reference: u32, at: At, found: &SeamPoint) -> DualSeam {
        let position = self.bodies[reference as usize].position(&at);
        let foot = |(&owner, location)| {
            if owner == reference {
                at
            } else {
                self.bodies[owner as usize].foot_near(&position, location).at
            }
        };
        let at = vertex.owners.iter().zip(&found.locations).map(foot).collect();
        DualSeam { position, at }
    }
}
