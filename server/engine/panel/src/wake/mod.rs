//! Wakes: the edges where they leave the surface, and the strips of which they consist.
//!
//! From every trailing edge a strip of constant doublet strength (upper minus lower potential, [`crate::kutta`]) runs
//! downstream along x to infinity. Where a trailing edge ends on a body, the circulation of its last strip goes on over
//! the body: the strip's inner border then follows edges of the mesh along the body, near the straight line
//! downstream, to the body's aft end on the plane of symmetry. The potential jumps across those edges by the strip's circulation, so that
//! no vortex lies on the body, and what matters of the path is only that the sheet beside it is outside the body.
//!
//! In the order of the data: [`edges`] (which edges are trailing edges), [`strips`] (their lines and sides), [`paths`] (over bodies), [`sheets`]
//! (geometry, jumps and borders of a strip), [`crossing`] (whether a wake cuts the surface).

mod crossing;
mod edges;
mod lines;
mod paths;
mod sheets;
mod sight;
mod strips;

use moldline_mesh::{SurfaceMesh, Vector3};
use rayon::prelude::*;

pub use crossing::NearPass;
pub use lines::{EdgeLine, LeftOut, Reason};
pub(crate) use sheets::{Corner, Jump, Piece, Ray};
pub(crate) use sight::{Face, Sight};
pub(crate) use strips::{Beside, Strip};

use crate::{PanelError, TrailingEdges, panels::Panels};

/// All wakes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Wakes {
    pub strips: Vec<Strip>,
    /// Pieces of every strip.
    pub pieces: Vec<Vec<Piece>>,
    /// Trailing edges and edges of paths over bodies.
    pub jumps: Vec<Jump>,
    pub rays: Vec<Ray>,
    /// Whether an edge of the panels is a trailing edge.
    pub trailing: Vec<bool>,
    /// What looks like a trailing edge, but is none.
    pub left_out: Vec<LeftOut>,
}

impl Wakes {
    /// Finds trailing edges, strips and paths at the positions of the mesh.
    pub fn new(mesh: &SurfaceMesh, panels: &Panels, rule: &TrailingEdges) -> Result<Self, PanelError> {
        let points = panels.gather(&mesh.vertices);
        let edges::Found { edges, left_out } = edges::find(mesh, panels, &points, rule)?;
        let mut trailing = vec![false; panels.edges.len()];
        edges.iter().for_each(|&e| trailing[e as usize] = true);
        let mut strips = strips::along_lines(panels, &points, &edges)?;
        let mut paths = Vec::with_capacity(strips.len());
        for strip in &mut strips {
            paths.push(paths::over_bodies(panels, &points, &trailing, strip)?);
        }
        let mut wakes = Self { trailing, left_out, ..Self::default() };
        for (index, (strip, paths)) in (0..).zip(strips.iter().zip(paths)) {
            wakes.pieces.push(sheets::lay(panels, index, strip, paths, &mut wakes.jumps, &mut wakes.rays)?);
        }
        wakes.strips = strips;
        Ok(wakes)
    }

    /// The lines of trailing edges, the longest first.
    pub fn lines(&self, panels: &Panels, points: &[Vector3]) -> Vec<EdgeLine> {
        let sights: Vec<_> =
            (0..panels.edges.len() as u32).map(|edge| Sight::new(panels, points, edge)).collect();
        let edges = self.strips.iter().map(|strip| strip.edge).collect();
        EdgeLine::of(panels, points, &sights, edges)
    }

    /// Checks that no strip meets a cell. Returns the passes that are too near for the cells there, one of each strip.
    ///
    /// # Errors
    /// [`PanelError::WakeCutsBody`] for the first crossing.
    pub fn check(&self, panels: &Panels, points: &[Vector3]) -> Result<Vec<NearPass>, PanelError> {
        let mut on_edge = vec![false; points.len()];
        self.strips.iter().flat_map(|s| [s.a, s.b]).for_each(|point| on_edge[point as usize] = true);
        let strips: Vec<_> = self.strips.iter().zip(&self.pieces).collect();
        let checked: Vec<_> = strips
            .into_par_iter()
            .map(|(strip, pieces)| crossing::check(panels, points, &on_edge, strip, pieces))
            .collect();
        Ok(checked.into_iter().collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect())
    }
}
