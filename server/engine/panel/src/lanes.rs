//! Numbers for several points at once, in the vectors of the processor, and elementary functions of them without branches.
//!
//! Only IEEE additions, multiplications, divisions, square roots, comparisons and bit operations: the same bits on every
//! processor and with every vector width.

use std::{
    f64::consts::{FRAC_PI_2, FRAC_PI_4, LN_2, PI},
    ops::{Add, Div, Mul, Neg, Sub},
};

use pulp::{Simd, bytemuck::cast_slice_mut};

/// Points that are handled at once.
pub(crate) const LANES: usize = 8;

/// One number for each of them.
pub(crate) type Lane = [f64; LANES];

/// `atan(sqrt w) / sqrt w` for `w <= tan^2(pi/8)`: interpolation at Chebyshev nodes, relative error 7e-17.
const ARC_TANGENT: [f64; 11] = [
    1.0,
    -0.33333333333328435,
    0.19999999998854168,
    -0.14285714180900647,
    0.11111106177375227,
    -0.09090773003240828,
    0.07689952488233016,
    -0.066402251735395,
    0.0568830340363325,
    -0.04347919839046537,
    0.021133752033748364,
];

/// `atanh(sqrt w) / sqrt w` for `w <= 0.0402`: likewise, 3e-17.
const AREA_TANGENT: [f64; 8] = [
    1.0,
    0.3333333333333784,
    0.19999999997649623,
    0.1428571475222002,
    0.1111106572671427,
    0.09093299439357387,
    0.07622970364396756,
    0.07698923670596138,
];

/// A vector of numbers: as many as the processor handles at once.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wide<S: Simd>(S, S::f64s);

macro_rules! operator {
    ($operator: ident, $name: ident, $simd: ident) => {
        impl<S: Simd> $operator for Wide<S> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self(self.0, self.0.$simd(self.1, other.1))
            }
        }

        impl<S: Simd> $operator<f64> for Wide<S> {
            type Output = Self;

            #[inline(always)]
            fn $name(self, other: f64) -> Self {
                Self(self.0, self.0.$simd(self.1, self.0.splat_f64s(other)))
            }
        }
    };
}

operator!(Add, add, add_f64s);
operator!(Sub, sub, sub_f64s);
operator!(Mul, mul, mul_f64s);
operator!(Div, div, div_f64s);

impl<S: Simd> Neg for Wide<S> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self(self.0, self.0.neg_f64s(self.1))
    }
}

impl<S: Simd> Wide<S> {
    /// Vectors in a lane.
    pub const PARTS: usize = LANES / S::F64_LANES;

    #[inline(always)]
    pub fn splat(simd: S, value: f64) -> Self {
        Self(simd, simd.splat_f64s(value))
    }

    /// The numbers of a lane, part by part.
    #[inline(always)]
    pub fn load(simd: S, lane: &Lane, part: usize) -> Self {
        Self(simd, S::as_simd_f64s(lane).0[part])
    }

    #[inline(always)]
    pub fn store(self, lane: &mut Lane, part: usize) {
        S::as_mut_simd_f64s(lane).0[part] = self.1;
    }

    #[inline(always)]
    pub fn sqrt(self) -> Self {
        Self(self.0, self.0.sqrt_f64s(self.1))
    }

    #[inline(always)]
    fn abs(self) -> Self {
        Self(self.0, self.0.abs_f64s(self.1))
    }

    /// `then` where self is less than the other, else `otherwise`.
    #[inline(always)]
    fn if_less(self, other: Self, then: Self, otherwise: Self) -> Self {
        let mask = self.0.less_than_f64s(self.1, other.1);
        Self(self.0, self.0.select_f64s(mask, then.1, otherwise.1))
    }

    /// The number with the sign of another.
    #[inline(always)]
    fn with_sign_of(self, other: Self) -> Self {
        let sign = self.0.and_f64s(other.1, self.0.splat_f64s(-0.0));
        Self(self.0, self.0.or_f64s(sign, self.1))
    }

    #[inline(always)]
    fn polynomial<const N: usize>(self, coefficients: &[f64; N]) -> Self {
        let mut value = Self::splat(self.0, coefficients[N - 1]);
        let mut k = N - 1;
        while k > 0 {
            k -= 1;
            value = value * self + coefficients[k];
        }
        value
    }

    /// `atan2(self, x)`; 0 at the origin.
    #[inline(always)]
    pub fn argument(self, x: Self) -> Self {
        const TAN_PI_8: f64 = 0.414_213_562_373_095_03;
        let (zero, one) = (Self::splat(self.0, 0.0), Self::splat(self.0, 1.0));
        let (ay, ax) = (self.abs(), x.abs());
        let low = ax.if_less(ay, ax, ay);
        let high = ax.if_less(ay, ay, ax);
        let bound = high * TAN_PI_8;
        let numerator = bound.if_less(low, low - high, low);
        let denominator = bound.if_less(low, low + high, high);
        let t = numerator / zero.if_less(denominator, denominator, one);
        let part = t * (t * t).polynomial(&ARC_TANGENT);
        let octant = bound.if_less(low, part + FRAC_PI_4, part);
        let quadrant = ax.if_less(ay, -octant + FRAC_PI_2, octant);
        let half = x.if_less(zero, -quadrant + PI, quadrant);
        half.with_sign_of(self)
    }

    /// `ln((self + l) / (self - l))` for `0 <= l < self`, to full relative accuracy for small `l / self` too.
    ///
    /// With `2^k` the power of two nearest to the ratio, it is `k ln 2 + 2 atanh(t)`, `t = (n 2^-k - m) / (n 2^-k + m)`, `n, m = self +- l`.
    #[inline(always)]
    pub fn log_ratio(self, l: f64) -> Self {
        /// Added to the difference of exponents so that it stays positive.
        const BIAS: u64 = 1024;
        /// Exponent and sign of a number.
        const EXPONENT: u64 = 0xfff0_0000_0000_0000;
        /// `2^52`, whose last bits are whole numbers.
        const INTEGER: u64 = 0x4330_0000_0000_0000;
        let simd = self.0;
        let (n, m) = (self + l, self - l);
        let difference = simd.sub_u64s(simd.transmute_u64s_f64s(n.1), simd.transmute_u64s_f64s(m.1));
        let rounded = simd.add_u64s(difference, simd.splat_u64s((BIAS << 52) + (1 << 51)));
        // k as an exponent, and as a number.
        let exponent = simd.and_u64s(rounded, simd.splat_u64s(EXPONENT));
        let power = Self(
            simd,
            simd.transmute_f64s_u64s(simd.sub_u64s(simd.splat_u64s((BIAS + 1023) << 52), exponent)),
        );
        let whole = simd.or_u64s(whole::<S>(exponent), simd.splat_u64s(INTEGER));
        let k = Self(simd, simd.transmute_f64s_u64s(whole)) - (4_503_599_627_370_496.0 + BIAS as f64);
        let numerator = self * (power - 1.0) + (power + 1.0) * l;
        let denominator = self * (power + 1.0) + (power - 1.0) * l;
        let t = numerator / denominator;
        k * LN_2 + t * 2.0 * (t * t).polynomial(&AREA_TANGENT)
    }
}

/// Exponents as whole numbers.
#[inline(always)]
fn whole<S: Simd>(mut exponents: S::u64s) -> S::u64s {
    let each: &mut [u64] = cast_slice_mut(std::slice::from_mut(&mut exponents));
    each.iter_mut().for_each(|bits| *bits >>= 52);
    exponents
}

#[cfg(test)]
mod tests {
    use super::*;

    /// With every vector width of the processor: the same bits.
    fn argument(y: f64, x: f64) -> f64 {
        struct Argument(f64, f64);
        impl pulp::WithSimd for Argument {
            type Output = f64;

            fn with_simd<S: Simd>(self, simd: S) -> f64 {
                let mut out = [0.0; LANES];
                Wide::splat(simd, self.0).argument(Wide::splat(simd, self.1)).store(&mut out, 0);
                out[0]
            }
        }
        let widest = pulp::Arch::new().dispatch(Argument(y, x));
        let narrowest = pulp::WithSimd::with_simd(Argument(y, x), pulp::Scalar::new());
        assert_eq!(widest.to_bits(), narrowest.to_bits());
        widest
    }

    fn log_ratio(s: f64, l: f64) -> f64 {
        struct LogRatio(f64, f64);
        impl pulp::WithSimd for LogRatio {
            type Output = f64;

            fn with_simd<S: Simd>(self, simd: S) -> f64 {
                let mut out = [0.0; LANES];
                Wide::splat(simd, self.0).log_ratio(self.1).store(&mut out, 0);
                out[0]
            }
        }
        let widest = pulp::Arch::new().dispatch(LogRatio(s, l));
        let narrowest = pulp::WithSimd::with_simd(LogRatio(s, l), pulp::Scalar::new());
        assert_eq!(widest.to_bits(), narrowest.to_bits());
        widest
    }

    #[test]
    fn argument_is_that_of_the_library() {
        for i in 0..4000 {
            let angle = PI * (f64::from(i) / 2000.0 - 1.0) + 1e-3;
            for size in [1e-30, 1e-3, 1.0, 7.3e20] {
                let (y, x) = (size * angle.sin(), size * angle.cos());
                let expected = y.atan2(x);
                assert!((argument(y, x) - expected).abs() <= 4.5e-16 * expected.abs(), "{y} {x}");
            }
        }
        for tiny in [1e-5, 1e-12, 1e-200] {
            assert!((argument(tiny, 1.0) / tiny.atan() - 1.0).abs() < 3e-16);
        }
        assert_eq!((argument(0.0, 1.0), argument(0.0, -2.0), argument(3.0, 0.0)), (0.0, PI, FRAC_PI_2));
        assert_eq!(argument(0.0, 0.0), 0.0);
    }

    #[test]
    fn logarithm_is_that_of_the_library() {
        for i in 1..=3000 {
            // From far away to very near the edge.
            let l = 10_f64.powf(-f64::from(i) / 200.0);
            let far = 2.0 * l.atanh();
            if l < 0.999 {
                assert!((log_ratio(1.0, l) / far - 1.0).abs() < 1e-15, "{l}");
            }
            let near = 1.0 - l;
            let expected = (2.0 / (1.0 - near) - 1.0).ln();
            assert!((log_ratio(3.0, 3.0 * near) - expected).abs() < 3e-15 * expected + 1e-15 / l, "{near}");
        }
        assert_eq!(log_ratio(2.0, 0.0), 0.0);
    }
}
