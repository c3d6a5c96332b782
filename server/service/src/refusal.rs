//! The engine's errors as the service's: class, field, and the engine's own words, which name index, value and limit.

use moldline_deform::{DeformError, SetupError};
use moldline_parameterisation::DesignError;

use crate::error::{Code, ServiceError};

impl From<SetupError> for ServiceError {
    fn from(error: SetupError) -> Self {
        let field = match &error {
            SetupError::Cancelled => return Self::new(Code::Cancelled, error.to_string()),
            SetupError::Option { field, .. } | SetupError::UnknownName { field, .. } => format!("options.{field}"),
            SetupError::NotSymmetric(_) => "options.symmetric".to_owned(),
            SetupError::Components(_) => "components".to_owned(),
            SetupError::Component { index, .. } | SetupError::UnusedComponent { index, .. } => {
                format!("components[{index}]")
            }
            SetupError::Parameterisation(_) => "parameterisation".to_owned(),
            SetupError::Factorisation { field, .. } => field.clone(),
            SetupError::Mesh(_)
            | SetupError::OpenMesh { .. }
            | SetupError::NonManifold { .. }
            | SetupError::OffSurface { .. }
            | SetupError::CellAcrossSeam { .. }
            | SetupError::TangentSeam { .. }
            | SetupError::ReferenceSeam(_) => "mesh".to_owned(),
        };
        Self::invalid(field, error.to_string())
    }
}

impl From<DeformError> for ServiceError {
    fn from(error: DeformError) -> Self {
        let text = error.to_string();
        match error {
            DeformError::Design(error) => error.into(),
            DeformError::Cancelled => Self::new(Code::Cancelled, text),
            DeformError::ControlPoints(_) => Self::invalid("control_points", text),
            DeformError::SeamLost { .. } | DeformError::NotProjected { .. } | DeformError::FootPoint { .. } => {
                Self::new(Code::FailedPrecondition, "").at("design", text)
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
