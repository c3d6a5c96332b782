//! Lift and induced drag from the wake far downstream.
//!
//! The circulation is linear between the middles of neighbouring strips and falls to zero at a tip, so its derivative, the vorticity
//! gamma, is constant on straight elements (halves of the strips). With Gamma of both halves of the aircraft,
//!
//! ```text
//! lift / (rho V) = integral Gamma dy,    drag / rho = - 1/(4 pi) sum_ij gamma_i gamma_j integral integral ln |r| ds_i ds_j
//! ```
//!
//! The inner integral is closed, the outer one by Gauss's rule; an element on itself is closed, too. Where the circulation goes on over a
//! body to the plane of symmetry, it is constant, and counts in the lift. Off that plane it goes on linearly to the
//! mean of what arrives at the body's aft end.

use moldline_foundation::quadrature::GAUSS_4;
use moldline_mesh::Vector3;

use crate::{
    panels::Panels,
    wake::{Beside, Wakes},
};

/// A point of the trace: weighted points of the surface.
type End = [(u32, f64); 2];

/// A straight piece of the wake's trace with constant vorticity.
#[derive(Clone, Debug)]
struct Element {
    ends: [End; 2],
    /// Circulation at its end minus that at its beginning (or a multiple): factors of the strips ...
    rise: Vec<(u32, f64)>,
    /// ... over half the length of these strips, or over its own length if there are none.
    over: Vec<u32>,
}

/// The trace of all wakes.
#[derive(Clone, Debug)]
pub(crate) struct Trace {
    elements: Vec<Element>,
    /// Points whose `y` count in the lift, with strip and sign.
    lifting: Vec<(u32, u32, f64)>,
    /// Ends of the strips.
    strips: Vec<[u32; 2]>,
    symmetric: bool,
}

type Plane = [f64; 2];

fn sub(a: Plane, b: Plane) -> Plane {
    [a[0] - b[0], a[1] - b[1]]
}

fn dot(a: Plane, b: Plane) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn cross(a: Plane, b: Plane) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// `integral ln |x - s| ds` from p to q, and its gradient with respect to x, p and q.
///
/// With u1, u2 the components of `p - x`, `q - x` along the unit vector e from p to q, and h the one across,
///
/// ```text
/// integral = F(u2) - F(u1),   F(u) = u ln sqrt(u^2 + h^2) - u + h atan(u / h)
/// dF = ln sqrt(u^2 + h^2) du + atan(u / h) dh
/// ```
fn inner(x: Plane, p: Plane, q: Plane) -> (f64, [Plane; 3]) {
    let d = sub(q, p);
    let length = dot(d, d).sqrt();
    let e = [d[0] / length, d[1] / length];
    let (to_p, to_q) = (sub(p, x), sub(q, x));
    let (u1, u2, h) = (dot(to_p, e), dot(to_q, e), cross(to_p, e));
    let parts = |u: f64| {
        let squared = (u * u + h * h).max(f64::MIN_POSITIVE);
        let log = 0.5 * squared.ln();
        let angle = u.atan2(h.abs()) * h.signum();
        (u * log - u + h * angle, log, angle)
    };
    let ((f1, log1, angle1), (f2, log2, angle2)) = (parts(u1), parts(u2));
    // The derivatives are -log1 with respect to u1, log2 to u2, angle2 - angle1 to h; then e turns with p and q.
    let by_h = angle2 - angle1;
    let by_e = [
        -log1 * to_p[0] + log2 * to_q[0] - by_h * to_p[1],
        -log1 * to_p[1] + log2 * to_q[1] + by_h * to_p[0],
    ];
    let along = dot(by_e, e);
    let turn = [(by_e[0] - e[0] * along) / length, (by_e[1] - e[1] * along) / length];
    // h = p_y e_z - p_z e_y: its gradient with respect to p is (e_z, -e_y).
    let of_p = [-log1 * e[0] + by_h * e[1], -log1 * e[1] - by_h * e[0]];
    let of_q = [log2 * e[0], log2 * e[1]];
    let x = [-of_p[0] - of_q[0], -of_p[1] - of_q[1]];
    (f2 - f1, [x, [of_p[0] - turn[0], of_p[1] - turn[1]], [of_q[0] + turn[0], of_q[1] + turn[1]]])
}

impl Trace {
    pub fn new(panels: &Panels, wakes: &Wakes) -> Self {
        let at = |point: u32| [(point, 0.5), (point, 0.5)];
        let mut elements = Vec::new();
        let mut lifting = Vec::new();
        for (index, strip) in wakes.strips.iter().enumerate() {
            let own = index as u32;
            let middle = [(strip.a, 0.5), (strip.b, 0.5)];
            lifting.extend([(strip.a, own, -1.0), (strip.b, own, 1.0)]);
            for (side, point) in [strip.a, strip.b].into_iter().enumerate() {
                let sign = if side == 0 { 1.0 } else { -1.0 };
                let ends = if side == 0 { [at(point), middle] } else { [middle, at(point)] };
                match strip.beside[side] {
                    Beside::Tip => {
                        elements.push(Element { ends, rise: vec![(own, sign)], over: vec![own] });
                    }
                    Beside::Strip(other) => {
                        let rise = vec![(own, sign), (other, -sign)];
                        elements.push(Element { ends, rise, over: vec![own, other] });
                    }
                    Beside::Plane => {}
                    Beside::Body(end) => {
                        lifting.extend([(point, own, sign), (end, own, -sign)]);
                        if !panels.on_plane[end as usize] {
                            let roots = roots_at(wakes, end);
                            let share = sign / roots.len() as f64;
                            let mut rise: Vec<(u32, f64)> = roots.iter().map(|r| (*r, -share)).collect();
                            rise.push((own, sign));
                            let ends = if side == 0 { [at(end), at(point)] } else { [at(point), at(end)] };
                            elements.push(Element { ends, rise, over: Vec::new() });
                        }
                    }
                }
            }
        }
        let strips = wakes.strips.iter().map(|s| [s.a, s.b]).collect();
        Self { elements, lifting, strips, symmetric: panels.symmetric }
    }

    /// `integral Gamma dy`.
    pub fn lift(&self, points: &[Vector3], circulation: &[f64]) -> f64 {
        let half: f64 = self
            .lifting
            .iter()
            .map(|&(point, strip, sign)| sign * circulation[strip as usize] * points[point as usize].y)
            .sum();
        self.factor() * half
    }

    /// The change of [`lift`](Self::lift).
    pub fn lift_jvp(
        &self,
        points: &[Vector3],
        circulation: &[f64],
        d_points: &[Vector3],
        d_circulation: &[f64],
    ) -> f64 {
        self.lift(points, d_circulation) + self.lift(d_points, circulation)
    }

    /// The transpose of [`lift_jvp`](Self::lift_jvp).
    pub fn lift_vjp(
        &self,
        points: &[Vector3],
        circulation: &[f64],
        seed: f64,
        point_seeds: &mut [Vector3],
        circulation_seeds: &mut [f64],
    ) {
        let seed = self.factor() * seed;
        for &(point, strip, sign) in &self.lifting {
            circulation_seeds[strip as usize] += seed * sign * points[point as usize].y;
            point_seeds[point as usize].y += seed * sign * circulation[strip as usize];
        }
    }

    /// Number of halves for each that is solved.
    fn factor(&self) -> f64 {
        if self.symmetric { 2.0 } else { 1.0 }
    }

    /// The point of an end, in y and z.
    fn end(&self, end: &End, points: &[Vector3]) -> Plane {
        let at = |(point, weight): (u32, f64)| {
            let p = &points[point as usize];
            [weight * p.y, weight * p.z]
        };
        let (one, two) = (at(end[0]), at(end[1]));
        [one[0] + two[0], one[1] + two[1]]
    }

    fn length(&self, strip: u32, points: &[Vector3]) -> f64 {
        let [a, b] = self.strips[strip as usize].map(|p| &points[p as usize]);
        (b.y - a.y).hypot(b.z - a.z)
    }

    /// The length over which the circulation rises.
    fn denominator(&self, element: &Element, ends: [Plane; 2], points: &[Vector3]) -> f64 {
        if element.over.is_empty() {
            let d = sub(ends[1], ends[0]);
            dot(d, d).sqrt()
        } else {
            0.5 * element.over.iter().map(|s| self.length(*s, points)).sum::<f64>()
        }
    }

    /// The quadratic form of the drag, `drag / rho = sum_kl w_k w_l D_kl`, for the circulations of several onset flows.
    pub fn drag<const B: usize>(&self, points: &[Vector3], circulations: &[Vec<f64>; B]) -> [[f64; B]; B] {
        let mut out = [[0.0; B]; B];
        let gamma = self.vorticity(points, circulations);
        self.pairs(points, |i, j, integral, _| {
            for k in 0..B {
                for l in 0..B {
                    out[k][l] += gamma[i][k] * gamma[j][l] * integral;
                }
            }
        });
        // Gauss's rule outside and the closed form inside are not quite symmetric.
        std::array::from_fn(|k| std::array::from_fn(|l| 0.5 * (out[k][l] + out[l][k])))
    }

    /// The vorticity of every element, for every onset flow.
    fn vorticity<const B: usize>(&self, points: &[Vector3], circulations: &[Vec<f64>; B]) -> Vec<[f64; B]> {
        self.elements
            .iter()
            .map(|element| {
                let ends = element.ends.each_ref().map(|end| self.end(end, points));
                let by = 1.0 / self.denominator(element, ends, points);
                std::array::from_fn(|k| {
                    let rise = element.rise.iter().map(|(s, f)| f * circulations[k][*s as usize]);
                    by * rise.sum::<f64>()
                })
            })
            .collect()
    }

    /// Calls back with every pair's integral, times `-1/(4 pi)` and the number of images, and its gradient with respect to the ends of both.
    fn pairs(&self, points: &[Vector3], mut each: impl FnMut(usize, usize, f64, [Plane; 4])) {
        let factor = -self.factor() / (4.0 * std::f64::consts::PI);
        let ends: Vec<[Plane; 2]> =
            self.elements.iter().map(|e| e.ends.each_ref().map(|end| self.end(end, points))).collect();
        for (i, &[a, b]) in ends.iter().enumerate() {
            let d = sub(b, a);
            let length = dot(d, d).sqrt();
            let e = [d[0] / length, d[1] / length];
            for (j, &[p, q]) in ends.iter().enumerate() {
                let mut value = 0.0;
                let mut gradient = [[0.0; 2]; 4];
                let mut add = |sign: f64, p: Plane, q: Plane, flip: f64| {
                    for (node, weight) in GAUSS_4 {
                        let (wa, wb) = (0.5 * (1.0 - node), 0.5 * (1.0 + node));
                        let x = [wa * a[0] + wb * b[0], wa * a[1] + wb * b[1]];
                        let (f, [fx, fp, fq]) = inner(x, p, q);
                        let w = 0.5 * weight * sign;
                        value += w * length * f;
                        for axis in 0..2 {
                            let flip = if axis == 0 { flip } else { 1.0 };
                            gradient[0][axis] += w * (wa * length * fx[axis] - e[axis] * f);
                            gradient[1][axis] += w * (wb * length * fx[axis] + e[axis] * f);
                            gradient[2][axis] += w * length * fp[axis] * flip;
                            gradient[3][axis] += w * length * fq[axis] * flip;
                        }
                    }
                };
                if i != j {
                    add(1.0, p, q, 1.0);
                }
                if self.symmetric {
                    add(-1.0, [-p[0], p[1]], [-q[0], q[1]], -1.0);
                }
                if i == j {
                    value += length * length * (length.ln() - 1.5);
                    let by_length = 2.0 * length * (length.ln() - 1.0);
                    for axis in 0..2 {
                        gradient[0][axis] -= by_length * e[axis];
                        gradient[1][axis] += by_length * e[axis];
                    }
                }
                each(i, j, factor * value, gradient.map(|g| g.map(|x| factor * x)));
            }
        }
    }

    /// The change of [`drag`](Self::drag): every entry by its gradient, of which there are few.
    pub fn drag_jvp<const B: usize>(
        &self,
        points: &[Vector3],
        circulations: &[Vec<f64>; B],
        d_points: &[Vector3],
        d_circulations: &[Vec<f64>; B],
    ) -> [[f64; B]; B] {
        let entry = |k: usize, l: usize| {
            let mut seed = [[0.0; B]; B];
            seed[k][l] = 1.0;
            let mut point_seeds = vec![Vector3::zeros(); points.len()];
            let mut strip_seeds: [Vec<f64>; B] = std::array::from_fn(|k| vec![0.0; circulations[k].len()]);
            self.drag_vjp(points, circulations, &seed, &mut point_seeds, &mut strip_seeds);
            let mut sum = point_seeds.iter().zip(d_points).map(|(s, d)| s.dot(d)).sum::<f64>();
            for (seeds, change) in strip_seeds.iter().zip(d_circulations) {
                sum += seeds.iter().zip(change).map(|(s, d)| s * d).sum::<f64>();
            }
            sum
        };
        std::array::from_fn(|k| std::array::from_fn(|l| entry(k, l)))
    }

    /// The transpose of [`drag_jvp`](Self::drag_jvp): adds to the seeds of points and circulations.
    pub fn drag_vjp<const B: usize>(
        &self,
        points: &[Vector3],
        circulations: &[Vec<f64>; B],
        seed: &[[f64; B]; B],
        point_seeds: &mut [Vector3],
        circulation_seeds: &mut [Vec<f64>; B],
    ) {
        let seed: [[f64; B]; B] =
            std::array::from_fn(|k| std::array::from_fn(|l| 0.5 * (seed[k][l] + seed[l][k])));
        let gamma = self.vorticity(points, circulations);
        let mut gamma_seeds = vec![[0.0; B]; self.elements.len()];
        let mut end_seeds = vec![[[0.0; 2]; 2]; self.elements.len()];
        self.pairs(points, |i, j, integral, gradient| {
            let mut weight = 0.0;
            for k in 0..B {
                for l in 0..B {
                    weight += seed[k][l] * gamma[i][k] * gamma[j][l];
                    gamma_seeds[i][k] += seed[k][l] * gamma[j][l] * integral;
                    gamma_seeds[j][l] += seed[k][l] * gamma[i][k] * integral;
                }
            }
            for axis in 0..2 {
                end_seeds[i][0][axis] += weight * gradient[0][axis];
                end_seeds[i][1][axis] += weight * gradient[1][axis];
                end_seeds[j][0][axis] += weight * gradient[2][axis];
                end_seeds[j][1][axis] += weight * gradient[3][axis];
            }
        });
        for (index, element) in self.elements.iter().enumerate() {
            let seeds = (&gamma_seeds[index], end_seeds[index]);
            self.vorticity_vjp(element, points, &gamma[index], seeds, point_seeds, circulation_seeds);
        }
    }

    /// From seeds of an element's vorticity gamma and of its ends to those of points and circulations: the transpose of
    /// [`vorticity`](Self::vorticity) and [`end`](Self::end).
    fn vorticity_vjp<const B: usize>(
        &self,
        element: &Element,
        points: &[Vector3],
        gamma: &[f64; B],
        (gamma_seeds, mut end_seeds): (&[f64; B], [Plane; 2]),
        point_seeds: &mut [Vector3],
        circulation_seeds: &mut [Vec<f64>; B],
    ) {
        let ends = element.ends.each_ref().map(|end| self.end(end, points));
        let by = 1.0 / self.denominator(element, ends, points);
        let mut of_denominator = 0.0;
        for k in 0..B {
            let s = gamma_seeds[k];
            of_denominator -= s * gamma[k] * by;
            for (strip, factor) in &element.rise {
                circulation_seeds[k][*strip as usize] += s * by * factor;
            }
        }
        if element.over.is_empty() {
            let d = sub(ends[1], ends[0]);
            let length = dot(d, d).sqrt();
            for axis in 0..2 {
                let part = of_denominator * d[axis] / length;
                end_seeds[0][axis] -= part;
                end_seeds[1][axis] += part;
            }
        }
        for strip in &element.over {
            let [a, b] = self.strips[*strip as usize];
            let d = points[b as usize] - points[a as usize];
            let part = 0.5 * of_denominator / d.y.hypot(d.z) * Vector3::new(0.0, d.y, d.z);
            point_seeds[a as usize] -= part;
            point_seeds[b as usize] += part;
        }
        for (end, seed) in element.ends.iter().zip(&end_seeds) {
            for (point, weight) in end {
                point_seeds[*point as usize] += Vector3::new(0.0, weight * seed[0], weight * seed[1]);
            }
        }
    }
}

/// Strips whose circulation arrives at the aft end of a body.
fn roots_at(wakes: &Wakes, end: u32) -> Vec<u32> {
    let arrives = |strip: &crate::wake::Strip| strip.beside.contains(&Beside::Body(end));
    (0..wakes.strips.len() as u32).filter(|s| arrives(&wakes.strips[*s as usize])).collect()
}

#[cfg(test)]
mod tests {
    use moldline_testing::Wing;
    use num_dual::{Dual64, DualNum};

    use super::*;
    use crate::{Options, PanelSetup};

    /// Against the closed form in dual numbers: beside the segment, far away, near it, and near its line.
    #[test]
    fn logarithmic_potential_of_a_segment() {
        type D = [Dual64; 2];
        let textbook = |[x, p, q]: &[D; 3]| {
            let difference = |a: &D, b: &D| [a[0] - b[0], a[1] - b[1]];
            let dot = |a: &D, b: &D| a[0] * b[0] + a[1] * b[1];
            let d = difference(q, p);
            let length = dot(&d, &d).sqrt();
            let e = d.map(|x| x / length);
            let at = |end: &D| {
                let way = difference(end, x);
                let (u, h) = (dot(&way, &e), way[0] * e[1] - way[1] * e[0]);
                u * (u * u + h * h).ln() * 0.5 - u + h * (u / h).atan()
            };
            at(q) - at(p)
        };
        let (p, q) = ([0.3, -0.2], [1.1, 0.4]);
        for x in [[0.9, -0.4], [-30.0, 20.0], [0.7, 0.1 + 1e-4], [-0.5, -0.8 + 1e-6], [2.0, 2.0]] {
            let positions = [x, p, q];
            let (value, gradient) = inner(x, p, q);
            for (i, axis) in (0..3).flat_map(|i| [(i, 0), (i, 1)]) {
                let seeded: [D; 3] = std::array::from_fn(|j| {
                    std::array::from_fn(|k| {
                        Dual64::new(positions[j][k], if (j, k) == (i, axis) { 1.0 } else { 0.0 })
                    })
                });
                let expected = textbook(&seeded);
                assert!((value - expected.re).abs() < 1e-12 * value.abs().max(1.0), "{x:?}: {value}");
                let found = gradient[i][axis];
                assert!((found - expected.eps).abs() < 1e-11 * found.abs().max(1.0), "{x:?}: {found}");
            }
        }
    }

    /// An elliptic circulation over a plane trace has the least drag, `(integral Gamma dy)^2 2 / (pi b^2)`; the error falls with the square of
    /// the spacing.
    #[test]
    fn elliptic_circulation() {
        let excess = [20, 40, 80].map(|along| {
            let mesh = Wing::rectangular(8, along).mesh();
            let setup = PanelSetup::new(&mesh, Options::default()).unwrap();
            let points = setup.panels.gather(&mesh.vertices);
            let gamma = |strip: &crate::wake::Strip| {
                let y = 0.5 * (points[strip.a as usize].y + points[strip.b as usize].y) / 4.0;
                (1.0 - y * y).sqrt()
            };
            let circulation: Vec<f64> = setup.wakes.strips.iter().map(gamma).collect();
            let lift = setup.trace.lift(&points, &circulation);
            let least = 2.0 * lift * lift / (std::f64::consts::PI * 64.0);
            assert!(
                (lift / (2.0 * std::f64::consts::PI) - 1.0).abs() < 2.0 / (along * along) as f64,
                "{lift}"
            );
            setup.trace.drag(&points, &[circulation])[0][0] / least - 1.0
        });
        // The root at the tips is coarse for a straight line, and costs most of it.
        assert!(excess[2].abs() < 0.002, "{excess:?}");
        assert!(
            excess[0].abs() > 2.0 * excess[1].abs() && excess[1].abs() > 2.0 * excess[2].abs(),
            "{excess:?}"
        );
    }
}
