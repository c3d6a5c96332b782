//! Double-double arithmetic: numbers with twice the digits of a double, as the unevaluated sum of two (Dekker, A floating-point
//! technique for extending the available precision, Numerische Mathematik 18, 1971).

use std::ops::{Add, Mul, Sub};

/// `high + low`, the low part being no more than half a unit in the last place of the high one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DoubleDouble {
    /// The number, rounded to a double.
    pub high: f64,
    /// What that rounds off.
    pub low: f64,
}

/// `a + b` without rounding (Knuth's TwoSum).
#[inline]
pub fn two_sum(a: f64, b: f64) -> DoubleDouble {
    let high = a + b;
    let part = high - a;
    DoubleDouble { high, low: (a - (high - part)) + (b - part) }
}

/// Veltkamp's split: `a` as the sum of two numbers of half its digits, whose products are exact.
#[inline]
pub fn split(a: f64) -> [f64; 2] {
    let shifted = 134_217_729.0 * a;
    let high = shifted - (shifted - a);
    [high, a - high]
}

/// What is rounded off in `product = a b` (Dekker's TwoProduct), from the [`split`] factors.
#[inline]
pub fn product_error(product: f64, [a, b]: [f64; 2], [c, d]: [f64; 2]) -> f64 {
    ((a * c - product) + a * d + b * c) + b * d
}

impl DoubleDouble {
    /// The square root of a number that is not negative.
    pub fn sqrt(self) -> Self {
        let root = self.high.sqrt();
        if root == 0.0 {
            return Self::default();
        }
        let square = Self::from(root) * Self::from(root);
        two_sum(root, (self - square).high / (2.0 * root))
    }
}

impl From<f64> for DoubleDouble {
    fn from(high: f64) -> Self {
        Self { high, low: 0.0 }
    }
}

impl Add for DoubleDouble {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let (a, b) = (two_sum(self.high, other.high), two_sum(self.low, other.low));
        let first = two_sum(a.high, a.low + b.high);
        two_sum(first.high, first.low + b.low)
    }
}

impl Sub for DoubleDouble {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self + Self { high: -other.high, low: -other.low }
    }
}

impl Mul for DoubleDouble {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let product = self.high * other.high;
        let off = product_error(product, split(self.high), split(other.high));
        two_sum(product, off + (self.high * other.low + self.low * other.high))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Integers of 106 bits, exact.
    fn integer(x: DoubleDouble) -> i128 {
        x.high as i128 + x.low as i128
    }

    #[test]
    fn digits_are_kept() {
        let (a, b) = (9_007_199_254_740_991.0, 6_369_051_672_525_773.0);
        assert_eq!(integer(DoubleDouble::from(a) * DoubleDouble::from(b)), a as i128 * b as i128);
        let large = two_sum(1e30, 1.0) + two_sum(3.0, 2_f64.powi(-40));
        assert_eq!(large - DoubleDouble::from(1e30), two_sum(4.0, 2_f64.powi(-40)));
        for x in [2.0, 3.0, 1e-3, 7e5] {
            let root = DoubleDouble::from(x).sqrt();
            let off = root * root - DoubleDouble::from(x);
            assert!(off.high.abs() < 1e-31 * x, "{off:?}");
        }
        assert_eq!(DoubleDouble::from(0.0).sqrt(), DoubleDouble::default());
    }
}
