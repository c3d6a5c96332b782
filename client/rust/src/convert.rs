//! Conversions between messages of the protocol and the model.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use moldline_proto::v1::{self, Array, DataType, check_request, deform_request, design_point};

use crate::{
    At, CacheStatus, CellQuality, ControlPoints, Deformation, Design, DesignPoint, Distribution, Error,
    Function, LeftOut, Linearisation, Mesh, Point, QualityReport, QualitySummary, Residuals, SessionState,
    SetupAccess, SetupFacts, SetupSummary, Status, Timings, Variable, VariableGroup, Visibility, Work,
};

/// A float64 array; the product of `shape` is the number of values.
pub fn array(values: &[f64], shape: &[usize]) -> Array {
    let mut data = Vec::with_capacity(size_of_val(values));
    values.iter().for_each(|value| data.extend_from_slice(&value.to_le_bytes()));
    let shape = shape.iter().map(|&extent| extent as u64).collect();
    Array { dtype: DataType::Float64.into(), shape, data: data.into() }
}

/// A uint32 array; the product of `shape` is the number of values.
pub fn index_array(values: &[u32], shape: &[usize]) -> Array {
    let data: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    let shape = shape.iter().map(|&extent| extent as u64).collect();
    Array { dtype: DataType::Uint32.into(), shape, data: data.into() }
}

/// Items of N bytes each: elements of `width` bytes, or groups of them.
fn items<const N: usize, T>(
    array: Option<&Array>,
    dtype: DataType,
    width: usize,
    item: impl Fn(&[u8; N]) -> T,
) -> Result<Vec<T>, Error> {
    let array = array.ok_or_else(|| missing("an array"))?;
    let (bytes, rest) = array.data.as_chunks::<N>();
    let length =
        array.shape.iter().try_fold(width, |length, &extent| length.checked_mul(extent.try_into().ok()?));
    if array.dtype() != dtype || length != Some(array.data.len()) || !rest.is_empty() {
        return Err(Error::internal("the server sent an array that contradicts itself"));
    }
    Ok(bytes.iter().map(item).collect())
}

/// Values of a float64 array.
pub fn numbers(array: Option<&Array>) -> Result<Vec<f64>, Error> {
    items(array, DataType::Float64, 8, |&bytes| f64::from_le_bytes(bytes))
}

/// Points of a float64 array with last extent 3.
pub fn points(array: Option<&Array>) -> Result<Vec<Point>, Error> {
    items(array, DataType::Float64, 8, |bytes: &[u8; 24]| {
        let (coordinates, _) = bytes.as_chunks();
        [0, 1, 2].map(|axis| f64::from_le_bytes(coordinates[axis]))
    })
}

/// Pairs of a float64 array with last extent 2.
pub fn pairs(array: Option<&Array>) -> Result<Vec<[f64; 2]>, Error> {
    items(array, DataType::Float64, 8, |bytes: &[u8; 16]| {
        let (parts, _) = bytes.as_chunks();
        [0, 1].map(|part| f64::from_le_bytes(parts[part]))
    })
}

/// Values of a uint32 array.
pub fn indices(array: Option<&Array>) -> Result<Vec<u32>, Error> {
    items(array, DataType::Uint32, 4, |&bytes| u32::from_le_bytes(bytes))
}

/// Pairs of a uint32 array with last extent 2.
pub fn index_pairs(array: Option<&Array>) -> Result<Vec<[u32; 2]>, Error> {
    items(array, DataType::Uint32, 4, |bytes: &[u8; 8]| {
        let (parts, _) = bytes.as_chunks();
        [0, 1].map(|part| u32::from_le_bytes(parts[part]))
    })
}

/// A point given as a list.
pub fn point(values: &[f64]) -> Result<Point, Error> {
    values
        .try_into()
        .map_err(|_| Error::internal("the server sent a vector that does not have three components"))
}

pub fn setup_facts(message: Option<v1::SetupDescription>, built: bool) -> Result<SetupFacts, Error> {
    let message = message.ok_or_else(|| missing("a description"))?;
    let variables = message.variables.into_iter().map(|v| Variable {
        name: v.name,
        unit: v.unit,
        baseline: v.baseline,
        lower: v.lower,
        upper: v.upper,
    });
    let groups = message.groups.into_iter().map(|group| VariableGroup {
        name: group.name,
        first: group.first as usize,
        shape: group.shape.iter().map(|&extent| extent as usize).collect(),
    });
    let functions =
        message.functions.into_iter().map(|f| Function { name: f.name, unit: f.unit, value: f.value });
    Ok(SetupFacts {
        id: message.setup_id,
        built,
        name: message.name,
        access: access(message.access),
        report_text: message.report_text,
        report_json: message.report_json,
        variables: variables.collect(),
        groups: groups.collect(),
        components: message.components,
        control_point_counts: message.control_point_counts.iter().map(|&count| count as usize).collect(),
        functions: functions.collect(),
        vertex_count: message.vertex_count as usize,
        cell_count: message.cell_count as usize,
        turned_cell_count: message.turned_cell_count as usize,
        left_out: message.left_out.map_or_else(LeftOut::default, |of| LeftOut {
            nodes: of.nodes as usize,
            merged_nodes: of.merged_nodes as usize,
            other_cells: of.other_cells as usize,
            collapsed_cells: of.collapsed_cells as usize,
        }),
        build_time: seconds(message.build_seconds),
    })
}

pub fn access(message: Option<v1::SetupAccess>) -> SetupAccess {
    let message = message.unwrap_or_default();
    let visibility = match message.visibility() {
        v1::Visibility::Tenants => Visibility::Tenants,
        v1::Visibility::Public => Visibility::Public,
        v1::Visibility::Private | v1::Visibility::Unspecified => Visibility::Private,
    };
    SetupAccess { owned: message.owned, visibility, shared_with: message.shared_with }
}

pub fn visibility(visibility: Visibility) -> v1::Visibility {
    match visibility {
        Visibility::Private => v1::Visibility::Private,
        Visibility::Tenants => v1::Visibility::Tenants,
        Visibility::Public => v1::Visibility::Public,
    }
}

pub fn setup_summary(message: v1::SetupSummary) -> SetupSummary {
    SetupSummary {
        id: message.setup_id,
        name: message.name,
        vertex_count: message.vertex_count as usize,
        cell_count: message.cell_count as usize,
        variable_count: message.variable_count as usize,
        created: time(message.created_time),
        access: access(message.access),
    }
}

pub fn mesh(message: Option<v1::Mesh>) -> Result<Mesh, Error> {
    let message = message.ok_or_else(|| missing("a mesh"))?;
    Ok(Mesh {
        vertices: points(message.vertices.as_ref())?,
        cells: items(message.cells.as_ref(), DataType::Uint32, 4, |bytes: &[u8; 16]| {
            let (corners, _) = bytes.as_chunks();
            [0, 1, 2, 3].map(|corner| u32::from_le_bytes(corners[corner]))
        })?,
        cell_owner: indices(message.cell_owner.as_ref())?,
        seam: items(message.seam.as_ref(), DataType::Uint8, 1, |&[seam]| seam != 0)?,
    })
}

pub fn control_points(messages: &[v1::ControlPoints]) -> Result<ControlPoints, Error> {
    messages.iter().map(|each| Ok((each.component.clone(), points(each.points.as_ref())?))).collect()
}

pub fn session_state(message: Option<v1::Session>) -> Result<SessionState, Error> {
    let message = message.ok_or_else(|| missing("a session"))?;
    let design = |point: v1::DesignPoint| {
        let design = match point.input {
            None => Design::Baseline,
            Some(design_point::Input::Design(array)) => Design::Vector(numbers(Some(&array))?),
            Some(design_point::Input::Named(named)) => Design::Named(named.values.into_iter().collect()),
        };
        Ok::<_, Error>(DesignPoint { design, control_points: control_points(&point.control_points)? })
    };
    Ok(SessionState {
        id: message.session_id,
        setup_id: message.setup_id,
        generation: message.generation,
        design: message.design.map(design).transpose()?,
        label: message.label,
        created: time(message.created_time),
        updated: time(message.updated_time),
    })
}

/// A design as a message, of which every request has an enumeration of its own.
pub enum Input {
    Vector(Array),
    Named(v1::NamedDesign),
}

/// A design as a message; nothing for the baseline.
pub fn design(design: &Design) -> Option<Input> {
    match design {
        Design::Baseline => None,
        Design::Vector(values) => Some(Input::Vector(array(values, &[values.len()]))),
        Design::Named(values) => {
            let values = values.iter().map(|(name, value)| (name.clone(), *value)).collect();
            Some(Input::Named(v1::NamedDesign { values }))
        }
    }
}

impl From<Input> for design_point::Input {
    fn from(input: Input) -> Self {
        match input {
            Input::Vector(array) => Self::Design(array),
            Input::Named(named) => Self::Named(named),
        }
    }
}

impl From<Input> for deform_request::Input {
    fn from(input: Input) -> Self {
        match input {
            Input::Vector(array) => Self::Design(array),
            Input::Named(named) => Self::Named(named),
        }
    }
}

impl From<Input> for check_request::At {
    fn from(input: Input) -> Self {
        match input {
            Input::Vector(array) => Self::Design(array),
            Input::Named(named) => Self::Named(named),
        }
    }
}

fn given_control_points(points: &ControlPoints) -> Vec<v1::ControlPoints> {
    let message = |(component, points): (&String, &Vec<Point>)| v1::ControlPoints {
        component: component.clone(),
        points: Some(array(points.as_flattened(), &[points.len(), 3])),
    };
    points.iter().map(message).collect()
}

pub fn design_point(point: &DesignPoint) -> v1::DesignPoint {
    v1::DesignPoint {
        input: design(&point.design).map(Into::into),
        control_points: given_control_points(&point.control_points),
    }
}

pub fn deform_request(
    session_id: String,
    point: &DesignPoint,
    include_cell_quality: bool,
) -> v1::DeformRequest {
    v1::DeformRequest {
        session_id,
        input: design(&point.design).map(Into::into),
        control_points: given_control_points(&point.control_points),
        include_cell_quality,
    }
}

/// The id, if any, and the design, from which the server recomputes a linearisation that it no longer holds.
pub fn at(at: &At) -> v1::LinearisationPoint {
    let (linearisation_id, point) = match at {
        At::Linearisation(linearisation) => (linearisation.id.clone(), Some(&linearisation.point)),
        At::Point(point) => (String::new(), Some(point)),
        At::Held(id) => (id.clone(), None),
        At::Baseline => (String::new(), Some(&DesignPoint::default())),
    };
    v1::LinearisationPoint { linearisation_id, design_point: point.map(design_point) }
}

pub fn deformation(message: v1::DeformResponse, point: DesignPoint) -> Result<Deformation, Error> {
    let residuals = message.residuals.unwrap_or_default();
    let report = message.quality.unwrap_or_default();
    let components = report.components.into_iter().map(|each| (each.component, quality(each.summary)));
    Ok(Deformation {
        vertices: points(message.vertices.as_ref())?,
        functions: numbers(message.functions.as_ref())?,
        linearisation: Linearisation { id: message.linearisation_id, point },
        quality: QualityReport { total: quality(report.total), components: components.collect() },
        cell_quality: message.cell_quality.map(cell_quality).transpose()?,
        residuals: Residuals {
            seam: residuals.seam,
            held: residuals.held,
            projection: residuals.projection,
            projection_steps: residuals.projection_steps,
            crossing_pairs: residuals.crossing_pairs,
        },
        timings: timings(message.timings),
    })
}

fn quality(message: Option<v1::QualitySummary>) -> QualitySummary {
    let message = message.unwrap_or_default();
    QualitySummary {
        cells: message.cells as usize,
        aspect_ratio: distribution(message.aspect_ratio),
        edge_ratio: distribution(message.edge_ratio),
        min_scaled_jacobian: message.min_scaled_jacobian,
        min_angle: message.min_angle,
        max_angle: message.max_angle,
        skew_p95: message.skew_p95,
        skew_max: message.skew_max,
        folded: message.folded as usize,
        inverted: message.inverted as usize,
    }
}

fn distribution(message: Option<v1::Distribution>) -> Distribution {
    let v1::Distribution { p50, p95, p99, max, above_5_percent } = message.unwrap_or_default();
    Distribution { p50, p95, p99, max, above_5_percent }
}

fn cell_quality(message: v1::CellQuality) -> Result<CellQuality, Error> {
    Ok(CellQuality {
        aspect_ratio: numbers(message.aspect_ratio.as_ref())?,
        edge_ratio: numbers(message.edge_ratio.as_ref())?,
        scaled_jacobian: numbers(message.scaled_jacobian.as_ref())?,
        skew: numbers(message.skew.as_ref())?,
    })
}

pub fn timings(message: Option<v1::Timings>) -> Timings {
    let message = message.unwrap_or_default();
    Timings { queue: seconds(message.queue_seconds), engine: seconds(message.engine_seconds) }
}

pub fn status(message: v1::GetStatusResponse) -> Status {
    let work = message.work.into_iter().map(|w| Work {
        kind: w.kind,
        tenant: w.tenant,
        setup_id: w.setup_id,
        session_id: w.session_id,
        running: w.running,
        age: seconds(w.age_seconds),
        running_for: seconds(w.running_seconds),
        stage: w.stage,
        fraction: w.fraction,
    });
    Status {
        version: message.version,
        uptime: seconds(message.uptime_seconds),
        all_tenants: message.all_tenants,
        running: message.running,
        queued: message.queued,
        running_limit: message.running_limit,
        queued_limit: message.queued_limit,
        sessions: message.sessions,
        setups_resident: message.setups_resident,
        setups_stored: message.setups_stored,
        stored_bytes: message.stored_bytes,
        setup_cache: cache(message.setup_cache),
        linearisation_cache: cache(message.linearisation_cache),
        work: work.collect(),
    }
}

fn cache(message: Option<v1::CacheStatus>) -> CacheStatus {
    let v1::CacheStatus { entries, bytes, budget_bytes, hits, misses, evictions } =
        message.unwrap_or_default();
    CacheStatus { entries, bytes, budget_bytes, hits, misses, evictions }
}

pub fn missing(what: &str) -> Error {
    Error::internal(format!("the server's answer lacks {what}"))
}

fn time(seconds_since_1970: f64) -> SystemTime {
    UNIX_EPOCH + seconds(seconds_since_1970)
}

/// Zero if the server sent a value that is not a duration.
fn seconds(value: f64) -> Duration {
    Duration::try_from_secs_f64(value).unwrap_or_default()
}
