//! Area vectors of cells, and vertex normals as their sums.

use crate::{Cell, Vector3};

/// Vertex normals, not normalised: the sum of the area vectors of the cells at each vertex.
pub fn vertex_normals(vertices: &[[f64; 3]], cells: &[Cell]) -> Vec<Vector3> {
    let mut normals = vec![Vector3::zeros(); vertices.len()];
    for cell in cells {
        let area = area_vector(vertices, cell);
        for &vertex in cell.vertices() {
            normals[vertex as usize] += area;
        }
    }
    normals
}

/// Newell's area vector of a cell, m^2: of a warped quadrilateral the mean of its two splits.
pub fn area_vector(vertices: &[[f64; 3]], cell: &Cell) -> Vector3 {
    let at = |vertex: u32| Vector3::from(vertices[vertex as usize]);
    match *cell.vertices() {
        [a, b, c] => 0.5 * (at(b) - at(a)).cross(&(at(c) - at(a))),
        [a, b, c, d] => 0.5 * (at(c) - at(a)).cross(&(at(d) - at(b))),
        _ => Vector3::zeros(),
    }
}
