//! Trailing edges: found by their angle or in vertex groups, or given.

use moldline_mesh::{SurfaceMesh, Vector3};

use crate::{PanelError, TrailingEdges, bounds::within, panels::Panels};

/// Least angle between the normals at a trailing edge that is given, degrees.
const GIVEN: f64 = 30.0;
/// The same for edges between vertices of a group.
const GROUPED: f64 = 60.0;
/// Bounds of the angle by which edges are found, degrees.
const FOUND: [f64; 2] = [60.0, 180.0];

/// The trailing edges, as edges of the panels.
pub(super) fn find(
    mesh: &SurfaceMesh,
    panels: &Panels,
    points: &[Vector3],
    rule: &TrailingEdges,
) -> Result<Vec<u32>, PanelError> {
    let (edges, how) = match rule {
        TrailingEdges::None => return Ok(Vec::new()),
        TrailingEdges::Angle { degrees } => {
            (sharp(panels, points, *degrees)?, format!("where normals turn by {degrees} degrees or more"))
        }
        TrailingEdges::Groups(names) => {
            (grouped(mesh, panels, points, names)?, format!("in the vertex groups {names:?}"))
        }
        TrailingEdges::Edges(list) => (given(panels, points, list)?, "in the list of edges".to_owned()),
    };
    if edges.is_empty() { Err(PanelError::NoTrailingEdge { how }) } else { Ok(edges) }
}

/// Least cosine of the sweep of an edge that is found: beyond it is a tip.
const STEEPEST: f64 = 0.1;

/// The angle between the outward normals at an edge, degrees, and the cosine of the angle between their bisector and what of the x axis is normal
/// to the edge; none at an edge of one panel.
fn turn(panels: &Panels, points: &[Vector3], edge: u32) -> Option<(f64, f64)> {
    let e = &panels.edges[edge as usize];
    let normal = |panel: u32| {
        let [a, b, c, d] = panels.corners[panel as usize].map(|v| points[v as usize]);
        (c - a).cross(&(d - b)).normalize()
    };
    let (one, two) = (normal(e.left), normal(e.right?));
    let angle = one.dot(&two).clamp(-1.0, 1.0).acos().to_degrees();
    let along = (points[e.b as usize] - points[e.a as usize]).normalize();
    let normal_part = (1.0 - along.x * along.x).max(0.0).sqrt();
    let downstream = if normal_part > STEEPEST { (one + two).normalize().x / normal_part } else { 0.0 };
    Some((angle, downstream))
}

/// Edges where the normal turns by an angle and that point downstream.
fn sharp(panels: &Panels, points: &[Vector3], degrees: f64) -> Result<Vec<u32>, PanelError> {
    within("options.trailing_edges.degrees", degrees, FOUND[0], FOUND[1])?;
    let sharp = |e: &u32| turn(panels, points, *e).is_some_and(|(angle, x)| angle >= degrees && x > 0.5);
    Ok((0..panels.edges.len() as u32).filter(sharp).collect())
}

/// Edges between vertices of a group.
fn grouped(
    mesh: &SurfaceMesh,
    panels: &Panels,
    points: &[Vector3],
    names: &[String],
) -> Result<Vec<u32>, PanelError> {
    let all = 0..panels.edges.len() as u32;
    let mut inside = vec![false; panels.vertex_of.len()];
    let mut found = vec![false; panels.edges.len()];
    for (index, name) in names.iter().enumerate() {
        let group = mesh.vertex_group(name).ok_or_else(|| PanelError::UnknownGroup {
            field: format!("trailing_edges[{index}]"),
            name: name.clone(),
            known: mesh.vertex_groups.iter().map(|g| g.name.clone()).collect(),
        })?;
        inside.fill(false);
        for vertex in &group.indices {
            if let Ok(point) = panels.vertex_of.binary_search(vertex) {
                inside[point] = true;
            }
        }
        for edge in all.clone() {
            let e = &panels.edges[edge as usize];
            found[edge as usize] |= inside[e.a as usize]
                && inside[e.b as usize]
                && turn(panels, points, edge).is_some_and(|(angle, _)| angle >= GROUPED);
        }
    }
    Ok(all.filter(|e| found[*e as usize]).collect())
}

/// Edges given by their mesh vertices. Edges of the half that is not solved stand for their images.
fn given(panels: &Panels, points: &[Vector3], list: &[[u32; 2]]) -> Result<Vec<u32>, PanelError> {
    let mut edges = Vec::with_capacity(list.len());
    for (index, &edge) in list.iter().enumerate() {
        if edge.iter().any(|&v| v as usize >= panels.vertices) {
            return Err(PanelError::NotAnEdge { index, edge });
        }
        let own = |v: u32| panels.vertex_of.binary_search(&v).ok();
        let image = |v: u32| panels.partner.as_ref()?.iter().position(|p| *p == v);
        let ends = [own(edge[0]).zip(own(edge[1])), image(edge[0]).zip(image(edge[1]))];
        let (a, b) = ends.into_iter().flatten().next().ok_or(PanelError::NotAnEdge { index, edge })?;
        let found = panels.edge_between(a as u32, b as u32);
        let found = found.ok_or(PanelError::NotAnEdge { index, edge })?;
        let (angle, _) = turn(panels, points, found).ok_or(PanelError::NotAnEdge { index, edge })?;
        if angle < GIVEN {
            return Err(PanelError::BluntTrailingEdge { edge, angle, least: GIVEN });
        }
        edges.push(found);
    }
    edges.sort_unstable();
    edges.dedup();
    Ok(edges)
}
