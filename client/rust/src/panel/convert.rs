//! Conversions between messages of the protocol and the model of the panel service.

use moldline_proto::v1::{self, Array};

pub use crate::convert::missing;
use crate::{
    Error, Point,
    convert::{array, index_array, index_pairs, indices, numbers, pairs, point, points, timings},
};

use super::{
    Analysis, AnalysisPoint, At, Cell, Coefficients, ConfigurationFacts, ConfigurationOptions, IndexGroups,
    LineLeftOut, Loads, OnDoubt, Reference, Sections, Solver, Symmetry, TrailingEdges, Warning, Wind,
};

pub fn vertices(vertices: &[Point]) -> Array {
    array(vertices.as_flattened(), &[vertices.len(), 3])
}

pub fn configuration_request(
    vertices: &[Point],
    cells: &[Cell],
    options: &ConfigurationOptions,
) -> v1::CreateConfigurationRequest {
    let options_message = v1::PanelOptions {
        symmetry: symmetry(options.symmetry).into(),
        trailing_edges: Some(trailing_edges(&options.trailing_edges)),
        components: options.components.clone().map(|names| v1::NameList { names }),
        solver: solver(options.solver).into(),
        tolerance: options.tolerance,
        merge_tolerance: options.merge_tolerance,
        on_doubt: on_doubt(options.on_doubt).into(),
    };
    v1::CreateConfigurationRequest {
        cells: Some(index_array(cells.as_flattened(), &[cells.len(), 4])),
        vertices: Some(self::vertices(vertices)),
        cell_groups: groups(&options.cell_groups),
        vertex_groups: groups(&options.vertex_groups),
        options: Some(options_message),
    }
}

fn groups(groups: &IndexGroups) -> Vec<v1::IndexGroup> {
    let group = |(name, indices): (&String, &Vec<u32>)| v1::IndexGroup {
        name: name.clone(),
        indices: Some(index_array(indices, &[indices.len()])),
    };
    groups.iter().map(group).collect()
}

fn symmetry(symmetry: Symmetry) -> v1::PanelSymmetry {
    match symmetry {
        Symmetry::Automatic => v1::PanelSymmetry::Unspecified,
        Symmetry::None => v1::PanelSymmetry::None,
        Symmetry::Half => v1::PanelSymmetry::Half,
        Symmetry::Mirror => v1::PanelSymmetry::Mirror,
    }
}

fn solver(solver: Solver) -> v1::PanelSolver {
    match solver {
        Solver::Automatic => v1::PanelSolver::Unspecified,
        Solver::Double => v1::PanelSolver::Double,
        Solver::Single => v1::PanelSolver::Single,
        Solver::Iterative => v1::PanelSolver::Iterative,
    }
}

fn on_doubt(on_doubt: OnDoubt) -> v1::PanelOnDoubt {
    match on_doubt {
        OnDoubt::Refuse => v1::PanelOnDoubt::Unspecified,
        OnDoubt::Warn => v1::PanelOnDoubt::Warn,
    }
}

fn warnings(messages: Vec<v1::PanelWarning>) -> Vec<Warning> {
    messages.into_iter().map(|v1::PanelWarning { kind, text }| Warning { kind, text }).collect()
}

fn left_out(message: v1::LineLeftOut) -> Result<LineLeftOut, Error> {
    let v1::LineLeftOut { vertices, length, width, turn, reason } = message;
    Ok(LineLeftOut { vertices: indices(vertices.as_ref())?, length, width, turn, reason })
}

fn trailing_edges(edges: &TrailingEdges) -> v1::TrailingEdges {
    use v1::trailing_edges::Rule;
    let rule = match edges {
        TrailingEdges::None => Rule::None(v1::NoTrailingEdges {}),
        TrailingEdges::Edges(pairs) => Rule::Edges(index_array(pairs.as_flattened(), &[pairs.len(), 2])),
        TrailingEdges::Groups(names) => Rule::Groups(v1::NameList { names: names.clone() }),
        TrailingEdges::Angle(degrees) => Rule::Angle(*degrees),
    };
    v1::TrailingEdges { rule: Some(rule) }
}

pub fn facts(message: Option<v1::Configuration>) -> Result<ConfigurationFacts, Error> {
    let message = message.ok_or_else(|| missing("a configuration"))?;
    Ok(ConfigurationFacts {
        solver: match message.solver() {
            v1::PanelSolver::Unspecified => Solver::Automatic,
            v1::PanelSolver::Double => Solver::Double,
            v1::PanelSolver::Single => Solver::Single,
            v1::PanelSolver::Iterative => Solver::Iterative,
        },
        id: message.configuration_id,
        vertex_count: message.vertex_count as usize,
        cell_count: message.cell_count as usize,
        unknowns: message.unknowns as usize,
        symmetric: message.symmetric,
        trailing_edges: index_pairs(message.trailing_edges.as_ref())?,
        roots: indices(message.roots.as_ref())?,
        // Absent in answers of older servers.
        aft_ends: message.aft_ends.as_ref().map_or(Ok(Vec::new()), |array| indices(Some(array)))?,
        left_out: message.left_out.into_iter().map(left_out).collect::<Result<_, _>>()?,
        warnings: warnings(message.warnings),
        memory: message.memory_bytes,
        components: message.components,
    })
}

pub fn wind(wind: &Wind) -> v1::FlowAngles {
    v1::FlowAngles { alpha: wind.alpha, sideslip: wind.sideslip }
}

pub fn reference(reference: &Reference) -> v1::FlowReference {
    let Reference { area, chord, span, point } = *reference;
    v1::FlowReference { area, chord, span, point: point.to_vec() }
}

/// The id, if any, and the vertices, from which the server solves again what it no longer holds.
pub fn at(at: &At) -> v1::AnalysisPoint {
    let AnalysisPoint { vertices: positions, flow } = &at.point;
    v1::AnalysisPoint {
        analysis_id: at.id.clone(),
        geometry: Some(v1::AnalysisGeometry {
            vertices: positions.as_deref().map(vertices),
            mach: flow.mach,
        }),
        flow: Some(wind(&flow.wind)),
        reference: Some(reference(&flow.reference)),
    }
}

pub fn coefficients(array: Option<&Array>) -> Result<Vec<Coefficients>, Error> {
    let numbers = numbers(array)?;
    let (rows, rest) = numbers.as_chunks();
    if !rest.is_empty() {
        return Err(Error::internal("the server sent an incomplete row of coefficients"));
    }
    Ok(rows.iter().map(|&row| row.into()).collect())
}

/// The analyses of an answer, one for each requested point.
pub fn analyses(answer: v1::Analysis, points: Vec<AnalysisPoint>) -> Result<Vec<Analysis>, Error> {
    if answer.flows.len() != points.len() {
        return Err(missing("an analysis for each wind"));
    }
    let flows = answer.flows.into_iter().zip(points);
    let analysis = |(flow, point): (v1::FlowAnalysis, AnalysisPoint)| {
        let pressures = |array: Option<&Array>| array.map_or(Ok(Vec::new()), |array| numbers(Some(array)));
        Ok(Analysis {
            id: answer.analysis_id.clone(),
            point,
            coefficients: flow.coefficients.unwrap_or_default().into(),
            wake_lift: flow.wake_lift,
            disagreement: flow.disagreement,
            warnings: warnings(flow.warnings),
            cp: pressures(flow.cp.as_ref())?,
            vertex_cp: pressures(flow.vertex_cp.as_ref())?,
            total: loads(&flow.total.unwrap_or_default())?,
            components: flow
                .components
                .iter()
                .map(|each| Ok((each.name.clone(), loads(each)?)))
                .collect::<Result<_, Error>>()?,
            sections: sections(flow.sections.unwrap_or_default())?,
            supercritical_cells: flow.supercritical_cells as usize,
            residual: answer.residual,
            residuals: answer.residuals.clone(),
            rounds: answer.rounds as usize,
            reused: answer.reused,
            timings: timings(answer.timings),
        })
    };
    flows.map(analysis).collect()
}

fn loads(message: &v1::Loads) -> Result<Loads, Error> {
    Ok(Loads {
        force: point(&message.force)?,
        moment: point(&message.moment)?,
        lift: message.lift,
        drag: message.drag,
    })
}

fn sections(message: v1::SectionLoads) -> Result<Sections, Error> {
    Ok(Sections {
        edges: index_pairs(message.edges.as_ref())?,
        middles: points(message.middles.as_ref())?,
        spans: pairs(message.spans.as_ref())?,
        loads: numbers(message.loads.as_ref())?,
    })
}
