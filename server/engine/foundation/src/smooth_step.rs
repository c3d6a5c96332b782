//! The quintic smooth step.

/// `t^3 (10 + t (6 t - 15))`: 0 at 0, 1 at 1, twice continuously differentiable when continued by these constants.
/// `t` is in 0..=1.
pub fn smooth_step(t: f64) -> f64 {
    t * t * t * (10.0 + t * (6.0 * t - 15.0))
}

#[cfg(test)]
mod tests {
    use super::smooth_step;

    #[test]
    fn ends_are_exact_and_flat() {
        assert_eq!([smooth_step(0.0), smooth_step(0.5), smooth_step(1.0)], [0.0, 0.5, 1.0]);
        let h = 1e-4;
        for (end, inwards) in [(0.0, h), (1.0, -h)] {
            let [a, b, c] = [end, end + inwards, end + 2.0 * inwards].map(smooth_step);
            assert!(((b - a) / h).abs() < 1e-6 && ((a - 2.0 * b + c) / (h * h)).abs() < 1e-2);
        }
    }
}
