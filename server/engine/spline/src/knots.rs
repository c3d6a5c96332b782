//! Knot vectors: validation once, so that evaluation never fails.

use crate::MAX_DEGREE;

/// Why a sequence of numbers is not a knot vector.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum KnotError {
    /// The degree is zero or larger than [`MAX_DEGREE`].
    #[error("degree {degree} is not between 1 and {MAX_DEGREE}")]
    Degree {
        /// The requested degree.
        degree: usize,
    },
    /// Fewer knots than a single span needs.
    #[error("{count} knots are too few for degree {degree}: at least {} are needed (2 degree + 2)", 2 * degree + 2)]
    TooFew {
        /// The degree.
        degree: usize,
        /// The number of knots given.
        count: usize,
    },
    /// A knot is NaN or infinite.
    #[error("knot {index} is {value}, which is not a finite number")]
    NotFinite {
        /// Position in the knot vector.
        index: usize,
        /// The knot.
        value: f64,
    },
    /// A knot is smaller than the one before it.
    #[error("knot {index} is {value}, smaller than the {previous} before it: knots must not decrease")]
    Decreasing {
        /// Position in the knot vector.
        index: usize,
        /// The knot.
        value: f64,
        /// The knot before it.
        previous: f64,
    },
    /// An interior knot is repeated so often that the spline is discontinuous there.
    #[error(
        "the interior knot {value} (from index {index}) is repeated {multiplicity} times, more than the degree \
         {degree}: the spline would be torn there; split it into two patches"
    )]
    Multiplicity {
        /// Position of the first repetition.
        index: usize,
        /// The knot.
        value: f64,
        /// Its multiplicity.
        multiplicity: usize,
        /// The degree.
        degree: usize,
    },
    /// The domain, from knot `degree` to knot `count - degree - 1`, has no length.
    #[error("the domain of the knot vector is empty: it starts and ends at {value}")]
    EmptyDomain {
        /// Both ends of the domain.
        value: f64,
    },
}

/// A validated knot vector with precomputed numbers of each knot interval for evaluation.
///
/// With degree `p` and `n` control points it has `n + p + 1` knots `t`; its domain is `[t_p, t_n]`. It may be clamped
/// (end knots repeated `p + 1` times) or not.
#[derive(Debug, Clone, PartialEq)]
pub struct KnotVector {
    degree: usize,
    knots: Vec<f64>,
    breaks: Vec<f64>,
    /// Knot index `s` of each interval: `breaks[i] = t_s < t_(s+1) = breaks[i + 1]`.
    spans: Vec<usize>,
    /// Reciprocal knot differences of the recurrence, `p (p + 1) / 2` per interval.
    reciprocals: Vec<f64>,
    /// First guess of the interval, over equal bins of the domain.
    bins: Vec<u32>,
    bins_per_unit: f64,
}

impl KnotVector {
    /// Validates `knots` for splines of the given degree.
    ///
    /// # Errors
    /// A [`KnotError`] that names the offending index and value.
    pub fn new(degree: usize, knots: Vec<f64>) -> Result<Self, KnotError> {
        if degree == 0 || degree > MAX_DEGREE {
            return Err(KnotError::Degree { degree });
        }
        if knots.len() < 2 * degree + 2 {
            return Err(KnotError::TooFew { degree, count: knots.len() });
        }
        if let Some(index) = knots.iter().position(|t| !t.is_finite()) {
            return Err(KnotError::NotFinite { index, value: knots[index] });
        }
        if let Some(i) = knots.windows(2).position(|w| w[1] < w[0]) {
            return Err(KnotError::Decreasing { index: i + 1, value: knots[i + 1], previous: knots[i] });
        }
        let n = knots.len() - degree - 1;
        let (a, b) = (knots[degree], knots[n]);
        if a >= b {
            return Err(KnotError::EmptyDomain { value: a });
        }
        let mut start = 0;
        while start < knots.len() {
            let value = knots[start];
            let multiplicity = knots[start..].iter().take_while(|&&t| t == value).count();
            // At the ends of the domain degree + 1 equal knots are the usual clamping.
            let limit = if value > a && value < b { degree } else { degree + 1 };
            if multiplicity > limit {
                return Err(KnotError::Multiplicity { index: start, value, multiplicity, degree });
            }
            start += multiplicity;
        }
        Ok(Self::from_valid(degree, knots))
    }

    /// The clamped knot vector over `[0, 1]` with equal intervals.
    ///
    /// # Errors
    /// If the degree is out of range or the control points are fewer than `degree + 1`.
    pub fn clamped_uniform(degree: usize, control_point_count: usize) -> Result<Self, KnotError> {
        let intervals = control_point_count.saturating_sub(degree);
        if intervals == 0 {
            return Err(KnotError::TooFew { degree, count: control_point_count + degree + 1 });
        }
        let inner = (0..=intervals).map(|i| i as f64 / intervals as f64);
        let knots = std::iter::repeat_n(0.0, degree).chain(inner).chain(std::iter::repeat_n(1.0, degree));
        Self::new(degree, knots.collect())
    }

    pub(crate) fn from_valid(degree: usize, knots: Vec<f64>) -> Self {
        let n = knots.len() - degree - 1;
        let spans: Vec<usize> = (degree..n).filter(|&s| knots[s] < knots[s + 1]).collect();
        let mut breaks: Vec<f64> = spans.iter().map(|&s| knots[s]).collect();
        breaks.push(knots[n]);
        let mut reciprocals = Vec::with_capacity(spans.len() * degree * (degree + 1) / 2);
        for &s in &spans {
            for j in 1..=degree {
                for r in 0..j {
                    reciprocals.push(1.0 / (knots[s + r + 1] - knots[s + 1 + r - j]));
                }
            }
        }
        let count = 2 * spans.len();
        let (a, b) = (knots[degree], knots[n]);
        let bins_per_unit = count as f64 / (b - a);
        let bins = (0..count)
            .map(|bin| {
                let left = a + (b - a) * bin as f64 / count as f64;
                (breaks[1..spans.len()].partition_point(|&t| t <= left)) as u32
            })
            .collect();
        Self { degree, knots, breaks, spans, reciprocals, bins, bins_per_unit }
    }

    /// The polynomial degree `p`.
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// All knots, as given.
    pub fn knots(&self) -> &[f64] {
        &self.knots
    }

    /// The number of control points (basis functions) `n`.
    pub fn control_point_count(&self) -> usize {
        self.knots.len() - self.degree - 1
    }

    /// First and last parameter.
    pub fn domain(&self) -> (f64, f64) {
        (self.breaks[0], self.breaks[self.breaks.len() - 1])
    }

    /// The distinct knots of the domain, increasing; one more than there are intervals.
    pub fn breaks(&self) -> &[f64] {
        &self.breaks
    }

    /// The number of non-empty intervals of the domain.
    pub fn interval_count(&self) -> usize {
        self.spans.len()
    }

    /// The interval `i` with `breaks[i] <= u < breaks[i + 1]` (the last one is closed); `u` is clamped to the domain.
    #[inline]
    pub fn interval(&self, u: f64) -> usize {
        let last = self.spans.len() - 1;
        // The cast saturates, and maps NaN to 0: no input leaves the table.
        let bin = (((u - self.breaks[0]) * self.bins_per_unit) as usize).min(self.bins.len() - 1);
        let mut i = self.bins[bin] as usize;
        while i < last && u >= self.breaks[i + 1] {
            i += 1;
        }
        while i > 0 && u < self.breaks[i] {
            i -= 1;
        }
        i
    }

    /// The knot index `s` with `t_s <= u < t_(s+1)`; `u` is clamped to the domain. The functions that do not vanish
    /// there are `s - p ..= s`.
    #[inline]
    pub fn span(&self, u: f64) -> usize {
        self.spans[self.interval(u)]
    }

    /// The knot index of an interval.
    #[inline]
    pub fn span_of_interval(&self, interval: usize) -> usize {
        self.spans[interval]
    }

    #[inline(always)]
    pub(crate) fn reciprocals(&self, interval: usize) -> &[f64] {
        let count = self.degree * (self.degree + 1) / 2;
        &self.reciprocals[interval * count..(interval + 1) * count]
    }

    /// Greville abscissae: the mean of the `p` inner knots of each basis function.
    pub fn greville(&self) -> Vec<f64> {
        let p = self.degree;
        (0..self.control_point_count())
            .map(|i| self.knots[i + 1..=i + p].iter().sum::<f64>() / p as f64)
            .collect()
    }

    /// The multiplicity of `value` among the knots.
    pub fn multiplicity(&self, value: f64) -> usize {
        self.knots.iter().filter(|&&t| t == value).count()
    }

    /// Whether both ends are repeated at least `p` times, so that the spline starts at its first control point and
    /// ends at its last.
    pub fn is_clamped(&self) -> bool {
        let (a, b) = self.domain();
        self.knots[1] == a && self.knots[self.knots.len() - 2] == b
    }
}
