//! Seeded random numbers.

use moldline_foundation::Vector3;

/// Random numbers that depend on the seed alone.
#[derive(Clone, Debug)]
pub struct Random(fastrand::Rng);

impl Random {
    /// A sequence of its own for each seed.
    pub fn new(seed: u64) -> Self {
        Self(fastrand::Rng::with_seed(seed))
    }

    /// Uniform in 0..1.
    pub fn unit(&mut self) -> f64 {
        self.0.f64()
    }

    /// Uniform in -1..1.
    pub fn signed(&mut self) -> f64 {
        self.between(-1.0, 1.0)
    }

    /// Uniform in `low..high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Spread evenly over orders of magnitude.
    pub fn logarithmic(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    /// True or false.
    pub fn coin(&mut self) -> bool {
        self.0.bool()
    }

    /// Coordinates uniform in `-scale..scale`.
    pub fn vector(&mut self, scale: f64) -> Vector3 {
        Vector3::from_fn(|_, _| scale * self.signed())
    }

    /// `count` vectors with coordinates uniform in -1..1.
    pub fn vectors(&mut self, count: usize) -> Vec<[f64; 3]> {
        (0..count).map(|_| std::array::from_fn(|_| self.signed())).collect()
    }
}
