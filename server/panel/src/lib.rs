//! A source-doublet panel method for closed bodies and wings in subsonic flow, with exact derivatives.
//!
//! [`PanelSetup::new`] finds once all that does not change with the positions of the vertices: the half that is solved,
//! trailing edges, wakes and stencils. [`PanelSetup::solve`] computes the flow for unit winds along the axes; [`Solution::analyse`] combines
//! them at any angle of attack, and [`Solution::linearise`] gives products with the derivative.
//!
//! Unknown is the perturbation potential on the outside, one number a cell, from the condition that it vanishes inside (Morino and Kuo,
//! AIAA J. 12, 1974). In the order of the data: [`surface`] (Goethert's rule, geometry of the panels), [`gradient`],
//! [`kutta`], [`influence`], [`system`], [`pressure`], [`trefftz`],
//! [`wake_force`], [`wind`].
//!
//! Axes: x aft, y starboard, z up. Parallel loops run on rayon's current pool. Results are the same to the last bit whatever its
//! size.
//!
//! Absent on purpose: files, serialisation, clocks; viscosity, free wakes, supersonic flow.

mod bounds;
mod clusters;
mod coefficients;
mod distributions;
mod error;
mod flow;
mod gradient;
mod influence;
mod kutta;
mod lanes;
mod linear_system;
mod linearisation;
#[cfg(test)]
#[path = "../tests/suite/meshes.rs"]
#[allow(dead_code, clippy::unwrap_used, reason = "shared with the tests of the whole crate")]
mod meshes;
mod options;
mod panel_setup;
mod panels;
mod pressure;
mod progress;
mod solution;
mod stage;
mod state;
mod surface;
mod symmetry;
mod trefftz;
mod wake;
mod wake_force;
mod wind;

pub use coefficients::Scalars;
pub use error::PanelError;
pub use flow::{Flow, Reference};
pub use linearisation::{Inputs, Linearisation, Outputs};
pub use moldline_foundation::{Monitor, NoMonitor};
pub use options::{Options, Solver, Symmetry, TrailingEdges};
pub use panel_setup::{PanelSetup, SetupSummary, memory_estimate};
pub use solution::{Analysis, Loads, MAX_MACH, Section, Solution};
pub use stage::Stage;
