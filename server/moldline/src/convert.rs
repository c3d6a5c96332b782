//! Wire messages to the service's types and back.

pub mod check;

use std::time::SystemTime;

use moldline_deform::Tangent;
use moldline_mesh::{Cell, CellQuality, Distribution, QualityReport, Summary};
use moldline_proto::v1;
use moldline_service::{
    Access, ArchiveKind, At, CacheStatus, ControlPointVectors, Created, Design, Directions, FileEntry,
    Gradients, Linearised, Listed, Page, Product, Progress, Seeds, ServiceError, Session, SessionUpdate,
    SetupSummary, Status, StoredSetup, Tenant, TenantError, Timing, UploadHeader, UploadSource, Values,
    Visibility,
};
use v1::{DataType, create_setup_request::Part, deform_request, design_point};

/// The first message of an upload.
pub fn header(part: v1::CreateSetupRequest) -> Result<UploadHeader, ServiceError> {
    match part.part {
        Some(Part::Header(header)) => upload(header),
        _ => Err(ServiceError::invalid("header", "has to be the first message")),
    }
}

/// What an upload announces.
pub fn upload(header: v1::SetupHeader) -> Result<UploadHeader, ServiceError> {
    let v1::SetupHeader { request_id, setup_file, source, visibility, shared_with } = header;
    let visibility = self::visibility("header.", visibility, shared_with)?;
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
    Ok(UploadHeader { request_id, setup_file, visibility, source })
}

/// Who may use a set-up, if it is said; the fields have `prefix` before them.
pub fn visibility(
    prefix: &str,
    visibility: i32,
    shared_with: Vec<String>,
) -> Result<Option<Visibility>, ServiceError> {
    let field = || format!("{prefix}visibility");
    let chosen = v1::Visibility::try_from(visibility)
        .map_err(|_| ServiceError::invalid(field(), format!("there is no visibility {visibility}")))?;
    if chosen != v1::Visibility::Tenants && !shared_with.is_empty() {
        let description = "names tenants, and so the visibility has to be VISIBILITY_TENANTS";
        return Err(ServiceError::invalid(format!("{prefix}shared_with"), description));
    }
    Ok(match chosen {
        v1::Visibility::Unspecified => None,
        v1::Visibility::Private => Some(Visibility::Private),
        v1::Visibility::Public => Some(Visibility::Public),
        v1::Visibility::Tenants => {
            let tenants = shared_with.iter().enumerate().map(|(index, name)| {
                let refuse = |error: TenantError| {
                    ServiceError::invalid(format!("{prefix}shared_with[{index}]"), error.to_string())
                };
                Tenant::new(name).map_err(refuse)
            });
            Some(Visibility::Tenants(tenants.collect::<Result<_, _>>()?))
        }
    })
}

/// Any later message of an upload.
pub fn chunk(part: v1::CreateSetupRequest) -> Result<v1::SetupChunk, ServiceError> {
    match part.part {
        Some(Part::Chunk(chunk)) => Ok(chunk),
        _ => Err(ServiceError::invalid("chunk", "only chunks follow the header")),
    }
}

pub fn progress(Progress { stage, fraction, message }: Progress) -> v1::Progress {
    v1::Progress { stage: stage.to_owned(), fraction, message }
}

pub fn created(Created { setup, access, built }: &Created) -> v1::CreatedSetup {
    let setup_id = setup.id.to_string();
    v1::CreatedSetup { setup_id, built: *built, setup: Some(description(setup, access)) }
}

pub fn description(setup: &StoredSetup, access: &Access) -> v1::SetupDescription {
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
    let functions = setup.engine.functions().iter().zip(&setup.functions).map(|(function, &value)| {
        v1::Function { name: function.name.clone(), unit: function.unit.to_owned(), value }
    });
    let components = setup.engine.components().iter();
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
        functions: functions.collect(),
        control_point_counts: components.map(|c| c.user_control_point_count() as u64).collect(),
        setup_id: setup.id.to_string(),
        access: Some(self::access(access)),
    }
}

pub fn access(Access { owned, visibility }: &Access) -> v1::SetupAccess {
    let (visibility, shared_with) = match visibility {
        Visibility::Private => (v1::Visibility::Private, Vec::new()),
        Visibility::Public => (v1::Visibility::Public, Vec::new()),
        Visibility::Tenants(tenants) => {
            (v1::Visibility::Tenants, tenants.iter().filter(|_| *owned).map(Tenant::to_string).collect())
        }
    };
    v1::SetupAccess { owned: *owned, visibility: visibility.into(), shared_with }
}

pub fn page(page_size: u32, token: String) -> Page {
    Page { size: page_size as usize, token }
}

pub fn listed_setups(Listed { entries, next }: Listed<SetupSummary>) -> v1::ListSetupsResponse {
    let setups = entries.into_iter().map(|entry| v1::SetupSummary {
        setup_id: entry.id,
        name: entry.name,
        vertex_count: entry.vertices as u64,
        cell_count: entry.cells as u64,
        variable_count: entry.variables as u64,
        created_time: unix_seconds(entry.created),
        access: Some(access(&entry.access)),
    });
    v1::ListSetupsResponse { setups: setups.collect(), next_page_token: next.unwrap_or_default() }
}

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
        created_time: unix_seconds(session.created),
        updated_time: unix_seconds(session.updated),
    }
}

fn stored_design(Design { values, control_points }: Design) -> v1::DesignPoint {
    let input = match values {
        Values::Vector(vector) => design_point::Input::Design(numbers(&[vector.len()], [&vector[..]])),
        Values::Named(values) => {
            design_point::Input::Named(v1::NamedDesign { values: values.into_iter().collect() })
        }
    };
    let given = control_points
        .into_iter()
        .map(|(component, of)| v1::ControlPoints { component, points: Some(points(&of)) });
    v1::DesignPoint { input: Some(input), control_points: given.collect() }
}

pub fn update(request: v1::UpdateSessionRequest) -> Result<SessionUpdate, ServiceError> {
    let v1::UpdateSessionRequest { expected_generation, design, label, request_id, .. } = request;
    let design = design.map(|point| design_point("design.", point)).transpose()?;
    Ok(SessionUpdate { expected_generation, design, label, request_id })
}

fn unix_seconds(time: SystemTime) -> f64 {
    time.duration_since(SystemTime::UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

pub fn status(status: Status) -> v1::GetStatusResponse {
    let cache = |cache: CacheStatus| v1::CacheStatus {
        entries: cache.entries as u64,
        bytes: cache.bytes as u64,
        budget_bytes: cache.budget as u64,
        hits: cache.hits,
        misses: cache.misses,
        evictions: cache.evictions,
    };
    let work = status.work.into_iter().map(|work| v1::Work {
        kind: work.kind.to_owned(),
        tenant: work.tenant.to_string(),
        setup_id: work.setup.unwrap_or_default(),
        session_id: work.session.unwrap_or_default(),
        running: work.running.is_some(),
        age_seconds: work.age.as_secs_f64(),
        running_seconds: work.running.unwrap_or_default().as_secs_f64(),
        stage: work.stage.unwrap_or_default().to_owned(),
        fraction: work.fraction,
    });
    v1::GetStatusResponse {
        version: status.version.to_owned(),
        uptime_seconds: status.uptime.as_secs_f64(),
        all_tenants: status.all_tenants,
        running: status.running as u64,
        queued: status.queued as u64,
        running_limit: status.running_limit as u64,
        queued_limit: status.queued_limit as u64,
        sessions: status.sessions as u64,
        setups_resident: status.setups_resident as u64,
        setups_stored: status.setups_stored as u64,
        stored_bytes: status.stored_bytes,
        setup_cache: Some(cache(status.setup_cache)),
        linearisation_cache: Some(cache(status.linearisation_cache)),
        work: work.collect(),
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

/// Control points of the baseline.
pub fn control_points(setup: &StoredSetup) -> Result<Vec<v1::ControlPoints>, ServiceError> {
    let parameterisation = setup.engine.parameterisation();
    let points_of = parameterisation.control_points(&parameterisation.baseline())?;
    let components = parameterisation.components().iter().zip(&points_of);
    Ok(components
        .map(|(component, of)| v1::ControlPoints { component: component.clone(), points: Some(points(of)) })
        .collect())
}

/// Four vertices; a triangle's fourth is the largest number.
fn corners(cell: &Cell) -> [u32; 4] {
    let mut corners = [u32::MAX; 4];
    corners[..cell.vertices().len()].copy_from_slice(cell.vertices());
    corners
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

/// A design whose fields have `prefix` before them.
pub fn design_point(
    prefix: &str,
    v1::DesignPoint { input, control_points }: v1::DesignPoint,
) -> Result<Design, ServiceError> {
    let values = match input {
        None => Values::default(),
        Some(design_point::Input::Named(named)) => Values::Named(named.values.into_iter().collect()),
        Some(design_point::Input::Design(array)) => {
            let field = format!("{prefix}design");
            let [_] = shape(&field, &array)?;
            Values::Vector(float64(&field, &array)?)
        }
    };
    let control_points = control_points.into_iter().map(|v1::ControlPoints { component, points }| {
        let field = format!("{prefix}control_points[\"{component}\"]");
        let array = points.ok_or_else(|| ServiceError::invalid(&field, "has no points"))?;
        Ok((component, positions(&field, &array)?))
    });
    Ok(Design { values, control_points: control_points.collect::<Result<_, ServiceError>>()? })
}

/// Where a derivative is taken.
pub fn at(point: Option<v1::LinearisationPoint>) -> Result<At, ServiceError> {
    let v1::LinearisationPoint { linearisation_id, design_point: point } = point.unwrap_or_default();
    let design = point.map(|point| design_point("at.design_point.", point)).transpose()?;
    Ok(At { id: (!linearisation_id.is_empty()).then_some(linearisation_id), design })
}

pub fn directions(
    design: Option<v1::Array>,
    control_points: Vec<v1::ControlPointVectors>,
) -> Result<Directions, ServiceError> {
    let design = design.map(|array| vectors("design", &array)).transpose()?;
    let control_points = control_points.into_iter().map(|v1::ControlPointVectors { component, vectors }| {
        let field = format!("control_points[\"{component}\"]");
        let array = vectors.ok_or_else(|| ServiceError::invalid(&field, "has no vectors"))?;
        Ok(ControlPointVectors { vectors: point_vectors(&field, &array)?, component })
    });
    Ok(Directions { design, control_points: control_points.collect::<Result<_, ServiceError>>()? })
}

pub fn seeds(vertices: Option<v1::Array>, functions: Option<v1::Array>) -> Result<Seeds, ServiceError> {
    Ok(Seeds {
        vertices: vertices.map(|array| point_vectors("vertices", &array)).transpose()?,
        functions: functions.map(|array| vectors("functions", &array)).transpose()?,
    })
}

pub fn deformed(linearised: &Linearised, include_cell_quality: bool) -> v1::DeformResponse {
    let deformation = linearised.deformation();
    v1::DeformResponse {
        vertices: Some(points(&deformation.vertices)),
        quality: Some(quality(&deformation.quality)),
        linearisation_id: linearised.id().to_owned(),
        timings: Some(timings(linearised.timing())),
        residuals: Some(v1::Residuals {
            seam: deformation.seam_residual,
            projection: deformation.projection_residual,
            held: deformation.held_residual,
            projection_steps: deformation.projection_steps as u32,
        }),
        cell_quality: include_cell_quality.then(|| cell_quality(&deformation.cell_quality)),
        functions: Some(numbers(&[deformation.functions.len()], [&deformation.functions[..]])),
    }
}

pub fn jvp(product: &Product<Vec<Tangent>>) -> v1::ApplyJacobianVectorResponse {
    let (vertices, functions) = tangents(&product.value);
    v1::ApplyJacobianVectorResponse { vertices, functions, timings: Some(timings(product.timing)) }
}

pub fn vjp(Product { value, timing }: &Product<Gradients>) -> v1::ApplyAdjointResponse {
    let Gradients { design, control_points } = value;
    let control_points = control_points.iter().map(|ControlPointVectors { component, vectors }| {
        let shape = [vectors.len(), vectors.first().map_or(0, Vec::len), 3];
        let array = numbers(&shape, vectors.iter().map(|vector| vector.as_flattened()));
        v1::ControlPointVectors { component: component.clone(), vectors: Some(array) }
    });
    v1::ApplyAdjointResponse {
        design: design.as_ref().map(|design| {
            let shape = [design.len(), design.first().map_or(0, Vec::len)];
            numbers(&shape, design.iter().map(Vec::as_slice))
        }),
        control_points: control_points.collect(),
        timings: Some(timings(*timing)),
    }
}

/// Some of the Jacobian's `columns`, the `first` one and those after it.
pub fn jacobian(first: usize, columns: usize, some: &[Tangent], timing: Timing) -> v1::JacobianResponse {
    let (vertices, functions) = tangents(some);
    let (first, columns) = (first as u32, columns as u32);
    v1::JacobianResponse { first, columns, vertices, functions, timings: Some(timings(timing)) }
}

fn tangents(tangents: &[Tangent]) -> (Option<v1::Array>, Option<v1::Array>) {
    let (vertices, functions) = tangents.first().map_or((0, 0), |t| (t.vertices.len(), t.functions.len()));
    let of_vertices = tangents.iter().map(|tangent| tangent.vertices.as_flattened());
    let of_functions = tangents.iter().map(|tangent| &tangent.functions[..]);
    (
        Some(numbers(&[tangents.len(), vertices, 3], of_vertices)),
        Some(numbers(&[tangents.len(), functions], of_functions)),
    )
}

pub fn timings(Timing { queued, engine }: Timing) -> v1::Timings {
    v1::Timings { queue_seconds: queued.as_secs_f64(), engine_seconds: engine.as_secs_f64() }
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

pub fn points(points: &[[f64; 3]]) -> v1::Array {
    numbers(&[points.len(), 3], [points.as_flattened()])
}

/// An array whose elements are those of `parts`, one after the other.
pub fn numbers<'a>(shape: &[usize], parts: impl IntoIterator<Item = &'a [f64]>) -> v1::Array {
    let mut data = Vec::with_capacity(size_of::<f64>() * shape.iter().product::<usize>());
    for part in parts {
        if cfg!(target_endian = "little") {
            data.extend_from_slice(bytemuck::cast_slice(part));
        } else {
            part.iter().for_each(|value| data.extend_from_slice(&value.to_le_bytes()));
        }
    }
    array(DataType::Float64, shape, data)
}

pub fn array(dtype: DataType, shape: &[usize], data: Vec<u8>) -> v1::Array {
    let shape = shape.iter().map(|&extent| extent as u64).collect();
    v1::Array { dtype: dtype.into(), shape, data: data.into() }
}

/// The extents, if there are `N` of them and the data have as many elements.
pub fn shape<const N: usize>(field: &str, array: &v1::Array) -> Result<[u64; N], ServiceError> {
    extents(field, array, size_of::<f64>() as u64)
}

/// The same for elements of any size.
fn extents<const N: usize>(field: &str, array: &v1::Array, element: u64) -> Result<[u64; N], ServiceError> {
    let shape: [u64; N] = array.shape.as_slice().try_into().map_err(|_| {
        let found = array.shape.len();
        ServiceError::invalid(format!("{field}.shape"), format!("{found} dimensions, expected {N}"))
    })?;
    let bytes = shape.iter().try_fold(element, |bytes, &extent| bytes.checked_mul(extent));
    if bytes != Some(array.data.len() as u64) {
        return Err(ServiceError::invalid(
            format!("{field}.data"),
            format!("{} bytes do not fill the shape {shape:?} of {element}-byte elements", array.data.len()),
        ));
    }
    Ok(shape)
}

/// Rows of `C` indices each.
pub fn index_rows<const C: usize>(field: &str, array: &v1::Array) -> Result<Vec<[u32; C]>, ServiceError> {
    let [_, columns] = extents(field, array, size_of::<u32>() as u64)?;
    if columns != C as u64 {
        return Err(ServiceError::invalid(format!("{field}.shape[1]"), format!("{columns} is not {C}")));
    }
    let flat = of_indices(field, array)?;
    Ok(flat.as_chunks::<C>().0.to_vec())
}

/// A list of indices.
pub fn indices(field: &str, array: &v1::Array) -> Result<Vec<u32>, ServiceError> {
    let [_] = extents(field, array, size_of::<u32>() as u64)?;
    of_indices(field, array)
}

fn of_indices(field: &str, array: &v1::Array) -> Result<Vec<u32>, ServiceError> {
    if array.dtype() != DataType::Uint32 {
        return Err(ServiceError::invalid(
            format!("{field}.dtype"),
            format!("{} is not DATA_TYPE_UINT32", array.dtype().as_str_name()),
        ));
    }
    Ok(array.data.as_chunks::<4>().0.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect())
}

/// Positions: (n, 3).
pub fn positions(field: &str, array: &v1::Array) -> Result<Vec<[f64; 3]>, ServiceError> {
    let [_, columns] = shape(field, array)?;
    if columns != 3 {
        return Err(ServiceError::invalid(format!("{field}.shape[1]"), format!("{columns} is not 3")));
    }
    check_float64(field, array)?;
    Ok(of_points(&array.data))
}

/// # Errors
/// `InvalidArgument` for elements of another type.
pub fn check_float64(field: &str, array: &v1::Array) -> Result<(), ServiceError> {
    if array.dtype() != DataType::Float64 {
        return Err(ServiceError::invalid(
            format!("{field}.dtype"),
            format!("{} is not DATA_TYPE_FLOAT64", array.dtype().as_str_name()),
        ));
    }
    Ok(())
}

/// Little-endian numbers of any alignment, one by one or in points.
pub fn elements<T: bytemuck::Pod>(bytes: &[u8], swap: impl Fn(&mut T)) -> Vec<T> {
    let mut elements = vec![T::zeroed(); bytes.len() / size_of::<T>()];
    let filled = size_of_val(&elements[..]);
    bytemuck::cast_slice_mut(&mut elements).copy_from_slice(&bytes[..filled]);
    if cfg!(target_endian = "big") {
        elements.iter_mut().for_each(swap);
    }
    elements
}

pub fn of_numbers(bytes: &[u8]) -> Vec<f64> {
    elements(bytes, |number: &mut f64| *number = f64::from_bits(number.to_bits().swap_bytes()))
}

pub fn of_points(bytes: &[u8]) -> Vec<[f64; 3]> {
    elements(bytes, |point: &mut [f64; 3]| {
        point.iter_mut().for_each(|number| *number = f64::from_bits(number.to_bits().swap_bytes()));
    })
}

pub fn float64(field: &str, array: &v1::Array) -> Result<Vec<f64>, ServiceError> {
    check_float64(field, array)?;
    Ok(of_numbers(&array.data))
}

/// Vectors of numbers: (k, length).
pub fn vectors(field: &str, array: &v1::Array) -> Result<Vec<Vec<f64>>, ServiceError> {
    let [_, length] = filled(field, array)?;
    check_float64(field, array)?;
    Ok(array.data.chunks_exact(size_of::<f64>() * length).map(of_numbers).collect())
}

/// Vectors of points: (k, length, 3).
pub fn point_vectors(field: &str, array: &v1::Array) -> Result<Vec<Vec<[f64; 3]>>, ServiceError> {
    let [_, length, columns] = filled(field, array)?;
    if columns != 3 {
        return Err(ServiceError::invalid(format!("{field}.shape[2]"), format!("{columns} is not 3")));
    }
    check_float64(field, array)?;
    Ok(array.data.chunks_exact(size_of::<[f64; 3]>() * length).map(of_points).collect())
}

/// The extents, none of which is zero.
fn filled<const N: usize>(field: &str, array: &v1::Array) -> Result<[usize; N], ServiceError> {
    let shape = shape(field, array)?;
    match shape.iter().position(|&extent| extent == 0) {
        Some(axis) => Err(ServiceError::invalid(format!("{field}.shape[{axis}]"), "0 is not positive")),
        // There is a byte for each at least.
        None => Ok(shape.map(|extent| extent as usize)),
    }
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

    #[test]
    fn blocks_of_vectors_have_the_right_number_of_filled_dimensions() {
        let array = |shape: &[u64]| v1::Array {
            dtype: DataType::Float64.into(),
            shape: shape.to_vec(),
            data: vec![0; 8 * shape.iter().product::<u64>() as usize].into(),
        };
        let field = |error: ServiceError| error.violations[0].field.clone();
        for (shape, expected) in [
            (&[2][..], "design.shape"),
            (&[0, 2], "design.shape[0]"),
            (&[u64::MAX, 0], "design.data"),
            (&[1, 2, 3], "design.shape"),
        ] {
            let empty = v1::Array { data: Vec::new().into(), ..v1::Array::default() };
            let sized = if shape.contains(&0) { empty } else { array(shape) };
            let sized = v1::Array { shape: shape.to_vec(), dtype: DataType::Float64.into(), ..sized };
            assert_eq!(field(directions(Some(sized), Vec::new()).unwrap_err()), expected);
        }
        let error = seeds(Some(array(&[1, 3, 2])), None).unwrap_err();
        assert_eq!(field(error), "vertices.shape[2]");
        let read = seeds(Some(array(&[2, 5, 3])), Some(array(&[2, 4]))).unwrap();
        assert_eq!(read.vertices, Some(vec![vec![[0.0; 3]; 5]; 2]));
        assert_eq!(read.functions, Some(vec![vec![0.0; 4]; 2]));
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
