//! Gauss and Legendre's quadrature on [-1, 1]: with `n` nodes exact for polynomials of degree `2 n - 1`.

/// Nodes and weights for `n = 2`.
pub const GAUSS_2: [(f64, f64); 2] = [(-0.577_350_269_189_625_8, 1.0), (0.577_350_269_189_625_8, 1.0)];

/// Nodes and weights for `n = 4`.
pub const GAUSS_4: [(f64, f64); 4] = [
    (-0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
    (-0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
    (0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
    (0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
];

/// Nodes, largest first, and weights for any `n`: the roots of the Legendre polynomial by Newton's method.
pub fn gauss_legendre(n: usize) -> Vec<(f64, f64)> {
    (0..n)
        .map(|i| {
            let mut x = (std::f64::consts::PI * (i as f64 + 0.75) / (n as f64 + 0.5)).cos();
            let mut slope = 1.0;
            for _ in 0..20 {
                let (mut p, mut before) = (1.0, 0.0);
                for k in 1..=n {
                    let k = k as f64;
                    (p, before) = (((2.0 * k - 1.0) * x * p - (k - 1.0) * before) / k, p);
                }
                slope = n as f64 * (x * p - before) / (x * x - 1.0);
                let step = p / slope;
                x -= step;
                if step.abs() < 1e-16 {
                    break;
                }
            }
            (x, 2.0 / ((1.0 - x * x) * slope * slope))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rule_integrates_its_polynomials() {
        for n in 1..=16 {
            let rule = gauss_legendre(n);
            for degree in 0..2 * n {
                let sum: f64 = rule.iter().map(|(x, w)| w * x.powi(degree as i32)).sum();
                let exact = if degree % 2 == 0 { 2.0 / (degree as f64 + 1.0) } else { 0.0 };
                assert!((sum - exact).abs() < 1e-13, "{n} points, degree {degree}: {sum} {exact}");
            }
        }
    }

    #[test]
    fn the_tables_are_those_of_the_formula() {
        for table in [&GAUSS_2[..], &GAUSS_4] {
            for ((x, w), (y, v)) in table.iter().zip(gauss_legendre(table.len()).iter().rev()) {
                assert!((x - y).abs() < 1e-15 && (w - v).abs() < 1e-15, "({x}, {w}) against ({y}, {v})");
            }
        }
    }
}
