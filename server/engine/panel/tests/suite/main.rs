//! Tests against closed forms, published results, differences and dual numbers, and with bad input.

#![allow(clippy::unwrap_used, reason = "helpers of tests may panic")]

mod derivatives;
mod flow;
mod refusals;
mod solvers;
mod wakes;
