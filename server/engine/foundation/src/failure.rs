//! Errors of the engine: their class, and the field of the input that they are about.

use std::fmt;

/// The class of a [`Failure`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Class {
    /// The input is wrong.
    Input,
    /// The input is valid, but the computation fails on it.
    Computation,
    /// The computation needs more memory than the limit.
    Memory,
    /// The caller cancelled the computation.
    Cancelled,
}

/// A typed error that knows where in the input its cause is. Each error enum of the engine implements it next to its
/// variants, so that a new variant cannot be forgotten elsewhere.
pub trait Failure: std::error::Error {
    /// The class of the error.
    fn class(&self) -> Class {
        Class::Input
    }

    /// Path of the field of the input, such as `vertices[3][1]`, relative to the input of the function that returned the
    /// error; `None` if no field is to blame.
    fn field(&self) -> Option<String>;
}

/// A number in as few digits as tell it, with an exponent where it would have hundreds of zeros.
pub fn short(value: f64) -> String {
    let exact = value.to_string();
    if exact.len() <= 24 { exact } else { format!("{value:?}") }
}

/// The bounds that a number violates, for messages after it: `must be greater than 0`, or `is outside 0..=0.99`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outside {
    /// Least value allowed; the smallest normal number for any positive one.
    pub low: f64,
    /// Largest value allowed.
    pub high: f64,
}

impl fmt::Display for Outside {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self { low: f64::MIN_POSITIVE, high: f64::MAX } => {
                f.write_str("must be finite and greater than 0")
            }
            Self { low: f64::MIN_POSITIVE, high } => {
                write!(f, "must be greater than 0, and at most {high:?}")
            }
            Self { low: f64::MIN, high: f64::MAX } => f.write_str("must be finite"),
            Self { low, high } => write!(f, "is outside {}..={}", short(low), short(high)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_short() {
        let text = |low, high| Outside { low, high }.to_string();
        assert_eq!(text(f64::MIN_POSITIVE, 1e24), "must be greater than 0, and at most 1e24");
        assert_eq!(text(f64::MIN_POSITIVE, f64::MAX), "must be finite and greater than 0");
        assert_eq!(text(f64::MIN, f64::MAX), "must be finite");
        assert_eq!(text(1e-14, 1e-4), "is outside 0.00000000000001..=0.0001");
        assert_eq!(text(-1e300, 1.0), "is outside -1e300..=1");
    }
}
