//! The B-spline basis by the Cox-de Boor recurrence, with derivatives from the bases of lower degree.
//!
//! The divisors of the recurrence do not depend on the parameter, so their reciprocals are stored per interval. Values then take
//! additions and multiplications of non-negative numbers only, which is stable for every degree.

use crate::KnotVector;

/// The highest degree supported.
pub const MAX_DEGREE: usize = 9;

/// The non-vanishing basis functions at a parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Basis {
    /// Index of the first function.
    pub first: usize,
    /// Number of functions: degree + 1.
    pub count: usize,
    /// Values, first and second derivatives; entries from `count` on are zero.
    pub values: [[f64; MAX_DEGREE + 1]; 3],
}

impl Basis {
    /// The functions' values.
    #[inline]
    pub fn value(&self) -> &[f64] {
        &self.values[0][..self.count]
    }

    /// The functions' derivatives of the given order (0, 1, 2).
    #[inline]
    pub fn derivative(&self, order: usize) -> &[f64] {
        &self.values[order][..self.count]
    }
}

impl KnotVector {
    /// The basis at `u` (clamped to the domain) with derivatives up to the given order, at most 2; those of higher order
    /// are zero.
    #[inline]
    pub fn basis(&self, u: f64, derivatives: usize) -> Basis {
        let (first, values) = match self.degree() {
            1 => widen(self.basis_fixed::<2>(1, u, derivatives)),
            2 => widen(self.basis_fixed::<3>(2, u, derivatives)),
            3 => widen(self.basis_fixed::<4>(3, u, derivatives)),
            p => self.basis_fixed::<{ MAX_DEGREE + 1 }>(p, u, derivatives),
        };
        Basis { first, count: self.degree() + 1, values }
    }

    /// First function and values in arrays of length `N >= p + 1`. `p` is the degree, passed as a literal where it is
    /// known, so that the loops unroll.
    #[inline(always)]
    pub(crate) fn basis_fixed<const N: usize>(
        &self,
        p: usize,
        u: f64,
        derivatives: usize,
    ) -> (usize, [[f64; N]; 3]) {
        let (a, b) = self.domain();
        let u = u.clamp(a, b);
        let interval = self.interval(u);
        let s = self.span_of_interval(interval);
        let inverse = self.reciprocals(interval);
        let knots = &self.knots()[s + 1 - p..s + 1 + p];
        let mut left = [0.0; N];
        let mut right = [0.0; N];
        for j in 0..p {
            left[j] = u - knots[p - 1 - j];
            right[j] = knots[p + j] - u;
        }

        let mut values = [[0.0; N]; 3];
        // Bases of degree p - 1 and p - 2, from which the derivatives follow.
        let mut lower = [0.0; N];
        let mut lowest = [0.0; N];
        let mut n = [0.0; N];
        n[0] = 1.0;
        let mut row = 0;
        for j in 1..=p {
            if j == p {
                lower = n;
            }
            if j + 1 == p {
                lowest = n;
            }
            let mut saved = 0.0;
            for r in 0..j {
                let t = n[r] * inverse[row + r];
                n[r] = saved + right[r] * t;
                saved = left[j - 1 - r] * t;
            }
            n[j] = saved;
            row += j;
        }
        values[0] = n;

        let top = p * (p - 1) / 2;
        if derivatives >= 1 {
            values[1] = differences::<N>(p, &lower, &inverse[top..]);
        }
        if derivatives >= 2 && p >= 2 {
            let below = (p - 1) * (p - 2) / 2;
            let d = differences::<N>(p - 1, &lowest, &inverse[below..]);
            values[2] = differences::<N>(p, &d, &inverse[top..]);
        }
        (s - p, values)
    }
}

/// Derivatives of the functions of degree `p` from (derivatives of) those of degree `p - 1`.
#[inline(always)]
fn differences<const N: usize>(p: usize, lower: &[f64; N], inverse: &[f64]) -> [f64; N] {
    let mut out = [0.0; N];
    let mut previous = 0.0;
    for r in 0..p {
        let t = p as f64 * lower[r] * inverse[r];
        out[r] = previous - t;
        previous = t;
    }
    out[p] = previous;
    out
}

fn widen<const N: usize>((first, narrow): (usize, [[f64; N]; 3])) -> (usize, [[f64; MAX_DEGREE + 1]; 3]) {
    let mut wide = [[0.0; MAX_DEGREE + 1]; 3];
    for k in 0..3 {
        wide[k][..N].copy_from_slice(&narrow[k]);
    }
    (first, wide)
}
