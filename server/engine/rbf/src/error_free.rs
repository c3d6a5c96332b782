//! Error-free transformations of sums and products of doubles.

/// `a + b` rounded, and what is rounded off (Knuth).
#[inline(always)]
pub(crate) fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let part = sum - a;
    (sum, (a - (sum - part)) + (b - part))
}

/// `a b` rounded, and what is rounded off, by a fused multiply-add.
#[inline(always)]
pub(crate) fn two_product(a: f64, b: f64) -> (f64, f64) {
    let product = a * b;
    (product, a.mul_add(b, -product))
}

/// Splits numbers in two without error: the high part has few enough bits that products of high parts are exact (Rump, Ogita and
/// Oishi's `ExtractScalar`). Its number is the constant that is added and subtracted.
#[derive(Clone, Copy)]
pub(crate) struct Splitter(pub f64);

impl Splitter {
    /// High parts of numbers up to `largest` are multiples of `2^-bits` times the next power of two.
    pub fn new(largest: f64, bits: i32) -> Self {
        let above = f64::from_bits(((largest.to_bits() >> 52) + 1) << 52);
        // Between 2^52 and 2^53 times that multiple, which is the distance between the doubles there.
        Self(1.5 * above * 2_f64.powi(52 - bits))
    }

    /// Bits for which sums of so many products of high parts are exact.
    pub fn bits(products: usize) -> i32 {
        (53 - products.next_power_of_two().trailing_zeros() as i32) / 2
    }

    /// The high part.
    #[inline(always)]
    pub fn high(self, x: f64) -> f64 {
        (x + self.0) - self.0
    }

    /// High and low part.
    #[inline(always)]
    pub fn split(self, x: f64) -> [f64; 2] {
        let high = self.high(x);
        [high, x - high]
    }
}
