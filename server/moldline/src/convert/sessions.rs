//! Sessions, designs and deformations.

use moldline_host::ServiceError;
use moldline_mesh::{CellQuality, Distribution, QualityReport, Summary};
use moldline_mesh_service::{Design, Linearised, Listed, Session, SessionUpdate, Values};
use moldline_proto::v1::{self, DataType, deform_request, design_point};

use super::{arrays, status};

pub fn listed_sessions(Listed { entries, next }: Listed<Session>) -> v1::ListSessionsResponse {
    let sessions = entries.into_iter().map(session).collect();
    v1::ListSessionsResponse { sessions, next_page_token: next.unwrap_or_default() }
}

pub fn session(session: Session) -> v1::Session {
    v1::Session {
        session_id: session.id,
        setup_id: session.setup_id,
        generation: session.generation,
        design: session.design.map(stored_design),
        label: session.label,
        created_time: status::unix_seconds(session.created),
        updated_time: status::unix_seconds(session.updated),
    }
}

fn stored_design(Design { values, control_points }: Design) -> v1::DesignPoint {
    let input = match values {
        Values::Vector(vector) => {
            design_point::Input::Design(arrays::numbers(&[vector.len()], [&vector[..]]))
        }
        Values::Named(values) => {
            design_point::Input::Named(v1::NamedDesign { values: values.into_iter().collect() })
        }
    };
    let given = control_points
        .into_iter()
        .map(|(component, of)| v1::ControlPoints { component, points: Some(arrays::points(&of)) });
    v1::DesignPoint { input: Some(input), control_points: given.collect() }
}

pub fn update(request: v1::UpdateSessionRequest) -> Result<SessionUpdate, ServiceError> {
    let v1::UpdateSessionRequest { expected_generation, design, label, request_id, .. } = request;
    let design = design.map(|point| design_point("design.", point)).transpose()?;
    Ok(SessionUpdate { expected_generation, design, label, request_id })
}

pub fn design(
    input: Option<deform_request::Input>,
    control_points: Vec<v1::ControlPoints>,
) -> Result<Design, ServiceError> {
    let input = input.map(|input| match input {
        deform_request::Input::Design(array) => design_point::Input::Design(array),
        deform_request::Input::Named(named) => design_point::Input::Named(named),
    });
    design_point("", v1::DesignPoint { input, control_points })
}

/// A design. Errors name fields with `prefix` before them.
pub fn design_point(
    prefix: &str,
    v1::DesignPoint { input, control_points }: v1::DesignPoint,
) -> Result<Design, ServiceError> {
    let values = match input {
        None => Values::default(),
        Some(design_point::Input::Named(named)) => Values::Named(named.values.into_iter().collect()),
        Some(design_point::Input::Design(array)) => {
            let field = format!("{prefix}design");
            let [_] = arrays::shape(&field, &array)?;
            Values::Vector(arrays::float64(&field, &array)?)
        }
    };
    let control_points = control_points.into_iter().map(|v1::ControlPoints { component, points }| {
        let field = format!("{prefix}control_points[\"{component}\"]");
        let array = points.ok_or_else(|| ServiceError::invalid(&field, "has no points"))?;
        Ok((component, arrays::positions(&field, &array)?))
    });
    Ok(Design { values, control_points: control_points.collect::<Result<_, ServiceError>>()? })
}

pub fn deformed(linearised: &Linearised, include_cell_quality: bool) -> v1::DeformResponse {
    let deformation = linearised.deformation();
    v1::DeformResponse {
        vertices: Some(arrays::points(&deformation.vertices)),
        quality: Some(quality(&deformation.quality)),
        linearisation_id: linearised.id().to_owned(),
        timings: Some(status::timings(linearised.timing())),
        residuals: Some(v1::Residuals {
            seam: deformation.seam_residual,
            projection: deformation.projection_residual,
            held: deformation.held_residual,
            projection_steps: deformation.projection_steps as u32,
            crossing_pairs: deformation.crossings.len() as u32,
        }),
        cell_quality: include_cell_quality.then(|| cell_quality(&deformation.cell_quality)),
        functions: Some(arrays::numbers(&[deformation.functions.len()], [&deformation.functions[..]])),
    }
}

fn cell_quality(cells: &[CellQuality]) -> v1::CellQuality {
    let measure = |of: fn(&CellQuality) -> f64| {
        let data = cells.iter().flat_map(|cell| of(cell).to_le_bytes()).collect();
        Some(arrays::array(DataType::Float64, &[cells.len()], data))
    };
    v1::CellQuality {
        aspect_ratio: measure(|cell| cell.aspect_ratio),
        edge_ratio: measure(|cell| cell.edge_ratio),
        scaled_jacobian: measure(|cell| cell.scaled_jacobian),
        skew: measure(|cell| cell.skew),
    }
}

fn quality(report: &QualityReport) -> v1::QualityReport {
    let components = report.per_component.iter().map(|(component, each)| v1::ComponentQuality {
        component: component.clone(),
        summary: Some(summary(each)),
    });
    v1::QualityReport { total: Some(summary(&report.total)), components: components.collect() }
}

fn summary(summary: &Summary) -> v1::QualitySummary {
    v1::QualitySummary {
        cells: summary.cells as u64,
        aspect_ratio: Some(distribution(&summary.aspect_ratio)),
        edge_ratio: Some(distribution(&summary.edge_ratio)),
        min_scaled_jacobian: summary.min_scaled_jacobian,
        min_angle: summary.min_angle,
        max_angle: summary.max_angle,
        skew_p95: summary.skew_p95,
        skew_max: summary.skew_max,
        folded: summary.folded as u64,
        inverted: summary.inverted as u64,
    }
}

fn distribution(&Distribution { p50, p95, p99, max, above_5_percent }: &Distribution) -> v1::Distribution {
    v1::Distribution { p50, p95, p99, max, above_5_percent }
}

#[cfg(test)]
mod tests {
    use super::*;
    use deform_request::Input;

    fn vector(shape: &[u64], bytes: usize, dtype: DataType) -> Option<Input> {
        Some(Input::Design(v1::Array {
            dtype: dtype.into(),
            shape: shape.to_vec(),
            data: vec![0; bytes].into(),
        }))
    }

    #[test]
    fn arrays_that_contradict_themselves_are_refused_by_field() {
        let field = |input| design(input, Vec::new()).unwrap_err().violations[0].field.clone();
        assert_eq!(field(vector(&[2], 15, DataType::Float64)), "design.data");
        assert_eq!(field(vector(&[u64::MAX], 16, DataType::Float64)), "design.data");
        assert_eq!(field(vector(&[1, 2], 16, DataType::Float64)), "design.shape");
        assert_eq!(field(vector(&[], 8, DataType::Float64)), "design.shape");
        assert_eq!(field(vector(&[2], 16, DataType::Uint32)), "design.dtype");
    }

    #[test]
    fn control_points_have_three_columns() {
        let points = |shape: &[u64], bytes| v1::ControlPoints {
            component: "wing".to_owned(),
            points: Some(v1::Array {
                dtype: DataType::Float64.into(),
                shape: shape.to_vec(),
                data: vec![0; bytes].into(),
            }),
        };
        let field = |points| design(None, vec![points]).unwrap_err().violations[0].field.clone();
        assert_eq!(field(points(&[3, 2], 48)), "control_points[\"wing\"].shape[1]");
        assert_eq!(field(points(&[6], 48)), "control_points[\"wing\"].shape");
        let read = design(None, vec![points(&[2, 3], 48)]).unwrap();
        assert_eq!(read.control_points, [("wing".to_owned(), vec![[0.0; 3]; 2])]);
    }
}
