//! Area, volume and extent of closed components.

use moldline_foundation::{Vector3, quadrature::GAUSS_4};
use moldline_geometry::Body;

/// Wetted area and volume, m^2 and m^3, by Gauss quadrature with four points for each direction of a polynomial piece.
pub(crate) fn area_and_volume(body: &Body) -> (f64, f64) {
    // From the middle, where little is lost to cancellation.
    let bounds = body.bounds();
    let origin = (bounds.low + bounds.high) * 0.5;
    let (mut area, mut volume) = (0.0, 0.0);
    for patch in body.component().patches() {
        let points = &body.control_points()[patch.range.clone()];
        let sign = if patch.flipped { -1.0 } else { 1.0 };
        for u in patch.surface.knots_u().breaks().windows(2) {
            for v in patch.surface.knots_v().breaks().windows(2) {
                let quarter = 0.25 * (u[1] - u[0]) * (v[1] - v[0]);
                for (a, wa) in GAUSS_4 {
                    for (b, wb) in GAUSS_4 {
                        let at = |x: f64, w: &[f64]| w[0] + 0.5 * (1.0 + x) * (w[1] - w[0]);
                        let s = patch.surface.point(points, at(a, u), at(b, v));
                        let normal = s.d_u.cross(&s.d_v) * (quarter * wa * wb);
                        area += normal.norm();
                        volume += sign * (s.position - origin).dot(&normal) / 3.0;
                    }
                }
            }
        }
    }
    (area, volume)
}

/// Points on the surface by patch, rows along u.
pub(crate) struct Samples {
    grids: Vec<Vec<Vec<Vector3>>>,
    pub(crate) low: Vector3,
    pub(crate) high: Vector3,
}

/// Points on each interval of a patch's knots, and on a patch at most along each direction.
const PER_INTERVAL: usize = 4;
const PER_PATCH: usize = 64;

impl Samples {
    pub(crate) fn new(body: &Body) -> Self {
        let parameters = |breaks: &[f64]| {
            let count = (PER_INTERVAL * (breaks.len() - 1)).clamp(8, PER_PATCH);
            let (a, b) = (breaks[0], breaks[breaks.len() - 1]);
            (0..=count).map(|k| a + (b - a) * k as f64 / count as f64).collect::<Vec<_>>()
        };
        let grids: Vec<Vec<Vec<Vector3>>> = body
            .component()
            .patches()
            .iter()
            .map(|patch| {
                let points = &body.control_points()[patch.range.clone()];
                let vs = parameters(patch.surface.knots_v().breaks());
                let row = |u: f64| vs.iter().map(|&v| patch.surface.position(points, u, v)).collect();
                parameters(patch.surface.knots_u().breaks()).into_iter().map(row).collect()
            })
            .collect();
        let none = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
        let (low, high) =
            grids.iter().flatten().flatten().fold(none, |(low, high), p| (low.inf(p), high.sup(p)));
        Self { grids, low, high }
    }

    /// Smallest distance of a point from the plane 0 of an axis.
    pub(crate) fn gap(&self, axis: usize) -> f64 {
        self.grids.iter().flatten().flatten().map(|p| p[axis].abs()).fold(f64::INFINITY, f64::min)
    }

    /// The points where lines of the grids meet the plane `axis = station`.
    pub(crate) fn section(&self, axis: usize, station: f64) -> Vec<Vector3> {
        let mut points = Vec::new();
        let mut cut = |a: &Vector3, b: &Vector3| {
            let (da, db) = (a[axis] - station, b[axis] - station);
            if (da <= 0.0) != (db <= 0.0) {
                points.push(a + (b - a) * (da / (da - db)));
            }
        };
        for grid in &self.grids {
            for (i, row) in grid.iter().enumerate() {
                for (j, p) in row.iter().enumerate() {
                    if let Some(next) = row.get(j + 1) {
                        cut(p, next);
                    }
                    if let Some(next) = grid.get(i + 1) {
                        cut(p, &next[j]);
                    }
                }
            }
        }
        points
    }
}
