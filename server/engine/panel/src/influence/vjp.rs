//! Transposed derivatives of the residual `R`, patch by patch.

use moldline_foundation::simd::widest;
use moldline_mesh::Vector3;
use rayon::prelude::*;

use super::{
    assembly::wake_angles,
    derivative::{EdgeGradient, Filaments, Product, Slopes, SourceGradient, Strengths, each_pair, no_slopes},
    kernels::BY_4_PI,
    records::{EdgeRecord, Influence, PatchRecord, Radii, Tile, across},
};
use crate::{
    Monitor, PanelError, Stage,
    lanes::{LANES, Lane, total},
    progress::Progress,
};

/// Parts of the patches that gather the slopes of collocation points on their own. Fixed, so that sums do not depend on threads.
const PARTS: usize = 16;
/// Numbers in which the lanes of one product are summed.
const QUARTER: usize = LANES / 4;

/// The gradient of one seed of `R` with respect to the arguments of `R`.
#[derive(Clone)]
pub(crate) struct PairSeeds<const B: usize> {
    pub points: Vec<Vector3>,
    pub centres: Vec<Vector3>,
    /// Of `s = sigma n`.
    pub sources: [Vec<Vector3>; B],
    /// Of the circulations.
    pub strips: [Vec<f64>; B],
}

/// Seeds times the gradients of `R`, summed over all points. A row is one onset flow of one seed.
struct Sums<const B: usize> {
    patches: Vec<PatchSums>,
    wakes: WakeSums,
    /// Of every tile.
    slopes: Vec<Slopes<B>>,
}

/// Sums of one patch: of every edge and row those of `(a, b, T)`, of every panel and row those of omega and the arm.
struct PatchSums {
    edges: Vec<[f64; 9]>,
    panels: Vec<[f64; 4]>,
}

/// Sums of the wakes: of every strip and row those of omega, of every ray and row those of y and z.
struct WakeSums {
    strips: Vec<f64>,
    rays: Vec<[f64; 2]>,
}

impl<const B: usize> Influence<'_, B> {
    /// The transpose of [`jvp`](Self::jvp): `seeds[s][k]` are those of `R` for onset flow k.
    pub fn vjp(
        &self,
        strengths: &Strengths<'_, B>,
        seeds: &[[Vec<f64>; B]],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<PairSeeds<B>>, PanelError> {
        let filaments = self.filaments(strengths);
        let count = self.panels.len().div_ceil(LANES);
        // Of every tile: the rows of all seeds.
        let lane = |index: usize, row: &[f64]| {
            std::array::from_fn(|l| BY_4_PI * row.get(LANES * index + l).copied().unwrap_or(0.0))
        };
        let psi: Vec<Vec<Lane>> =
            (0..count).map(|index| seeds.iter().flatten().map(|row| lane(index, row)).collect()).collect();
        let sums = self.sums(&filaments, &psi, monitor)?;
        Ok((0..seeds.len())
            .map(|seed| {
                let row = |item: usize, k: usize| (item * seeds.len() + seed) * B + k;
                self.chain(row, &sums, &filaments, &psi)
            })
            .collect())
    }

    /// The pass over all pairs.
    fn sums(
        &self,
        filaments: &Filaments<B>,
        psi: &[Vec<Lane>],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Sums<B>, PanelError> {
        let tiles: Vec<Vec<Tile>> = (0..psi.len()).map(|index| self.images(index)).collect();
        let progress = Progress::new(monitor, Stage::Derivative, self.patches.len());
        let per_part = self.patches.len().div_ceil(PARTS).max(1);
        let parts: Vec<(Vec<PatchSums>, Vec<Slopes<B>>)> = self
            .patches
            .par_chunks(per_part)
            .map_init(<[Radii; 2]>::default, |radii, patches| {
                let mut slopes = vec![no_slopes(); tiles.len()];
                let mut sums = Vec::with_capacity(patches.len());
                for patch in patches {
                    if progress.cancelled() {
                        break;
                    }
                    sums.push(patch_vjp(patch, filaments, &tiles, psi, radii, &mut slopes));
                    progress.step();
                }
                (sums, slopes)
            })
            .collect();
        progress.finish()?;
        let mut slopes = vec![no_slopes(); tiles.len()];
        let wakes = self.wake_vjp(filaments, &tiles, psi, &mut slopes);
        for (_, part) in &parts {
            for (sum, part) in slopes.as_flattened_mut().iter_mut().zip(part.as_flattened()) {
                for axis in 0..3 {
                    (0..LANES).for_each(|l| sum[axis][l] += part[axis][l]);
                }
            }
        }
        let patches = parts.into_iter().flat_map(|(sums, _)| sums).collect();
        Ok(Sums { patches, wakes, slopes })
    }

    fn wake_vjp(
        &self,
        filaments: &Filaments<B>,
        tiles: &[Vec<Tile>],
        psi: &[Vec<Lane>],
        slopes: &mut [Slopes<B>],
    ) -> WakeSums {
        let rows = psi.first().map_or(0, Vec::len);
        let mut sums = WakeSums {
            strips: vec![0.0; self.wakes.strips.len() * rows],
            rays: vec![[0.0; 2]; self.wakes.rays.len() * rows],
        };
        let mut angles = vec![[0.0; LANES]; self.wakes.strips.len()];
        let product = |a: &Lane, b: &Lane| total(&std::array::from_fn(|l| a[l] * b[l]));
        for ((images, psi), slopes) in tiles.iter().zip(psi).zip(slopes) {
            for ray in 0..self.wakes.rays.len() {
                let g = self.ray_gradient(ray, filaments, images, slopes);
                for (sum, psi) in sums.rays[ray * rows..][..rows].iter_mut().zip(psi) {
                    (0..2).for_each(|axis| sum[axis] += product(psi, &g[axis]));
                }
            }
            angles.fill([0.0; LANES]);
            images.iter().for_each(|tile| wake_angles(&self.pieces, tile, &mut angles));
            for (sums, omega) in sums.strips.chunks_mut(rows.max(1)).zip(&angles) {
                sums.iter_mut().zip(psi).for_each(|(sum, psi)| *sum += product(psi, omega));
            }
        }
        sums
    }

    /// From sums over pairs to the points, centres, sources and circulations of one seed, whose rows of an item `row` has.
    fn chain(
        &self,
        row: impl Fn(usize, usize) -> usize,
        sums: &Sums<B>,
        filaments: &Filaments<B>,
        psi: &[Vec<Lane>],
    ) -> PairSeeds<B> {
        let mut out = PairSeeds {
            points: vec![Vector3::zeros(); self.surface.points.len()],
            centres: (0..self.panels.len())
                .map(|panel| {
                    let (tile, l) = (panel / LANES, panel % LANES);
                    let slope = |k: usize| Vector3::from(sums.slopes[tile][k].map(|axis| axis[l]));
                    (0..B).map(|k| slope(k) * psi[tile][row(0, k)][l]).sum()
                })
                .collect(),
            sources: std::array::from_fn(|_| vec![Vector3::zeros(); self.panels.len()]),
            strips: std::array::from_fn(|k| {
                (0..self.wakes.strips.len()).map(|s| -sums.wakes.strips[row(s, k)]).collect()
            }),
        };
        for (patch, sums) in self.patches.iter().zip(&sums.patches) {
            for (local, edge) in patch.edges.iter().enumerate() {
                self.chain_edge(edge, std::array::from_fn(|k| sums.edges[row(local, k)]), &mut out);
            }
            for (local, panel) in patch.panels.iter().enumerate() {
                for k in 0..B {
                    let [omega, x, y, z] = sums.panels[row(local, k)];
                    out.centres[panel.index] += omega * Vector3::from(panel.s[k]);
                    out.sources[k][panel.index] += Vector3::new(x, y, z);
                }
            }
        }
        for (index, ray) in self.wakes.rays.iter().enumerate() {
            for k in 0..B {
                let [y, z] = sums.wakes.rays[row(index, k)];
                out.points[ray.point as usize] += filaments.rays[index][k] * Vector3::new(0.0, y, z);
            }
        }
        out
    }

    /// From the sums of `(a, b, T)` to the ends of an edge and the sources beside it: `T = e x (s_left - s_right)`, `e = (b - a) / L`.
    fn chain_edge(&self, record: &EdgeRecord<B>, sums: [[f64; 9]; B], out: &mut PairSeeds<B>) {
        let e = &self.panels.edges[record.index];
        let along = Vector3::from(record.along);
        let mut of_along = Vector3::zeros();
        for k in 0..B {
            let [ax, ay, az, bx, by, bz, tx, ty, tz] = sums[k];
            out.points[e.a as usize] += Vector3::new(ax, ay, az);
            out.points[e.b as usize] += Vector3::new(bx, by, bz);
            let t = Vector3::new(tx, ty, tz);
            of_along += across(&self.sources[k], e).cross(&t);
            let difference = t.cross(&along);
            out.sources[k][e.left as usize] += difference;
            if let Some(right) = e.right {
                out.sources[k][right as usize] -= difference;
            }
        }
        let vector = (of_along - along * along.dot(&of_along)) / record.length;
        out.points[e.a as usize] -= vector;
        out.points[e.b as usize] += vector;
    }
}

/// The sums of one patch over all tiles.
fn patch_vjp<const B: usize>(
    patch: &PatchRecord<B>,
    filaments: &Filaments<B>,
    tiles: &[Vec<Tile>],
    psi: &[Vec<Lane>],
    radii: &mut [Radii; 2],
    slopes: &mut [Slopes<B>],
) -> PatchSums {
    let rows = psi.first().map_or(0, Vec::len);
    let mut edges = vec![[[0.0; QUARTER]; 9]; patch.edges.len() * rows];
    let mut panels = vec![[[0.0; QUARTER]; 4]; patch.panels.len() * rows];
    for ((images, psi), slopes) in tiles.iter().zip(psi).zip(slopes) {
        widest(
            #[inline(always)]
            || {
                let mut product = TileSums { psi, edges: &mut edges, panels: &mut panels };
                each_pair(patch, filaments, images, radii, slopes, &mut product);
            },
        );
    }
    PatchSums { edges: edges.iter().map(gathered).collect(), panels: panels.iter().map(gathered).collect() }
}

/// Adds one tile to the sums of a patch.
struct TileSums<'a> {
    /// Seeds of every row.
    psi: &'a [Lane],
    edges: &'a mut [[[f64; QUARTER]; 9]],
    panels: &'a mut [[[f64; QUARTER]; 4]],
}

impl<const B: usize> Product<B> for TileSums<'_> {
    #[inline(always)]
    fn edge(&mut self, local: usize, gradient: &EdgeGradient<B>) {
        let rows = self.psi.len();
        for (row, (sums, psi)) in self.edges[local * rows..][..rows].iter_mut().zip(self.psi).enumerate() {
            let ends = &gradient.ends[row % B];
            for i in 0..6 {
                gather(&mut sums[i], psi, &ends[i]);
            }
            for i in 0..3 {
                gather(&mut sums[6 + i], psi, &gradient.t[i]);
            }
        }
    }

    #[inline(always)]
    fn panel(&mut self, local: usize, gradient: &SourceGradient) {
        let rows = self.psi.len();
        for (sums, psi) in self.panels[local * rows..][..rows].iter_mut().zip(self.psi) {
            gather(&mut sums[0], psi, &gradient.omega);
            for i in 0..3 {
                gather(&mut sums[1 + i], psi, &gradient.arm[i]);
            }
        }
    }
}

/// Adds the product of seeds at the points of a tile with a gradient there.
#[inline(always)]
fn gather(sum: &mut [f64; QUARTER], seeds: &Lane, values: &Lane) {
    for i in 0..QUARTER {
        let at = |part: usize| seeds[part * QUARTER + i] * values[part * QUARTER + i];
        sum[i] += (at(0) + at(1)) + (at(2) + at(3));
    }
}

/// The whole sum, in one fixed order.
fn gathered<const N: usize>(sums: &[[f64; QUARTER]; N]) -> [f64; N] {
    std::array::from_fn(|i| (sums[i][0] + sums[i][2]) + (sums[i][1] + sums[i][3]))
}
