//! A seam vertex on two components: the root of `g(lambda) = Phi_T(S_r(mu(lambda)))` along a line `mu(lambda)` of its
//! reference component, where `Phi_T` is the smooth union of the signed distances to its targets (eq. 10 to 14).
//!
//! Soft bisection brings the iterate near the root, safeguarded Newton steps finish it ("polish"). Lines are followed on the
//! component in its reference state, so that they stay the same in its parameters whatever becomes of it.
//!
//! The derivative is that of the implicit function theorem: at a root the path of the iteration does not matter. With
//! `dmu = m dlambda + M dshift` along the line,
//!
//! ```text
//! 0 = sum_t w_t n_t . (dS_r + J dmu - dS_t)
//! ```
//!
//! gives `dlambda`. Without the polish `lambda` is what soft bisection makes of the values of `g` that it looked at, and the
//! derivative goes back through them.

use moldline_geometry::{
    Body, FootPoint, Location, ParameterDirection, SmoothUnion, SmoothUnionPoint, SurfacePoint,
};
use moldline_spline::Vector3;

use super::{
    soft_bracket::{self, SoftBracket, SoftStep},
    target::Target,
};
use crate::{SeamOptions, chart::product};

/// Newton and bisection steps of the polish at most.
const POLISH_STEPS: usize = 80;
/// Samples of the whole line when the bracket has lost the root.
const SAMPLES: usize = 128;

/// The line along which a seam vertex is searched.
#[derive(Clone, Debug)]
pub struct SeamLine {
    /// Component that carries the line.
    pub reference: u32,
    /// The vertex in the reference state, `lambda = 0`.
    pub start: Location,
    /// Direction of the line in the parameters `(u, v)` of the patch it starts in: one of them, the other one fixed as in the
    /// paper, or straight across the seam; whichever crosses the target best over a whole row of vertices.
    pub direction: [f64; 2],
    /// Bracket `[l, u]` of lambda.
    pub bracket: [f64; 2],
    /// Ends of the component along the line: the search goes no farther.
    pub limits: [f64; 2],
    /// Whether the line comes from inside the target, as lambda grows, at the root that is meant.
    pub from_inside: bool,
    /// Components whose union is to be met.
    pub targets: Vec<u32>,
    /// The start moves with the junctions at the ends of the seam: `(junction, weight)`.
    pub carried: Vec<(u32, f64)>,
}

/// `g` at a place of a line.
struct Look {
    g: f64,
    /// `dg/dlambda` within the patch.
    slope: f64,
    /// Length of the step that one unit of lambda makes, m.
    speed: f64,
    met: Met,
}

/// The foot points on the targets, seen from `lambda`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Met {
    pub lambda: f64,
    pub feet: Feet,
}

/// Foot points on the targets: mostly there is one, which takes no allocation.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Feet {
    One(FootPoint),
    Several(Vec<FootPoint>),
}

impl Feet {
    pub fn as_slice(&self) -> &[FootPoint] {
        match self {
            Self::One(foot) => std::slice::from_ref(foot),
            Self::Several(feet) => feet,
        }
    }

    pub fn as_mut_slice(&mut self) -> &mut [FootPoint] {
        match self {
            Self::One(foot) => std::slice::from_mut(foot),
            Self::Several(feet) => feet,
        }
    }
}

/// A point found on a line.
pub(super) struct LinePoint {
    pub lambda: f64,
    /// Its parameters on the reference component.
    pub at: Location,
    /// Where `g` decided `lambda`: at the root; without the polish at the lower end of the bracket and in each step.
    pub met: Vec<Met>,
    /// The steps of the soft bisection; none after the polish.
    pub steps: Vec<SoftStep>,
}

/// How the parameters of a point on a line follow the targets and the shift of the line's start.
pub(super) struct LineDerivative {
    pub targets: Vec<Target>,
    pub by_shift: [[f64; 2]; 2],
}

/// A line in one state of the components.
pub(super) struct LineSearch<'a> {
    pub line: &'a SeamLine,
    /// How far the line's start is carried, in parameters.
    pub shift: [f64; 2],
    pub options: &'a SeamOptions,
    /// Reference length, m.
    pub length: f64,
    /// The line's component in the reference state.
    pub reference: &'a Body,
    /// All components, deformed.
    pub bodies: &'a [Body],
}

const PARAMETERS: [ParameterDirection; 2] = [ParameterDirection::U, ParameterDirection::V];

/// The location at `lambda` of a line on a component in its reference state.
pub(super) fn along(reference: &Body, start: &Location, direction: [f64; 2], lambda: f64) -> Location {
    let mut at = *start;
    for k in 0..2 {
        if direction[k] != 0.0 {
            at = reference.walk(&at, PARAMETERS[k], lambda * direction[k]);
        }
    }
    at
}

/// The end of a line and its derivatives with respect to the start and to the lengths along `u` and `v`: rows are `u`, `v`.
struct Along {
    end: Location,
    by_start: [[f64; 2]; 2],
    by_lengths: [[f64; 2]; 2],
}

/// [`along`] for given lengths, with its derivative.
fn along_derivative(reference: &Body, start: &Location, lengths: [f64; 2]) -> Along {
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

impl LineSearch<'_> {
    /// The root, or the distance at which the search ended, m.
    pub fn eval(&self) -> Result<LinePoint, f64> {
        let start = along(self.reference, &self.line.start, self.shift, 1.0);
        let at = |lambda: f64| along(self.reference, &start, self.line.direction, lambda);
        let look = |lambda: f64, bound: f64| self.look(lambda, &at(lambda), bound);

        let (lower, upper) = self.bracket(&look)?;
        let (bracket, g_lower) = ([lower.met.lambda, upper], lower.g);
        let mut met = vec![lower.met];
        let soft = SoftBracket::eval(self.options, self.length, bracket, g_lower, |lambda| {
            let look = look(lambda, f64::INFINITY);
            if !self.options.polish {
                met.push(look.met);
            }
            look.g
        });
        if !self.options.polish {
            return Ok(LinePoint { lambda: soft.lambda, at: at(soft.lambda), met, steps: soft.steps });
        }
        let best = self.polish(&soft, &look).ok_or(f64::INFINITY)?;
        if best.g.abs() > self.options.tolerance * self.length {
            return Err(best.g.abs());
        }
        let lambda = best.met.lambda;
        Ok(LinePoint { lambda, at: at(lambda), met: vec![best.met], steps: Vec::new() })
    }

    /// Newton steps, bisection where they leave the hard bracket: the look nearest to a root; `None` if `g` is no number.
    fn polish(&self, soft: &SoftBracket, look: &impl Fn(f64, f64) -> Look) -> Option<Look> {
        let ([mut lower, mut upper], g_lower) = (soft.hard, soft.g_hard);
        let mut lambda = soft.lambda;
        if !(lambda > lower && lambda < upper) {
            lambda = 0.5 * (lower + upper);
        }
        let tolerance = self.options.tolerance * self.length;
        let mut best: Option<Look> = None;
        let mut bound = f64::INFINITY;
        for _ in 0..POLISH_STEPS {
            let here = look(lambda, bound);
            let (g, slope, speed) = (here.g, here.slope, here.speed);
            if g.abs() < best.as_ref().map_or(f64::INFINITY, |best| best.g.abs()) {
                best = Some(here);
            }
            if g.abs() <= 0.1 * tolerance {
                break;
            }
            if (g < 0.0) == (g_lower < 0.0) {
                lower = lambda;
            } else {
                upper = lambda;
            }
            let newton = lambda - g / slope;
            let next = if newton > lower && newton < upper { newton } else { 0.5 * (lower + upper) };
            if next == lambda || upper - lower <= f64::EPSILON * (1.0 + lambda.abs()) {
                break;
            }
            // Distances change no faster than the point moves; a factor covers the curvature of the line.
            bound = g.abs() + 4.0 * speed * (next - lambda).abs();
            lambda = next;
        }
        best
    }

    /// A bracket in which `g` changes sign the way it does in the reference state: the stored one, or, when the seam has
    /// left it, the nearest such one on the line. The look at its lower end, and its upper end.
    fn bracket(&self, look: &impl Fn(f64, f64) -> Look) -> Result<(Look, f64), f64> {
        let from_inside = self.line.from_inside;
        let crosses = |l: &Look, u: &Look| (l.g < 0.0) == from_inside && (u.g < 0.0) != from_inside;
        let [l, u] = self.line.bracket.map(|lambda| look(lambda, f64::INFINITY));
        if crosses(&l, &u) {
            return Ok((l, u.met.lambda));
        }
        let [start, end] = self.line.limits;
        let at = |k: usize| start + (end - start) * k as f64 / SAMPLES as f64;
        let mut samples: Vec<Look> = (0..=SAMPLES).map(|k| look(at(k), f64::INFINITY)).collect();
        let middle = |k: usize| (0.5 * (at(k) + at(k + 1))).abs();
        let nearest = (0..SAMPLES)
            .filter(|&k| crosses(&samples[k], &samples[k + 1]))
            .min_by(|&a, &b| middle(a).total_cmp(&middle(b)));
        match nearest {
            Some(k) => Ok((samples.swap_remove(k), at(k + 1))),
            None => Err(samples.iter().fold(f64::INFINITY, |least, look| least.min(look.g.abs()))),
        }
    }

    /// `g` at `lambda`, which is at the location `at`. A single target is searched within `bound` first.
    fn look(&self, lambda: f64, at: &Location, bound: f64) -> Look {
        let point = self.bodies[self.line.reference as usize].point(at);
        let (g, gradient, feet) = if let [target] = self.line.targets[..] {
            let foot = nearest(&self.bodies[target as usize], &point.position, bound);
            (foot.distance, foot.normal, Feet::One(foot))
        } else {
            let targets = self.line.targets.iter();
            let feet: Vec<FootPoint> =
                targets.map(|&t| self.bodies[t as usize].closest_point(&point.position)).collect();
            let union = self.union(&feet, &mut vec![0.0; feet.len()]);
            (union.phi, union.gradient, Feet::Several(feet))
        };
        let tangent = point.d_u * self.line.direction[0] + point.d_v * self.line.direction[1];
        Look { g, slope: gradient.dot(&tangent), speed: tangent.norm(), met: Met { lambda, feet } }
    }

    /// The smooth union of the targets (eq. 11). Its rho is much larger than that of the outer mold line, or a third
    /// component would displace the seam of two.
    fn union(&self, feet: &[FootPoint], weights: &mut [f64]) -> SmoothUnionPoint {
        let distances: Vec<(f64, Vector3)> = feet.iter().map(|foot| (foot.distance, foot.normal)).collect();
        SmoothUnion::from_fillet(self.options.fillet * self.length).eval(&distances, weights)
    }

    /// The derivative at a point that [`eval`](Self::eval) found.
    pub fn linearise(&self, lambda: f64, met: &[Met], steps: &[SoftStep]) -> LineDerivative {
        let shifted = along_derivative(self.reference, &self.line.start, self.shift);
        let direction = self.line.direction;
        // The location at lambda, `m`, and `M`: its derivatives with respect to lambda and to the shift.
        let follow = |lambda: f64| {
            let line = along_derivative(self.reference, &shifted.end, direction.map(|d| d * lambda));
            let m = line.by_lengths.map(|row| row[0] * direction[0] + row[1] * direction[1]);
            (line.end, m, product(&line.by_start, &shifted.by_lengths))
        };
        let terms: Vec<Term<'_>> = met
            .iter()
            .map(|met| {
                let (from, m, by_shift) = follow(met.lambda);
                let feet = met.feet.as_slice();
                let mut weights = vec![0.0; feet.len()];
                let gradient = self.union(feet, &mut weights).gradient;
                let SurfacePoint { d_u, d_v, .. } = self.bodies[self.line.reference as usize].point(&from);
                let slopes = [d_u, d_v].map(|j| j.dot(&gradient));
                Term { from, by_shift, feet, weights, slopes, slope: slopes[0] * m[0] + slopes[1] * m[1] }
            })
            .collect();
        let slopes: Vec<f64> = terms.iter().map(|term| term.slope).collect();
        let by_g = if self.options.polish {
            slopes.iter().map(|slope| -1.0 / slope).collect()
        } else {
            soft_bracket::derivative(steps, self.options.eta, self.length, &slopes)
        };
        let (_, m, mut by_shift) = follow(lambda);
        let mut targets = Vec::new();
        for (term, by_g) in terms.iter().zip(by_g).rev() {
            for ((&t, foot), weight) in self.line.targets.iter().zip(term.feet).zip(&term.weights) {
                targets.push(Target {
                    component: t as usize,
                    at: foot.location,
                    from: term.from,
                    normal: foot.normal,
                    gain: m.map(|m| -by_g * weight * m),
                });
            }
            for row in 0..2 {
                for column in 0..2 {
                    let along =
                        term.slopes[0] * term.by_shift[0][column] + term.slopes[1] * term.by_shift[1][column];
                    by_shift[row][column] += m[row] * by_g * along;
                }
            }
        }
        LineDerivative { targets, by_shift }
    }
}

/// A place where the targets were met, with the derivatives of `g` there.
struct Term<'a> {
    from: Location,
    by_shift: [[f64; 2]; 2],
    feet: &'a [FootPoint],
    weights: Vec<f64>,
    /// With respect to the parameters.
    slopes: [f64; 2],
    /// With respect to lambda.
    slope: f64,
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
