//! Tensor-product surfaces (eq. 1 of the paper for one patch), with first and second derivatives.
//!
//! The sums run over rows of constant `u` index: along each row the `v` functions combine the control points, then the
//! `u` functions combine the rows. Bilinear, mixed linear-cubic and bicubic patches have loops of fixed length.

use crate::rational::{Homogeneous, add_scaled, any_weight, first, second, value, xyz};
use crate::{KnotVector, MAX_DEGREE, Vector3};

/// A surface point with its first derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// The point `S`.
    pub position: Vector3,
    /// `S_u`.
    pub d_u: Vector3,
    /// `S_v`.
    pub d_v: Vector3,
}

/// A surface point with its first and second derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceJet {
    /// The point `S`.
    pub position: Vector3,
    /// `S_u`.
    pub d_u: Vector3,
    /// `S_v`.
    pub d_v: Vector3,
    /// `S_uu`.
    pub d_uu: Vector3,
    /// `S_uv`.
    pub d_uv: Vector3,
    /// `S_vv`.
    pub d_vv: Vector3,
}

/// A tensor-product basis; the control points, index `i n_v + j`, are passed to each evaluation.
#[derive(Debug, Clone, PartialEq)]
pub struct Surface {
    knots_u: KnotVector,
    knots_v: KnotVector,
    rational: bool,
}

impl Surface {
    /// A surface whose control points all have weight 1.
    pub fn new(knots_u: KnotVector, knots_v: KnotVector) -> Self {
        Self { knots_u, knots_v, rational: false }
    }

    /// A surface whose control points may have any positive weights.
    pub fn rational(knots_u: KnotVector, knots_v: KnotVector) -> Self {
        Self { knots_u, knots_v, rational: true }
    }

    /// Rational exactly if one of these control points has a weight other than 1.
    pub fn for_control_points(knots_u: KnotVector, knots_v: KnotVector, control_points: &[[f64; 4]]) -> Self {
        Self { knots_u, knots_v, rational: any_weight(control_points) }
    }

    /// Knots along `u`.
    pub fn knots_u(&self) -> &KnotVector {
        &self.knots_u
    }

    /// Knots along `v`.
    pub fn knots_v(&self) -> &KnotVector {
        &self.knots_v
    }

    /// Whether weights are taken into account.
    pub fn is_rational(&self) -> bool {
        self.rational
    }

    /// Numbers of control points along `u` and `v`.
    pub fn shape(&self) -> (usize, usize) {
        (self.knots_u.control_point_count(), self.knots_v.control_point_count())
    }

    /// The parameter rectangle: `[(u first, u last), (v first, v last)]`.
    pub fn domain(&self) -> [(f64, f64); 2] {
        [self.knots_u.domain(), self.knots_v.domain()]
    }

    /// The point at `(u, v)`, clamped to the domain. `control_points` has `n_u n_v` entries.
    #[inline]
    pub fn position(&self, control_points: &[[f64; 4]], u: f64, v: f64) -> Vector3 {
        let [p, ..] = self.sums::<0>(control_points, u, v);
        if self.rational { value(&p) } else { xyz(&p) }
    }

    /// The point with its first derivatives.
    #[inline]
    pub fn point(&self, control_points: &[[f64; 4]], u: f64, v: f64) -> SurfacePoint {
        let [p, a, b, ..] = self.sums::<1>(control_points, u, v);
        if self.rational {
            let position = value(&p);
            SurfacePoint { position, d_u: first(&p, &a, &position), d_v: first(&p, &b, &position) }
        } else {
            SurfacePoint { position: xyz(&p), d_u: xyz(&a), d_v: xyz(&b) }
        }
    }

    /// The point with its first and second derivatives.
    #[inline]
    pub fn jet(&self, control_points: &[[f64; 4]], u: f64, v: f64) -> SurfaceJet {
        let [p, a, b, aa, ab, bb] = self.sums::<2>(control_points, u, v);
        if self.rational {
            let s = value(&p);
            let s_a = first(&p, &a, &s);
            let s_b = first(&p, &b, &s);
            SurfaceJet {
                position: s,
                d_u: s_a,
                d_v: s_b,
                d_uu: second(&p, (&a, &s_a), (&a, &s_a), &aa, &s),
                d_uv: second(&p, (&a, &s_a), (&b, &s_b), &ab, &s),
                d_vv: second(&p, (&b, &s_b), (&b, &s_b), &bb, &s),
            }
        } else {
            SurfaceJet {
                position: xyz(&p),
                d_u: xyz(&a),
                d_v: xyz(&b),
                d_uu: xyz(&aa),
                d_uv: xyz(&ab),
                d_vv: xyz(&bb),
            }
        }
    }

    /// Homogeneous `S, S_u, S_v, S_uu, S_uv, S_vv`, as far as `ORDER` goes.
    #[inline]
    fn sums<const ORDER: usize>(&self, control_points: &[Homogeneous], u: f64, v: f64) -> [Homogeneous; 6] {
        const M: usize = MAX_DEGREE + 1;
        match (self.knots_u.degree(), self.knots_v.degree()) {
            (3, 3) => self.sums_fixed::<ORDER, 4, 4>(3, 3, control_points, u, v),
            (3, 1) => self.sums_fixed::<ORDER, 4, 2>(3, 1, control_points, u, v),
            (1, 3) => self.sums_fixed::<ORDER, 2, 4>(1, 3, control_points, u, v),
            (2, 2) => self.sums_fixed::<ORDER, 3, 3>(2, 2, control_points, u, v),
            (1, 1) => self.sums_fixed::<ORDER, 2, 2>(1, 1, control_points, u, v),
            (p, q) => self.sums_fixed::<ORDER, M, M>(p, q, control_points, u, v),
        }
    }

    #[inline(always)]
    fn sums_fixed<const ORDER: usize, const NU: usize, const NV: usize>(
        &self,
        p: usize,
        q: usize,
        control_points: &[Homogeneous],
        u: f64,
        v: f64,
    ) -> [Homogeneous; 6] {
        let n_v = self.knots_v.control_point_count();
        let (i0, bu) = self.knots_u.basis_fixed::<NU>(p, u, ORDER);
        let (j0, bv) = self.knots_v.basis_fixed::<NV>(q, v, ORDER);
        let mut sums = [[0.0; 4]; 6];
        for i in 0..=p {
            let start = (i0 + i) * n_v + j0;
            let row = &control_points[start..start + q + 1];
            let mut r = [[0.0; 4]; 3];
            for j in 0..=q {
                for k in 0..=ORDER {
                    add_scaled(&mut r[k], bv[k][j], &row[j]);
                }
            }
            add_scaled(&mut sums[0], bu[0][i], &r[0]);
            if ORDER >= 1 {
                add_scaled(&mut sums[1], bu[1][i], &r[0]);
                add_scaled(&mut sums[2], bu[0][i], &r[1]);
            }
            if ORDER >= 2 {
                add_scaled(&mut sums[3], bu[2][i], &r[0]);
                add_scaled(&mut sums[4], bu[1][i], &r[1]);
                add_scaled(&mut sums[5], bu[0][i], &r[2]);
            }
        }
        sums
    }
}
