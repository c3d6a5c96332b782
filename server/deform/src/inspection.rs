//! Quality of a deformed mesh, measured against the current surfaces.

use moldline_geometry::{Body, Location};
use moldline_mesh::{Cell, CellQuality, QualityReport, SurfaceMesh};
use moldline_spline::Vector3;
use rayon::prelude::*;

use crate::ownership::{Freedom, Ownership, centroid};

/// Where the search for a cell's foot point starts.
#[derive(Clone, Copy, Debug)]
enum Hint {
    /// At the current parameters of this vertex, which is in the middle of the surface.
    Vertex(u32),
    /// At the cell's own parameters in the reference state.
    Location(Location),
}

/// Finds the owner's normal at each cell, and from it the quality of the mesh.
#[derive(Clone, Debug)]
pub struct Inspection {
    hints: Vec<Hint>,
    names: Vec<String>,
}

impl Inspection {
    /// Prepares for a mesh in its reference state.
    pub fn new(mesh: &SurfaceMesh, ownership: &Ownership, reference: &[Body]) -> Self {
        let hints = mesh
            .cells
            .par_iter()
            .zip(&ownership.cell_owner)
            .map(|(cell, &owner)| {
                let inner = cell.vertices().iter().copied().find(|&v| {
                    matches!(ownership.of(v), [only] if only.component == owner && only.freedom == Freedom::Surface)
                });
                inner.map(Hint::Vertex).unwrap_or_else(|| {
                    let middle = centroid(&mesh.vertices, cell);
                    Hint::Location(reference[owner as usize].closest_point(&middle).location)
                })
            })
            .collect();
        Self { hints, names: reference.iter().map(|b| b.component().name().to_owned()).collect() }
    }

    /// Unit normal of its component at each cell's middle. `locations`: parameters of each vertex on its first owner.
    pub fn normals(
        &self,
        cells: &[Cell],
        owners: &[u32],
        vertices: &[[f64; 3]],
        locations: &[Location],
        bodies: &[Body],
    ) -> Vec<Vector3> {
        cells
            .par_iter()
            .zip(&self.hints)
            .zip(owners)
            .map(|((cell, hint), &owner)| {
                let body = &bodies[owner as usize];
                let hint = match *hint {
                    Hint::Vertex(v) => locations[v as usize],
                    Hint::Location(location) => location,
                };
                let foot = body.closest_point_near(&centroid(vertices, cell), &hint);
                foot.map_or_else(|| body.normal(&hint), |foot| foot.normal)
            })
            .collect()
    }

    /// Measures of every cell.
    pub fn cells(&self, vertices: &[[f64; 3]], cells: &[Cell], normals: &[Vector3]) -> Vec<CellQuality> {
        cells
            .par_iter()
            .zip(normals)
            .map(|(cell, normal)| CellQuality::of_cell(vertices, cell, normal))
            .collect()
    }

    /// The report; `None` for a mesh without cells.
    pub fn report(&self, cells: &[CellQuality], owners: &[u32]) -> Option<QualityReport> {
        QualityReport::new(cells, owners, &self.names)
    }
}

/// Area vector of a cell (Newell), m^2.
pub fn area_vector(vertices: &[[f64; 3]], cell: &Cell) -> Vector3 {
    let at = |v: u32| Vector3::from(vertices[v as usize]);
    let origin = at(cell.vertices()[0]);
    0.5 * cell.edges().map(|[a, b]| (at(a) - origin).cross(&(at(b) - origin))).sum::<Vector3>()
}
