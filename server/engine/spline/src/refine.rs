//! Exact changes of basis through the blossom (polar form): Bezier extraction, knot insertion, clamping.
//!
//! A control point of a spline of degree `p` is the value of its blossom `f(t_(i+1), ..., t_(i+p))` on one of its
//! polynomial pieces. So the control points over a finer knot vector, and the Bezier points `f(a, .., a, b, .., b)`, are
//! blossom values of the original pieces: rows of a sparse matrix with at most `p + 1` entries.

use crate::{KnotVector, MAX_DEGREE};

/// A row of a change of basis: the new control point is the sum of `weights[k]` times the old one `first + k`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinearRow {
    /// First old control point.
    pub first: usize,
    /// Number of weights: degree + 1.
    pub count: usize,
    /// The weights; they add up to 1.
    pub weights: [f64; MAX_DEGREE + 1],
}

impl KnotVector {
    /// The blossom of the piece over `interval` at `p` arguments, as weights on the piece's control points.
    ///
    /// # Panics
    /// If `arguments` does not have `degree` entries.
    pub fn blossom(&self, interval: usize, arguments: &[f64]) -> LinearRow {
        let p = self.degree();
        assert_eq!(arguments.len(), p, "a blossom has as many arguments as the degree");
        let s = self.span_of_interval(interval);
        let t = self.knots();
        // At the knots of a control point of this piece the blossom is that control point, exactly.
        if let Some(r) = (0..=p).find(|&r| t[s - p + r + 1..=s + r] == *arguments) {
            let mut weights = [0.0; MAX_DEGREE + 1];
            weights[r] = 1.0;
            return LinearRow { first: s - p, count: p + 1, weights };
        }
        // The recurrence of the basis, with another parameter at each level.
        let mut n = [0.0; MAX_DEGREE + 1];
        n[0] = 1.0;
        for j in 1..=p {
            let u = arguments[j - 1];
            let mut saved = 0.0;
            for r in 0..j {
                let (lo, hi) = (t[s + 1 + r - j], t[s + r + 1]);
                let value = n[r];
                n[r] = saved + (hi - u) / (hi - lo) * value;
                saved = (u - lo) / (hi - lo) * value;
            }
            n[j] = saved;
        }
        LinearRow { first: s - p, count: p + 1, weights: n }
    }

    /// The `p + 1` Bezier points of an interval, from its control points.
    pub fn bezier(&self, interval: usize) -> Vec<LinearRow> {
        let p = self.degree();
        let (a, b) = (self.breaks()[interval], self.breaks()[interval + 1]);
        (0..=p)
            .map(|k| {
                let arguments: Vec<f64> = (0..p).map(|i| if i < p - k { a } else { b }).collect();
                self.blossom(interval, &arguments)
            })
            .collect()
    }

    /// Knot insertion: the control points of the same spline over `finer`, whose domain lies in this one's, and which has
    /// all knots of this one inside its domain with at least their multiplicity.
    pub fn refinement(&self, finer: &KnotVector) -> Vec<LinearRow> {
        let p = self.degree();
        debug_assert_eq!(p, finer.degree());
        let (a, b) = finer.domain();
        let tau = finer.knots();
        (0..finer.control_point_count())
            .map(|i| {
                // A non-empty interval of the finer domain on which the new basis function lives.
                let k = (i..=i + p)
                    .filter(|&k| tau[k] < tau[k + 1] && tau[k] >= a && tau[k + 1] <= b)
                    .min_by_key(|&k| (2 * k).abs_diff(2 * i + p))
                    .unwrap_or(finer.span(0.5 * (a + b)));
                self.blossom(self.interval(0.5 * (tau[k] + tau[k + 1])), &tau[i + 1..=i + p])
            })
            .collect()
    }

    /// The knot vector of the piece over `[a, b]` (both in the domain), clamped at both ends.
    pub fn clamped_piece(&self, a: f64, b: f64) -> KnotVector {
        let p = self.degree();
        let inner = self.knots().iter().copied().filter(|&t| t > a && t < b);
        let knots = std::iter::repeat_n(a, p + 1).chain(inner).chain(std::iter::repeat_n(b, p + 1)).collect();
        KnotVector::from_valid(p, knots)
    }
}
