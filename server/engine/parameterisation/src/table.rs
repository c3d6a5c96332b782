//! A curve tabulated along an axis.

use moldline_foundation::Vector3;

/// Intervals between the tabulated stations.
const INTERVALS: usize = 512;

/// A curve tabulated along an axis, linear between stations and constant beyond.
pub(crate) struct Table {
    start: f64,
    end: f64,
    values: Vec<Vector3>,
}

impl Table {
    pub(crate) fn constant(value: Vector3) -> Self {
        Self { start: 0.0, end: 1.0, values: vec![value; 2] }
    }

    /// Tabulates `value` from `start` to `end`; `None` if the interval is empty or a value is missing.
    pub(crate) fn new(start: f64, end: f64, value: impl Fn(f64) -> Option<Vector3>) -> Option<Self> {
        let station = |i: usize| start + (end - start) * (i as f64 / INTERVALS as f64);
        let values = (0..=INTERVALS).map(|i| value(station(i))).collect::<Option<Vec<_>>>()?;
        (end > start).then_some(Self { start, end, values })
    }

    pub(crate) fn at(&self, x: f64) -> Vector3 {
        let intervals = self.values.len() - 1;
        let s = ((x - self.start) / (self.end - self.start)).clamp(0.0, 1.0) * intervals as f64;
        let i = (s as usize).min(intervals - 1);
        self.values[i].lerp(&self.values[i + 1], s - i as f64)
    }
}
