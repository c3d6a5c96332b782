//! Set-up of the seam search (sec. III.C of the paper): reference component, line, bracket and targets of every seam vertex.

use std::collections::{BTreeMap, HashMap};

use moldline_geometry::{Body, Location};
use moldline_mesh::{Topology, graph};
use rayon::prelude::*;

use super::{Junction, SeamLine, SeamSearch, SeamSolver, SeamVertex, line::along};
use crate::{
    Monitor, SeamOptions, SetupError, Stage,
    ownership::{Attachment, Freedom, Ownership},
};

/// Samples of a line over the length of a patch, when brackets are looked for.
const SAMPLES: f64 = 64.0;
/// Patches that a line is followed over at most.
const PATCHES: usize = 4;
/// Sine of the angle between line and target below which they do not cross.
const TANGENT: f64 = 1e-3;
/// Sine below which a vertex takes its own best line rather than that of its row.
const SHALLOW: f64 = 0.2;

/// A connected row of seam vertices on the same components, as the report shows it.
#[derive(Clone, Debug, PartialEq)]
pub struct SeamSummary {
    /// Names of the components that meet.
    pub components: Vec<String>,
    /// How many vertices.
    pub vertices: usize,
    /// Component whose lines are searched, and the parameter.
    pub reference: String,
    /// `u` or `v`, `across` where some lines run straight across the seam; `u, v` where three components meet.
    pub direction: &'static str,
    /// Least sine of the angle between a line and its target.
    pub transversality: f64,
    /// Widths of the brackets, in units of the line's length: least and largest.
    pub bracket: [f64; 2],
}

/// A candidate line: its component and direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Choice {
    component: u32,
    direction: Direction,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Direction {
    U,
    V,
    /// In the surface, along the gradient of the target's distance.
    Across,
}

/// The results of the search for the line of a seam vertex on two components, to be kept between set-ups.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundLine {
    /// Index into the mesh.
    pub vertex: u32,
    /// Component that carries the line, and the one to be met.
    pub components: [u32; 2],
    /// As in [`SeamLine`].
    pub direction: [f64; 2],
    /// As in [`SeamLine`].
    pub bracket: [f64; 2],
    /// As in [`SeamLine`].
    pub limits: [f64; 2],
    /// As in [`SeamLine`].
    pub from_inside: bool,
}

/// The lines of a solver, in the order of their vertices.
pub fn found_lines(solver: &SeamSolver) -> Vec<FoundLine> {
    let lines = solver.vertices.iter().filter_map(|vertex| match &vertex.search {
        SeamSearch::Line(line) => Some(FoundLine {
            vertex: vertex.vertex,
            components: [line.reference, line.targets[0]],
            direction: line.direction,
            bracket: line.bracket,
            limits: line.limits,
            from_inside: line.from_inside,
        }),
        SeamSearch::Junction(_) => None,
    });
    lines.collect()
}

/// The solver for the seam vertices of `ownership`. Lines of a row of vertices are taken from `found` if all of them are there.
///
/// # Errors
/// [`SetupError::TangentSeam`] where components touch without crossing.
pub fn seam_solver(
    ownership: &Ownership,
    topology: &Topology,
    vertices: &[[f64; 3]],
    bodies: &[Body],
    options: SeamOptions,
    length: f64,
    found: &[FoundLine],
    monitor: &dyn Monitor<Stage>,
) -> Result<(SeamSolver, Vec<SeamSummary>), SetupError> {
    let seam_vertices: Vec<u32> = ownership.vertices().filter(|&v| ownership.is_seam(v)).collect();
    let junctions: Vec<u32> = seam_vertices.iter().copied().filter(|&v| ownership.of(v).len() > 2).collect();
    let index_of: HashMap<u32, u32> = (0u32..).zip(&seam_vertices).map(|(i, &v)| (v, i)).collect();

    let found: HashMap<u32, &FoundLine> = found.iter().map(|line| (line.vertex, line)).collect();
    let mut lines: HashMap<u32, (SeamLine, f64)> = HashMap::new();
    let mut summaries = Vec::new();
    let rows = rows(ownership, topology, &seam_vertices);
    for (done, row) in rows.iter().enumerate() {
        if monitor.cancelled() {
            return Err(SetupError::Cancelled);
        }
        let known = row.iter().map(|vertex| restored(found.get(vertex)?, ownership, bodies));
        let built = match known.collect::<Option<Vec<_>>>() {
            Some(known) => known,
            None => row_lines(row, ownership, bodies, monitor)?,
        };
        let carried = carried(row, &junctions, ownership, topology, vertices, &index_of);
        summaries.push(summary(row, ownership, bodies, &built));
        for ((&vertex, (mut line, quality)), carried) in row.iter().zip(built).zip(carried) {
            line.carried = carried;
            lines.insert(vertex, (line, quality));
        }
        monitor.progress(Stage::Seams, (done + 1) as f64 / rows.len() as f64);
    }
    let solver_vertices = seam_vertices
        .iter()
        .map(|&vertex| {
            let owners: Vec<u32> = ownership.of(vertex).iter().map(|a| a.component).collect();
            let locations = ownership.of(vertex).iter().map(|a| a.location).collect();
            let search = match lines.remove(&vertex) {
                Some((line, _)) => SeamSearch::Line(line),
                None => SeamSearch::Junction(junction(vertex, ownership, bodies)?),
            };
            Ok(SeamVertex { vertex, owners, locations, search })
        })
        .collect::<Result<Vec<_>, SetupError>>()?;
    if !junctions.is_empty() {
        summaries.push(junction_summary(&junctions, ownership, bodies));
    }
    Ok((SeamSolver { vertices: solver_vertices, options, length }, summaries))
}

/// Rows of neighbouring vertices on the same two components. Vertices are in order within a row, rows in order of their first
/// vertices.
fn rows(ownership: &Ownership, topology: &Topology, seam_vertices: &[u32]) -> Vec<Vec<u32>> {
    let pair = |v: u32| -> Option<[u32; 2]> {
        match ownership.of(v) {
            [a, b] => Some([a.component, b.component]),
            _ => None,
        }
    };
    let mut row_of: BTreeMap<u32, usize> = BTreeMap::new();
    let mut rows: Vec<Vec<u32>> = Vec::new();
    for &first in seam_vertices {
        if pair(first).is_none() || row_of.contains_key(&first) {
            continue;
        }
        let mut row = Vec::new();
        let mut front = vec![first];
        row_of.insert(first, rows.len());
        while let Some(v) = front.pop() {
            row.push(v);
            for &n in topology.vertex_neighbours.row(v as usize) {
                if pair(n) == pair(first) && !row_of.contains_key(&n) {
                    row_of.insert(n, rows.len());
                    front.push(n);
                }
            }
        }
        row.sort_unstable();
        rows.push(row);
    }
    rows
}

/// Lines of one row with their transversality: the same choice for all vertices where that crosses the target everywhere.
fn row_lines(
    row: &[u32],
    ownership: &Ownership,
    bodies: &[Body],
    monitor: &dyn Monitor<Stage>,
) -> Result<Vec<(SeamLine, f64)>, SetupError> {
    let [a, b] = [0, 1].map(|k| ownership.of(row[0])[k].component);
    let choose = |component, direction| Choice { component, direction };
    let mut choices: Vec<Choice> = [a, b]
        .into_iter()
        .flat_map(|component| [Direction::U, Direction::V].map(|direction| choose(component, direction)))
        .collect();
    // Across the seam on the larger of the two, which is the flatter one there.
    let larger = if bodies[a as usize].size() >= bodies[b as usize].size() { a } else { b };
    choices.push(choose(larger, Direction::Across));
    // table[vertex][choice]
    let table: Vec<Vec<f64>> = row
        .par_iter()
        .map(|&v| {
            if monitor.cancelled() {
                return Err(SetupError::Cancelled);
            }
            Ok(choices.iter().map(|&choice| transversality(v, choice, ownership, bodies)).collect())
        })
        .collect::<Result<_, _>>()?;
    let worst = |k: usize| table.iter().map(|t| t[k]).fold(f64::INFINITY, f64::min);
    let best_of_row = (0..choices.len()).fold(0, |best, k| if worst(k) > worst(best) { k } else { best });
    let lines: Vec<Result<(SeamLine, f64), SetupError>> = row
        .par_iter()
        .zip(&table)
        .map(|(&vertex, scores)| {
            if monitor.cancelled() {
                return Err(SetupError::Cancelled);
            }
            let own_best =
                (0..choices.len()).fold(0, |best, k| if scores[k] > scores[best] { k } else { best });
            let k = if scores[best_of_row] > SHALLOW { best_of_row } else { own_best };
            let name = |c: u32| bodies[c as usize].component().name().to_owned();
            if let Some(holder) = ownership.of(vertex).iter().find(|o| o.freedom == Freedom::Fixed) {
                let holder = name(holder.component);
                return Err(SetupError::HeldSeam { vertex, reference: name(a), target: name(b), holder });
            }
            if scores[k] <= TANGENT {
                return Err(SetupError::TangentSeam {
                    vertex,
                    reference: name(a),
                    target: name(b),
                    transversality: scores[k].max(0.0),
                });
            }
            let reference = choices[k].component;
            let target = if reference == a { b } else { a };
            let line = line(vertex, choices[k], target, ownership, bodies).map_err(|fault| match fault {
                LineFault::End => {
                    SetupError::SeamAtEnd { vertex, reference: name(reference), target: name(target) }
                }
                LineFault::Sides { near, inside } => SetupError::SeamSides {
                    vertex,
                    reference: name(reference),
                    target: name(target),
                    transversality: scores[k],
                    near,
                    inside,
                },
            })?;
            Ok((line, scores[k]))
        })
        .collect();
    // In order, so that the error is that of the first vertex whatever the threads do.
    lines.into_iter().collect()
}

/// A line found by an earlier set-up, with its transversality; `None` if its vertex does not lie on those two components.
fn restored(found: &FoundLine, ownership: &Ownership, bodies: &[Body]) -> Option<(SeamLine, f64)> {
    let FoundLine { vertex, components: [reference, target], direction, bracket, limits, from_inside } =
        *found;
    let (own, other) = (ownership.on(vertex, reference)?, ownership.on(vertex, target)?);
    if reference == target {
        return None;
    }
    let line = SeamLine {
        reference,
        start: own.location,
        direction,
        bracket,
        limits,
        from_inside,
        targets: vec![target],
        carried: Vec::new(),
    };
    Some((line, sine(own, other, direction, bodies)))
}

/// `|n_t . S_a| / |S_a|`, the sine between the line and the target's surface; negative if the line would leave a sharp
/// edge that the vertex slides along.
fn transversality(vertex: u32, choice: Choice, ownership: &Ownership, bodies: &[Body]) -> f64 {
    let Some(own) = ownership.on(vertex, choice.component) else { return -1.0 };
    let body = &bodies[choice.component as usize];
    let bound = |a: &Attachment| a.component != choice.component && a.freedom != Freedom::Surface;
    if ownership.of(vertex).iter().any(bound) {
        return -1.0;
    }
    match own.freedom {
        Freedom::Fixed => return -1.0,
        Freedom::Edge(_) if choice.direction == Direction::Across => return -1.0,
        Freedom::Edge(edge) => {
            let side =
                body.component().edges()[edge as usize].sides.iter().find(|s| s.patch == own.location.patch);
            if side.is_some_and(|s| s.side.holds_u() != (choice.direction == Direction::V)) {
                return -1.0;
            }
        }
        Freedom::Surface => {}
    }
    let others = ownership.of(vertex).iter().filter(|o| o.component != choice.component);
    others
        .map(|other| sine(own, other, parameter_direction(choice, own, other, bodies), bodies))
        .fold(f64::INFINITY, f64::min)
}

/// The sine between a line and its target's surface; negative where there is none.
fn sine(own: &Attachment, other: &Attachment, [a, b]: [f64; 2], bodies: &[Body]) -> f64 {
    let normal = bodies[other.component as usize].normal(&other.location);
    let point = bodies[own.component as usize].point(&own.location);
    let tangent = point.d_u * a + point.d_v * b;
    let sine = normal.dot(&tangent).abs() / tangent.norm();
    if sine.is_finite() { sine } else { -1.0 }
}

/// The direction of a line in parameters, scaled so that a unit of lambda goes the length of a patch.
fn parameter_direction(choice: Choice, own: &Attachment, other: &Attachment, bodies: &[Body]) -> [f64; 2] {
    let body = &bodies[choice.component as usize];
    let [u, v] = body.component().patches()[own.location.patch as usize].surface.domain();
    let ranges = [u.1 - u.0, v.1 - v.0];
    match choice.direction {
        Direction::U => [ranges[0], 0.0],
        Direction::V => [0.0, ranges[1]],
        Direction::Across => {
            let point = body.point(&own.location);
            let normal = bodies[other.component as usize].normal(&other.location);
            let (e, f, g) = (point.d_u.norm_squared(), point.d_u.dot(&point.d_v), point.d_v.norm_squared());
            let (p, q) = (point.d_u.dot(&normal), point.d_v.dot(&normal));
            let direction = [g * p - f * q, e * q - f * p];
            let length = (direction[0] / ranges[0]).abs().max((direction[1] / ranges[1]).abs());
            direction.map(|d| d / length)
        }
    }
}

/// Why a line cannot be searched though it crosses its target at an angle.
enum LineFault {
    /// It ends at the vertex.
    End,
    /// The points `near` metres before and behind the vertex are both inside the target, or both outside.
    Sides { near: f64, inside: bool },
}

/// The line of a vertex with its bracket: from half way to the next root below to half way to the next root above, or
/// to the end of the component.
fn line(
    vertex: u32,
    choice: Choice,
    target: u32,
    ownership: &Ownership,
    bodies: &[Body],
) -> Result<SeamLine, LineFault> {
    // A row's vertices lie on both of its components.
    let (Some(own), Some(other)) = (ownership.on(vertex, choice.component), ownership.on(vertex, target))
    else {
        return Err(LineFault::End);
    };
    let start = own.location;
    let body = &bodies[choice.component as usize];
    let direction = parameter_direction(choice, own, other, bodies);
    let step = 1.0 / SAMPLES;
    let at = |lambda: f64| along(body, &start, direction, lambda);
    let body_to_meet = &bodies[target as usize];
    let inside = |lambda: f64| body_to_meet.signed_distance(&body.position(&at(lambda))) < 0.0;

    // Lengths to the end of the component, to the bracket's end, and the side of the target that lies there.
    let scan = |sign: f64| {
        let near = inside(sign * 0.01 * step);
        let mut length = 0.0;
        let mut bracket = None;
        let mut previous = at(0.0);
        for k in 1..=PATCHES * SAMPLES as usize {
            let lambda = sign * step * k as f64;
            let here = at(lambda);
            if here == previous || (k > 2 && came_round(&start, &here, direction, step)) {
                break;
            }
            (previous, length) = (here, step * k as f64);
            if bracket.is_none() && inside(lambda) != near {
                bracket = Some(0.5 * length);
            }
        }
        (near, length, bracket.unwrap_or(length))
    };
    let (below, length_below, bracket_below) = scan(-1.0);
    let (above, length_above, bracket_above) = scan(1.0);
    if !(length_below > 0.0 && length_above > 0.0) {
        return Err(LineFault::End);
    }
    if below == above {
        let near = (body.position(&at(0.01 * step)) - body.position(&start)).norm();
        return Err(LineFault::Sides { near, inside: below });
    }
    Ok(SeamLine {
        reference: choice.component,
        start,
        direction,
        bracket: [-bracket_below, bracket_above],
        limits: [-length_below, length_above],
        from_inside: below,
        targets: vec![other.component],
        carried: Vec::new(),
    })
}

/// Whether a line around a closed component is back at its start.
fn came_round(start: &Location, here: &Location, direction: [f64; 2], step: f64) -> bool {
    let near = |a: f64, b: f64, d: f64| (a - b).abs() <= 0.75 * step * d.abs();
    start.patch == here.patch && near(start.u, here.u, direction[0]) && near(start.v, here.v, direction[1])
}

/// For every vertex of a row, the junctions at the ends of its part of the row, with weights that go from one at the junction
/// to zero at the other end. Vertices on sharp edges end a part too: they keep to their edge.
fn carried(
    row: &[u32],
    junctions: &[u32],
    ownership: &Ownership,
    topology: &Topology,
    vertices: &[[f64; 3]],
    index_of: &HashMap<u32, u32>,
) -> Vec<Vec<(u32, f64)>> {
    let touches =
        |j: u32| topology.vertex_neighbours.row(j as usize).iter().any(|n| row.binary_search(n).is_ok());
    let on_edge = |v: u32| ownership.of(v).iter().any(|a| a.freedom != Freedom::Surface);
    let mut ends: Vec<u32> = junctions.iter().copied().filter(|&j| touches(j)).collect();
    if ends.is_empty() {
        return vec![Vec::new(); row.len()];
    }
    let junction_count = ends.len();
    ends.extend(row.iter().copied().filter(|&v| on_edge(v)));
    let distances: Vec<Vec<f64>> = ends
        .iter()
        .map(|&end| {
            let allowed = |v: u32| v == end || (row.binary_search(&v).is_ok() && !on_edge(v));
            graph::graph_distance(topology, vertices, &[end], allowed)
        })
        .collect();
    row.iter()
        .map(|&v| {
            if on_edge(v) {
                return Vec::new();
            }
            let mut near: Vec<(f64, usize)> =
                distances.iter().map(|d| d[v as usize]).zip(0..).filter(|(d, _)| d.is_finite()).collect();
            near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let weights = match near[..] {
                [] => Vec::new(),
                [(_, only)] => vec![(only, 1.0)],
                [(d1, first), (d2, second), ..] => {
                    vec![(first, d2 / (d1 + d2)), (second, d1 / (d1 + d2))]
                }
            };
            let moving = weights.into_iter().filter(|&(end, _)| end < junction_count);
            moving.map(|(end, weight)| (index_of[&ends[end]], weight)).collect()
        })
        .collect()
}

/// The best conditioned choice of reference component and targets for a vertex where several components meet.
fn junction(vertex: u32, ownership: &Ownership, bodies: &[Body]) -> Result<Junction, SetupError> {
    let owners = ownership.of(vertex);
    let mut best: Option<(f64, Junction)> = None;
    for own in owners.iter().filter(|o| o.freedom == Freedom::Surface) {
        let point = bodies[own.component as usize].point(&own.location);
        let (t_u, t_v) = (point.d_u.normalize(), point.d_v.normalize());
        let others: Vec<_> = owners.iter().filter(|o| o.component != own.component).collect();
        for (i, a) in others.iter().enumerate() {
            for b in &others[i + 1..] {
                let [n_a, n_b] = [a, b].map(|o| bodies[o.component as usize].normal(&o.location));
                let score = (n_a.dot(&t_u) * n_b.dot(&t_v) - n_a.dot(&t_v) * n_b.dot(&t_u)).abs();
                if best.as_ref().is_none_or(|(s, _)| score > *s) {
                    let targets = [a.component, b.component];
                    best = Some((score, Junction { reference: own.component, start: own.location, targets }));
                }
            }
        }
    }
    let name = |k: usize| bodies[owners[k].component as usize].component().name().to_owned();
    match best {
        Some((score, junction)) if score > TANGENT => Ok(junction),
        other => Err(SetupError::TangentSeam {
            vertex,
            reference: name(0),
            target: name(1),
            transversality: other.map_or(0.0, |(score, _)| score),
        }),
    }
}

fn summary(row: &[u32], ownership: &Ownership, bodies: &[Body], lines: &[(SeamLine, f64)]) -> SeamSummary {
    let name = |c: u32| bodies[c as usize].component().name().to_owned();
    let widths: Vec<f64> =
        lines.iter().map(|(l, _)| (l.bracket[1] - l.bracket[0]) / (l.limits[1] - l.limits[0])).collect();
    SeamSummary {
        components: ownership.of(row[0]).iter().map(|a| name(a.component)).collect(),
        vertices: row.len(),
        reference: name(lines[0].0.reference),
        direction: if lines.iter().all(|(l, _)| l.direction[1] == 0.0) {
            "u"
        } else if lines.iter().all(|(l, _)| l.direction[0] == 0.0) {
            "v"
        } else {
            "across"
        },
        transversality: lines.iter().map(|(_, t)| *t).fold(f64::INFINITY, f64::min),
        bracket: [
            widths.iter().copied().fold(f64::INFINITY, f64::min),
            widths.iter().copied().fold(0.0, f64::max),
        ],
    }
}

fn junction_summary(junctions: &[u32], ownership: &Ownership, bodies: &[Body]) -> SeamSummary {
    let mut components: Vec<String> = junctions
        .iter()
        .flat_map(|&v| ownership.of(v))
        .map(|a| bodies[a.component as usize].component().name().to_owned())
        .collect();
    components.sort();
    components.dedup();
    SeamSummary {
        components,
        vertices: junctions.len(),
        reference: String::new(),
        direction: "u, v",
        transversality: f64::NAN,
        bracket: [f64::NAN; 2],
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use moldline_geometry::{Component, Primitive};
    use moldline_mesh::{Cell, Topology};
    use moldline_spline::Vector3;

    use super::*;
    use crate::NoMonitor;

    /// Two cells, one on the upper face z = 0 of a block, one on the front x = 0 of a plate of the given thickness that
    /// stands in it.
    fn plate_in_a_block(thickness: f64) -> Result<(SeamSolver, Vec<SeamSummary>), SetupError> {
        let corner = Vector3::new;
        let block = Primitive::Box { low: corner(-8.0, -8.0, -4.0), high: corner(8.0, 8.0, 0.0) };
        let plate = Primitive::Box { low: corner(0.0, -2.0, -2.0), high: corner(thickness, 2.0, 2.0) };
        let bodies: Vec<Body> = [("block", block), ("plate", plate)]
            .iter()
            .map(|(name, primitive)| {
                let (component, points) = Component::primitive((*name).into(), primitive).unwrap();
                Body::new(Arc::new(component), points)
            })
            .collect();
        let vertices = [
            [-1.0, 0.0, 0.0],
            [-1.0, 1.0, 0.0],
            [0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0],
            [0.0, 1.0, 1.0],
        ];
        let cells = [Cell::quad(0, 2, 3, 1), Cell::quad(2, 4, 5, 3)];
        let ownership = Ownership::find(&vertices, &cells, &bodies, 1e-9, &NoMonitor)?;
        let topology = Topology::of_cells(vertices.len(), &cells);
        seam_solver(&ownership, &topology, &vertices, &bodies, SeamOptions::default(), 4.0, &[], &NoMonitor)
    }

    #[test]
    fn lines_cross_the_plate_straight() {
        let (solver, summaries) = plate_in_a_block(1.0).unwrap();
        assert_eq!(solver.vertices.len(), 2);
        assert_eq!(summaries[0].components, ["block", "plate"]);
        assert!((summaries[0].transversality - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_plate_too_thin_for_its_line_is_named() {
        let error = plate_in_a_block(1e-3).unwrap_err();
        let SetupError::SeamSides { vertex, reference, target, transversality, near, inside } = &error else {
            panic!("{error}")
        };
        assert_eq!((*vertex, reference.as_str(), target.as_str(), *inside), (2, "block", "plate", false));
        assert!((transversality - 1.0).abs() < 1e-12 && *near > 1e-3, "{error}");
        assert!(error.to_string().contains("`plate` is thinner"), "{error}");
    }
}
