//! The engine: a conforming surface mesh that follows its aircraft (Algorithm 1 of the paper).
//!
//! [`Setup::build`] finds once all that does not change with the design: which component each vertex lies on and where
//! ([`ownership`]), and what the steps of a deformation decide ([`chain`]): how seams are searched, which vertices carry the
//! displacement fields, how each vertex is placed. [`Setup::deform`] maps a design to the vertices of the mesh,
//! [`Setup::linearise`] keeps the derivative.
//!
//! Parallel loops run on rayon's current pool. Results are the same to the last bit whatever its size: every value
//! is computed by one task in one fixed order.
//!
//! Absent on purpose: files, serialisation, sessions, clocks.

mod bodies;
pub mod chain;
pub mod chart;
mod collisions;
mod constraints;
mod deformation;
mod error;
mod fit;
mod inputs;
pub mod inspection;
mod linearisation;
mod options;
pub mod ownership;
mod report;
mod setup;
mod soundness;
mod stage;
mod symmetry;

pub use chain::{
    field::RegionField,
    outputs::{ComponentPoint, Function, OutputDeclaration},
    seams::setup::{FoundLine, SeamSummary},
};
pub use deformation::Deformation;
pub use error::{Constraint, ControlPointsError, DeformError, SetupError, Source, VertexDistance};
pub use fit::Misfit;
pub use inputs::{Direction, Inputs};
pub use linearisation::{Gradient, Linearisation, Stages, Tangent};
pub use moldline_foundation::{Monitor, NoMonitor};
pub use moldline_geometry::Location;
pub use moldline_rbf::{Factors, Kernel};
pub use options::{OnEvent, Options, OuterMoldLine, Propagation, SeamOptions, SmoothingOptions};
pub use ownership::{Attachment, Freedom, OwnershipParts};
pub use report::{ComponentSummary, FieldSummary, ProtectedSummary, SetupReport};
pub use setup::{Derived, FoundSeams, Setup, SetupInput};
pub use stage::Stage;
pub use symmetry::Symmetry;
