//! What the tests of several crates share; a dependency of tests only.
//!
//! Generated meshes ([`sphere`], [`Wing`]), a set-up that is small enough to write by hand ([`ball`]), random numbers that are
//! the same everywhere ([`Random`]), and waiting with a pause and a bound ([`fn@eventually`]).
//!
//! Absent on purpose: references that a crate is compared with; they stay with its tests.
#![allow(clippy::unwrap_used, reason = "helpers of tests may panic")]

pub mod ball;
mod eventually;
mod meshes;
mod random;

pub use eventually::eventually;
pub use meshes::{Builder, Wing, partly_triangles, sphere};
pub use random::Random;
