//! Safeguarded Newton iterations for foot points: minimise `f = |S - x|^2 / 2` over parameters within bounds.
//!
//! With `r = S - x` the gradient is `J^T r` and the Hessian `J^T J + r . S_ab`. A step is the Newton step where the
//! Hessian (of the free parameters) is positive definite and the Gauss-Newton step elsewhere. Parameters at a bound that
//! the gradient pushes outward are held. No step is longer than `2 |r|`, which no foot point is further away than, and
//! none may increase the distance.

use crate::component::Patch;
use crate::{Side, Vector3};
use moldline_spline::{Surface, SurfaceJet};

pub(crate) type Rectangle = [(f64, f64); 2];

/// Steps shorter than this, relative to the size of the component, are the last ones of a quadratic iteration.
pub(crate) const LAST_STEP: f64 = 1e-11;
/// Steps shorter than this, relative to the size of the component, change nothing any more.
pub(crate) const NO_STEP: f64 = 1e-15;

/// A step in the parameters and what is known about it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Step {
    pub du: f64,
    pub dv: f64,
    /// Parameters held at a bound that the gradient pushes against.
    pub held: [bool; 2],
    /// The step comes from a positive definite Hessian, so that the iteration is quadratic.
    pub newton: bool,
    /// Length of the step in space, metres.
    pub length: f64,
}

/// The next step from `(u, v)` within a rectangle.
#[inline]
pub(crate) fn step(jet: &SurfaceJet, r: &Vector3, u: f64, v: f64, [ru, rv]: Rectangle) -> Step {
    let (gu, gv) = (jet.d_u.dot(r), jet.d_v.dot(r));
    let (guu, guv, gvv) = (jet.d_u.norm_squared(), jet.d_u.dot(&jet.d_v), jet.d_v.norm_squared());
    let (huu, huv, hvv) = (guu + jet.d_uu.dot(r), guv + jet.d_uv.dot(r), gvv + jet.d_vv.dot(r));
    let held_u = (u <= ru.0 && gu >= 0.0) || (u >= ru.1 && gu <= 0.0);
    let held_v = (v <= rv.0 && gv >= 0.0) || (v >= rv.1 && gv <= 0.0);
    let clamp_u = |du: f64| (u + du).clamp(ru.0, ru.1) - u;
    let clamp_v = |dv: f64| (v + dv).clamp(rv.0, rv.1) - v;
    // One parameter: Newton if convex, else Gauss-Newton, nothing where the tangent vanishes.
    let single = |g: f64, h: f64, gauss: f64| {
        if h > 1e-8 * gauss {
            (-g / h, true)
        } else if gauss > 0.0 {
            (-g / gauss, false)
        } else {
            (0.0, true)
        }
    };
    let (mut du, mut dv, newton) = match (held_u, held_v) {
        (true, true) => (0.0, 0.0, true),
        (true, false) => {
            let (dv, newton) = single(gv, hvv, gvv);
            (0.0, clamp_v(dv), newton)
        }
        (false, true) => {
            let (du, newton) = single(gu, huu, guu);
            (clamp_u(du), 0.0, newton)
        }
        (false, false) => {
            let det = huu * hvv - huv * huv;
            let newton = huu > 0.0 && hvv > 0.0 && det > 1e-8 * guu * gvv;
            let (a, b, c, det) =
                if newton { (huu, huv, hvv, det) } else { (guu, guv, gvv, guu * gvv - guv * guv) };
            if det > 1e-14 * a * c && det > 0.0 {
                let du = (b * gv - c * gu) / det;
                let dv = (b * gu - a * gv) / det;
                let inside = |t: f64, (low, high): (f64, f64)| t >= low && t <= high;
                if inside(u + du, ru) && inside(v + dv, rv) {
                    (du, dv, newton)
                } else {
                    let (du, dv) =
                        on_boundary([gu, gv], [a, b, c], [(ru.0 - u, ru.1 - u), (rv.0 - v, rv.1 - v)]);
                    (du, dv, newton)
                }
            } else {
                // The tangents are parallel or one of them vanishes: follow the longer one.
                let (along_u, first) =
                    if guu >= gvv { (true, single(gu, huu, guu)) } else { (false, single(gv, hvv, gvv)) };
                if along_u { (clamp_u(first.0), 0.0, false) } else { (0.0, clamp_v(first.0), false) }
            }
        }
    };
    let mut length = (jet.d_u * du + jet.d_v * dv).norm();
    let limit = 2.0 * r.norm();
    if length > limit {
        let scale = limit / length;
        (du, dv, length) = (du * scale, dv * scale, limit);
    }
    Step { du, dv, held: [held_u, held_v], newton, length }
}

/// The minimum of the convex model `g . d + d . H d / 2` on the boundary of a rectangle of steps: on each side in turn.
fn on_boundary([gu, gv]: [f64; 2], [a, b, c]: [f64; 3], [ru, rv]: Rectangle) -> (f64, f64) {
    let mut best = (f64::INFINITY, (0.0, 0.0));
    let mut offer = |du: f64, dv: f64| {
        let model = gu * du + gv * dv + 0.5 * (a * du * du + c * dv * dv) + b * du * dv;
        if model < best.0 {
            best = (model, (du, dv));
        }
    };
    for du in [ru.0, ru.1] {
        offer(du, (-(gv + b * du) / c).clamp(rv.0, rv.1));
    }
    for dv in [rv.0, rv.1] {
        offer((-(gu + b * dv) / a).clamp(ru.0, ru.1), dv);
    }
    best.1
}

/// Whether a step is acceptable: it decreases the squared distance, or it is a Newton step so short that the decrease is
/// lost in rounding.
#[inline]
pub(crate) fn is_progress(step: &Step, squared: f64, before: f64, size: f64) -> bool {
    squared < before || (step.newton && step.length <= 1e-6 * size && squared <= before * (1.0 + 1e-14))
}

/// Descends from `(u, v)` to the parameters of a minimum within a rectangle. If `f` is known to be convex there, it gives up (`None`) as
/// soon as the tangent plane of `f` shows that nothing in the rectangle is closer than the square root of `bound`.
pub(crate) fn in_rectangle(
    surface: &Surface,
    control_points: &[[f64; 4]],
    x: &Vector3,
    rectangle: Rectangle,
    (mut u, mut v): (f64, f64),
    size: f64,
    convex_bound: Option<f64>,
) -> Option<(f64, f64)> {
    let [ru, rv] = rectangle;
    let mut jet = surface.jet(control_points, u, v);
    let mut r = jet.position - x;
    let mut squared = r.norm_squared();
    for _ in 0..60 {
        if let Some(bound) = convex_bound {
            let (gu, gv) = (jet.d_u.dot(&r), jet.d_v.dot(&r));
            let fall_u = (gu * (u - ru.0)).max(gu * (u - ru.1)).max(0.0);
            let fall_v = (gv * (v - rv.0)).max(gv * (v - rv.1)).max(0.0);
            if squared - 2.0 * (fall_u + fall_v) >= bound {
                return None;
            }
        }
        let s = step(&jet, &r, u, v, rectangle);
        if s.length <= NO_STEP * size {
            break;
        }
        let last = s.newton && s.length <= LAST_STEP * size;
        let mut scale = 1.0;
        let accepted = loop {
            let (nu, nv) = ((u + scale * s.du).clamp(ru.0, ru.1), (v + scale * s.dv).clamp(rv.0, rv.1));
            let trial = surface.jet(control_points, nu, nv);
            let trial_r = trial.position - x;
            let trial_squared = trial_r.norm_squared();
            if last || is_progress(&s, trial_squared, squared, size) {
                (u, v, jet, r, squared) = (nu, nv, trial, trial_r, trial_squared);
                break true;
            }
            scale *= 0.5;
            if scale < 1e-6 {
                break false;
            }
        };
        if last || !accepted {
            break;
        }
    }
    Some((u, v))
}

/// The foot point along a side of a patch within a range of its parameter: parameter and distance.
pub(crate) fn on_side(
    patch: &Patch,
    control_points: &[[f64; 4]],
    side: Side,
    range: (f64, f64),
    x: &Vector3,
    start: f64,
) -> (f64, f64) {
    let points = &control_points[patch.range.clone()];
    let at = |t: f64| {
        let l = patch.on_side(0, side, t);
        let j = patch.surface.jet(points, l.u, l.v);
        let (d, dd) = if side.holds_u() { (j.d_v, j.d_vv) } else { (j.d_u, j.d_uu) };
        (j.position - x, d, dd)
    };
    let mut t = start.clamp(range.0, range.1);
    let (mut r, mut d, mut dd) = at(t);
    for _ in 0..60 {
        let gauss = d.norm_squared();
        if gauss == 0.0 {
            break;
        }
        let hessian = gauss + dd.dot(&r);
        let newton = hessian > 1e-8 * gauss;
        let dt = -d.dot(&r) / if newton { hessian } else { gauss };
        let dt = (t + dt).clamp(range.0, range.1) - t;
        let relative = dt.abs() / (range.1 - range.0);
        if relative <= 1e-16 {
            break;
        }
        // The last step of a quadratic iteration is taken whatever rounding does to the distance.
        let last = newton && relative <= 1e-9;
        let tolerance = if newton && relative <= 1e-6 { 1.0 + 1e-14 } else { 1.0 };
        let mut scale = 1.0;
        let accepted = loop {
            let next = at(t + scale * dt);
            if last || next.0.norm_squared() < tolerance * r.norm_squared() {
                t += scale * dt;
                (r, d, dd) = next;
                break true;
            }
            scale *= 0.5;
            if scale < 1e-4 {
                break false;
            }
        };
        if last || !accepted {
            break;
        }
    }
    (t.clamp(range.0, range.1), r.norm())
}
