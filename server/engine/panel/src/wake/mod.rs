//! Wakes: the edges where they leave the surface, and the strips of which they consist.
//!
//! From every trailing edge a strip runs downstream along x, whose doublet strength is the circulation (upper minus lower potential),
//! linear between the edge's ends. Where a trailing edge ends on a body, the circulation of its end goes on over
//! the body: the strip's inner border then follows edges of the mesh along the body, near the straight line
//! downstream, to the body's aft end. The potential jumps across those edges by the circulation ([`crate::nodes`]), so that
//! no vortex lies on the body, and what matters of the path is only that the sheet beside it is outside the body.
//!
//! In the order of the data: [`sight`] (an edge as the flow sees it), [`edges`] (which edges are trailing edges), [`lines`] (the same for reports), [`strips`] (their lines and sides), [`paths`] (over bodies), [`crossing`]
//! (whether a wake cuts the surface), [`sheets`] (triangles of the wakes).

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
pub(crate) use sheets::{SheetTriangle, Sheets};
pub(crate) use sight::Sight;
pub(crate) use strips::{Beside, Strip};

use crate::{Monitor, PanelError, Stage, TrailingEdges, panels::Panels, progress::poll};

/// All wakes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Wakes {
    pub strips: Vec<Strip>,
    /// Paths over bodies from both ends of every strip, where it ends on one.
    pub paths: Vec<[Option<Vec<u32>>; 2]>,
    /// Whether an edge of the panels is a trailing edge.
    pub trailing: Vec<bool>,
    /// What looks like a trailing edge, but is none.
    pub left_out: Vec<LeftOut>,
}

impl Wakes {
    /// Finds trailing edges, strips and paths at the positions of the mesh.
    pub fn new(
        mesh: &SurfaceMesh,
        panels: &Panels,
        rule: &TrailingEdges,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Self, PanelError> {
        let points = panels.gather(&mesh.vertices);
        let edges::Found { edges, left_out } = edges::find(mesh, panels, &points, rule)?;
        let mut trailing = vec![false; panels.edges.len()];
        edges.iter().for_each(|&e| trailing[e as usize] = true);
        let mut strips = strips::along_lines(panels, &points, &edges)?;
        let mut paths = Vec::with_capacity(strips.len());
        for strip in &mut strips {
            poll(monitor)?;
            let of_strip = paths::over_bodies(panels, &points, &trailing, strip)?;
            if of_strip.iter().all(Option::is_some) {
                return Err(PanelError::NoCarryOver { vertex: panels.vertex_of[strip.a as usize] });
            }
            paths.push(of_strip);
        }
        Ok(Self { strips, paths, trailing, left_out })
    }

    /// The lines of trailing edges, the longest first.
    pub fn lines(&self, panels: &Panels, points: &[Vector3]) -> Vec<EdgeLine> {
        let all = 0..panels.edges.len() as u32;
        let sights: Vec<_> = all.clone().map(|edge| Sight::new(panels, points, edge)).collect();
        EdgeLine::of(panels, points, &sights, all.filter(|e| self.trailing[*e as usize]).collect())
    }

    /// Checks that no strip meets a cell. Returns the passes that are too near for the cells there, one of each strip.
    ///
    /// # Errors
    /// [`PanelError::WakeCutsBody`] for the first crossing.
    pub fn check(
        &self,
        panels: &Panels,
        points: &[Vector3],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<NearPass>, PanelError> {
        let mut on_edge = vec![false; points.len()];
        self.strips.iter().flat_map(|s| [s.a, s.b]).for_each(|point| on_edge[point as usize] = true);
        let strips: Vec<_> = self.strips.iter().zip(&self.paths).collect();
        let checked: Vec<_> = strips
            .into_par_iter()
            .map(|(strip, paths)| {
                poll(monitor)?;
                crossing::check(panels, points, &on_edge, strip, &sheets::rest(strip, paths))
            })
            .collect();
        Ok(checked.into_iter().collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect())
    }

    /// What is left of a circulation at its body's aft end off the plane of symmetry, as factors of those at the ends of strips (strip after strip): all that
    /// arrive there give up the same share of what would leave as one vortex.
    pub fn leaving(&self, index: usize, side: usize) -> Vec<(u32, f64)> {
        let end = self.strips[index].beside[side];
        let mut arriving = Vec::new();
        for (other, strip) in self.strips.iter().enumerate() {
            for of in 0..2 {
                if strip.beside[of] == end {
                    arriving.push((2 * other + of, if of == side { 1.0 } else { -1.0 }));
                }
            }
        }
        let share = 1.0 / arriving.len() as f64;
        let own = 2 * index + side;
        let term =
            |(other, sign): (usize, f64)| (other as u32, f64::from(u8::from(other == own)) - sign * share);
        arriving.into_iter().map(term).filter(|(_, factor)| *factor != 0.0).collect()
    }
}
