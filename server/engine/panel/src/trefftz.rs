//! Lift and induced drag from the wake far downstream.
//!
//! The circulation is linear on every strip, so its derivative, the vorticity gamma, is constant there. With Gamma of both halves of the aircraft,
//!
//! ```text
//! lift / (rho V) = integral Gamma dy,    drag / rho = - 1/(4 pi) sum_ij gamma_i gamma_j integral integral ln |r| ds_i ds_j
//! ```
//!
//! The inner integral is closed, the outer one by Gauss's rule; a strip on itself is closed, too. Where the circulation goes on over a
//! body to the plane of symmetry, it is constant, and counts in the lift. Elsewhere it goes on linearly to what is left at the body's aft end
//! ([`crate::nodes`]).
//!
//! Circulations are those at both ends of every strip, strip after strip.

use moldline_foundation::quadrature::GAUSS_4;
use moldline_mesh::Vector3;

use crate::{
    Monitor, PanelError, Stage,
    panels::Panels,
    progress::poll,
    wake::{Beside, Wakes},
};

/// Factors of circulations.
type Terms = Vec<(u32, f64)>;

/// A straight piece of the wake's trace.
#[derive(Clone, Debug)]
struct Piece {
    /// Points at its beginning and its end.
    ends: [u32; 2],
    /// Circulations there.
    circulations: [Terms; 2],
    /// Whether they differ.
    sheds: bool,
}

/// The trace of all wakes.
#[derive(Clone, Debug)]
pub(crate) struct Trace {
    pieces: Vec<Piece>,
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
        let mut pieces = Vec::new();
        for (index, strip) in wakes.strips.iter().enumerate() {
            let own = [2 * index as u32, 2 * index as u32 + 1];
            let circulations = own.map(|end| vec![(end, 1.0)]);
            pieces.push(Piece { ends: [strip.a, strip.b], circulations, sheds: true });
            for (side, point) in [strip.a, strip.b].into_iter().enumerate() {
                let Beside::Body(end) = strip.beside[side] else { continue };
                let root = vec![(own[side], 1.0)];
                let sheds = !(panels.symmetric && panels.on_plane[end as usize]);
                let left = if sheds { wakes.leaving(index, side) } else { root.clone() };
                let (ends, circulations) =
                    if side == 0 { ([end, point], [left, root]) } else { ([point, end], [root, left]) };
                pieces.push(Piece { ends, circulations, sheds });
            }
        }
        Self { pieces, symmetric: panels.symmetric }
    }

    /// `integral Gamma dy`.
    pub fn lift(&self, points: &[Vector3], circulation: &[f64]) -> f64 {
        let of = |piece: &Piece| {
            let [a, b] = piece.ends.map(|p| points[p as usize].y);
            0.5 * (b - a) * piece.circulations.iter().map(|terms| value(terms, circulation)).sum::<f64>()
        };
        self.factor() * self.pieces.iter().map(of).sum::<f64>()
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
        let seed = 0.5 * self.factor() * seed;
        for piece in &self.pieces {
            let [a, b] = piece.ends.map(|p| p as usize);
            let width = points[b].y - points[a].y;
            let both: f64 = piece.circulations.iter().map(|terms| value(terms, circulation)).sum();
            point_seeds[b].y += seed * both;
            point_seeds[a].y -= seed * both;
            for (end, factor) in piece.circulations.iter().flatten() {
                circulation_seeds[*end as usize] += seed * width * factor;
            }
        }
    }

    /// Number of halves for each that is solved.
    fn factor(&self) -> f64 {
        if self.symmetric { 2.0 } else { 1.0 }
    }

    /// The pieces that shed vorticity, with their ends in y and z.
    fn elements(&self, points: &[Vector3]) -> Vec<(&Piece, [Plane; 2])> {
        let at = |p: u32| [points[p as usize].y, points[p as usize].z];
        self.pieces.iter().filter(|piece| piece.sheds).map(|piece| (piece, piece.ends.map(at))).collect()
    }

    /// The quadratic form of the drag, `drag / rho = sum_kl w_k w_l D_kl`, for the circulations of several onset flows.
    pub fn drag<const B: usize>(
        &self,
        points: &[Vector3],
        circulations: &[Vec<f64>; B],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<[[f64; B]; B], PanelError> {
        let mut out = [[0.0; B]; B];
        let gamma = self.vorticity(points, circulations);
        self.pairs(points, monitor, |i, j, integral, _| {
            for k in 0..B {
                for l in 0..B {
                    out[k][l] += gamma[i][k] * gamma[j][l] * integral;
                }
            }
        })?;
        // Gauss's rule outside and the closed form inside are not quite symmetric.
        Ok(std::array::from_fn(|k| std::array::from_fn(|l| 0.5 * (out[k][l] + out[l][k]))))
    }

    /// The vorticity of every element, for every onset flow.
    fn vorticity<const B: usize>(&self, points: &[Vector3], circulations: &[Vec<f64>; B]) -> Vec<[f64; B]> {
        self.elements(points)
            .iter()
            .map(|(piece, [a, b])| {
                let d = sub(*b, *a);
                let by = 1.0 / dot(d, d).sqrt();
                std::array::from_fn(|k| {
                    let [begin, end] =
                        piece.circulations.each_ref().map(|terms| value(terms, &circulations[k]));
                    by * (end - begin)
                })
            })
            .collect()
    }

    /// Calls back with every pair's integral, times `-1/(4 pi)` and the number of images, and its gradient with respect to the ends of both.
    fn pairs(
        &self,
        points: &[Vector3],
        monitor: &dyn Monitor<Stage>,
        mut each: impl FnMut(usize, usize, f64, [Plane; 4]),
    ) -> Result<(), PanelError> {
        let factor = -self.factor() / (4.0 * std::f64::consts::PI);
        let ends: Vec<[Plane; 2]> = self.elements(points).iter().map(|(_, ends)| *ends).collect();
        for (i, &[a, b]) in ends.iter().enumerate() {
            poll(monitor)?;
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
        Ok(())
    }

    /// The change of [`drag`](Self::drag): every entry by its gradient, of which there are few.
    pub fn drag_jvp<const B: usize>(
        &self,
        points: &[Vector3],
        circulations: &[Vec<f64>; B],
        d_points: &[Vector3],
        d_circulations: &[Vec<f64>; B],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<[[f64; B]; B], PanelError> {
        let entry = |k: usize, l: usize| {
            let mut seed = [[0.0; B]; B];
            seed[k][l] = 1.0;
            let mut point_seeds = vec![Vector3::zeros(); points.len()];
            let mut strip_seeds: [Vec<f64>; B] = std::array::from_fn(|k| vec![0.0; circulations[k].len()]);
            self.drag_vjp(points, circulations, &seed, &mut point_seeds, &mut strip_seeds, monitor)?;
            let mut sum = point_seeds.iter().zip(d_points).map(|(s, d)| s.dot(d)).sum::<f64>();
            for (seeds, change) in strip_seeds.iter().zip(d_circulations) {
                sum += seeds.iter().zip(change).map(|(s, d)| s * d).sum::<f64>();
            }
            Ok::<_, PanelError>(sum)
        };
        let mut out = [[0.0; B]; B];
        for (k, row) in out.iter_mut().enumerate() {
            for (l, value) in row.iter_mut().enumerate() {
                *value = entry(k, l)?;
            }
        }
        Ok(out)
    }

    /// The transpose of [`drag_jvp`](Self::drag_jvp): adds to the seeds of points and circulations.
    pub fn drag_vjp<const B: usize>(
        &self,
        points: &[Vector3],
        circulations: &[Vec<f64>; B],
        seed: &[[f64; B]; B],
        point_seeds: &mut [Vector3],
        circulation_seeds: &mut [Vec<f64>; B],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<(), PanelError> {
        let seed: [[f64; B]; B] =
            std::array::from_fn(|k| std::array::from_fn(|l| 0.5 * (seed[k][l] + seed[l][k])));
        let gamma = self.vorticity(points, circulations);
        let mut gamma_seeds = vec![[0.0; B]; gamma.len()];
        let mut end_seeds = vec![[[0.0; 2]; 2]; gamma.len()];
        self.pairs(points, monitor, |i, j, integral, gradient| {
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
        })?;
        for (index, (piece, [a, b])) in self.elements(points).into_iter().enumerate() {
            let d = sub(b, a);
            let length = dot(d, d).sqrt();
            let mut of_length = 0.0;
            for k in 0..B {
                let of_rise = gamma_seeds[index][k] / length;
                of_length -= of_rise * gamma[index][k];
                for (terms, sign) in piece.circulations.iter().zip([-1.0, 1.0]) {
                    terms
                        .iter()
                        .for_each(|(end, f)| circulation_seeds[k][*end as usize] += sign * f * of_rise);
                }
            }
            for (side, sign) in [-1.0, 1.0].into_iter().enumerate() {
                let seed = &mut point_seeds[piece.ends[side] as usize];
                seed.y += end_seeds[index][side][0] + sign * of_length * d[0] / length;
                seed.z += end_seeds[index][side][1] + sign * of_length * d[1] / length;
            }
        }
        Ok(())
    }
}

fn value(terms: &Terms, circulation: &[f64]) -> f64 {
    terms.iter().map(|(end, factor)| factor * circulation[*end as usize]).sum()
}

#[cfg(test)]
mod tests {
    use moldline_testing::Wing;
    use num_dual::{Dual64, DualNum};

    use super::*;
    use crate::{NoMonitor, Options, PanelSetup};

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

    /// An elliptic circulation over a plane trace has the least drag, `(integral Gamma dy)^2 2 / (pi b^2)`; the error falls with the spacing, since
    /// its root at the tips is coarse for straight lines.
    #[test]
    fn elliptic_circulation() {
        let excess = [20, 40, 80].map(|along| {
            let mesh = Wing::rectangular(8, along).mesh();
            let setup = PanelSetup::new(&mesh, Options::default()).unwrap();
            let points = setup.panels.gather(&mesh.vertices);
            let gamma = |p: u32| (1.0 - (points[p as usize].y / 4.0).powi(2)).max(0.0).sqrt();
            let circulation: Vec<f64> =
                setup.wakes.strips.iter().flat_map(|s| [s.a, s.b]).map(gamma).collect();
            let lift = setup.trace.lift(&points, &circulation);
            let least = 2.0 * lift * lift / (std::f64::consts::PI * 64.0);
            setup.trace.drag(&points, &[circulation], &NoMonitor).unwrap()[0][0] / least - 1.0
        });
        // A straight line's drag is never below the least.
        assert!(excess.iter().all(|e| (0.0..0.05).contains(e)), "{excess:?}");
        assert!(excess[0] > 1.8 * excess[1] && excess[1] > 1.8 * excess[2], "{excess:?}");
    }
}
