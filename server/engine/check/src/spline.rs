//! Spline surfaces in any kind of number, from the definitions: the Cox-de Boor recurrence, derivatives of the basis from the
//! basis of one degree less, and the quotient rule for weights. Only the knots are shared with the evaluation under test.

use moldline_spline::{KnotVector, MAX_DEGREE, Surface};
use nalgebra::Vector3;
use num_dual::DualNum;

/// A kind of number in which a surface can be evaluated.
pub trait Number: DualNum<Primitive = f64> + nalgebra::Scalar + Copy {}

impl<T: DualNum<Primitive = f64> + nalgebra::Scalar + Copy> Number for T {}

const SIZE: usize = MAX_DEGREE + 1;

/// Position and derivatives of a surface.
#[derive(Clone, Copy, Debug)]
pub struct Jet<T> {
    /// `S`.
    pub position: Vector3<T>,
    /// `S_u` and `S_v`.
    pub first: [Vector3<T>; 2],
    /// `S_uu`, `S_uv` and `S_vv`.
    pub second: [Vector3<T>; 3],
}

/// Index `s` of the knot interval `t_s <= u < t_(s+1)` that contains a parameter.
fn span(knots: &KnotVector, u: f64) -> usize {
    let t = knots.knots();
    let last = knots.control_point_count();
    (knots.degree() + 1..last).rev().find(|&s| t[s] <= u && t[s] < t[s + 1]).unwrap_or_else(|| {
        // The first interval that is not empty.
        (knots.degree()..last).find(|&s| t[s] < t[s + 1]).unwrap_or(knots.degree())
    })
}

/// `N_(s-q), ..., N_s` of degree `q` at `u`.
fn values<T: Number>(t: &[f64], s: usize, q: usize, u: T) -> [T; SIZE] {
    let mut n = [T::from(0.0); SIZE];
    n[0] = T::from(1.0);
    for degree in 1..=q {
        // From N_(s-degree+1 ..= s) of one degree less.
        let mut next = [T::from(0.0); SIZE];
        for (k, value) in next.iter_mut().enumerate().take(degree + 1) {
            let i = s + k - degree;
            if k > 0 {
                *value += n[k - 1] * (u - t[i]) / (t[i + degree] - t[i]);
            }
            if k < degree {
                *value += n[k] * (-u + t[i + degree + 1]) / (t[i + degree + 1] - t[i + 1]);
            }
        }
        n = next;
    }
    n
}

/// Derivatives of `N_(s-q), ..., N_s` of degree `q` from those of degree `q - 1`.
fn derive<T: Number>(t: &[f64], s: usize, q: usize, lower: &[T; SIZE]) -> [T; SIZE] {
    let mut out = [T::from(0.0); SIZE];
    for (k, value) in out.iter_mut().enumerate().take(q + 1) {
        let i = s + k - q;
        if k > 0 {
            *value += lower[k - 1] * (q as f64 / (t[i + q] - t[i]));
        }
        if k < q {
            *value -= lower[k] * (q as f64 / (t[i + q + 1] - t[i + 1]));
        }
    }
    out
}

/// First index, and the functions with their derivatives up to the second.
fn basis<T: Number>(knots: &KnotVector, u: T, order: usize) -> (usize, [[T; SIZE]; 3]) {
    let (p, t) = (knots.degree(), knots.knots());
    let s = span(knots, u.re());
    let mut all = [[T::from(0.0); SIZE]; 3];
    all[0] = values(t, s, p, u);
    if order >= 1 {
        all[1] = derive(t, s, p, &values(t, s, p - 1, u));
    }
    if order >= 2 && p >= 2 {
        all[2] = derive(t, s, p, &derive(t, s, p - 1, &values(t, s, p - 2, u)));
    }
    (s - p, all)
}

/// A surface with homogeneous control points `[w x, w y, w z, w]` at a pair of parameters, with derivatives up to `order`;
/// those of higher order are zero. Parameters are not clamped: beyond a side the outermost polynomial continues.
pub fn jet<T: Number>(surface: &Surface, points: &[[T; 4]], u: T, v: T, order: usize) -> Jet<T> {
    let (p, q) = (surface.knots_u().degree(), surface.knots_v().degree());
    let columns = surface.knots_v().control_point_count();
    let (i0, in_u) = basis(surface.knots_u(), u, order);
    let (j0, in_v) = basis(surface.knots_v(), v, order);
    // sums[a][b]: derivative a times along u and b times along v.
    let mut sums = [[[T::from(0.0); 4]; 3]; 3];
    for i in 0..=p {
        let row = &points[(i0 + i) * columns + j0..][..q + 1];
        let mut along_v = [[T::from(0.0); 4]; 3];
        for (j, point) in row.iter().enumerate() {
            for b in 0..=order {
                for d in 0..4 {
                    along_v[b][d] += point[d] * in_v[b][j];
                }
            }
        }
        for a in 0..=order {
            for b in 0..=order - a {
                for d in 0..4 {
                    sums[a][b][d] += along_v[b][d] * in_u[a][i];
                }
            }
        }
    }
    let xyz = |a: usize, b: usize| Vector3::new(sums[a][b][0], sums[a][b][1], sums[a][b][2]);
    let weight = |a: usize, b: usize| sums[a][b][3];
    let over = |x: Vector3<T>| x.map(|x| x / weight(0, 0));
    let times = |x: &Vector3<T>, w: T| x.map(|x| x * w);
    let position = over(xyz(0, 0));
    if !surface.is_rational() {
        return Jet {
            position: xyz(0, 0),
            first: [xyz(1, 0), xyz(0, 1)],
            second: [xyz(2, 0), xyz(1, 1), xyz(0, 2)],
        };
    }
    let d_u = over(xyz(1, 0) - times(&position, weight(1, 0)));
    let d_v = over(xyz(0, 1) - times(&position, weight(0, 1)));
    let two = T::from(2.0);
    let second = [
        over(xyz(2, 0) - times(&d_u, two * weight(1, 0)) - times(&position, weight(2, 0))),
        over(
            xyz(1, 1)
                - times(&d_v, weight(1, 0))
                - times(&d_u, weight(0, 1))
                - times(&position, weight(1, 1)),
        ),
        over(xyz(0, 2) - times(&d_v, two * weight(0, 1)) - times(&position, weight(0, 2))),
    ];
    Jet { position, first: [d_u, d_v], second }
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_dual::Dual64;

    /// A quarter of a torus: circle of radius 1 about the z axis at distance 3, both exact in rational quadratics.
    fn torus() -> (Surface, Vec<[f64; 4]>) {
        let knots = || KnotVector::new(2, vec![0.0, 0.0, 0.0, 1.0, 1.0, 1.0]).unwrap();
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let arc = [([1.0, 0.0], 1.0), ([1.0, 1.0], half), ([0.0, 1.0], 1.0)];
        let mut points = Vec::new();
        for ([c, s], w) in arc {
            for ([a, b], z) in arc {
                let radius = 3.0 + a;
                points.push([w * z * radius * c, w * z * radius * s, w * z * b, w * z]);
            }
        }
        (Surface::rational(knots(), knots()), points)
    }

    #[test]
    fn a_torus_is_a_torus() {
        let (surface, points) = torus();
        for (u, v) in [(0.0, 0.0), (0.3, 0.8), (1.0, 0.5), (1.0, 1.0)] {
            let x = jet(&surface, &points, u, v, 0).position;
            let around = x.x.hypot(x.y) - 3.0;
            assert!((around.hypot(x.z) - 1.0).abs() < 1e-15);
        }
    }

    #[test]
    fn derivatives_are_those_that_dual_parameters_carry() {
        let (surface, points) = torus();
        let points: Vec<[Dual64; 4]> = points.iter().map(|p| p.map(Dual64::from_re)).collect();
        let cubic = KnotVector::new(3, vec![0.0, 0.0, 0.0, 0.0, 0.4, 1.0, 1.0, 1.0, 1.0]).unwrap();
        let linear = KnotVector::new(1, vec![0.0, 0.0, 0.5, 1.0, 1.0]).unwrap();
        let polynomial = Surface::new(cubic, linear);
        let net: Vec<[Dual64; 4]> = (0..15)
            .map(|k| {
                let (i, j) = (f64::from(k / 3), f64::from(k % 3));
                [i + 0.1 * j * j, j - 0.2 * i * i, (i * j).sin(), 1.0].map(Dual64::from_re)
            })
            .collect();
        for (surface, points) in [(&surface, &points), (&polynomial, &net)] {
            for direction in 0..2 {
                let mut at = [0.37, 0.61].map(Dual64::from_re);
                at[direction] = at[direction].derivative();
                let j = jet(surface, points, at[0], at[1], 2);
                for axis in 0..3 {
                    let first = [j.first[0][axis].re, j.first[1][axis].re];
                    let second = [j.second[0][axis].re, j.second[1][axis].re, j.second[2][axis].re];
                    assert!((j.position[axis].eps - first[direction]).abs() < 1e-13);
                    for other in 0..2 {
                        let expected = second[direction + other];
                        assert!((j.first[other][axis].eps - expected).abs() < 1e-12);
                    }
                }
            }
        }
    }
}
