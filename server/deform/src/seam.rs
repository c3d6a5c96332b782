//! Soft-bracketed intersection motion (sec. III.C of the paper, eq. 10 to 14).
//!
//! Each seam vertex moves along a parametric line of its reference component, `q(lambda) = S_r(mu(lambda))`, to the root of
//! `g(lambda) = Phi_T(q(lambda))`, the smooth union of the signed distances to its targets. Soft bisection brings the
//! iterate near the root, safeguarded Newton steps finish it. A vertex where three components meet solves for both
//! parameters instead; the seams that end there are carried along.

use moldline_geometry::{Body, FootPoint, Location, ParameterDirection, SmoothUnion, SmoothUnionPoint};
use moldline_spline::Vector3;
use rayon::prelude::*;

use crate::{
    DeformError, Monitor, SeamOptions, Stage,
    chart::product,
    error::{LISTED, VertexDistance},
};

/// Newton and bisection steps of the polish at most.
const POLISH_STEPS: usize = 80;
/// Samples of the whole line when the bracket has lost the root.
const SAMPLES: usize = 128;
/// Newton steps at a point where three components meet.
const JUNCTION_STEPS: usize = 50;

/// The line along which a seam vertex is searched.
#[derive(Clone, Debug)]
pub struct SeamLine {
    /// Component that carries the line.
    pub reference: u32,
    /// The vertex in the reference state, `lambda = 0`.
    pub start: Location,
    /// Direction of the line in the parameters `(u, v)` of the patch it starts in: one of them, the other one held as in the
    /// paper, or straight across the seam; whichever crosses the target best over a whole row of vertices.
    pub direction: [f64; 2],
    /// Bracket `[l, u]` of lambda, and how far the line goes on at most.
    pub bracket: [f64; 2],
    /// Ends of the component along the line.
    pub limits: [f64; 2],
    /// Whether the line comes from inside the target, as lambda grows, at the root that is meant.
    pub from_inside: bool,
    /// Components whose union is to be met.
    pub targets: Vec<u32>,
    /// The start moves with the junctions at the ends of the seam: `(junction, weight)`.
    pub carried: Vec<(u32, f64)>,
}

/// A vertex where three components meet.
#[derive(Clone, Debug)]
pub struct Junction {
    /// Component on whose surface the point is sought.
    pub reference: u32,
    /// The vertex in the reference state.
    pub start: Location,
    /// The two components to be met at once.
    pub targets: [u32; 2],
}

/// How a seam vertex is found.
#[derive(Clone, Debug)]
pub enum SeamSearch {
    /// By one parameter.
    Line(SeamLine),
    /// By two parameters.
    Junction(Junction),
}

/// One vertex on two or more components.
#[derive(Clone, Debug)]
pub struct SeamVertex {
    /// Index into the mesh.
    pub vertex: u32,
    /// The components that it lies on.
    pub owners: Vec<u32>,
    /// Its parameters on each of them in the reference state.
    pub locations: Vec<Location>,
    /// How it is found.
    pub search: SeamSearch,
}

/// A seam vertex found.
#[derive(Clone, Debug, PartialEq)]
pub struct SeamPoint {
    /// Where it is, m.
    pub position: Vector3,
    /// Its parameters on each of its owners, in their order.
    pub locations: Vec<Location>,
    /// Largest distance to an owner, m.
    pub residual: f64,
    /// Where on its line it is; zero for a junction.
    pub lambda: f64,
}

/// The search over all seam vertices of a set-up.
#[derive(Clone, Debug)]
pub struct SeamSolver {
    /// The seam vertices.
    pub vertices: Vec<SeamVertex>,
    /// Numbers and tolerances.
    pub options: SeamOptions,
    /// Reference length, m.
    pub length: f64,
}

/// `(g, dg/dlambda)` at a point of a line.
#[derive(Clone, Copy)]
struct Residual {
    g: f64,
    slope: f64,
    /// Length of the step that one unit of lambda makes, m.
    speed: f64,
}

/// A soft bisection.
struct SoftBracket {
    steps: Vec<SoftStep>,
    /// The soft bracket in the end.
    bracket: [f64; 2],
    /// A bracket that surely contains a root, and `g` at its lower end.
    hard: [f64; 2],
    g_hard: f64,
}

/// One of its steps: the soft bracket and `g` at its lower end before, the middle, and the indicator.
#[derive(Clone, Copy)]
struct SoftStep {
    bracket: [f64; 2],
    g_l: f64,
    m: f64,
    g_m: f64,
    same_side: f64,
}

impl SoftBracket {
    fn lambda(&self) -> f64 {
        0.5 * (self.bracket[0] + self.bracket[1])
    }
}

/// The targets of a line seen from a point.
pub(crate) struct Targets {
    pub union: SmoothUnionPoint,
    /// Of each target in the union.
    pub weights: Vec<f64>,
    /// On each target.
    pub feet: Vec<FootPoint>,
}

const PARAMETERS: [ParameterDirection; 2] = [ParameterDirection::U, ParameterDirection::V];

/// The location at `lambda` of a line. Lines are walked on the component in its reference state, so that they stay the
/// same in its parameters whatever becomes of it.
pub(crate) fn along(reference: &Body, start: &Location, direction: [f64; 2], lambda: f64) -> Location {
    let mut at = *start;
    for k in 0..2 {
        if direction[k] != 0.0 {
            at = reference.walk(&at, PARAMETERS[k], lambda * direction[k]);
        }
    }
    at
}

/// The end of a line and how it depends on where it starts and on its lengths along `u` and `v`: rows are `u`, `v`.
pub(crate) struct Along {
    pub end: Location,
    pub by_start: [[f64; 2]; 2],
    pub by_lengths: [[f64; 2]; 2],
}

/// [`along`] for given lengths, with its derivative.
pub(crate) fn along_derivative(reference: &Body, start: &Location, lengths: [f64; 2]) -> Along {
    let by_u = reference.walk_derivative(start, PARAMETERS[0], lengths[0]);
    let by_v = reference.walk_derivative(&by_u.end, PARAMETERS[1], lengths[1]);
    let through = |column: [f64; 2]| by_v.by_start.map(|row| row[0] * column[0] + row[1] * column[1]);
    let first = through(by_u.by_length);
    Along {
        end: by_v.end,
        by_start: product(&by_v.by_start, &by_u.by_start),
        by_lengths: [0, 1].map(|row| [first[row], by_v.by_length[row]]),
    }
}

impl SeamSearch {
    /// The component whose parameters are searched.
    pub fn reference(&self) -> u32 {
        match self {
            Self::Line(line) => line.reference,
            Self::Junction(junction) => junction.reference,
        }
    }
}

impl SeamSolver {
    /// All seam points in the state of `bodies`, in the order of `vertices`. `reference`: the components as set up.
    ///
    /// # Errors
    /// [`DeformError::SeamLost`] naming the vertices whose line does not meet its target.
    pub fn eval(
        &self,
        reference: &[Body],
        bodies: &[Body],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<SeamPoint>, DeformError> {
        let junctions: Vec<(usize, Result<SeamPoint, f64>)> = self
            .vertices
            .par_iter()
            .enumerate()
            .filter_map(|(i, v)| match &v.search {
                SeamSearch::Junction(junction) => Some((i, self.junction(v, junction, bodies))),
                SeamSearch::Line(_) => None,
            })
            .collect();
        let mut found: Vec<Option<Result<SeamPoint, f64>>> = vec![None; self.vertices.len()];
        for (i, point) in junctions {
            found[i] = Some(point);
        }
        let lines: Vec<Option<Result<SeamPoint, f64>>> = self
            .vertices
            .par_iter()
            .map(|v| match &v.search {
                SeamSearch::Line(_) if monitor.cancelled() => None,
                SeamSearch::Line(line) => Some(self.line(v, line, reference, bodies, &found)),
                SeamSearch::Junction(_) => None,
            })
            .collect();
        if monitor.cancelled() {
            return Err(DeformError::Cancelled);
        }
        let mut points = Vec::with_capacity(self.vertices.len());
        let mut lost: Vec<(usize, f64)> = Vec::new();
        for (i, (line, junction)) in lines.into_iter().zip(found).enumerate() {
            // Every vertex has exactly one of the two: its search is a line or a junction.
            match line.or(junction).unwrap_or(Err(f64::NAN)) {
                Ok(point) => points.push(point),
                Err(distance) => lost.push((i, distance)),
            }
        }
        if lost.is_empty() { Ok(points) } else { Err(self.lost(&lost, bodies)) }
    }

    fn lost(&self, lost: &[(usize, f64)], bodies: &[Body]) -> DeformError {
        let name = |c: u32| bodies[c as usize].component().name().to_owned();
        let (reference, target) = match &self.vertices[lost[0].0].search {
            SeamSearch::Line(line) => {
                let targets: Vec<String> = line.targets.iter().map(|&t| name(t)).collect();
                (name(line.reference), targets.join("+"))
            }
            SeamSearch::Junction(j) => {
                (name(j.reference), format!("{} and {}", name(j.targets[0]), name(j.targets[1])))
            }
        };
        DeformError::SeamLost {
            reference,
            target,
            count: lost.len(),
            worst: lost
                .iter()
                .take(LISTED)
                .map(|&(i, distance)| VertexDistance { vertex: self.vertices[i].vertex, distance })
                .collect(),
        }
    }

    /// Smooth union of the targets' distances (eq. 11).
    fn residual(&self, line: &SeamLine, at: &Location, bodies: &[Body], bound: f64) -> Residual {
        let point = bodies[line.reference as usize].point(at);
        let tangent = point.d_u * line.direction[0] + point.d_v * line.direction[1];
        let (g, gradient) = if let [target] = line.targets[..] {
            let foot = nearest(&bodies[target as usize], &point.position, bound);
            (foot.distance, foot.normal)
        } else {
            let targets = self.targets(line, &point.position, bodies);
            (targets.union.phi, targets.union.gradient)
        };
        Residual { g, slope: gradient.dot(&tangent), speed: tangent.norm() }
    }

    /// The smooth union of a line's targets. Its rho is much larger than that of the outer mold line, or a third
    /// component would displace the seam of two.
    pub(crate) fn targets(&self, line: &SeamLine, x: &Vector3, bodies: &[Body]) -> Targets {
        let feet: Vec<FootPoint> =
            line.targets.iter().map(|&t| bodies[t as usize].closest_point(x)).collect();
        let distances: Vec<(f64, Vector3)> = feet.iter().map(|f| (f.distance, f.normal)).collect();
        let mut weights = vec![0.0; feet.len()];
        let union =
            SmoothUnion::from_fillet(self.options.fillet * self.length).eval(&distances, &mut weights);
        Targets { union, weights, feet }
    }

    /// The root on a line, or the distance at which the search ended.
    fn line(
        &self,
        vertex: &SeamVertex,
        line: &SeamLine,
        reference: &[Body],
        bodies: &[Body],
        junctions: &[Option<Result<SeamPoint, f64>>],
    ) -> Result<SeamPoint, f64> {
        let undeformed = &reference[line.reference as usize];
        let junction = |j: u32| junctions[j as usize].as_ref().and_then(|found| found.as_ref().ok());
        let start = along(undeformed, &line.start, self.carried(line, undeformed, junction), 1.0);
        let at = |lambda: f64| along(undeformed, &start, line.direction, lambda);
        let g = |lambda: f64, bound: f64| self.residual(line, &at(lambda), bodies, bound);

        let (bracket, g_lower) = self.bracket(line, &g)?;
        let soft = self.soft_bracket(bracket, g_lower, |lambda| g(lambda, f64::INFINITY).g);
        let mut lambda = soft.lambda();
        if !self.options.polish {
            return Ok(self.found(vertex, line.reference, lambda, at(lambda), bodies));
        }
        let ([mut lower, mut upper], g_lower) = (soft.hard, soft.g_hard);
        // Polish: Newton steps, bisection where they leave the hard bracket.
        if !(lambda > lower && lambda < upper) {
            lambda = 0.5 * (lower + upper);
        }
        let tolerance = self.options.tolerance * self.length;
        let mut best = (f64::INFINITY, lambda);
        let mut bound = f64::INFINITY;
        for _ in 0..POLISH_STEPS {
            let residual = g(lambda, bound);
            if residual.g.abs() < best.0 {
                best = (residual.g.abs(), lambda);
            }
            if residual.g.abs() <= 0.1 * tolerance {
                break;
            }
            if (residual.g < 0.0) == (g_lower < 0.0) {
                lower = lambda;
            } else {
                upper = lambda;
            }
            let newton = lambda - residual.g / residual.slope;
            let next = if newton > lower && newton < upper { newton } else { 0.5 * (lower + upper) };
            if next == lambda || upper - lower <= f64::EPSILON * (1.0 + lambda.abs()) {
                break;
            }
            // Distances change no faster than the point moves; a factor covers the curvature of the line.
            bound = residual.g.abs() + 4.0 * residual.speed * (next - lambda).abs();
            lambda = next;
        }
        if best.0 > tolerance {
            Err(best.0)
        } else {
            Ok(self.found(vertex, line.reference, best.1, at(best.1), bodies))
        }
    }

    /// Soft bisection (eq. 14): the bracket halves in every step whatever the indicator says. A hard bracket goes along.
    fn soft_bracket(
        &self,
        [mut lower, mut upper]: [f64; 2],
        mut g_lower: f64,
        g: impl Fn(f64) -> f64,
    ) -> SoftBracket {
        let mut steps = Vec::with_capacity(self.options.soft_steps);
        let (mut l, mut u, mut g_l) = (lower, upper, g_lower);
        for _ in 0..self.options.soft_steps {
            let m = 0.5 * (l + u);
            let g_m = g(m);
            if (g_m < 0.0) == (g_lower < 0.0) {
                (lower, g_lower) = (m, g_m);
            } else {
                upper = m;
            }
            let same_side = self.same_side(g_l, g_m);
            steps.push(SoftStep { bracket: [l, u], g_l, m, g_m, same_side });
            l += same_side * (m - l);
            u += (1.0 - same_side) * (m - u);
            g_l += same_side * (g_m - g_l);
        }
        SoftBracket { steps, bracket: [l, u], hard: [lower, upper], g_hard: g_lower }
    }

    /// Soft indicator that `g` has the same sign at two places.
    fn same_side(&self, g_l: f64, g_m: f64) -> f64 {
        let z = (g_l / self.length) * (g_m / self.length);
        0.5 * (1.0 + (self.options.eta * z).tanh())
    }

    /// The soft bisection of a line once more, for its derivative: where `g` was looked at, and how `lambda` follows `g`
    /// there. `slope(lambda)` is `dg/dlambda`.
    pub(crate) fn soft_sensitivities(
        &self,
        line: &SeamLine,
        start: &Location,
        reference: &Body,
        bodies: &[Body],
        slope: impl Fn(f64) -> f64,
    ) -> Vec<(f64, f64)> {
        let g = |lambda: f64, bound: f64| {
            self.residual(line, &along(reference, start, line.direction, lambda), bodies, bound)
        };
        // It was found when the mesh was deformed.
        let Ok((bracket, g_lower)) = self.bracket(line, &g) else { return Vec::new() };
        let soft = self.soft_bracket(bracket, g_lower, |lambda| g(lambda, f64::INFINITY).g);
        let squared = self.length * self.length;
        let (mut by_l, mut by_u, mut by_g) = (0.5, 0.5, 0.0);
        let mut sensitivities = Vec::with_capacity(soft.steps.len() + 1);
        for step in soft.steps.iter().rev() {
            let SoftStep { bracket: [l, u], g_l, m, g_m, same_side: s } = *step;
            let by_s = by_l * (m - l) - by_u * (m - u) + by_g * (g_m - g_l);
            // d tanh: (1 + tanh z) / 2 = s has the derivative 2 s (1 - s).
            let by_z = by_s * 2.0 * self.options.eta * s * (1.0 - s) / squared;
            let by_g_m = by_g * s + by_z * g_l;
            sensitivities.push((m, by_g_m));
            let by_m = by_l * s + by_u * (1.0 - s) + by_g_m * slope(m);
            by_g = by_g * (1.0 - s) + by_z * g_m;
            by_l = by_l * (1.0 - s) + 0.5 * by_m;
            by_u = by_u * s + 0.5 * by_m;
        }
        sensitivities.push((bracket[0], by_g));
        sensitivities
    }

    /// How far the start of a line is shifted with the junctions at the ends of the seam.
    pub(crate) fn carried<'p>(
        &self,
        line: &SeamLine,
        body: &Body,
        junction: impl Fn(u32) -> Option<&'p SeamPoint>,
    ) -> [f64; 2] {
        let mut shift = [0.0; 2];
        for &(index, weight) in &line.carried {
            let Some(point) = junction(index) else { continue };
            let Some(k) = self.carrier(line, index, point) else { continue };
            let (before, after) = (self.vertices[index as usize].locations[k], point.locations[k]);
            shift[0] += weight * shorter_way(body, after.patch, 0, after.u - before.u);
            shift[1] += weight * shorter_way(body, after.patch, 1, after.v - before.v);
        }
        shift
    }

    /// Which owner of a junction carries a line: the line's own component, if the junction is still on the same patch.
    pub(crate) fn carrier(&self, line: &SeamLine, junction: u32, point: &SeamPoint) -> Option<usize> {
        let vertex = &self.vertices[junction as usize];
        let k = vertex.owners.iter().position(|&o| o == line.reference)?;
        (vertex.locations[k].patch == point.locations[k].patch).then_some(k)
    }

    /// A bracket in which `g` changes sign the way it does in the reference state: the stored one, or, when the seam has
    /// left it, the nearest such one on the line.
    fn bracket(&self, line: &SeamLine, g: &impl Fn(f64, f64) -> Residual) -> Result<([f64; 2], f64), f64> {
        let value = |lambda: f64| g(lambda, f64::INFINITY).g;
        let crosses = |g_l: f64, g_u: f64| (g_l < 0.0) == line.from_inside && (g_u < 0.0) != line.from_inside;
        let [l, u] = line.bracket;
        let (g_l, g_u) = (value(l), value(u));
        if crosses(g_l, g_u) {
            return Ok(([l, u], g_l));
        }
        let [start, end] = line.limits;
        let at = |k: usize| start + (end - start) * k as f64 / SAMPLES as f64;
        let values: Vec<f64> = (0..=SAMPLES).map(|k| value(at(k))).collect();
        let middle = |k: usize| (0.5 * (at(k) + at(k + 1))).abs();
        (0..SAMPLES)
            .filter(|&k| crosses(values[k], values[k + 1]))
            .min_by(|&a, &b| middle(a).total_cmp(&middle(b)))
            .map(|k| ([at(k), at(k + 1)], values[k]))
            .ok_or_else(|| values.iter().fold(f64::INFINITY, |least, g| least.min(g.abs())))
    }

    /// Newton's method for two distances in the two parameters of the reference component.
    fn junction(&self, vertex: &SeamVertex, junction: &Junction, bodies: &[Body]) -> Result<SeamPoint, f64> {
        let body = &bodies[junction.reference as usize];
        let tolerance = self.options.tolerance * self.length;
        let distances = |at: &Location| {
            let point = body.point(at);
            let feet = junction.targets.map(|t| bodies[t as usize].closest_point(&point.position));
            (point, feet.map(|f| f.distance), feet.map(|f| f.normal))
        };
        let mut at = junction.start;
        let (mut point, mut g, mut normals) = distances(&at);
        for _ in 0..JUNCTION_STEPS {
            let norm = g[0].hypot(g[1]);
            if norm <= 0.1 * tolerance {
                break;
            }
            let [a, b] = [normals[0].dot(&point.d_u), normals[0].dot(&point.d_v)];
            let [c, d] = [normals[1].dot(&point.d_u), normals[1].dot(&point.d_v)];
            let determinant = a * d - b * c;
            let (du, dv) = ((b * g[1] - d * g[0]) / determinant, (c * g[0] - a * g[1]) / determinant);
            let mut step = 1.0;
            let improved = loop {
                let along_u = body.walk(&at, ParameterDirection::U, step * du);
                let next = body.walk(&along_u, ParameterDirection::V, step * dv);
                let (p, h, n) = distances(&next);
                if h[0].hypot(h[1]) < norm {
                    (at, point, g, normals) = (next, p, h, n);
                    break true;
                }
                step *= 0.5;
                if step < 1e-6 {
                    break false;
                }
            };
            if !improved {
                break;
            }
        }
        let residual = g[0].abs().max(g[1].abs());
        if residual > tolerance {
            Err(residual)
        } else {
            Ok(self.found(vertex, junction.reference, 0.0, at, bodies))
        }
    }

    /// Parameters on every owner of a point found on its reference component.
    fn found(
        &self,
        vertex: &SeamVertex,
        reference: u32,
        lambda: f64,
        at: Location,
        bodies: &[Body],
    ) -> SeamPoint {
        let position = bodies[reference as usize].position(&at);
        let mut residual: f64 = 0.0;
        let locations = vertex
            .owners
            .iter()
            .map(|&owner| {
                if owner == reference {
                    return at;
                }
                let foot = bodies[owner as usize].closest_point(&position);
                residual = residual.max(foot.distance.abs());
                foot.location
            })
            .collect();
        SeamPoint { position, locations, residual, lambda }
    }
}

/// A difference of one parameter, taken the shorter way around a closed patch: more than half of a range is the long way.
fn shorter_way(body: &Body, patch: u32, parameter: usize, difference: f64) -> f64 {
    let (low, high) = body.component().patches()[patch as usize].surface.domain()[parameter];
    let range = high - low;
    if difference.abs() > 0.5 * range { difference - range.copysign(difference) } else { difference }
}

/// The closest point, searched within `bound` first.
fn nearest(body: &Body, x: &Vector3, bound: f64) -> FootPoint {
    if bound.is_finite()
        && let Some(foot) = body.closest_point_within(x, bound)
    {
        return foot;
    }
    body.closest_point(x)
}
