//! B-splines: bases, curves, surfaces and volumes with values and exact first and second derivatives.
//!
//! A spline here is its *basis* only: the control points are passed to every evaluation, because one basis serves a
//! component's reference state, each of its deformed states and the seeds of its derivatives. Control points of
//! curves and surfaces are homogeneous, `[w x, w y, w z, w]`; a surface's are stored with the `v` index running
//! fastest. Evaluation lives on the stack and allocates nothing.
//!
//! ```
//! use moldline_spline::{KnotVector, Surface};
//!
//! // A bilinear patch over the unit square with one corner raised to z = 1.
//! let linear = KnotVector::clamped_uniform(1, 2)?;
//! let surface = Surface::new(linear.clone(), linear);
//! let corners = [[0.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0], [1.0, 0.0, 0.0, 1.0], [1.0, 1.0, 1.0, 1.0]];
//! // z = u v, with its derivatives.
//! let s = surface.jet(&corners, 0.5, 0.25);
//! assert_eq!((s.position.z, s.d_u.z, s.d_v.z, s.d_uv.z), (0.125, 0.25, 0.5, 1.0));
//! # Ok::<(), moldline_spline::KnotError>(())
//! ```
//!
//! Absent on purpose: fitting, file formats, trimming, anything specific to aircraft.

mod basis;
mod curve;
mod knots;
mod rational;
mod refine;
mod surface;
mod volume;

pub use basis::{Basis, MAX_DEGREE};
pub use curve::{Curve, CurveJet};
pub use knots::{KnotError, KnotVector};
pub use refine::LinearRow;
pub use surface::{Surface, SurfaceJet, SurfacePoint};
pub use volume::{LocateError, Volume, VolumeWeights};

pub use moldline_foundation::Vector3;
