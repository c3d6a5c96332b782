//! Quality of a deformed mesh, measured against the current surfaces.

use moldline_geometry::{Body, Location};
use moldline_mesh::{Cell, CellQuality, QualityReport, SurfaceMesh};
use moldline_spline::Vector3;
use rayon::prelude::*;

use crate::ownership::{Freedom, Ownership, centroid};

/// Where a cell's normal comes from.
#[derive(Clone, Copy, Debug)]
enum Source {
    /// The mean of the component's normals at these corners (a bit each), which are in the middle of the surface.
    Corners(u8),
    /// The foot point of its middle, searched from these parameters: all corners are on seams or sharp edges.
    Middle(Location),
}

/// Finds the owner's normal at each cell, and from it the quality of the mesh.
#[derive(Clone, Debug)]
pub struct Inspection {
    sources: Vec<Source>,
    names: Vec<String>,
}

impl Inspection {
    /// Prepares for a mesh in its reference state. `found`: the [`middles`](Self::middles) of an earlier set-up, taken if they fit.
    pub fn new(mesh: &SurfaceMesh, ownership: &Ownership, reference: &[Body], found: &[Location]) -> Self {
        let inner = |v: u32| matches!(ownership.of(v), [only] if only.freedom == Freedom::Surface);
        let masks: Vec<u8> = mesh
            .cells
            .iter()
            .map(|cell| {
                let corners = cell.vertices().iter().enumerate();
                corners.filter(|&(_, &v)| inner(v)).fold(0, |mask, (k, _)| mask | 1 << k)
            })
            .collect();
        let alone: Vec<usize> = (0..masks.len()).filter(|&cell| masks[cell] == 0).collect();
        let owner = |cell: usize| &reference[ownership.cell_owner[cell] as usize];
        let fits =
            |(&cell, at): (&usize, &Location)| (at.patch as usize) < owner(cell).component().patches().len();
        let middles: Vec<Location> = if found.len() == alone.len() && alone.iter().zip(found).all(fits) {
            found.to_vec()
        } else {
            let middle = |&cell: &usize| centroid(&mesh.vertices, &mesh.cells[cell]);
            alone.par_iter().map(|cell| owner(*cell).closest_point(&middle(cell)).location).collect()
        };
        let mut sources: Vec<Source> = masks.into_iter().map(Source::Corners).collect();
        for (&cell, location) in alone.iter().zip(middles) {
            sources[cell] = Source::Middle(location);
        }
        Self { sources, names: reference.iter().map(|b| b.component().name().to_owned()).collect() }
    }

    /// Parameters near the middles of the cells that have no corner in the middle of a surface.
    pub fn middles(&self) -> Vec<Location> {
        let middles = self.sources.iter().filter_map(|source| match source {
            Source::Middle(location) => Some(*location),
            Source::Corners(_) => None,
        });
        middles.collect()
    }

    /// Unit normal of its component at each cell. `locations`: parameters of each vertex on its first owner.
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
            .zip(&self.sources)
            .zip(owners)
            .map(|((cell, source), &owner)| {
                let body = &bodies[owner as usize];
                match *source {
                    Source::Corners(mask) => {
                        let corners = cell.vertices().iter().enumerate();
                        let inner = corners.filter(|&(k, _)| mask & (1 << k) != 0);
                        let sum: Vector3 = inner.map(|(_, &v)| body.normal(&locations[v as usize])).sum();
                        sum.normalize()
                    }
                    Source::Middle(location) => {
                        let middle = centroid(vertices, cell);
                        let corner = Vector3::from(vertices[cell.vertices()[0] as usize]);
                        let near = body.closest_point_near(&middle, &location);
                        // A foot point farther away than the cell's own corners is that of another sheet.
                        match near.filter(|foot| foot.distance.abs() <= (middle - corner).norm()) {
                            Some(foot) => foot.normal,
                            None => body.closest_point(&middle).normal,
                        }
                    }
                }
            })
            .collect()
    }

    /// The report; `None` for a mesh without cells.
    pub fn report(&self, cells: &[CellQuality], owners: &[u32]) -> Option<QualityReport> {
        QualityReport::new(cells, owners, &self.names)
    }
}
