//! The mean inverse distance between a triangle and a point, and of a triangle to itself, each with its gradient.
//!
//! With `r_k = a_k - x` the ways from the point to the corners, `e_k` the unit vector along the edge from `a_k` to `a_k+1`, n the unit normal and
//! `m_k = e_k x n`, the integral of the inverse distance is (Hess and Smith, J. Ship Res. 8, 1964)
//!
//! ```text
//! P = integral dS / r = sum_k Q_k m_k.r_k - h Omega,   Q_k = ln((r_k + r_k+1 + L_k) / (r_k + r_k+1 - L_k)),   h = n.r_0
//! ```
//!
//! with the solid angle Omega of van Oosterom and Strackee (IEEE Trans. Biomed. Eng. 30, 1983).

use moldline_mesh::Vector3;
use pulp::{Arch, Simd, WithSimd};

use crate::lanes::{LANES, Lane, Wide};

/// A triangle and what of it does not depend on the point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Triangle {
    pub corners: [Vector3; 3],
    /// Unit vectors along the edges, and their lengths.
    along: [Vector3; 3],
    lengths: [f64; 3],
    normal: Vector3,
    /// `m_k`: in the plane, outwards across the edges.
    outwards: [Vector3; 3],
    double_area: f64,
}

/// Points, by axis.
pub(crate) type Points = [Lane; 3];

/// A vector of each point.
type Ways<S> = [Wide<S>; 3];

/// Ways from points to the corners of a triangle, and their lengths.
struct Seen<S: Simd> {
    ways: [Ways<S>; 3],
    radii: [Wide<S>; 3],
}

#[inline(always)]
fn dot<S: Simd>(p: &Ways<S>, q: &Ways<S>) -> Wide<S> {
    p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
}

/// The product with one vector for all points.
#[inline(always)]
fn along<S: Simd>(p: &Ways<S>, q: &Vector3) -> Wide<S> {
    p[0] * q.x + p[1] * q.y + p[2] * q.z
}

/// From points to one point.
#[inline(always)]
fn way<S: Simd>(x: &Ways<S>, to: &Vector3) -> Ways<S> {
    [-(x[0] - to.x), -(x[1] - to.y), -(x[2] - to.z)]
}

#[inline(always)]
fn cross<S: Simd>(p: &Ways<S>, q: &Ways<S>) -> Ways<S> {
    [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]
}

#[inline(always)]
fn cross_one<S: Simd>(p: &Ways<S>, q: &Vector3) -> Ways<S> {
    [p[1] * q.z - p[2] * q.y, p[2] * q.x - p[0] * q.z, p[0] * q.y - p[1] * q.x]
}

impl Triangle {
    pub fn new(corners: [Vector3; 3]) -> Self {
        let edges = [0, 1, 2].map(|k| corners[(k + 1) % 3] - corners[k]);
        let lengths = edges.map(|e| e.norm());
        let along = [0, 1, 2].map(|k| edges[k] / lengths[k]);
        let area = edges[0].cross(&edges[1]);
        let double_area = area.norm();
        let normal = area / double_area;
        let outwards = along.map(|e| e.cross(&normal));
        Self { corners, along, lengths, normal, outwards, double_area }
    }

    /// Whether it has no area: two corners in one place, as at the beginning of a wake beside a body.
    pub fn is_empty(&self) -> bool {
        self.double_area <= 1e-12 * (self.lengths[0] * self.lengths[0] + self.lengths[1] * self.lengths[1])
    }

    /// The edge opposite to a corner, as the triangle runs through it.
    fn opposite(&self, k: usize) -> Vector3 {
        self.corners[(k + 2) % 3] - self.corners[(k + 1) % 3]
    }

    /// The mean inverse distances, 1/m, of several points x. `on` is the edge on which the points lie, if they lie on one: of that edge and the height
    /// nothing counts.
    pub fn means(&self, x: &Points, on: Option<usize>) -> Lane {
        struct Means<'a>(&'a Triangle, &'a Points, Option<usize>);
        impl WithSimd for Means<'_> {
            type Output = Lane;

            #[inline(always)]
            fn with_simd<S: Simd>(self, simd: S) -> Lane {
                let mut out = [0.0; LANES];
                for part in 0..Wide::<S>::PARTS {
                    let [x, y, z] = self.1;
                    let x = [Wide::load(simd, x, part), Wide::load(simd, y, part), Wide::load(simd, z, part)];
                    self.0.means_of(simd, &x, self.2).store(&mut out, part);
                }
                out
            }
        }
        Arch::new().dispatch(Means(self, x, on))
    }

    #[inline(always)]
    fn means_of<S: Simd>(&self, simd: S, x: &Ways<S>, on: Option<usize>) -> Wide<S> {
        let seen = self.seen(x);
        let Seen { ways, radii } = &seen;
        let mut sum = Wide::splat(simd, 0.0);
        for k in 0..3 {
            if on != Some(k) {
                let logarithm = (radii[k] + radii[(k + 1) % 3]).log_ratio(self.lengths[k]);
                sum = sum + logarithm * along(&ways[k], &self.outwards[k]);
            }
        }
        if on.is_none() {
            sum = sum - along(&ways[0], &self.normal) * self.angles(&seen);
        }
        sum * (2.0 / self.double_area)
    }

    #[inline(always)]
    fn seen<S: Simd>(&self, x: &Ways<S>) -> Seen<S> {
        let [a, b, c] = &self.corners;
        let ways = [way(x, a), way(x, b), way(x, c)];
        let [a, b, c] = &ways;
        Seen { radii: [dot(a, a).sqrt(), dot(b, b).sqrt(), dot(c, c).sqrt()], ways }
    }

    /// Solid angles.
    #[inline(always)]
    fn angles<S: Simd>(&self, seen: &Seen<S>) -> Wide<S> {
        let ([a, b, c], [ra, rb, rc]) = (&seen.ways, seen.radii);
        let volume = along(a, &self.normal) * self.double_area;
        let denominator = ra * rb * rc + dot(a, b) * rc + dot(a, c) * rb + dot(b, c) * ra;
        volume.argument(denominator) * 2.0
    }

    /// [`means`](Self::means), and their gradients with respect to the corners; that with respect to the point is minus their sum.
    pub fn means_with_gradients(&self, x: &Points, on: Option<usize>) -> (Lane, [[Lane; 3]; 3]) {
        struct Gradients<'a>(&'a Triangle, &'a Points, Option<usize>);
        impl WithSimd for Gradients<'_> {
            type Output = (Lane, [[Lane; 3]; 3]);

            #[inline(always)]
            fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
                let (mut means, mut gradients) = ([0.0; LANES], [[[0.0; LANES]; 3]; 3]);
                for part in 0..Wide::<S>::PARTS {
                    let [x, y, z] = self.1;
                    let x = [Wide::load(simd, x, part), Wide::load(simd, y, part), Wide::load(simd, z, part)];
                    let (mean, gradient) = self.0.gradients_of(simd, &x, self.2);
                    mean.store(&mut means, part);
                    for k in 0..3 {
                        for axis in 0..3 {
                            gradient[k][axis].store(&mut gradients[k][axis], part);
                        }
                    }
                }
                (means, gradients)
            }
        }
        Arch::new().dispatch(Gradients(self, x, on))
    }

    #[inline(always)]
    fn gradients_of<S: Simd>(&self, simd: S, x: &Ways<S>, on: Option<usize>) -> (Wide<S>, [Ways<S>; 3]) {
        let seen = self.seen(x);
        let Seen { ways, radii } = &seen;
        let zero = Wide::splat(simd, 0.0);
        let (n, mut sum, mut of_normal) = (&self.normal, zero, [zero; 3]);
        let mut gradients = [[zero; 3]; 3];
        let height = if on.is_none() { along(&ways[0], n) } else { zero };
        let one = Wide::splat(simd, 1.0);
        let inverse_radii = [one / radii[0], one / radii[1], one / radii[2]];
        for k in 0..3 {
            if on == Some(k) {
                continue;
            }
            let j = (k + 1) % 3;
            let (m, e, length) = (&self.outwards[k], &self.along[k], self.lengths[k]);
            let (a, b) = (&ways[k], &ways[j]);
            let s = radii[k] + radii[j];
            let q = s.log_ratio(length);
            let inverse = one / (radii[k] * radii[j] + dot(a, b));
            let distance = along(a, m);
            sum = sum + q * distance;
            let turned = cross_one(a, e);
            // The edge turns: n x a, of which what is along the edge does not count.
            let [x, y, z] = cross_one(a, n);
            let of_edge = [-x, -y, -z];
            let stretch = along(&of_edge, e);
            // dQ = (s dL - L ds) / (r_a r_b + r_a.r_b), and the solid angle's part of this edge.
            let volume = cross(a, b);
            let (factor, high) = (distance * inverse, height * inverse);
            let (high_a, high_b) = (high * inverse_radii[k], high * inverse_radii[j]);
            let shorter = factor * length;
            let (by_a, by_b) = (shorter * inverse_radii[k], shorter * inverse_radii[j]);
            let (longer, by_length) = (factor * s, q * (1.0 / length));
            for axis in 0..3 {
                of_normal[axis] = of_normal[axis] + q * turned[axis];
                let turn = by_length * (of_edge[axis] - stretch * e[axis]);
                let stretched = longer * e[axis];
                gradients[k][axis] = gradients[k][axis] + q * m[axis] - turn - stretched - by_a * a[axis]
                    + high_a * volume[axis];
                gradients[j][axis] =
                    gradients[j][axis] + turn + stretched - by_b * b[axis] + high_b * volume[axis];
            }
        }
        if on.is_none() {
            let angles = self.angles(&seen);
            sum = sum - height * angles;
            for axis in 0..3 {
                of_normal[axis] = of_normal[axis] - angles * ways[0][axis];
                gradients[0][axis] = gradients[0][axis] - angles * n[axis];
            }
        }
        let by = 2.0 / self.double_area;
        // The normal turns with the area vector, and the area grows by half n x (opposite edge).
        let normal = along(&of_normal, n);
        let of_area = [of_normal[0] - normal * n.x, of_normal[1] - normal * n.y, of_normal[2] - normal * n.z];
        let shrink = sum * by;
        for k in 0..3 {
            let opposite = self.opposite(k);
            let grows = n.cross(&opposite);
            let turned = cross_one(&of_area, &opposite);
            for axis in 0..3 {
                let of_size = turned[axis] - shrink * (0.5 * self.double_area * grows[axis]);
                gradients[k][axis] = gradients[k][axis] * by + of_size * (by / self.double_area);
            }
        }
        (shrink, gradients)
    }

    /// The mean inverse distance between two points of the triangle, 1/m: `4/3 sum_k ln(U / (U - 2 L_k)) / L_k` with the perimeter U (Eibert and
    /// Hansen, IEEE Trans. Antennas Propag. 43, 1995); and its gradient.
    pub fn own_mean_with_gradient(&self) -> (f64, [Vector3; 3]) {
        let perimeter: f64 = self.lengths.iter().sum();
        let mut value = 0.0;
        let mut by_length = [0.0; 3];
        for k in 0..3 {
            let (length, rest) = (self.lengths[k], perimeter - 2.0 * self.lengths[k]);
            let logarithm = (perimeter / rest).ln();
            value += logarithm / length;
            for (l, by) in by_length.iter_mut().enumerate() {
                *by += (1.0 / perimeter - 1.0 / rest) / length;
                if l == k {
                    *by += 2.0 / (rest * length) - logarithm / (length * length);
                }
            }
        }
        let mut gradient = [Vector3::zeros(); 3];
        for k in 0..3 {
            let g = 4.0 / 3.0 * by_length[k] * self.along[k];
            gradient[k] -= g;
            gradient[(k + 1) % 3] += g;
        }
        (4.0 / 3.0 * value, gradient)
    }
}

/// Against quadrature and dual numbers.
#[cfg(test)]
mod tests {
    use moldline_testing::Random;
    use num_dual::{Dual64, DualNum};

    use super::*;

    type D = [Dual64; 3];

    impl Triangle {
        pub fn mean(&self, x: &Vector3, on: Option<usize>) -> f64 {
            self.means(&[x.x, x.y, x.z].map(|c| [c; LANES]), on)[LANES - 1]
        }

        fn mean_with_gradient(&self, x: &Vector3, on: Option<usize>) -> (f64, [Vector3; 3]) {
            let (means, gradients) = self.means_with_gradients(&[x.x, x.y, x.z].map(|c| [c; LANES]), on);
            (means[0], gradients.map(|g| Vector3::from(g.map(|axis| axis[0]))))
        }
    }

    fn dot(p: &D, q: &D) -> Dual64 {
        p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
    }

    fn cross(p: &D, q: &D) -> D {
        [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]
    }

    fn minus(p: &D, q: &D) -> D {
        [p[0] - q[0], p[1] - q[1], p[2] - q[2]]
    }

    /// The textbook's formula; `on` as in [`Triangle::mean`].
    fn textbook(corners: &[D; 3], x: &D, on: Option<usize>) -> Dual64 {
        let ways = corners.each_ref().map(|a| minus(a, x));
        let radii = ways.each_ref().map(|r| dot(r, r).sqrt());
        let area = cross(&minus(&corners[1], &corners[0]), &minus(&corners[2], &corners[0]));
        let double_area = dot(&area, &area).sqrt();
        let n = area.map(|c| c / double_area);
        let mut sum = Dual64::from_re(0.0);
        for k in 0..3 {
            if on == Some(k) {
                continue;
            }
            let j = (k + 1) % 3;
            let edge = minus(&corners[j], &corners[k]);
            let length = dot(&edge, &edge).sqrt();
            let s = radii[k] + radii[j];
            sum += ((s + length) / (s - length)).ln() * dot(&cross(&edge, &n), &ways[k]) / length;
        }
        if on.is_none() {
            let volume = dot(&ways[0], &cross(&ways[1], &ways[2]));
            let [ra, rb, rc] = radii;
            let denominator = ra * rb * rc
                + dot(&ways[0], &ways[1]) * rc
                + dot(&ways[0], &ways[2]) * rb
                + dot(&ways[1], &ways[2]) * ra;
            sum -= dot(&n, &ways[0]) * volume.atan2(denominator) * 2.0;
        }
        sum * 2.0 / double_area
    }

    const CORNERS: [[f64; 3]; 3] = [[0.1, -0.2, 0.3], [1.3, 0.2, 0.1], [0.4, 1.1, -0.2]];

    fn barycentric(t: [f64; 3]) -> Vector3 {
        (0..3).map(|k| t[k] * Vector3::from(CORNERS[k])).sum()
    }

    fn dual(v: &Vector3, seed: Option<usize>) -> D {
        std::array::from_fn(|k| Dual64::new(v[k], if seed == Some(k) { 1.0 } else { 0.0 }))
    }

    #[test]
    fn mean_and_gradient_are_the_textbooks() {
        let corners = CORNERS.map(Vector3::from);
        let triangle = Triangle::new(corners);
        let n = triangle.normal;
        let points = [
            ("beside", Vector3::new(0.4, -0.8, 0.7), 1e-13),
            ("far", Vector3::new(-7.0, 5.0, -9.0), 1e-11),
            ("above", barycentric([0.3, 0.3, 0.4]) + 0.4 * n, 1e-13),
            ("near", barycentric([0.3, 0.3, 0.4]) - 1e-3 * n, 1e-12),
            ("in the plane, outside", barycentric([-0.3, 0.6, 0.7]), 1e-13),
            ("on the line of an edge", barycentric([1.6, -0.6, 0.0]), 1e-12),
            ("near an edge", barycentric([0.4, 0.6, 0.0]) + 1e-2 * n, 1e-11),
        ];
        for (case, x, tolerance) in points {
            let (mean, gradient) = triangle.mean_with_gradient(&x, None);
            assert!((triangle.mean(&x, None) - mean).abs() <= 1e-14 * mean, "{case}");
            for (k, axis) in (0..3).flat_map(|k| (0..3).map(move |axis| (k, axis))) {
                let seeded: [D; 3] = std::array::from_fn(|j| dual(&corners[j], (j == k).then_some(axis)));
                let expected = textbook(&seeded, &dual(&x, None), None);
                assert!((mean - expected.re).abs() <= tolerance * mean, "{case}: {mean} {}", expected.re);
                let found = gradient[k][axis];
                let size = gradient.iter().map(|g| g.norm()).sum::<f64>();
                assert!(
                    (found - expected.eps).abs() <= 10.0 * tolerance * size,
                    "{case}: {found} {}",
                    expected.eps
                );
            }
        }
        // On an edge, moving with it.
        for (edge, t) in [(0, [0.3, 0.7, 0.0]), (1, [0.0, 0.4, 0.6]), (2, [0.8, 0.0, 0.2])] {
            let x = barycentric(t);
            let (mean, gradient) = triangle.mean_with_gradient(&x, Some(edge));
            let near = triangle.mean(&(x + 1e-7 * n), None);
            assert!((mean - near).abs() < 1e-5 * mean, "{mean} {near}");
            let by_point: Vector3 = -gradient.iter().sum::<Vector3>();
            for (k, axis) in (0..3).flat_map(|k| (0..3).map(move |axis| (k, axis))) {
                let seeded: [D; 3] = std::array::from_fn(|j| dual(&corners[j], (j == k).then_some(axis)));
                let on: D = std::array::from_fn(|c| {
                    (0..3).map(|j| seeded[j][c] * t[j]).fold(Dual64::from_re(0.0), |s, x| s + x)
                });
                let expected = textbook(&seeded, &on, Some(edge));
                let found = gradient[k][axis] + t[k] * by_point[axis];
                assert!((found - expected.eps).abs() <= 1e-12 * mean, "{edge}: {found} {}", expected.eps);
            }
        }
    }

    /// Against the mean of the potential over ever smaller parts.
    #[test]
    fn mean_of_the_triangle_to_itself() {
        let mut random = Random::new(5);
        for _ in 0..4 {
            let corners: [Vector3; 3] = std::array::from_fn(|_| random.vector(1.0));
            let triangle = Triangle::new(corners);
            let (value, gradient) = triangle.own_mean_with_gradient();
            // Midpoints of n^2 parts; the error falls with the square of n.
            let rule = |n: usize| {
                let mut sum = 0.0;
                for i in 0..n {
                    for j in 0..n - i {
                        let mut add = |s: f64, t: f64| {
                            let x =
                                corners[0] + (corners[1] - corners[0]) * s + (corners[2] - corners[0]) * t;
                            sum += triangle.mean(&x, None);
                        };
                        let (u, v, by) = (i as f64, j as f64, 1.0 / n as f64);
                        add((u + 1.0 / 3.0) * by, (v + 1.0 / 3.0) * by);
                        if i + j + 1 < n {
                            add((u + 2.0 / 3.0) * by, (v + 2.0 / 3.0) * by);
                        }
                    }
                }
                sum / (n * n) as f64
            };
            let (coarse, fine) = (rule(20), rule(40));
            let limit = fine + (fine - coarse) / 3.0;
            assert!((value / limit - 1.0).abs() < 2e-4, "{value} {limit}");
            let direction: [Vector3; 3] = std::array::from_fn(|_| random.vector(1.0));
            let at = |step: f64| {
                Triangle::new(std::array::from_fn(|k| corners[k] + step * direction[k]))
                    .own_mean_with_gradient()
                    .0
            };
            let expected = (at(1e-5) - at(-1e-5)) / 2e-5;
            let found: f64 = (0..3).map(|k| gradient[k].dot(&direction[k])).sum();
            assert!((found - expected).abs() < 1e-7 * found.abs().max(1.0), "{found} {expected}");
        }
    }
}
