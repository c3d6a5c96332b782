//! Axis-aligned boxes.

use moldline_foundation::Vector3;

/// An axis-aligned box; empty if `low > high`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aabb {
    /// Smallest coordinates, metres.
    pub low: Vector3,
    /// Largest coordinates, metres.
    pub high: Vector3,
}

impl Aabb {
    /// The empty box.
    pub fn empty() -> Self {
        Self { low: Vector3::repeat(f64::INFINITY), high: Vector3::repeat(f64::NEG_INFINITY) }
    }

    /// The smallest box around the points.
    pub fn around(points: impl IntoIterator<Item = Vector3>) -> Self {
        let mut b = Self::empty();
        for p in points {
            b.include(&p);
        }
        b
    }

    /// Extends the box to a point.
    pub fn include(&mut self, p: &Vector3) {
        self.low = self.low.inf(p);
        self.high = self.high.sup(p);
    }

    /// The smallest box around both.
    pub fn union(&self, other: &Self) -> Self {
        Self { low: self.low.inf(&other.low), high: self.high.sup(&other.high) }
    }

    /// Length of the diagonal, metres.
    pub fn diagonal(&self) -> f64 {
        (self.high - self.low).norm()
    }

    /// The centre.
    pub fn center(&self) -> Vector3 {
        (self.low + self.high) * 0.5
    }

    /// Largest magnitude of a coordinate, metres.
    pub fn reach(&self) -> f64 {
        self.low.amax().max(self.high.amax())
    }

    /// Square of the distance from `x` to the box; 0 inside.
    #[inline]
    pub fn squared_distance(&self, x: &Vector3) -> f64 {
        let mut sum = 0.0;
        for k in 0..3 {
            let d = (self.low[k] - x[k]).max(x[k] - self.high[k]).max(0.0);
            sum += d * d;
        }
        sum
    }

    /// Distance from `x` to the box; 0 inside.
    pub fn distance(&self, x: &Vector3) -> f64 {
        self.squared_distance(x).sqrt()
    }
}
