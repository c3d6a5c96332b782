//! Collisions: components that have come to cross where they did not, and surfaces that pass through themselves.

use std::sync::Arc;

use moldline_mesh::{Crossings, Plane, SurfaceMesh};

use crate::{DeformError, Monitor, OnEvent, SetupError, Stage, ownership::Ownership};

/// Pairs of cells that are told at most.
const MOST: usize = 1000;
/// Pairs of cells that may cross in the mesh as it is given, for every cell of it.
const KNOWN: usize = 16;

/// The search for collisions after a deformation.
#[derive(Clone, Debug)]
pub(crate) struct Collisions {
    on_event: OnEvent,
    search: Crossings,
    /// Pairs that cross in the mesh as it was given, ascending.
    known: Vec<[u32; 2]>,
    /// Plane and tolerance of a half model, and the side on which it lies.
    half: Option<(Plane, f64, f64)>,
    mesh: Arc<SurfaceMesh>,
    ownership: Arc<Ownership>,
}

impl Collisions {
    /// # Errors
    /// [`SetupError::Crossings`] if far more cells of the mesh cross than a mesh can have by mistake; cancelled.
    pub fn new(
        on_event: OnEvent,
        mesh: &Arc<SurfaceMesh>,
        ownership: &Arc<Ownership>,
        half: Option<(&Plane, f64)>,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Self, SetupError> {
        let search = Crossings::new(mesh);
        let limit = KNOWN * mesh.cells.len();
        let known = match on_event {
            OnEvent::Ignore => Vec::new(),
            _ => {
                let found = search.find(&mesh.vertices, limit + 1, &|| monitor.cancelled());
                found.ok_or(SetupError::Cancelled)?
            }
        };
        if let Some(&cells) = known.first().filter(|_| known.len() > limit) {
            let corner = mesh.cells[cells[0] as usize].vertices()[0];
            return Err(SetupError::Crossings { limit, cells, position: mesh.vertices[corner as usize] });
        }
        let half = half.map(|(plane, tolerance)| {
            let sum: f64 = mesh.vertices.iter().map(|x| plane.signed_distance(x)).sum();
            (*plane, tolerance, sum.signum())
        });
        Ok(Self { on_event, search, known, half, mesh: mesh.clone(), ownership: ownership.clone() })
    }

    /// Pairs of cells that cross and did not before, ascending; a cell that crosses its own mirror image is a pair with itself.
    ///
    /// # Errors
    /// [`DeformError::Collision`] if there are any and events are refused; cancelled.
    pub fn find(
        &self,
        vertices: &[[f64; 3]],
        names: impl Fn(u32) -> String,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<[u32; 2]>, DeformError> {
        if self.on_event == OnEvent::Ignore {
            return Ok(Vec::new());
        }
        let most = MOST + self.known.len();
        let cancelled = || monitor.cancelled();
        let found = self.search.find(vertices, most, &cancelled).ok_or(DeformError::Cancelled)?;
        let mut pairs: Vec<[u32; 2]> =
            found.into_iter().filter(|pair| self.known.binary_search(pair).is_err()).collect();
        pairs.extend(self.past_the_plane(vertices));
        pairs.sort_unstable();
        pairs.truncate(MOST);
        match pairs.first() {
            Some(&[one, two]) if self.on_event == OnEvent::Refuse => {
                let mut corners: Vec<u32> = [one, two]
                    .iter()
                    .flat_map(|c| self.mesh.cells[*c as usize].vertices())
                    .copied()
                    .collect();
                corners.sort_unstable();
                corners.dedup();
                let owner = |cell: u32| names(self.ownership.cell_owner[cell as usize]);
                Err(DeformError::Collision {
                    count: pairs.len(),
                    cells: [one, two],
                    components: [owner(one), owner(two)],
                    position: vertices[corners[0] as usize],
                    vertices: corners,
                })
            }
            _ => Ok(pairs),
        }
    }

    /// Cells of a half model that reach past the plane of symmetry.
    fn past_the_plane(&self, vertices: &[[f64; 3]]) -> Vec<[u32; 2]> {
        let Some((plane, tolerance, side)) = &self.half else { return Vec::new() };
        let past = |vertex: &u32| side * plane.signed_distance(&vertices[*vertex as usize]) < -tolerance;
        let cells = (0..).zip(&self.mesh.cells);
        cells.filter(|(_, cell)| cell.vertices().iter().any(past)).map(|(index, _)| [index, index]).collect()
    }
}
