//! The formulas of the influence of edges, panels and wakes on one point, each with its derivative directly below it.
//!
//! Vectors begin at the point P: `a`, `b`, `c`, `d` are corners less P, in the order in which the panel runs through them, `n`
//! its unit normal. Solid angles are positive where the panel is seen from inside.
//!
//! The functions have no branches that depend on the point, so that loops over lanes of points become vector code.

use moldline_mesh::Vector3;

use crate::lanes::{argument, log_ratio};

/// `1 / (4 pi)`.
pub(super) const BY_4_PI: f64 = 0.25 / std::f64::consts::PI;

/// Components x, y, z.
pub(super) type Vector = [f64; 3];

#[inline(always)]
pub(super) fn dot(p: &Vector, q: &Vector) -> f64 {
    p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
}

#[inline(always)]
fn cross(p: &Vector, q: &Vector) -> Vector {
    [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]
}

#[inline(always)]
fn norm(p: &Vector) -> f64 {
    dot(p, p).sqrt()
}

/// The logarithm of an edge, `Q = integral ds / r = ln((|a| + |b| + L) / (|a| + |b| - L))` for the length L.
#[inline(always)]
pub(super) fn edge_logarithm([ra, rb]: [f64; 2], length: f64) -> f64 {
    log_ratio(ra + rb, length)
}

/// The derivative of an edge's part of the potential: of its logarithm, and of the solid angles of the panels beside it.
///
/// With `S = |a| + |b|` and `L^2 = |b - a|^2`, `(S + L) (S - L) = 2 (|a||b| + a.b)`, so
///
/// ```text
/// dQ = -2 L / ((S + L) (S - L)) (a.da / |a| + b.db / |b|) + 2 S / ((S + L) (S - L)) dL
/// ```
///
/// A solid angle is an area on the unit sphere, and changes by what its border sweeps: each edge adds `integral r . (v x dr) / |r|^3` for the
/// velocity v of its points, which is linear between the ends. The integral of the weights `1 - t` and t of the ends is closed:
///
/// ```text
/// dOmega = sum over edges (g_a.da + g_b.db),   g_a = -(a x b) / (|a| (|a||b| + a.b)),   g_b = -(a x b) / (|b| (|a||b| + a.b))
/// ```
pub(super) struct EdgeDerivative {
    a: Vector,
    b: Vector,
    /// `a x b`
    cross: Vector,
    by_radii: [f64; 2],
    /// `1 / ((S + L) (S - L))`
    by_product: f64,
    /// `Q`, and its derivative with respect to L times the edge's direction.
    logarithm: f64,
    stretch: Vector,
    /// The derivative of Q with respect to S, over `|a|` and over `|b|`.
    shrink: [f64; 2],
}

impl EdgeDerivative {
    /// `along` is the edge's direction, `radii` and `by_radii` are `|a|`, `|b|` and their inverses.
    #[inline(always)]
    pub fn new(a: Vector, along: &Vector, length: f64, [ra, rb]: [f64; 2], by_radii: [f64; 2]) -> Self {
        let way = [length * along[0], length * along[1], length * along[2]];
        let sum = ra + rb;
        let by_product = 1.0 / ((sum + length) * (sum - length));
        let by_sum = -2.0 * length * by_product;
        let by_length = 2.0 * sum * by_product;
        Self {
            a,
            b: [a[0] + way[0], a[1] + way[1], a[2] + way[2]],
            cross: cross(&a, &way),
            by_radii,
            by_product,
            logarithm: edge_logarithm([ra, rb], length),
            stretch: [by_length * along[0], by_length * along[1], by_length * along[2]],
            shrink: [by_sum * by_radii[0], by_sum * by_radii[1]],
        }
    }

    /// The gradient of `strength Omega - Q t.a` with respect to both ends, at fixed `strength` and `t`.
    #[inline(always)]
    pub fn by_ends(&self, strength: f64, t: &Vector) -> [Vector; 2] {
        let t_a = dot(t, &self.a);
        let turn = -2.0 * self.by_product * strength;
        let (turn_a, turn_b) = (turn * self.by_radii[0], turn * self.by_radii[1]);
        let mut by = [[0.0; 3]; 2];
        for axis in 0..3 {
            by[0][axis] = turn_a * self.cross[axis]
                - t_a * (self.shrink[0] * self.a[axis] - self.stretch[axis])
                - self.logarithm * t[axis];
            by[1][axis] =
                turn_b * self.cross[axis] - t_a * (self.shrink[1] * self.b[axis] + self.stretch[axis]);
        }
        by
    }

    /// The gradient of `Q t.a` with respect to `t`: `Q a`.
    #[inline(always)]
    pub fn logarithm_times_a(&self) -> Vector {
        [self.logarithm * self.a[0], self.logarithm * self.a[1], self.logarithm * self.a[2]]
    }
}

/// What the solid angle of a quadrilateral a, b, c, d needs that does not depend on the point.
pub(super) struct Shape {
    /// `(b - a) x (c - a)` and `(c - a) x (d - a)`.
    pub twice_areas: [Vector; 2],
    /// Squared lengths ab, bc, cd, da, ac.
    pub squares: [f64; 5],
}

impl Shape {
    pub fn new([a, b, c, d]: [Vector3; 4]) -> Self {
        Self {
            twice_areas: [(b - a).cross(&(c - a)).into(), (c - a).cross(&(d - a)).into()],
            squares: [b - a, c - b, d - c, a - d, c - a].map(|v| v.norm_squared()),
        }
    }
}

/// The solid angle of a quadrilateral: that of the triangles abc and acd.
///
/// Of a triangle, `tan(Omega / 2) = D / N` with `D = a.(b x c)` and `N = |a||b||c| + a.b |c| + a.c |b| + b.c |a|`. With
/// `ab = 2 (|a||b| + a.b) = (|a| + |b|)^2 - |b - a|^2` for each side, `N = (ab |c| + ac |b| + bc |a|) / 2 - 2 |a||b||c|`, which takes the radii
/// only. Both complex numbers `N + i D` are multiplied, which leaves one arc tangent. The derivative is [`EdgeDerivative`]'s.
#[inline(always)]
pub(super) fn solid_angle(from_a: &Vector, [a, b, c, d]: [f64; 4], shape: &Shape) -> f64 {
    let twice = |p: f64, q: f64, square: f64| (p + q) * (p + q) - square;
    let (ab, bc) = (twice(a, b, shape.squares[0]), twice(b, c, shape.squares[1]));
    let (cd, da) = (twice(c, d, shape.squares[2]), twice(d, a, shape.squares[3]));
    let ac = twice(a, c, shape.squares[4]);
    let one = [0.5 * (ab * c + ac * b + bc * a) - 2.0 * a * b * c, dot(&shape.twice_areas[0], from_a)];
    let two = [0.5 * (ac * d + da * c + cd * a) - 2.0 * a * c * d, dot(&shape.twice_areas[1], from_a)];
    let re = one[0] * two[0] - one[1] * two[1];
    let im = one[0] * two[1] + two[0] * one[1];
    2.0 * argument(im, re)
}

/// [`solid_angle`] from points that may be near the panel.
///
/// There both triangles' numbers nearly vanish: at the height h, rounding leaves `r^3 / (area h)` units in the last place. Here it leaves `r / h`:
/// the polygon is cut into triangles of each side with the unit normal that points towards the panel.
#[inline(always)]
pub(super) fn solid_angle_near(corners: &[Vector; 4], radii: [f64; 4], normal: &Vector) -> f64 {
    let heights = [
        dot(&corners[0], normal),
        dot(&corners[1], normal),
        dot(&corners[2], normal),
        dot(&corners[3], normal),
    ];
    let side = 1.0_f64.copysign(heights[0] + heights[1] + heights[2] + heights[3]);
    let (mut re, mut im) = (1.0, 0.0);
    for i in 0..4 {
        let j = (i + 1) % 4;
        let (p, q) = (&corners[i], &corners[j]);
        let real = radii[i] * radii[j] + dot(p, q) + side * (heights[i] * radii[j] + heights[j] * radii[i]);
        let imaginary = side * dot(normal, &cross(p, q));
        (re, im) = (re * real - im * imaginary, re * imaginary + im * real);
    }
    2.0 * argument(im, re)
}

/// The solid angle of a panel from its own centre, seen from inside: 2 pi if it is plane.
///
/// [`solid_angle`] has no meaning there: the centre lies on the panel, and mostly on the diagonal that cuts it. The derivative is
/// [`EdgeDerivative`]'s as everywhere; the source term needs no value, since its arm `c - P` is zero and stays so.
pub(super) fn own_solid_angle([a, b, c, d]: [Vector3; 4], centre: &Vector3, n: &Vector3) -> f64 {
    [(a, b), (b, c), (c, d), (d, a)]
        .into_iter()
        .map(|(p, q)| {
            let (p, q) = (p - centre, q - centre);
            let (rp, rq) = (p.norm(), q.norm());
            let real = rp * rq + p.dot(&q) + n.dot(&p) * rq + n.dot(&q) * rp;
            2.0 * argument(n.dot(&p.cross(&q)), real)
        })
        .sum()
}

/// The solid angle of the strip from p to q along x to infinity: of the triangle p, q and the point at infinity.
///
/// The third corner is a long vector along x; divided by its length, `D = p_y q_z - p_z q_y` and
/// `N = |p||q| + p.q + p_x |q| + q_x |p| = (|p| + p_x) (|q| + q_x) + p_y q_y + p_z q_z`.
#[inline(always)]
pub(super) fn strip_solid_angle(p: &Vector, q: &Vector) -> f64 {
    let (rp, rq) = (norm(p), norm(q));
    let real = (rp + p[0]) * (rq + q[0]) + p[1] * q[1] + p[2] * q[2];
    2.0 * argument(p[1] * q[2] - p[2] * q[1], real)
}

/// The part of a border that runs from `a` along x to infinity in the derivative of a solid angle: the y and z components of g in `dOmega = g.da`.
///
/// It is `g_a` of [`EdgeDerivative`] with b far along x: `g = -(a x e_x) / (|a| (|a| + a_x))`; `g_b` vanishes.
#[inline(always)]
pub(super) fn ray_derivative(a: &Vector) -> [f64; 2] {
    let r = norm(a);
    let factor = -1.0 / (r * (r + a[0]));
    [factor * a[2], -factor * a[1]]
}

/// The solid angle of a quadrilateral of a wake. Its edges' derivatives are those of edges and rays.
#[inline(always)]
pub(super) fn wake_solid_angle([a, b, c, d]: &[Vector; 4]) -> f64 {
    let (ra, rb, rc, rd) = (norm(a), norm(b), norm(c), norm(d));
    let one = triangle(a, b, c, [ra, rb, rc]);
    let two = triangle(a, c, d, [ra, rc, rd]);
    2.0 * argument(one[0] * two[1] + one[1] * two[0], one[0] * two[0] - one[1] * two[1])
}

/// `N` and `D` of a triangle ([`solid_angle`]).
#[inline(always)]
fn triangle(a: &Vector, b: &Vector, c: &Vector, [ra, rb, rc]: [f64; 3]) -> [f64; 2] {
    [ra * rb * rc + dot(a, b) * rc + dot(a, c) * rb + dot(b, c) * ra, dot(a, &cross(b, c))]
}

/// Against the textbook's formulas in dual numbers, one arc tangent a triangle, at points far away and near, in the plane of the panel
/// and on the line of an edge.
#[cfg(test)]
mod tests {
    use num_dual::{Dual64, DualNum};

    use super::*;

    type D = [Dual64; 3];

    fn difference(p: &D, q: &D) -> D {
        [p[0] - q[0], p[1] - q[1], p[2] - q[2]]
    }

    fn dual_dot(p: &D, q: &D) -> Dual64 {
        p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
    }

    fn dual_cross(p: &D, q: &D) -> D {
        [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]
    }

    fn dual_norm(p: &D) -> Dual64 {
        dual_dot(p, p).sqrt()
    }

    /// `integral ds / r`
    fn textbook_logarithm(a: &D, b: &D) -> Dual64 {
        let sum = dual_norm(a) + dual_norm(b);
        let length = dual_norm(&difference(b, a));
        (length * 2.0 / (sum - length)).ln_1p()
    }

    fn textbook_triangle(a: &D, b: &D, c: &D) -> Dual64 {
        let [ra, rb, rc] = [a, b, c].map(dual_norm);
        let denominator = ra * rb * rc + dual_dot(a, b) * rc + dual_dot(a, c) * rb + dual_dot(b, c) * ra;
        // a.(b x c) as it keeps its digits far away.
        let volume = dual_dot(a, &dual_cross(&difference(b, a), &difference(c, a)));
        volume.atan2(denominator) * 2.0
    }

    fn textbook_quadrilateral([a, b, c, d]: &[D; 4]) -> Dual64 {
        textbook_triangle(a, b, c) + textbook_triangle(a, c, d)
    }

    /// The triangle of p, q and a corner at infinity along x.
    fn textbook_strip(p: &D, q: &D) -> Dual64 {
        let x = [1.0, 0.0, 0.0].map(Dual64::from_re);
        let (rp, rq) = (dual_norm(p), dual_norm(q));
        let denominator = rp * rq + dual_dot(p, q) + p[0] * rq + q[0] * rp;
        dual_dot(p, &dual_cross(q, &x)).atan2(denominator) * 2.0
    }

    fn way(x: &Vector, p: &Vector) -> Vector {
        [x[0] - p[0], x[1] - p[1], x[2] - p[2]]
    }

    /// The gradient of a function of `N` positions, and its value.
    fn differentiate<const N: usize>(
        positions: &[Vector; N],
        f: impl Fn(&[D; N]) -> Dual64,
    ) -> (f64, [Vector; N]) {
        let at = |position: usize, axis: usize| {
            f(&std::array::from_fn(|i| {
                std::array::from_fn(|k| {
                    let seed = if (i, k) == (position, axis) { 1.0 } else { 0.0 };
                    Dual64::new(positions[i][k], seed)
                })
            }))
        };
        let gradient = std::array::from_fn(|i| std::array::from_fn(|k| at(i, k).eps));
        (at(0, 0).re, gradient)
    }

    fn assert_close<const N: usize>(case: &str, found: &[Vector; N], expected: &[Vector; N], tolerance: f64) {
        let size = expected.as_flattened().iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        for (found, expected) in found.as_flattened().iter().zip(expected.as_flattened()) {
            assert!((found - expected).abs() <= tolerance * size, "{case}: {found} {expected}");
        }
    }

    /// A warped quadrilateral.
    const WARPED: [Vector; 4] = [[0.0, 0.0, 0.0], [1.0, 0.1, 0.1], [1.1, 0.9, -0.05], [-0.1, 1.0, 0.1]];
    /// A plane one, in z = 0.
    const PLANE: [Vector; 4] = [[0.0, 0.0, 0.0], [1.0, 0.1, 0.0], [1.1, 0.9, 0.0], [-0.1, 1.0, 0.0]];

    /// Points, and a factor on rounding for what is lost there: far away differences of positions, near the panel the angle's numbers, near an
    /// edge `|a| + |b| - L`.
    fn points() -> Vec<(&'static str, Vector, f64)> {
        vec![
            ("very far", [4e3, -3e3, 1e3], 1e4),
            ("far", [-7.0, 5.0, -9.0], 1.0),
            ("beside", [0.4, -0.8, 0.7], 1.0),
            ("beneath", [0.5, 0.5, -0.6], 1.0),
            ("near", [0.4, 0.5, 0.08], 1e2),
            ("very near", [0.4, 0.5, -1e-5], 1e7),
            ("in the plane, outside", [1.9, 0.7, 0.0], 1.0),
            ("near an edge", [0.5, 0.05, 1e-3], 1e7),
            ("on the line of the edge ab", [-0.6, -0.06, 0.0], 1.0),
            ("far on the line of the edge ab", [-60.0, -6.0, 0.0], 1e2),
        ]
    }

    fn edge_derivative(a: &Vector, b: &Vector, p: &Vector) -> EdgeDerivative {
        let edge = way(b, a);
        let length = norm(&edge);
        let along = edge.map(|x| x / length);
        let (from_a, from_b) = (way(a, p), way(b, p));
        let radii = [norm(&from_a), norm(&from_b)];
        EdgeDerivative::new(from_a, &along, length, radii, radii.map(|r| 1.0 / r))
    }

    #[test]
    fn logarithm_of_an_edge() {
        let t = [0.3, -0.8, 0.5];
        for corners in [WARPED, PLANE] {
            for (case, p, factor) in points() {
                for i in 0..4 {
                    let (a, b) = (corners[i], corners[(i + 1) % 4]);
                    let potential = |[a, b, p]: &[D; 3]| {
                        let (a, b) = (difference(a, p), difference(b, p));
                        -textbook_logarithm(&a, &b) * dual_dot(&a, &t.map(Dual64::from_re))
                    };
                    let (value, expected) = differentiate(&[a, b, p], potential);
                    let radii = [&a, &b].map(|x| norm(&way(x, &p)));
                    let q = edge_logarithm(radii, norm(&way(&b, &a)));
                    let scale = (q * norm(&way(&a, &p))).abs();
                    assert!((-q * dot(&t, &way(&a, &p)) - value).abs() <= 1e-15 * factor * scale, "{case}");
                    let derivative = edge_derivative(&a, &b, &p);
                    let [by_a, by_b] = derivative.by_ends(0.0, &t);
                    let by_p = [0, 1, 2].map(|k| -by_a[k] - by_b[k]);
                    // Near the line of an edge, all that matters is in both ends together.
                    assert_close(case, &[by_a, by_b, by_p], &expected, 1e-13 * factor);
                    let by_t = derivative.logarithm_times_a();
                    assert_close(case, &[by_t], &[way(&a, &p).map(|x| q * x)], 1e-15);
                }
            }
        }
    }

    #[test]
    fn solid_angle_of_a_quadrilateral() {
        for (name, corners) in [("warped", WARPED), ("plane", PLANE)] {
            for (case, p, factor) in points() {
                let case = &format!("{name}, {case}");
                let [a, b, c, d] = corners;
                let angle = |[a, b, c, d, p]: &[D; 5]| {
                    textbook_quadrilateral(&[a, b, c, d].map(|x| difference(x, p)))
                };
                let (value, expected) = differentiate(&[a, b, c, d, p], angle);

                let ways = corners.map(|x| way(&x, &p));
                let radii = ways.map(|x| norm(&x));
                let points = corners.map(Vector3::from);
                let area = (points[2] - points[0]).cross(&(points[3] - points[1]));
                let normal = (area / area.norm()).into();
                // Far away, only the first keeps all digits of a small angle.
                for (found, least) in [
                    (
                        solid_angle(&ways[0], radii, &Shape::new(points)),
                        1e-15 * factor * value.abs().min(1.0),
                    ),
                    (solid_angle_near(&ways, radii, &normal), 1e-15),
                    (wake_solid_angle(&ways), 1e-15),
                ] {
                    let tolerance = least + 1e-14 * factor * value.abs();
                    // A border gives its solid angle up to 4 pi.
                    let error = (found - value) * BY_4_PI;
                    assert!((error - error.round()).abs() <= tolerance, "{case}: {found} {value}");
                }

                let mut found = [[0.0; 3]; 5];
                for i in 0..4 {
                    let j = (i + 1) % 4;
                    let ends = edge_derivative(&corners[i], &corners[j], &p).by_ends(1.0, &[0.0; 3]);
                    for k in 0..3 {
                        found[i][k] += ends[0][k];
                        found[j][k] += ends[1][k];
                        found[4][k] -= ends[0][k] + ends[1][k];
                    }
                }
                assert_close(case, &found, &expected, 1e-13 * factor);
            }
        }
    }

    /// A square seen from a point on its axis: `Omega = 4 atan(s^2 / (h sqrt(2 s^2 + h^2)))` for the half side s and the height h.
    #[test]
    fn solid_angle_of_a_square() {
        let corners = [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]];
        for h in [1e-12, 1e-8, 1e-4, 0.01, 0.1, 0.5, 1.0, 10.0, 1e3] {
            let exact = 4.0 * (1.0 / (h * f64::sqrt(2.0 + h * h))).atan();
            for side in [1.0, -1.0] {
                let ways = corners.map(|x| way(&x, &[0.0, 0.0, -side * h]));
                let radii = ways.map(|x| norm(&x));
                let near = solid_angle_near(&ways, radii, &[0.0, 0.0, 1.0]);
                assert!((side * near / exact - 1.0).abs() < 2e-15 * h.max(1.0).powi(2), "near, {h}: {near}");
                if h >= 0.5 {
                    let far = solid_angle(&ways[0], radii, &Shape::new(corners.map(Vector3::from)));
                    assert!((side * far / exact - 1.0).abs() < 2e-15 * h.max(1.0), "far, {h}: {far}");
                }
            }
        }
    }

    /// From inside: 2 pi for a plane panel, and what is seen from nearer and nearer to it for a warped one.
    #[test]
    fn solid_angle_from_the_own_centre() {
        for corners in [WARPED, PLANE] {
            let points = corners.map(Vector3::from);
            let centre: Vector3 = points.iter().sum::<Vector3>() / 4.0;
            let area = (points[2] - points[0]).cross(&(points[3] - points[1]));
            let normal = area / area.norm();
            let own = own_solid_angle(points, &centre, &normal);
            let p = (centre - 1e-9 * normal).into();
            let ways = corners.map(|x| way(&x, &p));
            let near = solid_angle_near(&ways, ways.map(|x| norm(&x)), &normal.into());
            assert!((own - near).abs() < 1e-7, "{own} {near}");
            if corners == PLANE {
                assert!((own - 2.0 * std::f64::consts::PI).abs() < 1e-14, "{own}");
            }
        }
    }

    #[test]
    fn solid_angle_of_a_strip_to_infinity() {
        let (a, b) = ([0.2, 0.1, 0.3], [0.5, 1.1, 0.2]);
        for (case, p, factor) in [
            ("far", [-30.0, 20.0, 25.0], 1.0),
            ("beside", [0.1, -0.7, 0.4], 1.0),
            ("upstream", [-3.0, 0.6, 0.2], 1.0),
            ("upstream, on the line of a border", [-2.0, 0.1, 0.3], 1.0),
            ("under the strip", [3.0, 0.7, 0.1], 1.0),
            ("near the strip", [3.0, 0.7, 0.2401], 1e4),
            ("near a border", [5.0, 0.1, 0.2999], 1e9),
        ] {
            let angle = |[a, b, p]: &[D; 3]| textbook_strip(&difference(a, p), &difference(b, p));
            let (value, expected) = differentiate(&[a, b, p], angle);
            let found = strip_solid_angle(&way(&a, &p), &way(&b, &p));
            assert!((found - value).abs() <= 1e-15 * factor * (1.0 + value.abs()), "{case}: {found} {value}");

            // The border runs from a to b, from there downstream, and comes back along a.
            let [mut by_a, mut by_b] = edge_derivative(&a, &b, &p).by_ends(1.0, &[0.0; 3]);
            let [out, back] = [&b, &a].map(|x| ray_derivative(&way(x, &p)));
            for k in 0..2 {
                by_b[1 + k] += out[k];
                by_a[1 + k] -= back[k];
            }
            let by_p = [0, 1, 2].map(|k| -by_a[k] - by_b[k]);
            assert_close(case, &[by_a, by_b, by_p], &expected, 1e-13 * factor);
        }
        // A long quadrilateral is nearly a strip.
        let p = [0.1, -0.7, 0.4];
        let far = |x: &Vector| way(&[x[0] + 1e6, x[1], x[2]], &p);
        let quadrilateral = wake_solid_angle(&[way(&a, &p), way(&b, &p), far(&b), far(&a)]);
        assert!((strip_solid_angle(&way(&a, &p), &way(&b, &p)) - quadrilateral).abs() < 1e-9);
    }

    /// On an edge or a border, nothing is finite: the assembly reports it.
    #[test]
    fn nothing_is_finite_on_an_edge() {
        let [a, b, ..] = PLANE;
        let p = [0, 1, 2].map(|k| 0.5 * (a[k] + b[k]));
        assert!(!edge_logarithm([&a, &b].map(|x| norm(&way(x, &p))), norm(&way(&b, &a))).is_finite());
        assert!(ray_derivative(&[-2.0, 0.0, 0.0]).iter().all(|g| !g.is_finite()));
    }
}
