//! What a mesh must be before anything is built on it: one closed surface, each cell once, pointing outwards.

use std::collections::HashMap;

use moldline_mesh::{Cell, SurfaceMesh, Topology, cracks, merge, topology::enclosed_volume};

use crate::{SetupError, symmetry::MeshSymmetry};

/// Distance within which the corners of two cells are the same, as a fraction of the reference length.
const SAME_CORNERS: f64 = 1e-9;
/// Distance from the plane of symmetry, as a fraction of the reference length, within which a border is meant to lie in it.
const NEAR_PLANE: f64 = 1e-2;

/// Refuses cells that are there twice, whether they share vertices or have their own.
///
/// # Errors
/// [`SetupError::RepeatedCells`].
pub(crate) fn refuse_repeated_cells(mesh: &SurfaceMesh, length: f64) -> Result<(), SetupError> {
    let target = merge::near(&mesh.vertices, SAME_CORNERS * length);
    let mut seen: HashMap<[u32; 4], u32> = HashMap::with_capacity(mesh.cells.len());
    let (mut count, mut first) = (0, None);
    for (index, cell) in (0..).zip(&mesh.cells) {
        let mut corners = [u32::MAX; 4];
        for (corner, &vertex) in corners.iter_mut().zip(cell.vertices()) {
            *corner = target[vertex as usize];
        }
        corners.sort_unstable();
        let other = *seen.entry(corners).or_insert(index);
        if other != index {
            count += 1;
            first = first.or(Some([other, index]));
        }
    }
    match first {
        None => Ok(()),
        Some(first) => {
            let vertex = mesh.cells[first[0] as usize].vertices()[0];
            Err(SetupError::RepeatedCells { count, first, position: mesh.vertices[vertex as usize] })
        }
    }
}

/// Refuses edges with three cells and more, and neighbours that point to opposite sides.
///
/// # Errors
/// [`SetupError::NonManifold`], [`SetupError::MixedOrientation`].
pub(crate) fn refuse_branches(mesh: &SurfaceMesh, topology: &Topology) -> Result<(), SetupError> {
    let at = |edge: u32| {
        let first = topology.edges[edge as usize];
        (first, mesh.vertices[first[0] as usize])
    };
    if let Some(&edge) = topology.non_manifold_edges.first() {
        let (first, position) = at(edge);
        return Err(SetupError::NonManifold { count: topology.non_manifold_edges.len(), first, position });
    }
    if let Some(&edge) = topology.inconsistent_edges.first() {
        let (first, position) = at(edge);
        let around = topology.edge_cells.row(edge as usize);
        let cells = [around[0], around[around.len() - 1]];
        let count = topology.inconsistent_edges.len();
        return Err(SetupError::MixedOrientation { count, cells, first, position });
    }
    Ok(())
}

/// Turns the cells of closed pieces whose volume is negative; their number. `open_edges`: those outside the plane of symmetry.
pub(crate) fn turn_inward_pieces(
    mesh: &mut SurfaceMesh,
    topology: &Topology,
    symmetry: &MeshSymmetry,
    open_edges: &[u32],
) -> usize {
    let piece = |cell: &Cell| topology.vertex_piece[cell.vertices()[0] as usize] as usize;
    let mut closed = vec![true; topology.pieces];
    for &edge in open_edges {
        closed[topology.vertex_piece[topology.edges[edge as usize][0] as usize] as usize] = false;
    }
    let mut members = vec![Vec::new(); topology.pieces];
    for (index, cell) in mesh.cells.iter().enumerate() {
        members[piece(cell)].push(index);
    }
    let plane = symmetry.half().map(|(plane, _)| plane);
    let mut turned = 0;
    for members in members.into_iter().zip(closed).filter_map(|(members, closed)| closed.then_some(members)) {
        let cells: Vec<Cell> = members.iter().map(|&index| mesh.cells[index]).collect();
        if enclosed_volume(&mesh.vertices, &cells, plane) < 0.0 {
            turned += members.len();
            members.into_iter().for_each(|index| mesh.cells[index] = mesh.cells[index].flipped());
        }
    }
    turned
}

/// The error of a mesh with open edges: what made them.
pub(crate) fn open_mesh(
    mesh: &SurfaceMesh,
    topology: &Topology,
    symmetry: &MeshSymmetry,
    open_edges: &[u32],
    length: f64,
) -> SetupError {
    let edges: Vec<[u32; 2]> = open_edges.iter().map(|&edge| topology.edges[edge as usize]).collect();
    let count = edges.len();
    if let Some(crack) = cracks::find(&mesh.vertices, &edges, length) {
        return SetupError::DoubleVertices {
            edges: crack.edges,
            distance: crack.distance,
            tolerance: crack.tolerance(length),
            first: crack.first,
            position: mesh.vertices[crack.first[0] as usize],
        };
    }
    let off = |vertex: u32| symmetry.plane.signed_distance(&mesh.vertices[vertex as usize]);
    let farthest = edges.iter().flatten().copied().max_by(|&a, &b| off(a).abs().total_cmp(&off(b).abs()));
    let side = |sign: f64| (0..mesh.vertices.len() as u32).all(|v| sign * off(v) >= -NEAR_PLANE * length);
    if let Some(vertex) = farthest.filter(|&v| off(v).abs() <= NEAR_PLANE * length)
        && (side(1.0) || side(-1.0))
    {
        let position = mesh.vertices[vertex as usize];
        let (distance, tolerance) = (off(vertex).abs(), symmetry.tolerance);
        return SetupError::BorderOffPlane { count, vertex, position, distance, tolerance };
    }
    let first = edges.first().copied().unwrap_or_default();
    SetupError::OpenMesh { count, first, position: mesh.vertices[first[0] as usize] }
}
