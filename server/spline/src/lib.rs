//! B-splines: bases, curves, surfaces and volumes with values and exact first and second derivatives.
//!
//! A spline here is its *basis* only: the control points are passed to every evaluation, because one basis serves a
//! component's reference state, each of its deformed states and the seeds of its derivatives. Control points of
//! curves and surfaces are homogeneous, `[w x, w y, w z, w]`; a surface's are stored with the `v` index running
//! fastest. Evaluation lives on the stack and allocates nothing.
//!
//! Absent on purpose: fitting, file formats, trimming, anything that knows what an aircraft is.

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
