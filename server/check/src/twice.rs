//! Numbers with twice the digits of a double, as the unevaluated sum of two (Dekker, A floating-point technique for
//! extending the available precision, Numerische Mathematik 18, 1971).

use std::ops::{Add, Mul, Sub};

/// `leading + rest`, the rest being no more than half a unit in the last place of the leading part.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twice {
    /// The number, rounded.
    pub leading: f64,
    /// What is rounded off.
    pub rest: f64,
}

/// `a + b` without rounding.
#[inline]
pub fn sum(a: f64, b: f64) -> Twice {
    let leading = a + b;
    let part = leading - a;
    Twice { leading, rest: (a - (leading - part)) + (b - part) }
}

/// The upper and the lower half of the digits.
#[inline]
pub fn halves(a: f64) -> [f64; 2] {
    let shifted = 134_217_729.0 * a;
    let upper = shifted - (shifted - a);
    [upper, a - upper]
}

/// What is rounded off in `product = a b`, of which the halves are given.
#[inline]
pub fn rounded_off(product: f64, [a, b]: [f64; 2], [c, d]: [f64; 2]) -> f64 {
    ((a * c - product) + a * d + b * c) + b * d
}

impl Twice {
    /// The square root of a number that is not negative.
    pub fn sqrt(self) -> Self {
        let root = self.leading.sqrt();
        if root == 0.0 {
            return Self::default();
        }
        let square = Self::from(root) * Self::from(root);
        sum(root, (self - square).leading / (2.0 * root))
    }
}

impl From<f64> for Twice {
    fn from(leading: f64) -> Self {
        Self { leading, rest: 0.0 }
    }
}

impl Add for Twice {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let (a, b) = (sum(self.leading, other.leading), sum(self.rest, other.rest));
        let first = sum(a.leading, a.rest + b.leading);
        sum(first.leading, first.rest + b.rest)
    }
}

impl Sub for Twice {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self + Self { leading: -other.leading, rest: -other.rest }
    }
}

impl Mul for Twice {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let product = self.leading * other.leading;
        let off = rounded_off(product, halves(self.leading), halves(other.leading));
        sum(product, off + (self.leading * other.rest + self.rest * other.leading))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Integers of 106 bits, exact.
    fn integer(x: Twice) -> i128 {
        x.leading as i128 + x.rest as i128
    }

    #[test]
    fn digits_are_kept() {
        let (a, b) = (9_007_199_254_740_991.0, 6_369_051_672_525_773.0);
        assert_eq!(integer(Twice::from(a) * Twice::from(b)), a as i128 * b as i128);
        let large = sum(1e30, 1.0) + sum(3.0, 2_f64.powi(-40));
        assert_eq!(large - Twice::from(1e30), sum(4.0, 2_f64.powi(-40)));
        for x in [2.0, 3.0, 1e-3, 7e5] {
            let root = Twice::from(x).sqrt();
            let off = root * root - Twice::from(x);
            assert!(off.leading.abs() < 1e-31 * x, "{off:?}");
        }
        assert_eq!(Twice::from(0.0).sqrt(), Twice::default());
    }
}
