//! Soft bisection (eq. 14 of the paper) of a scalar function `g(lambda)`, with its derivative.
//!
//! The bracket halves in every step whatever the indicator of equal signs says, so that the end is a smooth function of the
//! values of `g`. A hard bracket, which surely contains a root, goes along.

use crate::SeamOptions;

/// A bisection and its end.
pub(super) struct SoftBracket {
    /// The steps taken.
    pub steps: Vec<SoftStep>,
    /// The middle of the soft bracket at the end.
    pub lambda: f64,
    /// A bracket that contains a root, and `g` at its lower end.
    pub hard: [f64; 2],
    /// `g` at the lower end of the hard bracket.
    pub g_hard: f64,
}

/// One step: the soft bracket and `g` at its lower end before, the middle, and the indicator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SoftStep {
    bracket: [f64; 2],
    g_l: f64,
    m: f64,
    g_m: f64,
    same_side: f64,
}

impl SoftBracket {
    /// Bisects `bracket`, at whose lower end `g` is `g_lower`. `length` makes `g` dimensionless.
    pub fn eval(
        options: &SeamOptions,
        length: f64,
        [mut lower, mut upper]: [f64; 2],
        mut g_lower: f64,
        mut g: impl FnMut(f64) -> f64,
    ) -> Self {
        let mut steps = Vec::with_capacity(options.soft_steps);
        let (mut l, mut u, mut g_l) = (lower, upper, g_lower);
        for _ in 0..options.soft_steps {
            let m = 0.5 * (l + u);
            let g_m = g(m);
            if (g_m < 0.0) == (g_lower < 0.0) {
                (lower, g_lower) = (m, g_m);
            } else {
                upper = m;
            }
            // Soft indicator that `g` has the same sign at both places.
            let z = (g_l / length) * (g_m / length);
            let same_side = 0.5 * (1.0 + (options.eta * z).tanh());
            steps.push(SoftStep { bracket: [l, u], g_l, m, g_m, same_side });
            l += same_side * (m - l);
            u += (1.0 - same_side) * (m - u);
            g_l += same_side * (g_m - g_l);
        }
        Self { steps, lambda: 0.5 * (l + u), hard: [lower, upper], g_hard: g_lower }
    }
}

/// The derivative of the end with respect to each value of `g` that decided it: first that at the lower end of the bracket,
/// then those of the steps. `slopes` are `dg/dlambda` in the same order.
pub(super) fn derivative(steps: &[SoftStep], eta: f64, length: f64, slopes: &[f64]) -> Vec<f64> {
    let squared = length * length;
    let (mut by_l, mut by_u, mut by_g) = (0.5, 0.5, 0.0);
    let mut derivative = vec![0.0; steps.len() + 1];
    for (i, step) in steps.iter().enumerate().rev() {
        let SoftStep { bracket: [l, u], g_l, m, g_m, same_side: s } = *step;
        let by_s = by_l * (m - l) - by_u * (m - u) + by_g * (g_m - g_l);
        // d tanh: (1 + tanh z) / 2 = s has the derivative 2 s (1 - s).
        let by_z = by_s * 2.0 * eta * s * (1.0 - s) / squared;
        let by_g_m = by_g * s + by_z * g_l;
        derivative[i + 1] = by_g_m;
        let by_m = by_l * s + by_u * (1.0 - s) + by_g_m * slopes[i + 1];
        by_g = by_g * (1.0 - s) + by_z * g_m;
        by_l = by_l * (1.0 - s) + 0.5 * by_m;
        by_u = by_u * s + 0.5 * by_m;
    }
    derivative[0] = by_g;
    derivative
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_derivative_is_that_of_the_end() {
        let options = SeamOptions { soft_steps: 7, eta: 3.0, ..SeamOptions::default() };
        // The values of g on a parabola, the i-th one shifted by `shift[i]`.
        let run = |shift: &[f64; 8]| {
            let g = |lambda: f64| lambda * lambda - 0.3;
            let mut next = 1;
            SoftBracket::eval(&options, 2.0, [0.0, 1.0], g(0.0) + shift[0], |lambda| {
                next += 1;
                g(lambda) + shift[next - 1]
            })
        };
        let at = run(&[0.0; 8]);
        let slopes: Vec<f64> = std::iter::once(0.0).chain(at.steps.iter().map(|s| 2.0 * s.m)).collect();
        let derivative = derivative(&at.steps, options.eta, 2.0, &slopes);
        for i in 0..8 {
            let h = 1e-6;
            let [above, below] = [h, -h].map(|h| {
                let mut shift = [0.0; 8];
                shift[i] = h;
                run(&shift).lambda
            });
            let difference = (above - below) / (2.0 * h);
            assert!((derivative[i] - difference).abs() < 1e-9, "{i}: {} {difference}", derivative[i]);
        }
    }
}
