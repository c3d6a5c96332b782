//! Components of an aircraft as untrimmed spline patches, and signed distances to them.
//!
//! - [`Component`]: patches and how their edges join, found from the geometry, not from names. Set-up data.
//! - [`Body`]: a component in one state (reference or deformed); evaluation, and closest points with their signs.
//! - [`SignedDistance`], [`SmoothUnion`]: the implicit operations of the paper's section II.B with their derivatives, which
//!   `docs/derivation.md` derives.
//! - [`Primitive`]: shapes with analytic distances, which are exact rational components as well.
//!
//! Nothing depends on the unit of length: every tolerance is relative to a component's size.
//!
//! ```
//! use moldline_geometry::{Body, Component, FootChange, Primitive, SignedDistance, Vector3};
//!
//! let sphere = Primitive::Sphere { center: Vector3::zeros(), radius: 2.0 };
//! let (component, control_points) = Component::primitive("sphere".into(), &sphere)?;
//! let body = Body::new(component.into(), control_points);
//!
//! let distance = SignedDistance::new(&body);
//! let x = Vector3::new(1.0, 2.0, 2.0);
//! let point = distance.eval(&x);
//! assert!((point.phi - 1.0).abs() < 1e-12);
//! assert!((point.normal - x / 3.0).norm() < 1e-12);
//!
//! // The point moves while the surface stays: the gradient turns as that of |x| does, by (I - n n^T) dx / |x|.
//! let dx = Vector3::new(0.0, 0.3, 0.0);
//! let (d_phi, d_normal) = distance.derivative(&x, &point.foot).jvp(&FootChange { x: dx, ..Default::default() });
//! assert!((d_phi - 0.2).abs() < 1e-12);
//! assert!((d_normal - (dx - x / 3.0 * 0.2) / 3.0).norm() < 1e-12);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Absent on purpose: meshes, files, and the parameterisation that moves control points.

mod basis;
mod bezier;
mod body;
mod bounds;
mod closest_point;
mod component;
mod crossing;
mod descent;
mod distance;
mod error;
mod foot_point;
mod hierarchy;
mod joining;
mod location;
mod newton;
mod patch;
mod primitive;
mod topology;
mod union;
mod walk;

pub use basis::PointBasis;
pub use body::Body;
pub use bounds::Aabb;
pub use component::Component;
pub use distance::{FootChange, SignedDistance, SignedDistanceDerivative, SignedDistancePoint};
pub use error::ComponentError;
pub use foot_point::{Feature, FootPoint};
pub use joining::ComponentOptions;
pub use location::{Location, Side};
pub use moldline_foundation::block::{self, Block};
pub use moldline_spline::{SurfaceJet, SurfacePoint, Vector3};
pub use patch::{Patch, PatchInput};
pub use primitive::{Primitive, PrimitiveError};
pub use topology::{Edge, EdgeSide, Incidence, Vertex, VertexKind};
pub use union::{SmoothUnion, SmoothUnionPoint};
pub use walk::{ParameterDirection, Walk};
