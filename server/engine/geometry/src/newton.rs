//! Newton iterations for foot points within a trust region: minimise `f = |S - x|^2 / 2` over parameters within bounds.
//!
//! With `r = S - x` the gradient is `J^T r` and the Hessian `J^T J + r . S_ab`. A step is the global minimum of that
//! quadratic model, whether convex or not, over the steps that leave neither the bounds nor the trust region (a rectangle
//! as well, whose sides are as long in space): the Newton step where it may be taken, and exactly along a bound where the
//! minimum is there. The trust region shrinks where the model promises too much, so that every accepted step decreases
//! the distance and the iteration ends at a point where the model has nothing to gain.

use crate::location::Rectangle;
use moldline_foundation::Vector3;
use moldline_spline::{Surface, SurfaceJet};

/// Steps shorter than this, relative to the size of the component, are the last ones of a quadratic iteration.
const LAST_STEP: f64 = 1e-11;
/// Steps shorter than this, relative to the size of the component, are lost in rounding.
const NO_STEP: f64 = 1e-15;
/// Trials of a step. Each that is refused shrinks the trust region to a quarter or less, so that more are made only with
/// numbers that are not finite.
const MAX_TRIALS: usize = 600;

/// The state of an iteration within a rectangle of parameters.
pub(crate) struct Iterate<'a> {
    pub x: &'a Vector3,
    /// Size of the component, metres.
    pub size: f64,
    pub u: f64,
    pub v: f64,
    pub jet: SurfaceJet,
    /// `S - x`.
    pub r: Vector3,
    pub squared: f64,
    /// Half a side of the trust region, metres...
    trust: f64,
    /// ... and relative to the parameters' ranges: at a pole lengths in space do not limit how far one turns around it.
    share: f64,
}

/// The outcome of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Progress {
    Moved,
    /// The parameters are those of a minimum; the jet may be that of the last iterate but one.
    Converged,
}

/// A step in the parameters with its properties.
#[derive(Debug, Clone, Copy)]
struct Step {
    du: f64,
    dv: f64,
    /// The trust region does not limit it, so that the iteration is quadratic.
    newton: bool,
    /// Length of the step in space, metres.
    length: f64,
    /// The decrease of `|S - x|^2` that the model predicts.
    decrease: f64,
}

impl<'a> Iterate<'a> {
    pub fn new(x: &'a Vector3, size: f64, (u, v): (f64, f64), jet: SurfaceJet) -> Self {
        let r = jet.position - x;
        let squared = r.norm_squared();
        Self { x, size, u, v, jet, r, squared, trust: squared.sqrt(), share: 1.0 }
    }

    /// Parameters at a bound that the gradient pushes against.
    #[inline]
    pub fn held(&self, [ru, rv]: Rectangle) -> [bool; 2] {
        let at = |t: f64, (low, high): (f64, f64), d: &Vector3| {
            (t <= low && d.dot(&self.r) >= 0.0) || (t >= high && d.dot(&self.r) <= 0.0)
        };
        [at(self.u, ru, &self.jet.d_u), at(self.v, rv, &self.jet.d_v)]
    }

    /// Takes one step; `jet` evaluates the surface.
    #[inline]
    pub fn advance(&mut self, rectangle: Rectangle, jet: impl Fn(f64, f64) -> SurfaceJet) -> Progress {
        for _ in 0..MAX_TRIALS {
            let s = self.step(rectangle);
            let settled = s.length <= NO_STEP * self.size;
            if settled || (!s.newton && s.decrease <= 4.0 * f64::EPSILON * self.squared) {
                return Progress::Converged;
            }
            let [ru, rv] = rectangle;
            let (u, v) = ((self.u + s.du).clamp(ru.0, ru.1), (self.v + s.dv).clamp(rv.0, rv.1));
            if s.newton && s.length <= LAST_STEP * self.size {
                (self.u, self.v) = (u, v);
                return Progress::Converged;
            }
            let next = jet(u, v);
            let r = next.position - self.x;
            let squared = r.norm_squared();
            let decrease = self.squared - squared;
            // A short Newton step is right even if its decrease is lost in rounding.
            let rounding = s.newton && s.length <= 1e-6 * self.size && -decrease <= noise(&self.r, self.x);
            let accepted = decrease > 1e-3 * s.decrease || rounding;
            if !s.newton && decrease > 0.75 * s.decrease {
                self.trust *= 2.0;
                self.share *= 2.0;
            } else if !(rounding || decrease >= 0.25 * s.decrease) {
                self.trust = 0.25 * s.length.min(self.trust);
                let share = (s.du.abs() / (ru.1 - ru.0)).max(s.dv.abs() / (rv.1 - rv.0));
                self.share = 0.25 * share.min(self.share);
            }
            if accepted {
                (self.u, self.v, self.jet, self.r, self.squared) = (u, v, next, r, squared);
                return Progress::Moved;
            }
        }
        Progress::Converged
    }

    /// The minimum of the model over the steps within the rectangle and the trust region.
    #[inline]
    fn step(&self, [ru, rv]: Rectangle) -> Step {
        let (jet, r) = (&self.jet, &self.r);
        let (gu, gv) = (jet.d_u.dot(r), jet.d_v.dot(r));
        let (guu, guv, gvv) = (jet.d_u.norm_squared(), jet.d_u.dot(&jet.d_v), jet.d_v.norm_squared());
        let (huu, huv, hvv) = (guu + jet.d_uu.dot(r), guv + jet.d_uv.dot(r), gvv + jet.d_vv.dot(r));
        let length = |du: f64, dv: f64| (du * du * guu + 2.0 * du * dv * guv + dv * dv * gvv).max(0.0).sqrt();

        let (share_u, share_v) = (self.share * (ru.1 - ru.0), self.share * (rv.1 - rv.0));

        let det = huu * hvv - huv * huv;
        if huu > 0.0 && det > 1e-14 * huu * hvv {
            let du = (huv * gv - hvv * gu) / det;
            let dv = (huv * gu - huu * gv) / det;
            let inside = |t: f64, (low, high): (f64, f64)| t >= low && t <= high;
            let short = (du * du * guu).max(dv * dv * gvv) <= self.trust * self.trust;
            let narrow = du.abs() <= share_u && dv.abs() <= share_v;
            if short && narrow && inside(self.u + du, ru) && inside(self.v + dv, rv) {
                let decrease = -(gu * du + gv * dv);
                return Step { du, dv, newton: true, length: length(du, dv), decrease };
            }
        }

        // On the boundary: each side in turn, along which the model is a parabola.
        let trust_u = (self.trust / guu.sqrt()).min(share_u);
        let trust_v = (self.trust / gvv.sqrt()).min(share_v);
        let low = [(ru.0 - self.u).max(-trust_u), (rv.0 - self.v).max(-trust_v)];
        let high = [(ru.1 - self.u).min(trust_u), (rv.1 - self.v).min(trust_v)];
        let mut best = (0.0, 0.0, 0.0);
        let mut offer = |du: f64, dv: f64| {
            let model = gu * du + gv * dv + 0.5 * (huu * du * du + hvv * dv * dv) + huv * du * dv;
            if model < best.0 {
                best = (model, du, dv);
            }
        };
        for du in [low[0], high[0]] {
            if hvv > 0.0 {
                offer(du, (-(gv + huv * du) / hvv).clamp(low[1], high[1]));
            } else {
                offer(du, low[1]);
                offer(du, high[1]);
            }
        }
        for dv in [low[1], high[1]] {
            if huu > 0.0 {
                offer((-(gu + huv * dv) / huu).clamp(low[0], high[0]), dv);
            } else {
                offer(low[0], dv);
                offer(high[0], dv);
            }
        }
        let (model, du, dv) = best;
        let newton = (du == 0.0 || du.abs() < trust_u) && (dv == 0.0 || dv.abs() < trust_v);
        Step { du, dv, newton, length: length(du, dv), decrease: -2.0 * model }
    }
}

/// A bound on the rounding of `|S - x|^2`: that of the difference of coordinates, and of its square.
fn noise(r: &Vector3, x: &Vector3) -> f64 {
    let r = r.norm();
    1e-14 * r * (r + x.norm())
}

/// Descends from `(u, v)` to the parameters of a minimum within a rectangle. If `f` is known to be convex there, it gives
/// up (`None`) as soon as the tangent plane of `f` shows that nothing in the rectangle is closer than the square root of
/// `convex_bound`.
pub(crate) fn in_rectangle(
    surface: &Surface,
    control_points: &[[f64; 4]],
    x: &Vector3,
    rectangle: Rectangle,
    (u, v): (f64, f64),
    size: f64,
    convex_bound: Option<f64>,
) -> Option<(f64, f64)> {
    let [ru, rv] = rectangle;
    let jet = |u, v| surface.jet(control_points, u, v);
    let mut i = Iterate::new(x, size, (u, v), jet(u, v));
    for _ in 0..100 {
        if let Some(bound) = convex_bound {
            let (gu, gv) = (i.jet.d_u.dot(&i.r), i.jet.d_v.dot(&i.r));
            let fall_u = (gu * (i.u - ru.0)).max(gu * (i.u - ru.1)).max(0.0);
            let fall_v = (gv * (i.v - rv.0)).max(gv * (i.v - rv.1)).max(0.0);
            if i.squared - 2.0 * (fall_u + fall_v) >= bound {
                return None;
            }
        }
        if i.advance(rectangle, jet) == Progress::Converged {
            break;
        }
    }
    Some((i.u, i.v))
}

/// The foot point of `x` on a curve within a range of its parameter, from `start`: parameter and distance. `curve` gives
/// the position relative to `x` and the first and second derivative.
pub(crate) fn on_curve(
    x: &Vector3,
    range: (f64, f64),
    start: f64,
    curve: impl Fn(f64) -> [Vector3; 3],
) -> (f64, f64) {
    let mut t = start.clamp(range.0, range.1);
    let [mut r, mut d, mut dd] = curve(t);
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
        let allowance = if newton && relative <= 1e-6 { noise(&r, x) } else { 0.0 };
        let mut scale = 1.0;
        let accepted = loop {
            let next = curve(t + scale * dt);
            if last || next[0].norm_squared() < r.norm_squared() + allowance {
                t += scale * dt;
                [r, d, dd] = next;
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
