//! Patches: a user's input, and the smooth pieces of a component.

use crate::error::ComponentError;
use crate::location::{Location, Side};
use crate::newton;
use moldline_foundation::{Vector3, quadrature::GAUSS_4};
use moldline_spline::{KnotVector, Surface, SurfacePoint};
use std::ops::Range;

/// A user's patch.
#[derive(Debug, Clone, PartialEq)]
pub struct PatchInput {
    /// Its name, for messages.
    pub name: String,
    /// Knots along `u`.
    pub knots_u: KnotVector,
    /// Knots along `v`.
    pub knots_v: KnotVector,
    /// Cartesian control points, metres, index `i n_v + j`.
    pub control_points: Vec<[f64; 3]>,
    /// Positive weights in the same order; all 1 if absent.
    pub weights: Option<Vec<f64>>,
}

impl PatchInput {
    /// Checks that counts fit the knots and numbers are finite.
    pub(crate) fn validate(&self) -> Result<(), ComponentError> {
        let name = || self.name.clone();
        let (n_u, n_v) = (self.knots_u.control_point_count(), self.knots_v.control_point_count());
        let count = self.control_points.len();
        if count != n_u * n_v {
            return Err(ComponentError::ControlPointCount { patch: name(), count, n_u, n_v });
        }
        for (index, p) in self.control_points.iter().enumerate() {
            if let Some(&value) = p.iter().find(|c| !c.is_finite()) {
                return Err(ComponentError::NotFinite { patch: name(), index, value });
            }
        }
        if let Some(weights) = &self.weights {
            if weights.len() != count {
                return Err(ComponentError::WeightCount { patch: name(), weights: weights.len(), count });
            }
            if let Some(index) = weights.iter().position(|w| !(1e-9..=1e9).contains(w)) {
                return Err(ComponentError::Weight { patch: name(), index, value: weights[index] });
            }
        }
        Ok(())
    }
}

/// A smooth, clamped, oriented piece of a component.
#[derive(Debug, Clone, PartialEq)]
pub struct Patch {
    /// The name of the user's patch it is (part of).
    pub name: String,
    /// Index of that patch among the user's.
    pub source: usize,
    /// Its basis; a part of a user's patch keeps that patch's parameters.
    pub surface: Surface,
    /// Its control points in the component's array.
    pub range: Range<usize>,
    /// Whether `S_u x S_v` points into the component.
    pub flipped: bool,
}

impl Patch {
    pub(crate) fn point(&self, control_points: &[[f64; 4]], u: f64, v: f64) -> SurfacePoint {
        self.surface.point(&control_points[self.range.clone()], u, v)
    }

    /// First and last value of the parameter along a side.
    pub(crate) fn side_domain(&self, side: Side) -> (f64, f64) {
        self.surface.domain()[usize::from(side.holds_u())]
    }

    pub(crate) fn on_side(&self, patch: u32, side: Side, t: f64) -> Location {
        let [u, v] = self.surface.domain();
        match side {
            Side::UMin => Location { patch, u: u.0, v: t },
            Side::UMax => Location { patch, u: u.1, v: t },
            Side::VMin => Location { patch, u: t, v: v.0 },
            Side::VMax => Location { patch, u: t, v: v.1 },
        }
    }

    /// Parameters along a side: every break and `per_interval - 1` values between each two.
    pub(crate) fn side_samples(&self, side: Side, per_interval: usize) -> Vec<f64> {
        let knots = if side.holds_u() { self.surface.knots_v() } else { self.surface.knots_u() };
        samples(knots, per_interval)
    }

    /// The point of a side nearest to `x` within a range of its parameter: the parameter and the distance. Newton from
    /// the best of a number of samples, in steps that never increase the distance.
    pub(crate) fn closest_on_side(
        &self,
        control_points: &[[f64; 4]],
        side: Side,
        range: (f64, f64),
        x: &Vector3,
    ) -> (f64, f64) {
        let inside = |t: &f64| *t > range.0 && *t < range.1;
        let candidates = self.side_samples(side, 6).into_iter().filter(inside).chain([range.0, range.1]);
        let distance = |t: f64| {
            let l = self.on_side(0, side, t);
            (self.surface.position(&control_points[self.range.clone()], l.u, l.v) - x).norm()
        };
        let best = candidates.map(|t| (distance(t), t)).min_by(|a, b| a.0.total_cmp(&b.0));
        let start = best.map_or(range.0, |b| b.1);
        self.closest_on_side_near(control_points, side, range, x, start)
    }

    /// As [`closest_on_side`](Self::closest_on_side), by Newton from `start`.
    pub(crate) fn closest_on_side_near(
        &self,
        control_points: &[[f64; 4]],
        side: Side,
        range: (f64, f64),
        x: &Vector3,
        start: f64,
    ) -> (f64, f64) {
        let points = &control_points[self.range.clone()];
        newton::on_curve(x, range, start, |t| {
            let l = self.on_side(0, side, t);
            let j = self.surface.jet(points, l.u, l.v);
            let (d, dd) = if side.holds_u() { (j.d_v, j.d_vv) } else { (j.d_u, j.d_uu) };
            [j.position - x, d, dd]
        })
    }

    /// The unit normal `S_u x S_v`, not yet turned outward; its limit where the product vanishes, and zero if there is
    /// none.
    pub(crate) fn normal(&self, control_points: &[[f64; 4]], u: f64, v: f64) -> Vector3 {
        self.normal_at(control_points, u, v, &self.point(control_points, u, v))
    }

    /// The same for a point that is already evaluated.
    #[inline]
    pub(crate) fn normal_at(&self, control_points: &[[f64; 4]], u: f64, v: f64, p: &SurfacePoint) -> Vector3 {
        let [(u0, u1), (v0, v1)] = self.surface.domain();
        if let Some(n) = cross(&p.d_u, &p.d_v, u1 - u0, v1 - v0) {
            return n;
        }
        let control_points = &control_points[self.range.clone()];
        // On a collapsed side the derivative along it vanishes; to first order it grows with the mixed derivative.
        let j = self.surface.jet(control_points, u, v);
        let (middle_u, middle_v) = (0.5 * (u0 + u1), 0.5 * (v0 + v1));
        let (lu, lv) = (u1 - u0, v1 - v0);
        let toward_u = if u < middle_u { lu } else { -lu };
        let toward_v = if v < middle_v { lv } else { -lv };
        let limits = [(p.d_u, j.d_uv * toward_u), (j.d_uv * toward_v, p.d_v)];
        let at_side = [u == u0 || u == u1, v == v0 || v == v1];
        for ((a, b), _) in limits.iter().zip(at_side).filter(|(_, at)| *at) {
            let scale_u = if b == &p.d_v { 1.0 } else { lu };
            let scale_v = if a == &p.d_u { 1.0 } else { lv };
            if let Some(n) = cross(a, b, scale_u, scale_v) {
                return n;
            }
        }
        // Higher contact: the normal a little further inside.
        for step in [1e-6, 1e-4, 1e-2] {
            let (u, v) = (u + step * toward_u, v + step * toward_v);
            let p = self.surface.point(control_points, u, v);
            if let Some(n) = cross(&p.d_u, &p.d_v, lu, lv) {
                return n;
            }
        }
        Vector3::zeros()
    }

    /// Volume of the cone from `origin` over the patch: `1/3` of the integral of `(S - o) . (S_u x S_v)`, by Gauss
    /// quadrature with four points per interval; only its sign is used.
    pub(crate) fn cone_volume(&self, control_points: &[[f64; 4]], origin: &Vector3) -> f64 {
        let mut sum = 0.0;
        for u in self.surface.knots_u().breaks().windows(2) {
            for v in self.surface.knots_v().breaks().windows(2) {
                let area = (u[1] - u[0]) * (v[1] - v[0]);
                for (a, wa) in GAUSS_4 {
                    for (b, wb) in GAUSS_4 {
                        let at = |x: f64, w: &[f64]| w[0] + 0.5 * (1.0 + x) * (w[1] - w[0]);
                        let p = self.point(control_points, at(a, u), at(b, v));
                        sum += 0.25 * area * wa * wb * (p.position - origin).dot(&p.d_u.cross(&p.d_v));
                    }
                }
            }
        }
        sum / 3.0
    }
}

/// The unit vector along `a x b`, unless the angle between them or one of their lengths is lost in rounding.
fn cross(a: &Vector3, b: &Vector3, scale_a: f64, scale_b: f64) -> Option<Vector3> {
    let (a, b) = (a * scale_a, b * scale_b);
    let n = a.cross(&b);
    let (la, lb, ln) = (a.norm(), b.norm(), n.norm());
    let long_enough = la.min(lb) > 1e-9 * la.max(lb);
    (long_enough && ln > 1e-9 * la * lb).then(|| n / ln)
}

fn samples(knots: &KnotVector, per_interval: usize) -> Vec<f64> {
    let breaks = knots.breaks();
    let between = |w: &[f64]| {
        let (a, b) = (w[0], w[1]);
        (0..per_interval).map(move |k| a + (b - a) * k as f64 / per_interval as f64).collect::<Vec<_>>()
    };
    let mut all: Vec<f64> = breaks.windows(2).flat_map(between).collect();
    all.push(breaks[breaks.len() - 1]);
    all
}
