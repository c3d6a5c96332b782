//! Errors of the engine and of set-up files as the service's: class, field, and their own words, which name index, value
//! and limit.

use moldline_check::CheckError;
use moldline_deform::{DeformError, SetupError};
use moldline_mesh::{MeshError, io::ReadError};
use moldline_parameterisation::{DesignError, ParameterisationError};
use moldline_setup::SetupFileError;
use moldline_store::StoreError;

use crate::error::{Code, ServiceError};

impl From<StoreError> for ServiceError {
    fn from(error: StoreError) -> Self {
        const LATER: std::time::Duration = std::time::Duration::from_secs(1);
        let text = error.to_string();
        match error {
            StoreError::Full { .. } => Self::new(Code::ResourceExhausted, text),
            StoreError::Corrupt { .. } => Self::new(Code::Internal, text),
            StoreError::ReadOnly { .. } | StoreError::Location { .. } => Self::new(Code::Unavailable, text),
            StoreError::Unavailable { .. } => Self::new(Code::Unavailable, text).retry_after(LATER),
        }
    }
}

impl From<SetupFileError> for ServiceError {
    fn from(error: SetupFileError) -> Self {
        let field = match &error {
            SetupFileError::SetupFile { .. } => "setup_file".to_owned(),
            SetupFileError::MissingFile { field, .. }
            | SetupFileError::Path { field, .. }
            | SetupFileError::TooMany { field, .. }
            | SetupFileError::NotFinite { field, .. }
            | SetupFileError::Value { field, .. }
            | SetupFileError::Size { field, .. }
            | SetupFileError::Knots { field, .. }
            | SetupFileError::Choice { field, .. }
            | SetupFileError::Duplicate { field, .. } => field.clone(),
            SetupFileError::Syntax { file, field, .. } if field.is_empty() => file.clone(),
            SetupFileError::Syntax { field, .. } => field.clone(),
            SetupFileError::Format { .. } => "format".to_owned(),
            SetupFileError::Component { index, .. } => format!("components[{index}]"),
            SetupFileError::Primitive { index, .. } => format!("components[{index}].primitive"),
            SetupFileError::MeshFile { source: ReadError::Mesh(error), .. } | SetupFileError::Mesh(error) => {
                mesh_field(error)
            }
            SetupFileError::MeshFile { .. } => "mesh.file".to_owned(),
            SetupFileError::Parameterisation(error) => parameterisation_field(error),
            SetupFileError::Archive { .. } => "archive".to_owned(),
            SetupFileError::Io { path, .. } => path.clone(),
        };
        Self::invalid(field, error.to_string())
    }
}

impl From<SetupError> for ServiceError {
    fn from(error: SetupError) -> Self {
        let field = match &error {
            SetupError::Cancelled => return Self::new(Code::Cancelled, error.to_string()),
            SetupError::Option { field, .. } | SetupError::UnknownName { field, .. } => {
                format!("options.{field}")
            }
            SetupError::NotSymmetric(_) => "options.symmetric".to_owned(),
            SetupError::NoComponents
            | SetupError::DuplicateComponent { .. }
            | SetupError::Baseline(_)
            | SetupError::ControlPoints(_) => "components".to_owned(),
            SetupError::Component { index, .. } | SetupError::UnusedComponent { index, .. } => {
                format!("components[{index}]")
            }
            SetupError::Parameterisation(error) => parameterisation_field(error),
            SetupError::Factorisation { field, .. } => field.clone(),
            SetupError::Output { name, .. } => format!("outputs[\"{name}\"]"),
            SetupError::Mesh(error) => mesh_field(error),
            SetupError::OffSurface { worst, .. } => match worst.first() {
                Some(worst) => format!("mesh.vertices[{}]", worst.vertex),
                None => "mesh.vertices".to_owned(),
            },
            SetupError::CellAcrossSeam { first, .. } => match first.first() {
                Some(cell) => format!("mesh.cells[{cell}]"),
                None => "mesh.cells".to_owned(),
            },
            SetupError::TangentSeam { vertex, .. }
            | SetupError::HeldSeam { vertex, .. }
            | SetupError::SeamAtEnd { vertex, .. }
            | SetupError::SeamSides { vertex, .. } => format!("mesh.vertices[{vertex}]"),
            SetupError::OpenMesh { .. } | SetupError::NonManifold { .. } | SetupError::ReferenceSeam(_) => {
                "mesh".to_owned()
            }
        };
        Self::invalid(field, error.to_string())
    }
}

/// The path of what is wrong with a mesh, which begins with `mesh`.
pub fn mesh_field(error: &MeshError) -> String {
    match error {
        MeshError::Empty { what } | MeshError::TooMany { what, .. } => {
            format!("mesh.{}", what.replace(' ', "_"))
        }
        MeshError::Coordinate { vertex, axis, .. } => format!("mesh.vertices[{vertex}][{axis}]"),
        MeshError::VertexOutOfRange { cell, corner, .. } => format!("mesh.cells[{cell}][{corner}]"),
        MeshError::RepeatedVertex { cell, .. } => format!("mesh.cells[{cell}]"),
        MeshError::UnusedVertices { first, .. } => format!("mesh.vertices[{first}]"),
        MeshError::GroupIndexOutOfRange { kind, .. } | MeshError::DuplicateGroup { kind, .. } => {
            format!("mesh.{kind}_groups")
        }
    }
}

fn parameterisation_field(error: &ParameterisationError) -> String {
    let field = match error {
        ParameterisationError::PatchSize { component, patch, .. } => {
            return format!("components[{component}].patches[{patch}]");
        }
        ParameterisationError::NotFinite { field, .. }
        | ParameterisationError::DuplicateName { field, .. }
        | ParameterisationError::UnknownName { field, .. }
        | ParameterisationError::Empty { field }
        | ParameterisationError::WrongUnit { field, .. }
        | ParameterisationError::WrongShape { field, .. }
        | ParameterisationError::NeedsBaseline { field, .. }
        | ParameterisationError::BaselineNotPositive { field, .. }
        | ParameterisationError::OutOfRange { field, .. }
        | ParameterisationError::Knots { field, .. }
        | ParameterisationError::Geometry { field, .. } => field.clone(),
        ParameterisationError::UnusedVariable { index, .. }
        | ParameterisationError::BaselineOutsideBounds { index, .. } => format!("variables[{index}]"),
    };
    format!("parameterisation.{field}")
}

impl From<DeformError> for ServiceError {
    fn from(error: DeformError) -> Self {
        let text = error.to_string();
        match error {
            DeformError::Design(error) => error.into(),
            DeformError::Cancelled => Self::new(Code::Cancelled, text),
            DeformError::ControlPoints(_) => Self::invalid("control_points", text),
            DeformError::SeamLost { .. }
            | DeformError::NotProjected { .. }
            | DeformError::Held { .. }
            | DeformError::FootPoint { .. } => Self::new(Code::FailedPrecondition, "").at("design", text),
            DeformError::SeedSize { index, what, .. } => Self::invalid(format!("{what}[{index}]"), text),
        }
    }
}

impl From<CheckError> for ServiceError {
    fn from(error: CheckError) -> Self {
        match error {
            CheckError::Deform(error) => error.into(),
            CheckError::Variable { index, error } => {
                Self::invalid(format!("variables[{index}]"), error.to_string())
            }
            CheckError::Line { .. } | CheckError::Vertex { .. } | CheckError::NoDesign { .. } => {
                Self::new(Code::FailedPrecondition, "").at("designs", error.to_string())
            }
        }
    }
}

impl From<DesignError> for ServiceError {
    fn from(error: DesignError) -> Self {
        let field = match &error {
            DesignError::Length { .. } => "design".to_owned(),
            DesignError::NotFinite { index, .. }
            | DesignError::OutOfBounds { index, .. }
            | DesignError::NotPositive { index, .. } => format!("design[{index}]"),
            DesignError::UnknownName { name, .. } => format!("design[\"{name}\"]"),
            DesignError::OverrideSize { component, .. } => format!("control_points[{component}]"),
            DesignError::OverrideNotFinite { component, index, axis, .. } => {
                format!("control_points[{component}][{index}][{axis}]")
            }
            DesignError::VectorLength { what, .. } => what.clone(),
        };
        Self::invalid(field, error.to_string())
    }
}
