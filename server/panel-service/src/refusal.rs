//! Errors of the panel method as the service's: class, field, and their own words.

use moldline_panel::PanelError;
use moldline_service::{Code, ServiceError, mesh_field};

/// What a caller is told.
pub fn refused(error: PanelError) -> ServiceError {
    let text = error.to_string();
    let field = match error {
        PanelError::Mesh(error) => mesh_field(&error).trim_start_matches("mesh.").to_owned(),
        PanelError::UnknownGroup { field, .. } => format!("options.{field}"),
        PanelError::OutOfRange { field, .. } | PanelError::Length { field, .. } => field,
        PanelError::Open { cell, .. } | PanelError::Inwards { cell, .. } => format!("cells[{cell}]"),
        PanelError::NonManifold { cells, .. } | PanelError::Inconsistent { cells, .. } => match cells.first()
        {
            Some(cell) => format!("cells[{cell}]"),
            None => "cells".to_owned(),
        },
        PanelError::NotSymmetric(_) => "vertices".to_owned(),
        PanelError::NotAnEdge { index, .. } => format!("options.trailing_edges[{index}]"),
        PanelError::NoTrailingEdge { .. }
        | PanelError::BranchedTrailingEdge { .. }
        | PanelError::BluntTrailingEdge { .. }
        | PanelError::NoCarryOver { .. } => "options.trailing_edges".to_owned(),
        PanelError::Sideslip { .. } => "sideslip".to_owned(),
        // A valid mesh whose vertices have come where the method fails.
        PanelError::ZeroArea { .. }
        | PanelError::ZeroEdge { .. }
        | PanelError::WakeCutsBody { .. }
        | PanelError::Gradient { .. }
        | PanelError::Singular { .. }
        | PanelError::NotConverged { .. } => {
            return ServiceError::new(Code::FailedPrecondition, "").at("vertices", text);
        }
        PanelError::Memory { .. } => return ServiceError::new(Code::ResourceExhausted, text),
        PanelError::Cancelled => return ServiceError::new(Code::Cancelled, text),
    };
    ServiceError::invalid(field, text)
}
