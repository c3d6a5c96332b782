//! The ground floor of the engine: what several numerical crates need and none of them owns.
//!
//! Vectors of space, tangents and seeds of many directions ([`block`]), progress and cancellation of long work ([`monitor`]),
//! classes and fields of errors ([`failure`]), vector instructions ([`simd`]), Gauss and Legendre's quadrature
//! ([`quadrature`]) and the quintic smooth step ([`smooth_step`]).
//!
//! Absent on purpose: meshes, splines, anything that one crate alone needs.

pub mod block;
pub mod failure;
pub mod monitor;
pub mod quadrature;
pub mod simd;
pub mod smooth_step;

pub use block::Block;
pub use failure::{Class, Failure, Outside, short};
pub use monitor::{Monitor, NoMonitor};

/// A point or vector of space, in metres where it is a position.
pub type Vector3 = nalgebra::Vector3<f64>;
