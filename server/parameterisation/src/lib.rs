//! Design variables to control points (paper II.A): declarative, by name, with bounds and units.
//!
//! A [`Parameterisation`] is compiled from the reference geometry, [`VariableDeclaration`]s and an ordered list of
//! [`OperationDeclaration`]s. It maps a design, one number per scalar variable in the declared unit, to the Cartesian
//! control points of every component. At the baseline they are the reference's, bit by bit. [`Linearisation`] gives
//! exact products with the Jacobian and its transpose.
//!
//! # Conventions
//! * Axes: x aft, y starboard, z up; the plane of symmetry is y = 0. Inside: metres, square metres, radians.
//! * Order: operations act in the declared order (free form, planform, rotation, translation is the usual one), each on
//!   the result of those before. Pivots and centre lines are points of the component: earlier operations move them
//!   too, later ones do not matter to them. Free-form displacements are those of the reference block, whatever came
//!   before it.
//! * What is added (angles, lengths, fractions of chord) acts by value - baseline; what multiplies (area, aspect ratio,
//!   factor, diameter) by value / baseline.
//! * Rotations are right-handed about their axis: about +y positive is nose up (leading edge up, trailing edge down).
//! * Twist: positive leading edge up, about the section's quarter chord parallel to the span axis; sections stay in
//!   their planes. Camber positive up, thickness positive thicker, both in fractions of the local (stretched) chord.
//! * Section functions run from root (0) to tip (1), clamped uniform B-splines; mirrored ones use the absolute span
//!   coordinate. Span stretch is outward positive and antisymmetric.
//! * Planform area runs from leading to trailing edge and from tip to tip, through the fuselage; aspect ratio is
//!   span^2/area. Thickness scales with the chord.
//!
//! Absent on purpose: files, serialisation, surfaces' derivatives, weights as variables (they never change).

mod axis;
mod channel;
mod compile;
mod error;
mod operation;
mod operations;
mod parameterisation;
mod pivot;
mod reference;
mod scalar;
mod sections;
mod table;
mod unit;
mod variables;

#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;

pub use axis::Axis;
pub use error::{DesignError, ParameterisationError};
pub use operation::Lattice;
pub use operations::*;
pub use parameterisation::{ControlPoints, Linearisation, Override, Parameterisation};
pub use pivot::Pivot;
pub use reference::{ComponentReference, PatchReference};
pub use scalar::Scalar;
pub use unit::{Dimension, Unit};
pub use variables::{Group, Variable, VariableDeclaration};
