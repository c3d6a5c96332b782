//! Wire messages to the service's types and back.

use moldline_mesh::{Cell, CellQuality, Distribution, QualityReport, Summary};
use moldline_proto::v1;
use moldline_service::{
    ArchiveKind, Created, Deformed, Design, FileEntry, Progress, ServiceError, StoredSetup, UploadHeader,
    UploadSource, Values,
};
use v1::{DataType, create_setup_request::Part, create_setup_response::Event, deform_request::Input};

/// The first message of an upload.
pub fn header(part: v1::CreateSetupRequest) -> Result<UploadHeader, ServiceError> {
    let Some(Part::Header(v1::SetupHeader { request_id, setup_file, source })) = part.part else {
        return Err(ServiceError::invalid("header", "has to be the first message"));
    };
    let source = match source {
        Some(v1::setup_header::Source::Files(list)) => {
            let files = list.files.into_iter().map(|v1::FileEntry { path, size }| FileEntry { path, size });
            UploadSource::Files(files.collect())
        }
        Some(v1::setup_header::Source::Archive(archive)) => {
            let kind = match archive.kind() {
                v1::ArchiveKind::Tar => ArchiveKind::Tar,
                v1::ArchiveKind::TarGz => ArchiveKind::TarGz,
                v1::ArchiveKind::Zip => ArchiveKind::Zip,
                v1::ArchiveKind::Unspecified => {
                    return Err(ServiceError::invalid("header.archive.kind", "has to be tar, tar.gz or zip"));
                }
            };
            UploadSource::Archive { kind, size: archive.size }
        }
        None => return Err(ServiceError::invalid("header.source", "is missing: name files or an archive")),
    };
    let setup_file = (!setup_file.is_empty()).then_some(setup_file);
    Ok(UploadHeader { request_id, setup_file, source })
}

/// Any later message of an upload.
pub fn chunk(part: v1::CreateSetupRequest) -> Result<v1::SetupChunk, ServiceError> {
    match part.part {
        Some(Part::Chunk(chunk)) => Ok(chunk),
        _ => Err(ServiceError::invalid("chunk", "only chunks follow the header")),
    }
}

pub fn progress(Progress { stage, fraction, message }: Progress) -> v1::CreateSetupResponse {
    let progress = v1::Progress { stage: stage.to_owned(), fraction, message };
    v1::CreateSetupResponse { event: Some(Event::Progress(progress)) }
}

pub fn created(Created { setup, built }: &Created) -> v1::CreateSetupResponse {
    let created =
        v1::CreatedSetup { setup_id: setup.id.to_string(), built: *built, setup: Some(description(setup)) };
    v1::CreateSetupResponse { event: Some(Event::Created(created)) }
}

pub fn description(setup: &StoredSetup) -> v1::SetupDescription {
    let parameterisation = setup.engine.parameterisation();
    let variables = parameterisation.variables().iter().map(|variable| v1::Variable {
        name: variable.name.clone(),
        unit: variable.unit.symbol().to_owned(),
        baseline: variable.baseline,
        lower: variable.lower,
        upper: variable.upper,
    });
    let groups = parameterisation.groups().iter().map(|group| v1::VariableGroup {
        name: group.name.clone(),
        first: group.range.start as u32,
        shape: group.shape.iter().map(|&extent| extent as u32).collect(),
    });
    v1::SetupDescription {
        name: setup.name.clone(),
        report_json: setup.report_json(),
        report_text: setup.engine.report().to_string(),
        variables: variables.collect(),
        groups: groups.collect(),
        components: parameterisation.components().to_vec(),
        vertex_count: setup.engine.mesh().vertices.len() as u64,
        cell_count: setup.engine.mesh().cells.len() as u64,
        build_seconds: setup.build_time.as_secs_f64(),
    }
}

pub fn mesh(setup: &StoredSetup) -> v1::Mesh {
    let mesh = setup.engine.mesh();
    let mut seam = vec![0_u8; mesh.vertices.len()];
    for vertex in setup.engine.seam_vertices() {
        seam[vertex as usize] = 1;
    }
    let cells = mesh.cells.iter().flat_map(corners).flat_map(u32::to_le_bytes).collect();
    let owner: Vec<u8> = setup.engine.cell_owner().iter().flat_map(|owner| owner.to_le_bytes()).collect();
    v1::Mesh {
        vertices: Some(points(&mesh.vertices)),
        cells: Some(array(DataType::Uint32, &[mesh.cells.len(), 4], cells)),
        cell_owner: Some(array(DataType::Uint32, &[mesh.cells.len()], owner)),
        seam: Some(array(DataType::Uint8, &[seam.len()], seam)),
    }
}

/// Four vertices; a triangle's fourth is the largest number.
fn corners(cell: &Cell) -> [u32; 4] {
    let mut corners = [u32::MAX; 4];
    corners[..cell.vertices().len()].copy_from_slice(cell.vertices());
    corners
}

pub fn design(input: Option<Input>, control_points: Vec<v1::ControlPoints>) -> Result<Design, ServiceError> {
    let values = match input {
        None => Values::default(),
        Some(Input::Named(named)) => Values::Named(named.values.into_iter().collect()),
        Some(Input::Design(array)) => {
            let [_] = shape("design", &array)?;
            Values::Vector(float64("design", &array)?)
        }
    };
    let control_points = control_points.into_iter().map(|v1::ControlPoints { component, points }| {
        let field = format!("control_points[\"{component}\"]");
        let array = points.ok_or_else(|| ServiceError::invalid(&field, "has no points"))?;
        let [_, columns] = shape(&field, &array)?;
        if columns != 3 {
            return Err(ServiceError::invalid(format!("{field}.shape[1]"), format!("{columns} is not 3")));
        }
        Ok((component, float64(&field, &array)?.as_chunks::<3>().0.to_vec()))
    });
    Ok(Design { values, control_points: control_points.collect::<Result<_, ServiceError>>()? })
}

pub fn deformed(deformed: &Deformed, include_cell_quality: bool) -> v1::DeformResponse {
    let deformation = &deformed.deformation;
    v1::DeformResponse {
        vertices: Some(points(&deformation.vertices)),
        quality: Some(quality(&deformation.quality)),
        linearisation_id: deformed.linearisation_id.clone(),
        timings: Some(v1::Timings {
            queue_seconds: deformed.queued.as_secs_f64(),
            engine_seconds: deformed.engine.as_secs_f64(),
        }),
        residuals: Some(v1::Residuals {
            seam: deformation.seam_residual,
            projection: deformation.projection_residual,
            held: deformation.held_residual,
            projection_steps: deformation.projection_steps as u32,
        }),
        cell_quality: include_cell_quality.then(|| cell_quality(&deformation.cell_quality)),
    }
}

fn cell_quality(cells: &[CellQuality]) -> v1::CellQuality {
    let measure = |of: fn(&CellQuality) -> f64| {
        let data = cells.iter().flat_map(|cell| of(cell).to_le_bytes()).collect();
        Some(array(DataType::Float64, &[cells.len()], data))
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

fn points(points: &[[f64; 3]]) -> v1::Array {
    let data = points.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
    array(DataType::Float64, &[points.len(), 3], data)
}

fn array(dtype: DataType, shape: &[usize], data: Vec<u8>) -> v1::Array {
    let shape = shape.iter().map(|&extent| extent as u64).collect();
    v1::Array { dtype: dtype.into(), shape, data: data.into() }
}

/// The extents, if there are `N` of them and the data have as many elements.
fn shape<const N: usize>(field: &str, array: &v1::Array) -> Result<[u64; N], ServiceError> {
    const BYTES: u64 = size_of::<f64>() as u64;
    let shape: [u64; N] = array.shape.as_slice().try_into().map_err(|_| {
        let found = array.shape.len();
        ServiceError::invalid(format!("{field}.shape"), format!("{found} dimensions, expected {N}"))
    })?;
    let bytes = shape.iter().try_fold(BYTES, |bytes, &extent| bytes.checked_mul(extent));
    if bytes != Some(array.data.len() as u64) {
        return Err(ServiceError::invalid(
            format!("{field}.data"),
            format!("{} bytes do not fill the shape {shape:?} of 8-byte elements", array.data.len()),
        ));
    }
    Ok(shape)
}

fn float64(field: &str, array: &v1::Array) -> Result<Vec<f64>, ServiceError> {
    if array.dtype() != DataType::Float64 {
        return Err(ServiceError::invalid(
            format!("{field}.dtype"),
            format!("{} is not DATA_TYPE_FLOAT64", array.dtype().as_str_name()),
        ));
    }
    Ok(array.data.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn triangles_are_marked_by_their_fourth_vertex() {
        assert_eq!(corners(&Cell::triangle(1, 2, 3)), [1, 2, 3, u32::MAX]);
        assert_eq!(corners(&Cell::quad(1, 2, 3, 4)), [1, 2, 3, 4]);
    }

    #[test]
    fn points_are_little_endian_rows() {
        let array = points(&[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
        assert_eq!(array.shape, [2, 3]);
        assert_eq!(array.data[8..16], 2.0_f64.to_le_bytes());
    }
}
