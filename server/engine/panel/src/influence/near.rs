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

use moldline_foundation::simd::widest;
use moldline_mesh::Vector3;

use crate::lanes::{LANES, Lane, argument, log_ratio};

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

/// Ways from points to the corners of a triangle, and their lengths.
struct Seen {
    ways: [[Lane; 3]; 3],
    radii: [Lane; 3],
}

#[inline(always)]
fn dot(p: &[f64; 3], q: &[f64; 3]) -> f64 {
    p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
}

#[inline(always)]
fn cross(p: &[f64; 3], q: &[f64; 3]) -> [f64; 3] {
    [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]
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
        let mut out = [0.0; LANES];
        widest(
            #[inline(always)]
            || out = self.means_inline(x, on),
        );
        out
    }

    #[inline(always)]
    fn means_inline(&self, x: &Points, on: Option<usize>) -> Lane {
        let Seen { ways, radii } = self.seen(x);
        let mut sums = [0.0; LANES];
        for k in 0..3 {
            if on == Some(k) {
                continue;
            }
            let j = (k + 1) % 3;
            let m = &self.outwards[k];
            for l in 0..LANES {
                let logarithm = log_ratio(radii[k][l] + radii[j][l], self.lengths[k]);
                sums[l] += logarithm * (m.x * ways[k][0][l] + m.y * ways[k][1][l] + m.z * ways[k][2][l]);
            }
        }
        if on.is_none() {
            let angles = self.angles(&ways, &radii);
            for l in 0..LANES {
                sums[l] -= self.height(&ways, l) * angles[l];
            }
        }
        sums.map(|sum| 2.0 * sum / self.double_area)
    }

    #[inline(always)]
    fn seen(&self, x: &Points) -> Seen {
        let mut seen = Seen { ways: [[[0.0; LANES]; 3]; 3], radii: [[0.0; LANES]; 3] };
        for k in 0..3 {
            for l in 0..LANES {
                let way = [0, 1, 2].map(|axis: usize| self.corners[k][axis] - x[axis][l]);
                (0..3).for_each(|axis| seen.ways[k][axis][l] = way[axis]);
                seen.radii[k][l] = (way[0] * way[0] + way[1] * way[1] + way[2] * way[2]).sqrt();
            }
        }
        seen
    }

    #[inline(always)]
    fn height(&self, ways: &[[Lane; 3]; 3], l: usize) -> f64 {
        let n = &self.normal;
        n.x * ways[0][0][l] + n.y * ways[0][1][l] + n.z * ways[0][2][l]
    }

    #[inline(always)]
    fn angles(&self, ways: &[[Lane; 3]; 3], radii: &[Lane; 3]) -> Lane {
        let dot = |i: usize, j: usize, l: usize| {
            ways[i][0][l] * ways[j][0][l] + ways[i][1][l] * ways[j][1][l] + ways[i][2][l] * ways[j][2][l]
        };
        let mut angles = [0.0; LANES];
        for l in 0..LANES {
            let [ra, rb, rc] = [radii[0][l], radii[1][l], radii[2][l]];
            let volume = self.height(ways, l) * self.double_area;
            let denominator = ra * rb * rc + dot(0, 1, l) * rc + dot(0, 2, l) * rb + dot(1, 2, l) * ra;
            angles[l] = 2.0 * argument(volume, denominator);
        }
        angles
    }

    /// [`means`](Self::means), and their gradients with respect to the corners; that with respect to the point is minus their sum.
    pub fn means_with_gradients(&self, x: &Points, on: Option<usize>) -> (Lane, [[Lane; 3]; 3]) {
        let mut out = ([0.0; LANES], [[[0.0; LANES]; 3]; 3]);
        widest(
            #[inline(always)]
            || out = self.gradients_inline(x, on),
        );
        out
    }

    #[inline(always)]
    fn gradients_inline(&self, x: &Points, on: Option<usize>) -> (Lane, [[Lane; 3]; 3]) {
        let Seen { ways, radii } = self.seen(x);
        let n: [f64; 3] = self.normal.into();
        let mut sums = [0.0; LANES];
        let mut gradients = [[[0.0; LANES]; 3]; 3];
        let mut of_normal = [[0.0; LANES]; 3];
        let mut heights = [0.0; LANES];
        if on.is_none() {
            for l in 0..LANES {
                heights[l] = self.height(&ways, l);
            }
        }
        for k in 0..3 {
            if on == Some(k) {
                continue;
            }
            let j = (k + 1) % 3;
            let (m, e, length): ([f64; 3], [f64; 3], f64) =
                (self.outwards[k].into(), self.along[k].into(), self.lengths[k]);
            for l in 0..LANES {
                let a = [ways[k][0][l], ways[k][1][l], ways[k][2][l]];
                let b = [ways[j][0][l], ways[j][1][l], ways[j][2][l]];
                let (ra, rb) = (radii[k][l], radii[j][l]);
                let s = ra + rb;
                let q = log_ratio(s, length);
                let inverse = 1.0 / (ra * rb + dot(&a, &b));
                let distance = dot(&m, &a);
                sums[l] += q * distance;
                let turned = cross(&a, &e);
                // The edge turns.
                let of_edge = cross(&n, &a);
                let along = dot(&e, &of_edge);
                // dQ = (s dL - L ds) / (r_a r_b + r_a.r_b), and the solid angle's part of this edge.
                let volume = cross(&a, &b);
                let (factor, high) = (distance * inverse, heights[l] * inverse);
                let (by_ra, by_rb) = (1.0 / ra, 1.0 / rb);
                for axis in 0..3 {
                    of_normal[axis][l] += q * turned[axis];
                    let turn = q * (of_edge[axis] - e[axis] * along) / length;
                    gradients[k][axis][l] +=
                        q * m[axis] - turn - factor * (s * e[axis] + length * by_ra * a[axis])
                            + high * by_ra * volume[axis];
                    gradients[j][axis][l] += turn
                        + factor * (s * e[axis] - length * by_rb * b[axis])
                        + high * by_rb * volume[axis];
                }
            }
        }
        if on.is_none() {
            let angles = self.angles(&ways, &radii);
            for l in 0..LANES {
                sums[l] -= heights[l] * angles[l];
                for axis in 0..3 {
                    of_normal[axis][l] -= angles[l] * ways[0][axis][l];
                    gradients[0][axis][l] -= angles[l] * n[axis];
                }
            }
        }
        let by = 2.0 / self.double_area;
        for k in 0..3 {
            let opposite: [f64; 3] = self.opposite(k).into();
            // The area grows by half n x (opposite edge).
            let grows = cross(&n, &opposite);
            for l in 0..LANES {
                let of = [of_normal[0][l], of_normal[1][l], of_normal[2][l]];
                let along = dot(&n, &of);
                let of_area = [0, 1, 2].map(|axis: usize| (of[axis] - n[axis] * along) / self.double_area);
                let turned = cross(&of_area, &opposite);
                for axis in 0..3 {
                    gradients[k][axis][l] = by * (gradients[k][axis][l] + turned[axis])
                        - by * sums[l] / self.double_area * grows[axis];
                }
            }
        }
        (sums.map(|sum| by * sum), gradients)
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
