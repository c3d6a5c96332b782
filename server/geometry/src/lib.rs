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
pub mod block;
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
pub use block::Block;
pub use body::Body;
pub use bounds::Aabb;
pub use component::Component;
pub use distance::{FootChange, SignedDistance, SignedDistanceDerivative, SignedDistancePoint};
pub use error::ComponentError;
pub use foot_point::{Feature, FootPoint};
pub use joining::ComponentOptions;
pub use location::{Location, Side};
pub use moldline_spline::{SurfaceJet, SurfacePoint, Vector3};
pub use patch::{Patch, PatchInput};
pub use primitive::{Primitive, PrimitiveError};
pub use topology::{Edge, EdgeSide, Incidence, Vertex, VertexKind};
pub use union::{SmoothUnion, SmoothUnionPoint};
pub use walk::{ParameterDirection, Walk};
