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
