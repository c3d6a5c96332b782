//! Test bodies, and references that share no code with what they check.
#![allow(dead_code, missing_docs)]

use moldline_geometry::{Body, Component, ComponentOptions, Location, PatchInput, Vector3};
use moldline_spline::KnotVector;
use std::sync::Arc;

pub use moldline_testing::Random;

pub fn cubic(n: usize) -> KnotVector {
    KnotVector::clamped_uniform(3, n).expect("valid")
}

pub fn linear() -> KnotVector {
    KnotVector::clamped_uniform(1, 2).expect("valid")
}

fn patch(name: &str, knots: [KnotVector; 2], rows: Vec<Vec<[f64; 3]>>) -> PatchInput {
    let [knots_u, knots_v] = knots;
    PatchInput { name: name.into(), knots_u, knots_v, control_points: rows.concat(), weights: None }
}

/// Chordwise control points (x, thickness) of half a section from the trailing to the leading edge.
const SECTION: [(f64, f64); 8] = [
    (1.0, 0.0),
    (0.9, 0.018),
    (0.72, 0.04),
    (0.5, 0.065),
    (0.28, 0.075),
    (0.09, 0.062),
    (0.0, 0.03),
    (0.0, 0.0),
];

/// How the sheets of a wing meet at its trailing edge.
#[derive(Clone, Copy, PartialEq)]
pub enum Trailing {
    Wedge,
    Cusp,
}

fn wing_point(y: f64, x: f64, z: f64, half_span: f64) -> [f64; 3] {
    let e = y.abs() / half_span;
    let chord = 5.0 - 3.8 * e;
    let (sin, cos) = (0.05 - 0.08 * e).sin_cos();
    let (x, z) = ((x - 0.25) * chord, z * chord * (1.0 - 0.3 * e) + 0.04 * chord * (x * (1.0 - x)));
    [10.0 + 0.5 * y.abs() + 0.25 * chord + x * cos + z * sin, y, 0.1 * y.abs() - x * sin + z * cos]
}

/// A swept, twisted, tapered wing over both halves: lower and upper sheet with a sharp trailing edge and flat tip caps that
/// have zero length at leading and trailing edge.
pub fn wing_patches(trailing: Trailing) -> Vec<PatchInput> {
    let half_span = 12.0;
    let knots_v = cubic(17);
    let spans: Vec<f64> = knots_v.greville().iter().map(|g| half_span * (2.0 * g - 1.0)).collect();
    let sheet = |sign: f64| -> Vec<Vec<[f64; 3]>> {
        let thickness = |k: usize, t: f64| if k == 1 && trailing == Trailing::Cusp { 0.0 } else { t };
        let point =
            |k: usize, (x, t): (f64, f64), y: f64| wing_point(y, x, sign * thickness(k, t), half_span);
        SECTION.iter().enumerate().map(|(k, &s)| spans.iter().map(|&y| point(k, s, y)).collect()).collect()
    };
    let (lower, upper) = (sheet(-1.0), sheet(1.0));
    let cap = |j: usize| -> Vec<Vec<[f64; 3]>> {
        lower.iter().zip(&upper).map(|(l, u)| vec![l[j], u[j]]).collect()
    };
    vec![
        patch("lower", [cubic(8), knots_v.clone()], lower.clone()),
        patch("upper", [cubic(8), knots_v.clone()], upper.clone()),
        patch("port tip", [cubic(8), linear()], cap(0)),
        patch("starboard tip", [cubic(8), linear()], cap(16)),
    ]
}

/// The same wing with one sheet wrapped around the leading edge, its sides meeting at the trailing edge. The sheet is only
/// C0 at the leading edge knot, which is geometrically smooth; the caps touch half of its sides each.
pub fn wrapped_wing_patches() -> Vec<PatchInput> {
    let mut patches = wing_patches(Trailing::Wedge);
    let n_v = patches[0].knots_v.control_point_count();
    let mut control_points = patches[0].control_points.clone();
    for row in patches[1].control_points.chunks(n_v).rev().skip(1) {
        control_points.extend_from_slice(row);
    }
    let first = patches[0].knots_u.knots();
    let mut knots: Vec<f64> = first[..first.len() - 1].to_vec();
    let second: Vec<f64> = first.iter().rev().map(|t| 2.0 - t).collect();
    knots.extend_from_slice(&second[4..]);
    let skin = PatchInput {
        name: "skin".into(),
        knots_u: KnotVector::new(3, knots).expect("valid"),
        knots_v: patches[0].knots_v.clone(),
        control_points,
        weights: None,
    };
    patches.splice(0..2, [skin]);
    patches
}

/// A round body with collapsed, smooth nose and pointed tail, closed around.
pub fn fuselage_patches() -> Vec<PatchInput> {
    let rows = [
        (0.0, 0.0),
        (0.0, 0.5),
        (0.6, 1.0),
        (2.0, 1.45),
        (5.0, 1.6),
        (10.0, 1.6),
        (16.0, 1.6),
        (20.0, 1.4),
        (24.0, 0.9),
        (27.0, 0.4),
        (29.0, 0.0),
    ];
    // Control points of a periodic cubic made clamped: a circle to within half a percent.
    let n = 12;
    let angle = |i: i64| (i as f64) * std::f64::consts::TAU / n as f64;
    let knots: Vec<f64> = (-3..=n as i64 + 3).map(|k| k as f64 / n as f64).collect();
    let periodic = KnotVector::new(3, knots).expect("valid");
    let clamped = periodic.clamped_piece(0.0, 1.0);
    let circle: Vec<[f64; 2]> = periodic
        .refinement(&clamped)
        .iter()
        .map(|row| {
            let mut p = [0.0; 2];
            for k in 0..row.count {
                let a = angle((row.first + k) as i64 - 1);
                p[0] += row.weights[k] * a.sin();
                p[1] -= row.weights[k] * a.cos();
            }
            p
        })
        .collect();
    let mut control: Vec<Vec<[f64; 3]>> = rows
        .iter()
        .map(|&(x, r)| circle.iter().map(|c| [x, 1.05 * r * c[0], 0.1 * x + 1.1 * r * c[1]]).collect())
        .collect();
    // Exactly closed: the seam's two columns are the same numbers.
    for row in &mut control {
        let first = row[0];
        if let Some(last) = row.last_mut() {
            *last = first;
        }
    }
    vec![patch("fuselage", [cubic(rows.len()), clamped], control)]
}

/// A tube with a square hole's worth of concave edges: an L-shaped bar with rounded sides, made of ruled patches.
pub fn bar_patches() -> Vec<PatchInput> {
    // Corners of the L, counter-clockwise.
    let corners = [(0.0, 0.0), (3.0, 0.0), (3.0, 1.0), (1.0, 1.0), (1.0, 3.0), (0.0, 3.0)];
    let mut patches = Vec::new();
    for k in 0..6 {
        let ((ax, ay), (bx, by)) = (corners[k], corners[(k + 1) % 6]);
        let rows: Vec<Vec<[f64; 3]>> =
            [(ax, ay), (bx, by)].iter().map(|&(x, y)| vec![[x, y, 0.0], [x, y, 5.0]]).collect();
        patches.push(patch(&format!("side {k}"), [linear(), linear()], rows));
    }
    // Ends: two quadrilaterals that meet the inner corner.
    for (name, z) in [("bottom", 0.0), ("top", 5.0)] {
        let quad = |a: usize, b: usize, c: usize, d: usize| {
            let p = |k: usize| [corners[k].0, corners[k].1, z];
            vec![vec![p(a), p(d)], vec![p(b), p(c)]]
        };
        patches.push(patch(&format!("{name} a"), [linear(), linear()], quad(0, 1, 2, 3)));
        patches.push(patch(&format!("{name} b"), [linear(), linear()], quad(0, 3, 4, 5)));
    }
    patches
}

pub fn body(name: &str, patches: Vec<PatchInput>) -> Body {
    let (component, points) =
        Component::new(name.into(), patches, &ComponentOptions::default()).expect("a valid component");
    Body::new(Arc::new(component), points)
}

/// Nearest point by brute force: a dense grid of samples on every patch, then a damped Gauss-Newton iteration (no second
/// derivatives, no code of the crate but evaluation) from the nearest samples.
pub struct Exhaustive {
    samples: Vec<(Vector3, Location)>,
    seeds: usize,
}

impl Exhaustive {
    pub fn new(body: &Body, per_interval: usize, seeds: usize) -> Self {
        let mut samples = Vec::new();
        for (i, p) in body.component().patches().iter().enumerate() {
            let along = |knots: &KnotVector| {
                let mut t: Vec<f64> = knots
                    .breaks()
                    .windows(2)
                    .flat_map(|w| {
                        (0..per_interval).map(move |k| w[0] + (w[1] - w[0]) * k as f64 / per_interval as f64)
                    })
                    .collect();
                t.push(knots.domain().1);
                t
            };
            for &u in &along(p.surface.knots_u()) {
                for &v in &along(p.surface.knots_v()) {
                    let l = Location { patch: i as u32, u, v };
                    samples.push((body.position(&l), l));
                }
            }
        }
        Self { samples, seeds }
    }

    pub fn distance(&self, body: &Body, x: &Vector3) -> f64 {
        let mut nearest: Vec<(f64, usize)> =
            self.samples.iter().enumerate().map(|(i, s)| ((s.0 - x).norm_squared(), i)).collect();
        let k = self.seeds.min(nearest.len() - 1);
        nearest.select_nth_unstable_by(k, |a, b| a.0.total_cmp(&b.0));
        nearest[..k].iter().map(|&(_, i)| refine(body, x, self.samples[i].1)).fold(f64::INFINITY, f64::min)
    }
}

/// Levenberg-Marquardt within the patch.
fn refine(body: &Body, x: &Vector3, start: Location) -> f64 {
    let domain = body.component().patches()[start.patch as usize].surface.domain();
    let (mut l, mut damping) = (start, 1e-3);
    let mut p = body.point(&l);
    let mut best = (p.position - x).norm();
    for _ in 0..200 {
        let r = p.position - x;
        let (mut gu, mut gv) = (p.d_u.dot(&r), p.d_v.dot(&r));
        let (mut a, mut b, mut c) = (p.d_u.norm_squared(), p.d_u.dot(&p.d_v), p.d_v.norm_squared());
        let at = |t: f64, (low, high): (f64, f64), g: f64| (t <= low && g > 0.0) || (t >= high && g < 0.0);
        if at(l.u, domain[0], gu) {
            (gu, b, a) = (0.0, 0.0, 1.0);
        }
        if at(l.v, domain[1], gv) {
            (gv, b, c) = (0.0, 0.0, 1.0);
        }
        a *= 1.0 + damping;
        c *= 1.0 + damping;
        let det = (a * c - b * b).max(1e-300);
        let trial = Location {
            patch: l.patch,
            u: (l.u - (c * gu - b * gv) / det).clamp(domain[0].0, domain[0].1),
            v: (l.v - (a * gv - b * gu) / det).clamp(domain[1].0, domain[1].1),
        };
        let q = body.point(&trial);
        let d = (q.position - x).norm();
        if d < best {
            let done = best - d < 1e-16 * best;
            (l, p, best, damping) = (trial, q, d, (damping * 0.1).max(1e-14));
            if done {
                break;
            }
        } else {
            damping = if damping < 1e-12 { 1e-9 } else { damping * 10.0 };
            if damping > 1e8 {
                break;
            }
        }
    }
    best
}

/// A triangulation of a body, oriented outward by the body's normals in the middle of the patches.
pub struct Triangulation(Vec<[Vector3; 3]>);

impl Triangulation {
    pub fn new(body: &Body, per_interval: [usize; 2]) -> Self {
        let mut triangles = Vec::new();
        for (i, p) in body.component().patches().iter().enumerate() {
            let along = |knots: &KnotVector, per_interval: usize| {
                let mut t = Vec::new();
                for w in knots.breaks().windows(2) {
                    for k in 0..per_interval {
                        t.push(w[0] + (w[1] - w[0]) * k as f64 / per_interval as f64);
                    }
                }
                t.push(knots.domain().1);
                t
            };
            let (us, vs) =
                (along(p.surface.knots_u(), per_interval[0]), along(p.surface.knots_v(), per_interval[1]));
            let at = |u: f64, v: f64| body.position(&Location { patch: i as u32, u, v });
            for u in us.windows(2) {
                for v in vs.windows(2) {
                    let [a, b, c, d] = [at(u[0], v[0]), at(u[1], v[0]), at(u[1], v[1]), at(u[0], v[1])];
                    for mut t in [[a, b, c], [a, c, d]] {
                        if p.flipped {
                            t.swap(1, 2);
                        }
                        triangles.push(t);
                    }
                }
            }
        }
        Self(triangles)
    }

    /// The winding number of the triangulation around `x`: the sum of solid angles over the full one.
    pub fn winding_number(&self, x: &Vector3) -> f64 {
        let mut sum = 0.0;
        for [a, b, c] in &self.0 {
            let (a, b, c) = (a - x, b - x, c - x);
            let (la, lb, lc) = (a.norm(), b.norm(), c.norm());
            let determinant = a.dot(&b.cross(&c));
            let rest = la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb;
            sum += 2.0 * determinant.atan2(rest);
        }
        sum / (4.0 * std::f64::consts::PI)
    }
}
