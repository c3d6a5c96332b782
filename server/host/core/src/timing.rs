//! How long requests take.

use std::{ops::Add, time::Duration};

/// Where the time of a request went.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timing {
    /// Waiting for the engine.
    pub queued: Duration,
    /// In the engine.
    pub engine: Duration,
}

impl Add for Timing {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { queued: self.queued + other.queued, engine: self.engine + other.engine }
    }
}

/// A computed value, and how long it took.
#[derive(Clone, Debug)]
pub struct Product<T> {
    /// The result.
    pub value: T,
    /// Time of the computation, including that of values that were computed for it.
    pub timing: Timing,
}
