//! The engine: a conforming surface mesh that follows its aircraft (Algorithm 1 of the paper).
//!
//! [`Setup::build`] finds once all that does not change with the design: which component each vertex lies on and where
//! ([`ownership`]), the seams and how they are searched ([`seam`]), the training vertices ([`training`]) and the
//! factorised displacement fields ([`field`]). [`Setup::deform`] maps a design to the vertices of the mesh.
//!
//! Parallel loops run on rayon's current pool. Results are the same to the last bit whatever its size: every value
//! is computed by one task in one fixed order.
//!
//! Absent on purpose: files, serialisation, sessions, clocks.

pub mod chart;
mod error;
pub mod field;
mod held;
pub mod inspection;
mod linearisation;
mod options;
pub mod outputs;
pub mod ownership;
mod pipeline;
pub mod projection;
mod report;
pub mod seam;
mod seam_derivative;
mod seam_setup;
mod setup;
mod stage;
pub mod training;

pub use error::{DeformError, SetupError, VertexDistance};
pub use held::Hold;
pub use linearisation::{Gradient, Linearisation, Stages, Tangent};
pub use moldline_foundation::{Monitor, NoMonitor};
pub use moldline_geometry::Location;
pub use moldline_rbf::{Factors, Kernel};
pub use options::{Options, OuterMoldLine, Propagation, SeamOptions, SmoothingOptions};
pub use outputs::{ComponentPoint, Function, OutputDeclaration};
pub use ownership::{Attachment, Freedom, OwnershipParts};
pub use pipeline::Deformation;
pub use report::{ComponentSummary, FieldSummary, ProtectedSummary, SetupReport, Symmetry};
pub use seam_setup::{FoundLine, SeamSummary};
pub use setup::{Derived, FoundSeams, RegionField, Setup, SetupInput};
pub use stage::Stage;
