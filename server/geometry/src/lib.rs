//! Components of an aircraft as untrimmed spline patches, and signed distances to them.
//!
//! - [`Component`]: patches and how their edges join, found from the geometry, not from names. Set-up data.
//! - [`Body`]: a component in one state (reference or deformed); evaluation, and closest points with their signs.
//! - [`SignedDistance`], [`SmoothUnion`]: the implicit operations of the paper's section II.B with their derivatives.
//! - [`Primitive`]: shapes with analytic distances, which are exact rational components as well.
//!
//! Nothing depends on the unit of length: every tolerance is relative to a component's size.
//!
//! Absent on purpose: meshes, files, and the parameterisation that moves control points.

mod basis;
mod bezier;
mod body;
mod bounds;
mod component;
mod distance;
mod hierarchy;
mod newton;
mod primitive;
mod topology;
mod union;

pub use basis::PointBasis;
pub use body::{Body, Feature, FootPoint, Location, ParameterDirection, Walk};
pub use bounds::Aabb;
pub use component::{Component, ComponentError, ComponentOptions, Patch, PatchInput};
pub use distance::{FootChange, SignedDistance, SignedDistanceDerivative, SignedDistancePoint};
pub use moldline_foundation::block::{self, Block};
pub use moldline_spline::{SurfaceJet, SurfacePoint, Vector3};
pub use primitive::{Primitive, PrimitiveError};
pub use topology::{Edge, EdgeSide, Incidence, Side, Vertex, VertexKind};
pub use union::{SmoothUnion, SmoothUnionPoint};
