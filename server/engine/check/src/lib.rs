//! Checks of the derivatives: an independent evaluation of the whole chain in dual numbers, central differences, and the
//! dot-product test.
//!
//! [`Chain`] evaluates [`moldline_deform::Setup::deform`] in dual numbers. It takes discrete decisions (patches, features, sides,
//! training sets, charts) and converged values to start from from the engine, and evaluates everything continuous anew:
//! splines from the recurrence, implicit steps by Newton's method in dual arithmetic, radial basis functions by LU
//! decomposition of the saddle-point matrix in double-double arithmetic.
//!
//! Absent on purpose: files, and anything that only a check would need in the engine.

mod body;
mod chain;
mod chart;
mod check;
mod differences;
mod double_double;
mod dual;
mod engine;
mod field;
mod kink;
mod outputs;
mod random;
mod report;
mod seam;
mod spline;

use moldline_foundation::{Class, Failure};

pub use chain::{Chain, Evaluation, Stages};
pub use check::{
    CheckOptions, DesignCheck, Difference, DotProduct, Function, Linear, Outputs, Phase, Step, VariableCheck,
    Watch, check_design, designs, largest, range,
};
pub use differences::{Derivative, central_difference, norm, relative_error};
pub use kink::Kink;
pub use report::{Designs, Maximum, Observer, Report, Request};

/// Why a check cannot be carried out.
#[derive(Debug, thiserror::Error)]
pub enum CheckError {
    /// The engine rejects the design, or does not find the mesh.
    #[error(transparent)]
    Deform(#[from] moldline_deform::DeformError),
    /// There is no such variable.
    #[error("{error}")]
    Variable {
        /// Index into the names given.
        index: usize,
        /// What is wrong with it.
        error: moldline_parameterisation::DesignError,
    },
    /// A seam point is off the line along which it is searched.
    #[error(
        "the seam point of vertex {vertex} is {distance:.1e} m away from the line along which it is searched"
    )]
    Line {
        /// Index into the mesh.
        vertex: u32,
        /// Least distance of the line, m.
        distance: f64,
    },
    /// The dual evaluation does not find a vertex.
    #[error("the evaluation in dual numbers does not find a place for vertex {vertex}")]
    Vertex {
        /// Index into the mesh.
        vertex: u32,
    },
    /// No random design far from the baseline has a mesh.
    #[error(
        "none of {attempts} random designs far from the baseline has a mesh; the last one: {last}. Narrow the bounds, or \
         give a design"
    )]
    NoDesign {
        /// Number of designs tried.
        attempts: usize,
        /// Why the last one has none.
        last: Box<moldline_deform::DeformError>,
    },
}

/// Paths in a [`Request`].
impl Failure for CheckError {
    fn class(&self) -> Class {
        match self {
            Self::Deform(error) => error.class(),
            Self::Variable { .. } => Class::Input,
            Self::Line { .. } | Self::Vertex { .. } | Self::NoDesign { .. } => Class::Computation,
        }
    }

    fn field(&self) -> Option<String> {
        match self {
            Self::Deform(error) => error.field(),
            Self::Variable { index, .. } => Some(format!("variables[{index}]")),
            Self::Line { .. } | Self::Vertex { .. } | Self::NoDesign { .. } => Some("designs".to_owned()),
        }
    }
}
