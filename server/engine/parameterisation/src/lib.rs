//! The parameterisation: a map from named design variables, with units and bounds, to control points (paper II.A).
//!
//! A [`Parameterisation`] is compiled from the reference geometry, [`VariableDeclaration`]s and an ordered list of
//! [`OperationDeclaration`]s. It maps a design, one number per scalar variable in the declared unit, to the Cartesian
//! control points of every component. At the baseline they are the reference's, bit by bit. [`Linearisation`] gives
//! exact products with the Jacobian and its transpose.
//!
//! ```
//! use moldline_parameterisation::*;
//! use moldline_spline::{KnotVector, Surface};
//!
//! // A flat square of 1 m that slides along x, in feet.
//! let surface = Surface::new(KnotVector::clamped_uniform(1, 2)?, KnotVector::clamped_uniform(1, 2)?);
//! let control_points = vec![[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]];
//! let wing = ComponentReference {
//!     name: "wing".into(),
//!     patches: vec![PatchReference { surface, control_points, weights: vec![] }],
//! };
//! let slide = VariableDeclaration {
//!     name: "slide".into(),
//!     shape: vec![],
//!     unit: Unit::Foot,
//!     baseline: None,
//!     lower: -1.0,
//!     upper: 1.0,
//! };
//! let translation = OperationDeclaration::Translation(TranslationDeclaration {
//!     components: vec!["wing".into()],
//!     direction: [1.0, 0.0, 0.0],
//!     variable: "slide".into(),
//! });
//! let parameterisation = Parameterisation::new(&[wing], &[slide], &[translation])?;
//!
//! let linearisation = parameterisation.linearise(&[0.5])?;
//! assert_eq!(linearisation.control_points()[0][0], [0.1524, 0.0, 0.0]);
//! assert_eq!(linearisation.jvp(&[[1.0]])?[0][0][0], [0.3048, 0.0, 0.0]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Conventions
//! * Axes: x aft, y starboard, z up; the plane of symmetry is y = 0. Inside: metres, square metres, radians.
//! * Order: operations act in the declared order (free form, planform, rotation, translation is the usual one), each on
//!   the result of those before it. Pivots and centre lines are points of the component: earlier operations move them
//!   too, later ones do not affect them. Free-form displacements are those of the reference block, whatever operations
//!   came before it.
//! * Additive variables (angles, lengths, fractions of chord) act through value - baseline, multiplicative ones (area,
//!   aspect ratio, factor, diameter) through value / baseline.
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
