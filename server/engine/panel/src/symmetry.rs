//! The plane of symmetry y = 0.

use std::collections::HashMap;

use moldline_mesh::{Plane, SurfaceMesh, Vector3, symmetry::pair_vertices};

use crate::PanelError;

/// Distance from the plane, and between a vertex and its partner's image, as a fraction of the diagonal of the mesh's box.
pub(crate) const SYMMETRY_TOLERANCE: f64 = 1e-5;

/// The distance within which vertices are in the plane, or each other's images, m: one for finding the symmetry and for checking it.
pub(crate) fn symmetry_tolerance(vertices: &[[f64; 3]]) -> f64 {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for x in vertices {
        for axis in 0..3 {
            low[axis] = low[axis].min(x[axis]);
            high[axis] = high[axis].max(x[axis]);
        }
    }
    SYMMETRY_TOLERANCE * (Vector3::from(high) - Vector3::from(low)).norm()
}

/// The mirror image.
pub(crate) fn mirrored(x: Vector3) -> Vector3 {
    Vector3::new(x.x, -x.y, x.z)
}

/// Partners of the vertices and of the cells of a mesh that is its own mirror image.
pub(crate) struct Partners {
    pub vertices: Vec<u32>,
    pub cells: Vec<u32>,
}

impl Partners {
    /// Pairs vertices and cells.
    pub fn new(mesh: &SurfaceMesh, tolerance: f64) -> Result<Self, PanelError> {
        let plane = Plane::y_zero();
        let vertices = pair_vertices(&mesh.vertices, &plane, tolerance)
            .map_err(|error| PanelError::NotSymmetric(error.to_string()))?;
        let key = |vertices: &mut dyn Iterator<Item = u32>| {
            let mut vertices: Vec<u32> = vertices.collect();
            vertices.sort_unstable();
            vertices
        };
        let by_vertices: HashMap<Vec<u32>, u32> = mesh
            .cells
            .iter()
            .enumerate()
            .map(|(index, cell)| (key(&mut cell.vertices().iter().copied()), index as u32))
            .collect();
        let mut cells = Vec::with_capacity(mesh.cells.len());
        for (index, cell) in mesh.cells.iter().enumerate() {
            let sides = cell.vertices().iter().map(|&v| plane.signed_distance(&mesh.vertices[v as usize]));
            let (low, high) = sides.fold((0.0_f64, 0.0_f64), |(low, high), y| (low.min(y), high.max(y)));
            let image = key(&mut cell.vertices().iter().map(|&v| vertices[v as usize]));
            match by_vertices.get(&image) {
                Some(&other) if other != index as u32 && (low >= -tolerance || high <= tolerance) => {
                    cells.push(other);
                }
                _ => {
                    let text = format!("cells[{index}] has no image, or crosses the plane");
                    return Err(PanelError::NotSymmetric(text));
                }
            }
        }
        Ok(Self { vertices, cells })
    }
}
