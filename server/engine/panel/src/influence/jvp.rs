//! Directional derivatives of the residual `R`, tile by tile.

use moldline_foundation::simd::widest;
use moldline_mesh::Vector3;
use rayon::prelude::*;

use super::{
    assembly::wake_angles,
    derivative::{EdgeGradient, Filaments, Product, Slopes, SourceGradient, Strengths, each_pair, no_slopes},
    kernels::{BY_4_PI, Vector},
    records::{Influence, PatchRecord, Radii, Tile, across},
};
use crate::{
    Monitor, PanelError, Stage,
    lanes::{LANES, Lane},
    panels::Edge,
    progress::Progress,
};

/// A change of the residual's arguments in one direction.
pub(crate) struct PairChange<'a, const B: usize> {
    pub points: &'a [Vector3],
    pub centres: &'a [Vector3],
    /// Of `s = sigma n`.
    pub sources: [Vec<Vector3>; B],
    /// Of the circulations.
    pub strips: [Vec<f64>; B],
}

/// The change of an edge.
struct EdgeChange<const B: usize> {
    /// Of both ends.
    ends: [f64; 6],
    /// Of T.
    t: [Vector; B],
}

impl<const B: usize> Influence<'_, B> {
    /// The directional derivatives of `R` at fixed doublet strengths: for each direction and onset flow, one number a panel.
    pub fn jvp(
        &self,
        strengths: &Strengths<'_, B>,
        changes: &[PairChange<'_, B>],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<[Vec<f64>; B]>, PanelError> {
        let n = self.panels.len();
        let filaments = self.filaments(strengths);
        let of_edges: Vec<Vec<EdgeChange<B>>> = changes.iter().map(|c| self.edge_changes(c)).collect();
        let tiles = n.div_ceil(LANES);
        let progress = Progress::new(monitor, Stage::Derivative, tiles);
        let rows: Vec<Vec<[Lane; B]>> = (0..tiles)
            .into_par_iter()
            .map_init(<[Radii; 2]>::default, |radii, index| {
                if progress.cancelled() {
                    return vec![[[0.0; LANES]; B]; changes.len()];
                }
                let out = self.tile_jvp(index, &filaments, changes, &of_edges, radii);
                progress.step();
                out
            })
            .collect();
        progress.finish()?;
        let of = |direction: usize, k: usize| {
            rows.iter().flat_map(|tile| tile[direction][k].iter().map(|x| x * BY_4_PI)).take(n).collect()
        };
        Ok((0..changes.len()).map(|direction| std::array::from_fn(|k| of(direction, k))).collect())
    }

    /// The changes of the ends and of T of every edge.
    fn edge_changes(&self, change: &PairChange<'_, B>) -> Vec<EdgeChange<B>> {
        let of_edge = |(index, e): (usize, &Edge)| {
            let (da, db) = (change.points[e.a as usize], change.points[e.b as usize]);
            let length = self.surface.lengths[index];
            let along = self.surface.edges[index] / length;
            let turn = (db - da - along * along.dot(&(db - da))) / length;
            let t = |k: usize| {
                let difference = across(&self.sources[k], e);
                (turn.cross(&difference) + along.cross(&across(&change.sources[k], e))).into()
            };
            EdgeChange { ends: [da.x, da.y, da.z, db.x, db.y, db.z], t: std::array::from_fn(t) }
        };
        self.panels.edges.iter().enumerate().map(of_edge).collect()
    }

    /// The changes of `4 pi R` at the points of a tile.
    fn tile_jvp(
        &self,
        index: usize,
        filaments: &Filaments<B>,
        changes: &[PairChange<'_, B>],
        of_edges: &[Vec<EdgeChange<B>>],
        radii: &mut [Radii; 2],
    ) -> Vec<[Lane; B]> {
        let mut out = vec![[[0.0; LANES]; B]; changes.len()];
        let images = self.images(index);
        let mut slopes = no_slopes();
        widest(
            #[inline(always)]
            || {
                for patch in &self.patches {
                    let mut product = PatchChange { patch, changes, of_edges, out: &mut out };
                    each_pair(patch, filaments, &images, radii, &mut slopes, &mut product);
                }
                self.wake_jvp(filaments, &images, changes, &mut slopes, &mut out);
            },
        );
        for (out, change) in out.iter_mut().zip(changes) {
            let moved = Tile::new(change.centres, LANES * index);
            for (out, slopes) in out.iter_mut().zip(&slopes) {
                for l in 0..LANES {
                    out[l] += (0..3).map(|axis| slopes[axis][l] * moved.0[axis][l]).sum::<f64>();
                }
            }
        }
        out
    }

    fn wake_jvp(
        &self,
        filaments: &Filaments<B>,
        images: &[Tile],
        changes: &[PairChange<'_, B>],
        slopes: &mut Slopes<B>,
        out: &mut [[Lane; B]],
    ) {
        for (index, ray) in self.wakes.rays.iter().enumerate() {
            let g = self.ray_gradient(index, filaments, images, slopes);
            for (out, change) in out.iter_mut().zip(changes) {
                let da = &change.points[ray.point as usize];
                for k in 0..B {
                    let strength = filaments.rays[index][k];
                    for l in 0..LANES {
                        out[k][l] += strength * (g[0][l] * da.y + g[1][l] * da.z);
                    }
                }
            }
        }
        let mut angles = vec![[0.0; LANES]; self.wakes.strips.len()];
        images.iter().for_each(|tile| wake_angles(&self.pieces, tile, &mut angles));
        for (out, change) in out.iter_mut().zip(changes) {
            for k in 0..B {
                for (omega, circulation) in angles.iter().zip(&change.strips[k]) {
                    for l in 0..LANES {
                        out[k][l] -= omega[l] * circulation;
                    }
                }
            }
        }
    }
}

/// Adds the changes that come from one patch.
struct PatchChange<'a, const B: usize> {
    patch: &'a PatchRecord<B>,
    changes: &'a [PairChange<'a, B>],
    of_edges: &'a [Vec<EdgeChange<B>>],
    out: &'a mut [[Lane; B]],
}

impl<const B: usize> Product<B> for PatchChange<'_, B> {
    #[inline(always)]
    fn edge(&mut self, local: usize, gradient: &EdgeGradient<B>) {
        let index = self.patch.edges[local].index;
        for (out, of_edges) in self.out.iter_mut().zip(self.of_edges) {
            let change = &of_edges[index];
            for k in 0..B {
                for l in 0..LANES {
                    let mut sum = 0.0;
                    for i in 0..6 {
                        sum += gradient.ends[k][i][l] * change.ends[i];
                    }
                    for i in 0..3 {
                        sum += gradient.t[i][l] * change.t[k][i];
                    }
                    out[k][l] += sum;
                }
            }
        }
    }

    #[inline(always)]
    fn panel(&mut self, local: usize, gradient: &SourceGradient) {
        let panel = &self.patch.panels[local];
        for (out, change) in self.out.iter_mut().zip(self.changes) {
            let dc = &change.centres[panel.index];
            for k in 0..B {
                let (s, ds) = (&panel.s[k], &change.sources[k][panel.index]);
                let along = s[0] * dc.x + s[1] * dc.y + s[2] * dc.z;
                for l in 0..LANES {
                    out[k][l] += gradient.omega[l] * along
                        + gradient.arm[0][l] * ds.x
                        + gradient.arm[1][l] * ds.y
                        + gradient.arm[2][l] * ds.z;
                }
            }
        }
    }
}
