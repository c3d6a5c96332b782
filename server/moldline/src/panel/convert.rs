//! Conversions between the messages of the protocol and the types of the panel method and its service.

use moldline_host::ServiceError;
use moldline_mesh::{Cell, Group, Limits, MeshError};
use moldline_panel::{
    Analysis, EdgeLine, Flow, Inputs, LeftOut, Loads, Options, Outputs, PanelError, Reference, Scalars,
    Section, TrailingEdges, Warning,
};
use moldline_panel_service::{Analysed, AnalysisPoint, Configuration, Definition, Geometry, Merging};
use moldline_proto::v1;
use v1::trailing_edges::Rule;

use super::choices::{ON_DOUBT, SOLVERS, SYMMETRIES, of_message, to_message};
use crate::convert::{
    arrays::{
        float64, index_array, index_rows, indices, numbers, point_vectors, points, positions, shape, vectors,
    },
    status::timings,
};

/// A mesh and its options. Counts are checked before anything is copied.
pub fn definition(
    request: v1::CreateConfigurationRequest,
    limits: &Limits,
) -> Result<Definition, ServiceError> {
    let v1::CreateConfigurationRequest { cells, vertices, cell_groups, vertex_groups, options } = request;
    let missing = |field: &str| ServiceError::invalid(field, "is missing");
    let cells = cells.ok_or_else(|| missing("cells"))?;
    let vertices = vertices.ok_or_else(|| missing("vertices"))?;
    let counts = [
        ("cells", cells.shape.first().copied().unwrap_or(0), limits.cells),
        ("vertices", vertices.shape.first().copied().unwrap_or(0), limits.vertices),
        ("cell groups", cell_groups.len() as u64, limits.groups),
        ("vertex groups", vertex_groups.len() as u64, limits.groups),
    ];
    for (what, count, limit) in counts {
        if count > limit as u64 {
            let count = usize::try_from(count).unwrap_or(usize::MAX);
            return Err(PanelError::from(MeshError::TooMany { what, count, limit }).into());
        }
    }
    // The mesh marks a triangle's missing vertex by the same number.
    let cells = index_rows::<4>("cells", &cells)?.into_iter().map(|[a, b, c, d]| Cell::quad(a, b, c, d));
    Ok(Definition {
        cells: cells.collect(),
        vertices: positions("vertices", &vertices)?,
        cell_groups: groups("cell_groups", cell_groups)?,
        vertex_groups: groups("vertex_groups", vertex_groups)?,
        merge_tolerance: options.as_ref().and_then(|options| options.merge_tolerance),
        options: self::options(options.unwrap_or_default())?,
    })
}

fn groups(field: &str, groups: Vec<v1::IndexGroup>) -> Result<Vec<Group>, ServiceError> {
    let group = |v1::IndexGroup { name, indices: list }| {
        let field = format!("{field}[\"{name}\"].indices");
        let mut indices = indices(&field, &list.unwrap_or_else(|| index_array(&[0], &[])))?;
        indices.sort_unstable();
        indices.dedup();
        Ok(Group { name, indices })
    };
    groups.into_iter().map(group).collect()
}

fn options(options: v1::PanelOptions) -> Result<Options, ServiceError> {
    let unknown =
        |field: &str, value: i32| ServiceError::invalid(field, format!("there is no choice {value}"));
    let symmetry = of_message(&SYMMETRIES, options.symmetry);
    let symmetry = symmetry.ok_or_else(|| unknown("options.symmetry", options.symmetry))?;
    let solver = of_message(&SOLVERS, options.solver);
    let solver = solver.ok_or_else(|| unknown("options.solver", options.solver))?;
    let defaults = Options::default();
    let on_doubt = match options.on_doubt {
        0 => defaults.on_doubt,
        value => of_message(&ON_DOUBT, value).ok_or_else(|| unknown("options.on_doubt", value))?,
    };
    let trailing_edges = match options.trailing_edges.and_then(|edges| edges.rule) {
        None => defaults.trailing_edges,
        Some(Rule::None(v1::NoTrailingEdges {})) => TrailingEdges::None,
        Some(Rule::Edges(edges)) => TrailingEdges::Edges(index_rows("options.trailing_edges.edges", &edges)?),
        Some(Rule::Groups(groups)) => TrailingEdges::Groups(groups.names),
        Some(Rule::Angle(degrees)) => TrailingEdges::Angle { degrees },
    };
    Ok(Options {
        symmetry,
        trailing_edges,
        components: options.components.map(|components| components.names),
        solver,
        tolerance: options.tolerance.unwrap_or(defaults.tolerance),
        on_doubt,
        memory_limit: defaults.memory_limit,
    })
}

pub fn configuration(configuration: &Configuration) -> v1::Configuration {
    let summary = &configuration.summary;
    let edges = &summary.trailing_edges;
    v1::Configuration {
        configuration_id: configuration.id.clone(),
        vertex_count: configuration.vertices.len() as u64,
        cell_count: configuration.cells as u64,
        unknowns: summary.unknowns as u64,
        symmetric: summary.symmetric,
        trailing_edges: Some(index_array(&[edges.len(), 2], edges.as_flattened())),
        roots: Some(index_array(&[summary.roots.len()], &summary.roots)),
        solver: to_message(&SOLVERS, summary.solver),
        memory_bytes: summary.memory,
        components: configuration.setup.component_names().map(str::to_owned).collect(),
        aft_ends: Some(index_array(&[summary.aft_ends.len()], &summary.aft_ends)),
        left_out: summary.left_out.iter().map(left_out).collect(),
        warnings: warnings(&summary.warnings),
        merged_vertex_count: configuration.merging.as_ref().map_or(0, Merging::count) as u64,
    }
}

fn left_out(LeftOut { line, reason }: &LeftOut) -> v1::LineLeftOut {
    let EdgeLine { vertices, from: _, to: _, length, width, turn } = line;
    v1::LineLeftOut {
        vertices: Some(index_array(&[vertices.len()], vertices)),
        length: *length,
        width: *width,
        turn: *turn,
        reason: reason.name().to_owned(),
    }
}

fn warnings(warnings: &[Warning]) -> Vec<v1::PanelWarning> {
    let message =
        |warning: &Warning| v1::PanelWarning { kind: warning.name().to_owned(), text: warning.to_string() };
    warnings.iter().map(message).collect()
}

/// Vertices and Mach number. Errors name fields with `prefix` before them.
pub fn geometry(prefix: &str, geometry: v1::AnalysisGeometry) -> Result<Geometry, ServiceError> {
    let v1::AnalysisGeometry { vertices, mach } = geometry;
    let vertices = vertices.map(|array| positions(&format!("{prefix}vertices"), &array)).transpose()?;
    Ok(Geometry { vertices, mach })
}

/// The reference of coefficients. Errors name fields with `prefix` before them.
pub fn reference(prefix: &str, reference: Option<v1::FlowReference>) -> Result<Reference, ServiceError> {
    let field = format!("{prefix}reference");
    let description = "is missing: name area, chord and span that coefficients refer to";
    let reference = reference.ok_or_else(|| ServiceError::invalid(&field, description))?;
    let v1::FlowReference { area, chord, span, point } = reference;
    let point = match point[..] {
        [] => [0.0; 3],
        [x, y, z] => [x, y, z],
        _ => {
            let description = format!("{} numbers, expected x, y and z", point.len());
            return Err(ServiceError::invalid(format!("{field}.point"), description));
        }
    };
    Ok(Reference { area, chord, span, point })
}

pub fn flow(v1::FlowAngles { alpha, sideslip }: v1::FlowAngles, reference: Reference) -> Flow {
    Flow { alpha, sideslip, reference }
}

/// The point of a derivative.
pub fn at(point: Option<v1::AnalysisPoint>) -> Result<AnalysisPoint, ServiceError> {
    let v1::AnalysisPoint { analysis_id, geometry: sent, flow: angles, reference: lengths } =
        point.unwrap_or_default();
    let angles =
        angles.ok_or_else(|| ServiceError::invalid("at.flow", "is missing: name the angle of attack"))?;
    let geometry = sent.map(|sent| geometry("at.geometry.", sent)).transpose()?;
    Ok(AnalysisPoint { analysis_id, geometry, flow: flow(angles, reference("at.", lengths)?) })
}

/// Blocks that must have the same number of rows.
struct Rows {
    rows: Option<(String, usize)>,
}

impl Rows {
    /// Reads the block of a field, if it was sent.
    fn block<T>(
        &mut self,
        field: String,
        sent: Option<v1::Array>,
        read: impl FnOnce(&str, &v1::Array) -> Result<Vec<T>, ServiceError>,
    ) -> Result<Option<Vec<T>>, ServiceError> {
        let Some(sent) = sent else { return Ok(None) };
        let block = read(&field, &sent)?;
        match &self.rows {
            Some((first, rows)) if *rows != block.len() => {
                let description = format!("{} rows, `{first}` has {rows}", block.len());
                return Err(ServiceError::invalid(format!("{field}.shape[0]"), description));
            }
            Some(_) => {}
            None => self.rows = Some((field, block.len())),
        }
        Ok(Some(block))
    }

    fn count(&self) -> usize {
        self.rows.as_ref().map_or(0, |(_, rows)| *rows)
    }
}

fn list(field: &str, array: &v1::Array) -> Result<Vec<f64>, ServiceError> {
    let [_] = shape(field, array)?;
    float64(field, array)
}

/// Directions of the inputs.
pub fn inputs(name: &str, inputs: v1::FlowInputs) -> Result<Vec<Inputs>, ServiceError> {
    let field = |part: &str| format!("{name}.{part}");
    let mut rows = Rows { rows: None };
    let vertices = rows.block(field("vertices"), inputs.vertices, point_vectors)?;
    let alpha = rows.block(field("alpha"), inputs.alpha, list)?;
    let sideslip = rows.block(field("sideslip"), inputs.sideslip, list)?;
    let mach = rows.block(field("mach"), inputs.mach, list)?;
    let area = rows.block(field("area"), inputs.area, list)?;
    let chord = rows.block(field("chord"), inputs.chord, list)?;
    let point = rows.block(field("point"), inputs.point, positions)?;
    let of = |block: &Option<Vec<f64>>, row: usize| block.as_ref().map_or(0.0, |block| block[row]);
    let mut vertices = vertices.map(Vec::into_iter);
    Ok((0..rows.count())
        .map(|row| Inputs {
            vertices: vertices.as_mut().and_then(Iterator::next).unwrap_or_default(),
            alpha: of(&alpha, row),
            sideslip: of(&sideslip, row),
            mach: of(&mach, row),
            area: of(&area, row),
            chord: of(&chord, row),
            point: point.as_ref().map_or([0.0; 3], |block| block[row]),
        })
        .collect())
}

/// Weights of the outputs.
pub fn seeds(seeds: v1::FlowOutputs) -> Result<Vec<Outputs>, ServiceError> {
    let mut rows = Rows { rows: None };
    let coefficients = rows.block("seeds.coefficients".to_owned(), seeds.coefficients, |field, array| {
        let [_, columns] = shape(field, array)?;
        if columns != Scalars::COUNT as u64 {
            let description = format!("{columns} is not {}: {}", Scalars::COUNT, Scalars::NAMES.join(", "));
            return Err(ServiceError::invalid(format!("{field}.shape[1]"), description));
        }
        Ok(float64(field, array)?.as_chunks::<{ Scalars::COUNT }>().0.to_vec())
    })?;
    let sections = rows.block("seeds.section_loads".to_owned(), seeds.section_loads, vectors)?;
    let cp = rows.block("seeds.cp".to_owned(), seeds.cp, vectors)?;
    let (mut sections, mut cp) = (sections.map(Vec::into_iter), cp.map(Vec::into_iter));
    Ok((0..rows.count())
        .map(|row| Outputs {
            scalars: Scalars::from_array(
                coefficients.as_ref().map_or([0.0; Scalars::COUNT], |block| block[row]),
            ),
            sections: sections.as_mut().and_then(Iterator::next).unwrap_or_default(),
            cp: cp.as_mut().and_then(Iterator::next).unwrap_or_default(),
        })
        .collect())
}

pub fn gradients(gradients: &[Inputs]) -> v1::FlowInputs {
    let k = gradients.len();
    let of = |part: fn(&Inputs) -> f64| {
        let values: Vec<f64> = gradients.iter().map(part).collect();
        Some(numbers(&[k], [&values[..]]))
    };
    let n = gradients.first().map_or(0, |row| row.vertices.len());
    v1::FlowInputs {
        vertices: Some(numbers(&[k, n, 3], gradients.iter().map(|row| row.vertices.as_flattened()))),
        alpha: of(|row| row.alpha),
        sideslip: of(|row| row.sideslip),
        mach: of(|row| row.mach),
        area: of(|row| row.area),
        chord: of(|row| row.chord),
        point: Some(numbers(&[k, 3], gradients.iter().map(|row| &row.point[..]))),
    }
}

pub fn outputs(changes: &[Outputs]) -> v1::FlowOutputs {
    let k = changes.len();
    let coefficients: Vec<f64> = changes.iter().flat_map(|row| row.scalars.to_array()).collect();
    let width = |of: fn(&Outputs) -> usize| changes.first().map_or(0, of);
    v1::FlowOutputs {
        coefficients: Some(numbers(&[k, Scalars::COUNT], [&coefficients[..]])),
        section_loads: Some(numbers(
            &[k, width(|row| row.sections.len())],
            changes.iter().map(|row| &row.sections[..]),
        )),
        cp: Some(numbers(&[k, width(|row| row.cp.len())], changes.iter().map(|row| &row.cp[..]))),
    }
}

/// Analyses of one solution at the requested angles.
pub fn analysis(analysed: &Analysed, angles: &[v1::FlowAngles], pressures: bool) -> v1::Analysis {
    let (residual, rounds) =
        analysed.analyses.first().map_or((0.0, 0), |first| (first.residual, first.rounds));
    let flows = analysed
        .analyses
        .iter()
        .zip(angles)
        .map(|(analysis, angles)| flow_analysis(analysis, *angles, pressures));
    v1::Analysis {
        analysis_id: analysed.solved.id.clone(),
        flows: flows.collect(),
        residual,
        residuals: analysed.solved.residuals.clone(),
        rounds: rounds as u64,
        reused: analysed.reused,
        timings: Some(timings(analysed.timing)),
    }
}

fn flow_analysis(analysis: &Analysis, angles: v1::FlowAngles, pressures: bool) -> v1::FlowAnalysis {
    let list = |values: &[f64]| pressures.then(|| numbers(&[values.len()], [values]));
    v1::FlowAnalysis {
        alpha: angles.alpha,
        sideslip: angles.sideslip,
        coefficients: Some(coefficients(&analysis.scalars)),
        wake_lift: analysis.wake_lift,
        disagreement: analysis.disagreement,
        total: Some(loads(&analysis.total)),
        components: analysis.components.iter().map(loads).collect(),
        sections: Some(sections(&analysis.sections)),
        cp: list(&analysis.cp),
        vertex_cp: list(&analysis.vertex_cp),
        supercritical_cells: analysis.supercritical_cells as u64,
        warnings: warnings(&analysis.warnings),
    }
}

fn coefficients(scalars: &Scalars) -> v1::FlowCoefficients {
    v1::FlowCoefficients {
        lift: scalars.lift,
        induced_drag: scalars.induced_drag,
        pressure_lift: scalars.pressure_lift,
        pressure_drag: scalars.pressure_drag,
        moment: scalars.moment,
        lift_slope: scalars.lift_slope,
        moment_slope: scalars.moment_slope,
        pressure_lift_slope: scalars.pressure_lift_slope,
        neutral_point: scalars.neutral_point,
    }
}

fn loads(Loads { name, force, moment, lift, drag }: &Loads) -> v1::Loads {
    v1::Loads { name: name.clone(), force: force.to_vec(), moment: moment.to_vec(), lift: *lift, drag: *drag }
}

fn sections(sections: &[Section]) -> v1::SectionLoads {
    let k = sections.len();
    let edges: Vec<u32> = sections.iter().flat_map(|section| section.edge).collect();
    let middles: Vec<[f64; 3]> = sections.iter().map(|section| section.middle).collect();
    let loads: Vec<f64> = sections.iter().map(|section| section.load).collect();
    v1::SectionLoads {
        edges: Some(index_array(&[k, 2], &edges)),
        middles: Some(points(&middles)),
        spans: Some(numbers(&[k, 2], sections.iter().map(|section| &section.span[..]))),
        loads: Some(numbers(&[k], [&loads[..]])),
    }
}
