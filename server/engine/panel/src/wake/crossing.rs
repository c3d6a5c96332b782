//! Whether a wake meets the surface: every crossing and every touch, and passes so near that the cells there cannot resolve them.
//!
//! Seen along x, the part of a strip that runs to infinity is a segment from p to q, and a cell is a few triangles. With s along the segment, h
//! across it, and d downstream of the strip's beginning, a triangle is cut down to `d >= 0, 0 <= s <= |pq|`. The wake meets it if what is left
//! has both signs of h, or none. The signs at vertices are exact (Shewchuk, Discrete Comput. Geom. 18, 1997), so that coincident stations,
//! cells ahead of a wake and edges in its plane are found.

use moldline_mesh::Vector3;
use robust::{Coord, orient2d};

use super::{sheets::Corner, strips::Strip};
use crate::{PanelError, panels::Panels};

/// Distance at which a wake passes a cell too near, as a fraction of the root of the cell's area.
const NEAR: f64 = 0.1;
/// How much less of a cell at the trailing edge itself counts, as a fraction of lengths: it touches the wake there.
const OWN: f64 = 1e-6;

/// A wake that passes a cell nearer than a tenth of the cell's size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearPass {
    /// The trailing edge, as mesh vertices.
    pub edge: [u32; 2],
    /// The cell.
    pub cell: u32,
    /// Distance, m.
    pub distance: f64,
    /// The root of the cell's area, m.
    pub size: f64,
    /// Where along x, m.
    pub x: f64,
}

/// Where the part of a strip along x begins: its border as seen along x.
struct Front {
    p: Vector3,
    q: Vector3,
    /// Length of pq as seen along x, and its direction there.
    length: f64,
    along: [f64; 2],
}

/// A vertex of a triangle seen from a front: s, h, d and x.
#[derive(Clone, Copy)]
struct Seen {
    s: f64,
    h: f64,
    d: f64,
    x: f64,
}

impl Front {
    fn new([p, q]: [Vector3; 2]) -> Option<Self> {
        let (y, z) = (q.y - p.y, q.z - p.z);
        let length = y.hypot(z);
        (length > 0.0).then(|| Self { p, q, length, along: [y / length, z / length] })
    }

    fn see(&self, v: &Vector3) -> Seen {
        let (y, z) = (v.y - self.p.y, v.z - self.p.z);
        let s = y * self.along[0] + z * self.along[1];
        let coordinate = |v: &Vector3| Coord { x: v.y, y: v.z };
        let h = orient2d(coordinate(&self.p), coordinate(&self.q), coordinate(v)) / self.length;
        let begins = self.p.x + s / self.length * (self.q.x - self.p.x);
        Seen { s, h, d: v.x - begins, x: v.x }
    }
}

/// Cuts a convex polygon down to where a linear function is not negative.
fn cut(polygon: &[Seen], f: impl Fn(&Seen) -> f64) -> Vec<Seen> {
    let mut rest = Vec::with_capacity(polygon.len() + 1);
    for (k, a) in polygon.iter().enumerate() {
        let b = &polygon[(k + 1) % polygon.len()];
        let (fa, fb) = (f(a), f(b));
        if fa >= 0.0 {
            rest.push(*a);
        }
        if fa * fb < 0.0 {
            let t = fa / (fa - fb);
            let mix = |a: f64, b: f64| a + t * (b - a);
            rest.push(Seen { s: mix(a.s, b.s), h: mix(a.h, b.h), d: mix(a.d, b.d), x: mix(a.x, b.x) });
        }
    }
    rest
}

/// What is left of a triangle behind a front: from `inset` on inside its ends and its beginning.
fn behind(front: &Front, triangle: &[Seen; 3], ends: f64, beginning: f64) -> Vec<Seen> {
    let rest = cut(triangle, |v| v.d - beginning);
    let rest = cut(&rest, |v| v.s - ends);
    cut(&rest, |v| front.length - ends - v.s)
}

/// The range of h, and x of the first point.
fn range(polygon: &[Seen]) -> Option<(f64, f64, f64)> {
    let x = polygon.iter().map(|v| v.x).fold(f64::INFINITY, f64::min);
    let low = polygon.iter().map(|v| v.h).fold(f64::INFINITY, f64::min);
    let high = polygon.iter().map(|v| v.h).fold(f64::NEG_INFINITY, f64::max);
    (!polygon.is_empty()).then_some((low, high, x))
}

/// Checks the infinite part of a strip, which begins at `ends`, and returns where it passes nearest to a cell, in proportion to the cell, if that is too near.
/// Sheets beside a body are left out: they begin on it. `trailing` says whether a point lies on a trailing edge.
pub(super) fn check(
    panels: &Panels,
    points: &[Vector3],
    trailing: &[bool],
    strip: &Strip,
    ends: &[Corner; 2],
) -> Result<Option<NearPass>, PanelError> {
    let edge = [strip.a, strip.b].map(|p| panels.vertex_of[p as usize]);
    let mut nearest: Option<NearPass> = None;
    let own = [ends[0].x, ends[1].x, ends[0].yz, ends[1].yz, strip.a, strip.b];
    let Some(front) = Front::new(ends.map(|corner| corner.position(points))) else { return Ok(None) };
    for (panel, corners) in panels.corners.iter().enumerate() {
        let cell = panels.cell_of[panel];
        let [a, b, c, d] = corners.map(|v| points[v as usize]);
        let size = (0.5 * (c - a).cross(&(d - b)).norm()).sqrt();
        let margin = NEAR * size;
        if !is_close(&front, &[a, b, c, d], margin) {
            continue;
        }
        let touching = corners.iter().any(|v| own.contains(v));
        let beside = corners.iter().any(|v| trailing[*v as usize]);
        let [a, b, c, d] = [a, b, c, d].map(|v| front.see(&v));
        // A warped quadrilateral lies between its two pairs of triangles.
        let triangles = [[a, b, c], [a, c, d], [a, b, d], [b, c, d]];
        let count = if panels.is_triangle(panel) { 1 } else { 4 };
        for triangle in &triangles[..count] {
            let inset = if touching { OWN } else { 0.0 };
            let met = range(&behind(&front, triangle, inset * front.length, inset * size));
            if let Some((low, high, x)) = met.filter(|(low, high, _)| *low <= 0.0 && *high >= 0.0) {
                let both = low < -OWN * size && high > OWN * size;
                if !touching || both || low == high {
                    return Err(PanelError::WakeCutsBody { edge, cell, x });
                }
            }
            if touching || beside {
                continue;
            }
            let Some((low, high, x)) = range(&behind(&front, triangle, -margin, 0.0)) else { continue };
            let distance = if low <= 0.0 && high >= 0.0 { margin } else { low.abs().min(high.abs()) };
            let is_nearer = nearest.is_none_or(|n| distance / size < n.distance / n.size);
            if distance < margin && is_nearer {
                nearest = Some(NearPass { edge, cell, distance, size, x });
            }
        }
    }
    Ok(nearest)
}

/// Whether boxes around a cell and the wake behind a front overlap.
fn is_close(front: &Front, corners: &[Vector3; 4], margin: f64) -> bool {
    let overlaps = |axis: usize| {
        let (p, q) = (front.p[axis], front.q[axis]);
        let low = corners.iter().map(|c| c[axis]).fold(f64::INFINITY, f64::min);
        let high = corners.iter().map(|c| c[axis]).fold(f64::NEG_INFINITY, f64::max);
        low <= p.max(q) + margin && high >= p.min(q) - margin
    };
    let last = corners.iter().map(|c| c.x).fold(f64::NEG_INFINITY, f64::max);
    last >= front.p.x.min(front.q.x) && overlaps(1) && overlaps(2)
}
