//! The basis at a point: how control points enter a surface point and its first derivatives at fixed parameters
//! (`dS = N dC`, `dJ = N' dC`; `docs/derivation.md`, section 1).

use crate::block::{Block, add_row};
use crate::body::Body;
use crate::location::Location;
use moldline_spline::Basis;

/// The weights with which the control points of a component enter `S`, `S_u` and `S_v` at one location.
///
/// The weights of rational patches are fixed, and internal tangents and seeds of control points are homogeneous:
/// `dS = sum_i N_i dP_i / W`, `W = sum_i N_i w_i`.
#[derive(Debug, Clone, Copy)]
pub struct PointBasis {
    u: Basis,
    v: Basis,
    /// Internal index of the first control point of the patch, and the number of control points per row.
    start: usize,
    stride: usize,
    /// `1 / W`, `W_u / W`, `W_v / W`.
    weight: [f64; 3],
}

impl Body {
    /// The weights of the control points at a location.
    pub fn basis(&self, l: &Location) -> PointBasis {
        let patch = &self.component().patches()[l.patch as usize];
        let (knots_u, knots_v) = (patch.surface.knots_u(), patch.surface.knots_v());
        let mut basis = PointBasis {
            u: knots_u.basis(l.u, 1),
            v: knots_v.basis(l.v, 1),
            start: patch.range.start,
            stride: knots_v.control_point_count(),
            weight: [1.0, 0.0, 0.0],
        };
        if patch.surface.is_rational() {
            let mut sums = [0.0; 3];
            basis.for_each(|i, weights| {
                let w = self.control_points()[i][3];
                sums.iter_mut().zip(weights).for_each(|(sum, n)| *sum += n * w);
            });
            basis.weight = [1.0 / sums[0], sums[1] / sums[0], sums[2] / sums[0]];
        }
        basis
    }
}

impl PointBasis {
    /// Calls `f(i, [N, N_u, N_v])` for every internal control point in the support.
    #[inline]
    fn for_each(&self, mut f: impl FnMut(usize, [f64; 3])) {
        let [inverse, ratio_u, ratio_v] = self.weight;
        let (u, v) = (&self.u, &self.v);
        for i in 0..u.count {
            let row = self.start + (u.first + i) * self.stride + v.first;
            for j in 0..v.count {
                let n = u.values[0][i] * v.values[0][j];
                let n_u = u.values[1][i] * v.values[0][j];
                let n_v = u.values[0][i] * v.values[1][j];
                f(row + j, [n * inverse, (n_u - ratio_u * n) * inverse, (n_v - ratio_v * n) * inverse]);
            }
        }
    }

    /// Adds `dS` at fixed parameters to `out`; `tangents` are those of the internal control points.
    #[inline]
    pub fn position_jvp(&self, tangents: &Block, out: &mut [f64]) {
        self.for_each(|i, [n, ..]| add_row(out, n, tangents.row(i)));
    }

    /// Adds the seeds of the control points for a seed of `S`.
    #[inline]
    pub fn position_vjp(&self, seed: &[f64], seeds: &mut Block) {
        self.for_each(|i, [n, ..]| add_row(seeds.row_mut(i), n, seed));
    }

    /// Adds `dS`, `dS_u`, `dS_v` at fixed parameters to the three rows of `out`.
    #[inline]
    pub fn point_jvp(&self, tangents: &Block, out: &mut Block) {
        self.for_each(|i, weights| {
            let tangent = tangents.row(i);
            weights.iter().enumerate().for_each(|(k, n)| add_row(out.row_mut(k), *n, tangent));
        });
    }

    /// Adds the seeds of the control points for seeds of `S`, `S_u`, `S_v`, the three rows of `seed`.
    #[inline]
    pub fn point_vjp(&self, seed: &Block, seeds: &mut Block) {
        self.for_each(|i, weights| {
            let to = seeds.row_mut(i);
            weights.iter().enumerate().for_each(|(k, n)| add_row(to, *n, seed.row(k)));
        });
    }
}
