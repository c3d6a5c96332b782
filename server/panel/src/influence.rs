//! Potentials of doublet panels, source panels and wakes at collocation points, and their derivative.
//!
//! With `R_i` the potential inside the surface at collocation point i (zero in the solution), mu the doublet strengths and
//! `s = sigma n` the sources:
//!
//! ```text
//! 4 pi R_i = - sum_j mu_j Omega_ij - sum_w Gamma_w Omega_iw - sum_e Q_ie T_e.(a_e - P_i) + sum_j s_j.(c_j - P_i) Omega_ij
//! ```
//!
//! Omega is the solid angle (van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30, 1983) of the panel's spherical
//! polygon, so that a closed surface of warped quadrilaterals closes exactly. The two triangles of a quadrilateral are
//! multiplied as complex numbers, which leaves one arc tangent; near a panel another form of the same number keeps its digits. Sources are summed by edges: `Q_e = ln((r_a + r_b + L) / (r_a + r_b - L))` belongs to
//! an edge, and both of its panels enter through `T_e = e x (s_left - s_right)`. The solid angle's derivative is a sum over edges as well
//! ([`EdgePairs`]), with the difference of the strengths on both sides.
//!
//! The derivative is linear in seeds and in directions, so a pair's geometry is evaluated once for all of them, and once for both images:
//! what a direction or a seed adds are a few products ([`EdgePairs`], [`PanelPairs`]). By the collocation point itself, it does not depend
//! on either ([`Slopes`]).
//!
//! Loops run over the collocation points of a tile and the panels of a patch. Nothing is approximated at a distance, so nothing jumps.

use std::{
    f64::consts::PI,
    sync::atomic::{AtomicUsize, Ordering},
};

use moldline_foundation::simd::widest;
use moldline_mesh::Vector3;
use rayon::prelude::*;

use crate::{
    Monitor, PanelError, Stage,
    lanes::{LANES, Lane, argument, log_ratio, total},
    matrix::Matrix,
    surface::Surface,
    topology::{Panels, Patch},
    wake::{Piece, Wakes},
};

/// Parts of the patches that gather seeds of collocation points on their own. Fixed, so that sums do not depend on threads.
const PARTS: usize = 16;
/// Numbers in which the lanes of one product are summed.
const QUARTER: usize = LANES / 4;
/// What is near a panel, as a part of its diagonal.
const NEAR: f64 = 0.25;
const BY_4_PI: f64 = 0.25 / PI;

/// Collocation points of a tile.
#[derive(Clone, Copy)]
struct Tile([Lane; 3]);

impl Tile {
    /// Those from `first` on; beyond the last one it is repeated.
    fn new(centres: &[Vector3], first: usize) -> Self {
        let at = |axis: usize| std::array::from_fn(|l| centres[(first + l).min(centres.len() - 1)][axis]);
        Self([at(0), at(1), at(2)])
    }

    fn mirrored(mut self) -> Self {
        self.0[1].iter_mut().for_each(|y| *y = -*y);
        self
    }

    /// Whether one of them may lie in a box.
    fn meets(&self, [low, high]: &[Vector3; 2]) -> bool {
        (0..3).all(|axis| {
            self.0[axis].iter().any(|x| *x >= low[axis]) && self.0[axis].iter().any(|x| *x <= high[axis])
        })
    }
}

/// An edge as the loops need it.
struct EdgeRecord<const B: usize> {
    /// Among all edges.
    index: usize,
    /// Among the patch's points.
    ends: [usize; 2],
    a: [f64; 3],
    along: [f64; 3],
    length: f64,
    /// `T`, for every onset flow.
    t: [[f64; 3]; B],
}

/// A panel as the loops need it.
struct PanelRecord<const B: usize> {
    /// Among all panels.
    index: usize,
    /// Among the patch's points.
    corners: [usize; 4],
    a: [f64; 3],
    /// `(b - a) x (c - a)` and `(c - a) x (d - a)`.
    twice_areas: [[f64; 3]; 2],
    /// Squared lengths ab, bc, cd, da, ac.
    squares: [f64; 5],
    normal: [f64; 3],
    /// A box beyond which no collocation point is so near that [`solid_angle`] would lose digits.
    reach: [Vector3; 2],
    centre: [f64; 3],
    /// `s`, for every onset flow.
    s: [[f64; 3]; B],
    /// Solid angle from its own centre.
    own: f64,
}

/// A patch as the loops need it.
struct PatchRecord<const B: usize> {
    points: Vec<[f64; 3]>,
    edges: Vec<EdgeRecord<B>>,
    panels: Vec<PanelRecord<B>>,
    /// The box of those of its panels.
    reach: [Vector3; 2],
}

/// Distances of a patch's points from those of a tile, and their inverses.
#[derive(Default)]
struct Radii {
    r: Vec<Lane>,
    by_r: Vec<Lane>,
}

impl Radii {
    #[inline(always)]
    fn fill(&mut self, points: &[[f64; 3]], tile: &Tile) {
        self.r.resize(points.len(), [0.0; LANES]);
        for (p, r) in points.iter().zip(&mut self.r) {
            for l in 0..LANES {
                let [x, y, z] = [p[0] - tile.0[0][l], p[1] - tile.0[1][l], p[2] - tile.0[2][l]];
                r[l] = (x * x + y * y + z * z).sqrt();
            }
        }
    }

    #[inline(always)]
    fn invert(&mut self) {
        self.by_r.resize(self.r.len(), [0.0; LANES]);
        for (r, by_r) in self.r.iter().zip(&mut self.by_r) {
            for l in 0..LANES {
                by_r[l] = 1.0 / r[l];
            }
        }
    }
}

/// A part of a wake as the loops need it.
struct PieceRecord {
    strip: u32,
    corners: [[f64; 3]; 4],
    infinite: bool,
}

/// The surface, its wakes and its sources for `B` onset flows.
pub(crate) struct Influence<'a, const B: usize> {
    panels: &'a Panels,
    wakes: &'a Wakes,
    surface: &'a Surface,
    sources: [Vec<Vector3>; B],
    patches: Vec<PatchRecord<B>>,
    pieces: Vec<PieceRecord>,
}

/// What the pass over pairs makes of the seeds of `R`, for one seed.
#[derive(Clone)]
pub(crate) struct PairSeeds<const B: usize> {
    pub points: Vec<Vector3>,
    pub centres: Vec<Vector3>,
    /// Of `s`.
    pub sources: [Vec<Vector3>; B],
    /// Of the circulations.
    pub strips: [Vec<f64>; B],
}

/// Strengths for which the residual is differentiated.
pub(crate) struct Strengths<'a, const B: usize> {
    /// mu of every panel.
    pub doublets: [&'a [f64]; B],
    /// Circulation of every strip.
    pub circulations: [&'a [f64]; B],
}

/// A change of what the residual depends on, in one direction.
pub(crate) struct PairChange<'a, const B: usize> {
    pub points: &'a [Vector3],
    pub centres: &'a [Vector3],
    pub sources: [Vec<Vector3>; B],
    pub strips: [Vec<f64>; B],
}

impl<'a, const B: usize> Influence<'a, B> {
    pub fn new(panels: &'a Panels, wakes: &'a Wakes, surface: &'a Surface) -> Self {
        let sources: [Vec<Vector3>; B] = std::array::from_fn(|k| surface.sources(panels.axes()[k]));
        let edge = |patch: &Patch, local: usize| {
            let index = patch.edges[local] as usize;
            let e = &panels.edges[index];
            let along = surface.edges[index] / surface.lengths[index];
            EdgeRecord {
                index,
                ends: patch.ends[local].map(|v| v as usize),
                a: surface.points[e.a as usize].into(),
                along: along.into(),
                length: surface.lengths[index],
                t: std::array::from_fn(|k| along.cross(&across(&sources[k], e)).into()),
            }
        };
        let panel = |patch: &Patch, local: usize| {
            let index = patch.panels[local] as usize;
            let [a, b, c, d] = panels.corners[index].map(|v| surface.points[v as usize]);
            let margin = Vector3::repeat(NEAR * (c - a).norm().max((d - b).norm()));
            PanelRecord {
                index,
                corners: patch.corners[local].map(|v| v as usize),
                a: a.into(),
                twice_areas: [(b - a).cross(&(c - a)).into(), (c - a).cross(&(d - a)).into()],
                squares: [b - a, c - b, d - c, a - d, c - a].map(|v| v.norm_squared()),
                normal: surface.normals[index].into(),
                reach: [a.inf(&b).inf(&c).inf(&d) - margin, a.sup(&b).sup(&c).sup(&d) + margin],
                centre: surface.centres[index].into(),
                s: std::array::from_fn(|k| sources[k][index].into()),
                own: own_solid_angle([a, b, c, d], &surface.centres[index], &surface.normals[index]),
            }
        };
        let patches = panels
            .patches
            .iter()
            .map(|patch| {
                let panels: Vec<PanelRecord<B>> =
                    (0..patch.panels.len()).map(|local| panel(patch, local)).collect();
                let [mut low, mut high] = [f64::INFINITY, f64::NEG_INFINITY].map(Vector3::repeat);
                for panel in &panels {
                    (low, high) = (low.inf(&panel.reach[0]), high.sup(&panel.reach[1]));
                }
                PatchRecord {
                    points: patch.points.iter().map(|p| surface.points[*p as usize].into()).collect(),
                    edges: (0..patch.edges.len()).map(|local| edge(patch, local)).collect(),
                    panels,
                    reach: [low, high],
                }
            })
            .collect();
        let mut pieces = Vec::new();
        for (strip, of_strip) in wakes.strips.iter().enumerate() {
            for piece in &of_strip.pieces {
                let at = |c: &crate::wake::Corner| <[f64; 3]>::from(c.position(&surface.points));
                let (corners, infinite) = match piece {
                    Piece::Strip([p, q]) => ([at(p), at(q), at(q), at(q)], true),
                    Piece::Quad(corners) => (corners.each_ref().map(at), false),
                };
                pieces.push(PieceRecord { strip: strip as u32, corners, infinite });
            }
        }
        Self { panels, wakes, surface, sources, patches, pieces }
    }

    /// The matrix of the potential inside (`circulation` maps doublet strengths to those of the wakes), and the right-hand sides `S sigma`.
    pub fn assemble(
        &self,
        circulation: &[Vec<(u32, f64)>],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<(Matrix, [Vec<f64>; B]), PanelError> {
        let n = self.panels.len();
        let mut matrix = Matrix::zeros(n);
        let tiles = n.div_ceil(LANES);
        let work = Work::new(monitor, Stage::Influence, tiles);
        let potentials: Vec<[Lane; B]> = matrix
            .tiles_mut()
            .enumerate()
            .map_init(
                || (Radii::default(), vec![[0.0; LANES]; self.wakes.strips.len()]),
                |(radii, strips), (index, rows)| {
                    let mut potential = [[0.0; LANES]; B];
                    if work.cancelled() {
                        return potential;
                    }
                    strips.fill([0.0; LANES]);
                    let images = self.images(index);
                    widest(
                        #[inline(always)]
                        || {
                            for patch in &self.patches {
                                for (image, tile) in images.iter().enumerate() {
                                    let own = (image == 0).then_some(index);
                                    accumulate(patch, tile, own, radii, rows, &mut potential);
                                }
                            }
                            images.iter().for_each(|tile| self.wake_angles(tile, strips));
                        },
                    );
                    for (row, omega) in circulation.iter().zip(strips.iter()) {
                        for &(panel, factor) in row {
                            for lane in 0..LANES {
                                rows[panel as usize][lane] += omega[lane] * factor;
                            }
                        }
                    }
                    for row in rows.iter_mut() {
                        row.iter_mut().for_each(|x| *x *= -BY_4_PI);
                    }
                    work.done(1);
                    potential
                },
            )
            .collect();
        work.finish()?;
        let right: [Vec<f64>; B] = std::array::from_fn(|k| {
            potentials.iter().flat_map(|p| p[k].iter().map(|x| x * BY_4_PI)).take(n).collect()
        });
        let sums = matrix.times(&[vec![1.0; n]]).swap_remove(0);
        let finite = |i: &usize| sums[*i].is_finite() && right.iter().all(|b| b[*i].is_finite());
        match (0..n).find(|i| !finite(i)) {
            Some(panel) => Err(PanelError::Singular { cell: self.panels.cell_of[panel] }),
            None => Ok((matrix, right)),
        }
    }

    /// A tile of collocation points, and its mirror image if there is one.
    fn images(&self, index: usize) -> Vec<Tile> {
        let tile = Tile::new(&self.surface.centres, LANES * index);
        if self.panels.symmetric { vec![tile, tile.mirrored()] } else { vec![tile] }
    }

    /// Adds the solid angles of the strips.
    #[inline(always)]
    fn wake_angles(&self, tile: &Tile, strips: &mut [Lane]) {
        for piece in &self.pieces {
            let out = &mut strips[piece.strip as usize];
            for l in 0..LANES {
                let at = |corner: usize| [0, 1, 2].map(|k| piece.corners[corner][k] - tile.0[k][l]);
                out[l] += if piece.infinite {
                    let (p, q) = (at(0), at(1));
                    let (rp, rq) = (norm(&p), norm(&q));
                    // The triangle of p, q and the point at infinity.
                    let real = (rp + p[0]) * (rq + q[0]) + p[1] * q[1] + p[2] * q[2];
                    2.0 * argument(p[1] * q[2] - p[2] * q[1], real)
                } else {
                    let [a, b, c, d] = [0, 1, 2, 3].map(at);
                    let [ra, rb, rc, rd] = [&a, &b, &c, &d].map(norm);
                    let one = triangle(&a, &b, &c, [ra, rb, rc]);
                    let two = triangle(&a, &c, &d, [ra, rc, rd]);
                    2.0 * argument(one[0] * two[1] + one[1] * two[0], one[0] * two[0] - one[1] * two[1])
                };
            }
        }
    }

    /// The directional derivatives of `R` at fixed doublet strengths: for each direction and onset flow, one number a panel.
    pub fn jvp(
        &self,
        strengths: &Strengths<'_, B>,
        changes: &[PairChange<'_, B>],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<[Vec<f64>; B]>, PanelError> {
        let n = self.panels.len();
        let terms = self.terms(strengths);
        let of_edges: Vec<Vec<EdgeChange<B>>> = changes.iter().map(|c| self.edge_changes(c)).collect();
        let tiles = n.div_ceil(LANES);
        let work = Work::new(monitor, Stage::Derivative, tiles);
        let rows: Vec<Vec<[Lane; B]>> = (0..tiles)
            .into_par_iter()
            .map_init(<[Radii; 2]>::default, |radii, index| {
                let mut out = vec![[[0.0; LANES]; B]; changes.len()];
                if work.cancelled() {
                    return out;
                }
                let images = self.images(index);
                let mut slopes = [[[0.0; LANES]; 3]; B];
                widest(
                    #[inline(always)]
                    || {
                        for patch in &self.patches {
                            self.patch_jvp(
                                patch,
                                &terms,
                                &images,
                                changes,
                                &of_edges,
                                radii,
                                &mut slopes,
                                &mut out,
                            );
                        }
                        self.wake_jvp(&terms, &images, changes, &mut slopes, &mut out);
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
                work.done(1);
                out
            })
            .collect();
        work.finish()?;
        let of = |direction: usize, k: usize| {
            rows.iter().flat_map(|tile| tile[direction][k].iter().map(|x| x * BY_4_PI)).take(n).collect()
        };
        Ok((0..changes.len()).map(|direction| std::array::from_fn(|k| of(direction, k))).collect())
    }

    /// The velocities of all panels at points, without what the wakes add.
    #[cfg(test)]
    pub fn velocities(&self, strengths: &Strengths<'_, B>, at: &[Vector3]) -> Vec<[Vector3; B]> {
        let terms = self.terms(strengths);
        let of_tile = |index: usize| {
            let tile = Tile::new(at, LANES * index);
            let images = if self.panels.symmetric { vec![tile, tile.mirrored()] } else { vec![tile] };
            let mut slopes = [[[0.0; LANES]; 3]; B];
            let mut radii = <[Radii; 2]>::default();
            for patch in &self.patches {
                pairs(patch, &terms, &images, &mut radii, &mut slopes, |_, _| (), |_, _| ());
            }
            let velocity =
                |l: usize| std::array::from_fn(|k| BY_4_PI * Vector3::from(slopes[k].map(|axis| axis[l])));
            (0..LANES).map(velocity).collect::<Vec<_>>()
        };
        let mut velocities: Vec<_> =
            (0..at.len().div_ceil(LANES)).into_par_iter().flat_map_iter(of_tile).collect();
        velocities.truncate(at.len());
        velocities
    }

    /// Changes of the ends and of T of every edge.
    fn edge_changes(&self, change: &PairChange<'_, B>) -> Vec<EdgeChange<B>> {
        let of_edge = |(index, e): (usize, &crate::topology::Edge)| {
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

    #[inline(always)]
    fn patch_jvp(
        &self,
        patch: &PatchRecord<B>,
        terms: &Terms<B>,
        images: &[Tile],
        changes: &[PairChange<'_, B>],
        of_edges: &[Vec<EdgeChange<B>>],
        radii: &mut [Radii; 2],
        slopes: &mut Slopes<B>,
        out: &mut [[Lane; B]],
    ) {
        let out = std::cell::RefCell::new(out);
        pairs(
            patch,
            terms,
            images,
            radii,
            slopes,
            #[inline(always)]
            |local, pairs| {
                let index = patch.edges[local].index;
                for (out, of_edges) in out.borrow_mut().iter_mut().zip(of_edges) {
                    let change = &of_edges[index];
                    for k in 0..B {
                        for l in 0..LANES {
                            let mut sum = 0.0;
                            for i in 0..6 {
                                sum += pairs.ends[k][i][l] * change.ends[i];
                            }
                            for i in 0..3 {
                                sum += pairs.t[i][l] * change.t[k][i];
                            }
                            out[k][l] += sum;
                        }
                    }
                }
            },
            #[inline(always)]
            |local, pairs| {
                let panel = &patch.panels[local];
                for (out, change) in out.borrow_mut().iter_mut().zip(changes) {
                    let dc = &change.centres[panel.index];
                    for k in 0..B {
                        let (s, ds) = (&panel.s[k], &change.sources[k][panel.index]);
                        let along = s[0] * dc.x + s[1] * dc.y + s[2] * dc.z;
                        for l in 0..LANES {
                            out[k][l] += pairs.omega[l] * along
                                + pairs.arm[0][l] * ds.x
                                + pairs.arm[1][l] * ds.y
                                + pairs.arm[2][l] * ds.z;
                        }
                    }
                }
            },
        );
    }

    fn wake_jvp(
        &self,
        terms: &Terms<B>,
        images: &[Tile],
        changes: &[PairChange<'_, B>],
        slopes: &mut Slopes<B>,
        out: &mut [[Lane; B]],
    ) {
        for (index, ray) in self.wakes.rays.iter().enumerate() {
            let g = self.ray_slopes(index, terms, images, slopes);
            for (out, change) in out.iter_mut().zip(changes) {
                let da = &change.points[ray.point as usize];
                for k in 0..B {
                    let strength = terms.rays[index][k];
                    for l in 0..LANES {
                        out[k][l] += strength * (g[0][l] * da.y + g[1][l] * da.z);
                    }
                }
            }
        }
        let mut angles = vec![[0.0; LANES]; self.wakes.strips.len()];
        images.iter().for_each(|tile| self.wake_angles(tile, &mut angles));
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

    /// [`ray_pairs`] of both images together; what they mean for the points is added to the slopes.
    #[inline(always)]
    fn ray_slopes(&self, ray: usize, terms: &Terms<B>, images: &[Tile], slopes: &mut Slopes<B>) -> [Lane; 2] {
        let point = &self.surface.points[self.wakes.rays[ray].point as usize];
        let mut sum = [[0.0; LANES]; 2];
        for (tile, side) in images.iter().zip([1.0, -1.0]) {
            let g = ray_pairs(point, tile);
            for l in 0..LANES {
                sum[0][l] += g[0][l];
                sum[1][l] += g[1][l];
                for k in 0..B {
                    slopes[k][1][l] -= side * terms.rays[ray][k] * g[0][l];
                    slopes[k][2][l] -= terms.rays[ray][k] * g[1][l];
                }
            }
        }
        sum
    }

    /// The transpose of [`jvp`](Self::jvp): `seeds[s][k]` are those of `R` for onset flow k.
    pub fn vjp(
        &self,
        strengths: &Strengths<'_, B>,
        seeds: &[[Vec<f64>; B]],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<PairSeeds<B>>, PanelError> {
        let n = self.panels.len();
        let terms = self.terms(strengths);
        let count = n.div_ceil(LANES);
        let tiles: Vec<Vec<Tile>> = (0..count).map(|index| self.images(index)).collect();
        // Of every tile: the rows of all seeds.
        let lane = |index: usize, row: &[f64]| {
            std::array::from_fn(|l| BY_4_PI * row.get(LANES * index + l).copied().unwrap_or(0.0))
        };
        let psi: Vec<Vec<Lane>> =
            (0..count).map(|index| seeds.iter().flatten().map(|row| lane(index, row)).collect()).collect();
        let work = Work::new(monitor, Stage::Derivative, self.patches.len());
        let per_part = self.patches.len().div_ceil(PARTS).max(1);
        let parts: Vec<(Vec<PatchSums>, Vec<Slopes<B>>)> = self
            .patches
            .par_chunks(per_part)
            .map_init(<[Radii; 2]>::default, |radii, patches| {
                let mut slopes = vec![[[[0.0; LANES]; 3]; B]; count];
                let mut sums = Vec::with_capacity(patches.len());
                for patch in patches {
                    if work.cancelled() {
                        break;
                    }
                    sums.push(patch_vjp(patch, &terms, &tiles, &psi, radii, &mut slopes));
                    work.done(1);
                }
                (sums, slopes)
            })
            .collect();
        work.finish()?;
        let mut slopes = vec![[[[0.0; LANES]; 3]; B]; count];
        let wakes = self.wake_vjp(&terms, &tiles, &psi, &mut slopes);
        for (_, part) in &parts {
            for (sum, part) in slopes.as_flattened_mut().iter_mut().zip(part.as_flattened()) {
                for axis in 0..3 {
                    (0..LANES).for_each(|l| sum[axis][l] += part[axis][l]);
                }
            }
        }
        let sums: Vec<PatchSums> = parts.into_iter().flat_map(|(sums, _)| sums).collect();
        Ok((0..seeds.len())
            .map(|seed| self.chain(seed, seeds.len(), &sums, &wakes, &terms, &psi, &slopes))
            .collect())
    }

    fn wake_vjp(
        &self,
        terms: &Terms<B>,
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
                let g = self.ray_slopes(ray, terms, images, slopes);
                for (sum, psi) in sums.rays[ray * rows..][..rows].iter_mut().zip(psi) {
                    (0..2).for_each(|axis| sum[axis] += product(psi, &g[axis]));
                }
            }
            angles.fill([0.0; LANES]);
            images.iter().for_each(|tile| self.wake_angles(tile, &mut angles));
            for (sums, omega) in sums.strips.chunks_mut(rows.max(1)).zip(&angles) {
                sums.iter_mut().zip(psi).for_each(|(sum, psi)| *sum += product(psi, omega));
            }
        }
        sums
    }

    /// From sums over pairs to one seed's points, centres, sources and circulations.
    fn chain(
        &self,
        seed: usize,
        seeds: usize,
        sums: &[PatchSums],
        wakes: &WakeSums,
        terms: &Terms<B>,
        psi: &[Vec<Lane>],
        slopes: &[Slopes<B>],
    ) -> PairSeeds<B> {
        let row = |item: usize, k: usize| (item * seeds + seed) * B + k;
        let mut points = vec![Vector3::zeros(); self.surface.points.len()];
        let mut sources: [Vec<Vector3>; B] =
            std::array::from_fn(|_| vec![Vector3::zeros(); self.panels.len()]);
        let mut centres: Vec<Vector3> = (0..self.panels.len())
            .map(|panel| {
                let (tile, l) = (panel / LANES, panel % LANES);
                let slope = |k: usize| Vector3::from(slopes[tile][k].map(|axis| axis[l]));
                (0..B).map(|k| slope(k) * psi[tile][row(0, k)][l]).sum()
            })
            .collect();
        for (patch, sums) in self.patches.iter().zip(sums) {
            for (local, record) in patch.edges.iter().enumerate() {
                let e = &self.panels.edges[record.index];
                let along = Vector3::from(record.along);
                let mut of_along = Vector3::zeros();
                for k in 0..B {
                    let [ax, ay, az, bx, by, bz, tx, ty, tz] = sums.edges[row(local, k)];
                    points[e.a as usize] += Vector3::new(ax, ay, az);
                    points[e.b as usize] += Vector3::new(bx, by, bz);
                    let t = Vector3::new(tx, ty, tz);
                    of_along += across(&self.sources[k], e).cross(&t);
                    let difference = t.cross(&along);
                    sources[k][e.left as usize] += difference;
                    if let Some(right) = e.right {
                        sources[k][right as usize] -= difference;
                    }
                }
                let vector = (of_along - along * along.dot(&of_along)) / record.length;
                points[e.a as usize] -= vector;
                points[e.b as usize] += vector;
            }
            for (local, panel) in patch.panels.iter().enumerate() {
                for k in 0..B {
                    let [omega, x, y, z] = sums.panels[row(local, k)];
                    centres[panel.index] += omega * Vector3::from(panel.s[k]);
                    sources[k][panel.index] += Vector3::new(x, y, z);
                }
            }
        }
        for (index, ray) in self.wakes.rays.iter().enumerate() {
            for k in 0..B {
                let [y, z] = wakes.rays[row(index, k)];
                points[ray.point as usize] += terms.rays[index][k] * Vector3::new(0.0, y, z);
            }
        }
        let strip = |k: usize| (0..self.wakes.strips.len()).map(|s| -wakes.strips[row(s, k)]).collect();
        PairSeeds { points, centres, sources, strips: std::array::from_fn(strip) }
    }

    /// Strengths of edges and rays, times 4 pi.
    fn terms(&self, strengths: &Strengths<'_, B>) -> Terms<B> {
        let mut edges: Vec<EdgeTerm<B>> = self
            .panels
            .edges
            .iter()
            .map(|e| EdgeTerm {
                constant: std::array::from_fn(|k| {
                    let mu = strengths.doublets[k];
                    let height = |panel: u32| {
                        self.sources[k][panel as usize].dot(&self.surface.centres[panel as usize])
                    };
                    let left = height(e.left) - mu[e.left as usize];
                    left - e.right.map_or(0.0, |right| height(right) - mu[right as usize])
                }),
                slope: std::array::from_fn(|k| across(&self.sources[k], e).into()),
            })
            .collect();
        for jump in &self.wakes.jumps {
            for k in 0..B {
                edges[jump.edge as usize].constant[k] -=
                    jump.sign * strengths.circulations[k][jump.strip as usize];
            }
        }
        let ray = |ray: &crate::wake::Ray| {
            std::array::from_fn(|k| -ray.sign * strengths.circulations[k][ray.strip as usize])
        };
        Terms { edges, rays: self.wakes.rays.iter().map(ray).collect() }
    }
}

/// `4 pi` times the strength of an edge as a filament: `constant - slope . P`.
struct EdgeTerm<const B: usize> {
    constant: [f64; B],
    slope: [[f64; 3]; B],
}

struct Terms<const B: usize> {
    edges: Vec<EdgeTerm<B>>,
    rays: Vec<[f64; B]>,
}

/// Left minus right of a vector field on the panels.
fn across(field: &[Vector3], edge: &crate::topology::Edge) -> Vector3 {
    field[edge.left as usize] - edge.right.map_or_else(Vector3::zeros, |right| field[right as usize])
}

/// How `4 pi R` changes with the points of a tile, for every onset flow.
type Slopes<const B: usize> = [[Lane; 3]; B];

/// How `4 pi R` changes with one edge, at the points of a tile and their images: `sum_k dR_k = ends[k] . (da, db) + t . dT_k`.
///
/// `dOmega = g_a . (da - dP) + g_b . (db - dP)` with `g_a = -(a x b) / (|a| (|a||b| + a.b))` and `g_b` likewise; `dQ = q_a . (da - dP)
/// + q_b . (db - dP) + q_l dL`.
struct EdgePairs<const B: usize> {
    ends: [[Lane; 6]; B],
    t: [Lane; 3],
}

impl<const B: usize> EdgePairs<B> {
    /// Adds one image; `side` is -1 for the mirrored one.
    #[inline(always)]
    fn add(
        &mut self,
        edge: &EdgeRecord<B>,
        term: &EdgeTerm<B>,
        tile: &Tile,
        radii: &Radii,
        side: f64,
        slopes: &mut Slopes<B>,
    ) {
        let length = edge.length;
        let way = [length * edge.along[0], length * edge.along[1], length * edge.along[2]];
        let [ra, rb] = [&radii.r[edge.ends[0]], &radii.r[edge.ends[1]]];
        let [by_ra, by_rb] = [&radii.by_r[edge.ends[0]], &radii.by_r[edge.ends[1]]];
        for l in 0..LANES {
            let p = [tile.0[0][l], tile.0[1][l], tile.0[2][l]];
            let a = [edge.a[0] - p[0], edge.a[1] - p[1], edge.a[2] - p[2]];
            let b = [a[0] + way[0], a[1] + way[1], a[2] + way[2]];
            let cross =
                [a[1] * way[2] - a[2] * way[1], a[2] * way[0] - a[0] * way[2], a[0] * way[1] - a[1] * way[0]];
            let sum = ra[l] + rb[l];
            // 2 (|a||b| + a.b)
            let by_product = 1.0 / ((sum + length) * (sum - length));
            let by_sum = -2.0 * length * by_product;
            let (q_a, q_b) = (by_sum * by_ra[l], by_sum * by_rb[l]);
            let stretch = 2.0 * sum * by_product;
            let q = log_ratio(sum, length);
            for k in 0..B {
                let (t, slope) = (&edge.t[k], &term.slope[k]);
                let t_a = t[0] * a[0] + t[1] * a[1] + t[2] * a[2];
                let strength = term.constant[k] - (slope[0] * p[0] + slope[1] * p[1] + slope[2] * p[2]);
                let turn = -2.0 * by_product * strength;
                let (turn_a, turn_b) = (turn * by_ra[l], turn * by_rb[l]);
                for axis in 0..3 {
                    let along = stretch * edge.along[axis];
                    let by_a = turn_a * cross[axis] - t_a * (q_a * a[axis] - along) - q * t[axis];
                    let by_b = turn_b * cross[axis] - t_a * (q_b * b[axis] + along);
                    self.ends[k][axis][l] += by_a;
                    self.ends[k][3 + axis][l] += by_b;
                    slopes[k][axis][l] -= if axis == 1 { side * (by_a + by_b) } else { by_a + by_b };
                }
            }
            for axis in 0..3 {
                self.t[axis][l] -= q * a[axis];
            }
        }
    }
}

/// How `4 pi R` changes with one panel as a source, at the points of a tile and their images: `dR_k = arm . ds_k + omega s_k . dc`.
struct PanelPairs {
    omega: Lane,
    arm: [Lane; 3],
}

impl PanelPairs {
    /// Adds one image; `side` is -1 for the mirrored one.
    #[inline(always)]
    fn add<const B: usize>(
        &mut self,
        panel: &PanelRecord<B>,
        tile: &Tile,
        radii: &Radii,
        side: f64,
        slopes: &mut Slopes<B>,
    ) {
        let omega = solid_angle(panel, tile, &radii.r);
        for l in 0..LANES {
            self.omega[l] += omega[l];
            for axis in 0..3 {
                self.arm[axis][l] += omega[l] * (panel.centre[axis] - tile.0[axis][l]);
                for k in 0..B {
                    let by_point = omega[l] * panel.s[k][axis];
                    slopes[k][axis][l] -= if axis == 1 { side * by_point } else { by_point };
                }
            }
        }
    }
}

/// Calls back with what derivatives need of every edge and panel of a patch, by their numbers in it.
#[inline(always)]
fn pairs<const B: usize>(
    patch: &PatchRecord<B>,
    terms: &Terms<B>,
    images: &[Tile],
    radii: &mut [Radii; 2],
    slopes: &mut Slopes<B>,
    mut of_edge: impl FnMut(usize, &EdgePairs<B>),
    mut of_panel: impl FnMut(usize, &PanelPairs),
) {
    for (tile, radii) in images.iter().zip(radii.iter_mut()) {
        radii.fill(&patch.points, tile);
        radii.invert();
    }
    for (local, edge) in patch.edges.iter().enumerate() {
        let mut pairs = EdgePairs { ends: [[[0.0; LANES]; 6]; B], t: [[0.0; LANES]; 3] };
        for ((tile, radii), side) in images.iter().zip(radii.iter()).zip([1.0, -1.0]) {
            pairs.add(edge, &terms.edges[edge.index], tile, radii, side, slopes);
        }
        of_edge(local, &pairs);
    }
    for (local, panel) in patch.panels.iter().enumerate() {
        let mut pairs = PanelPairs { omega: [0.0; LANES], arm: [[0.0; LANES]; 3] };
        for ((tile, radii), side) in images.iter().zip(radii.iter()).zip([1.0, -1.0]) {
            pairs.add(panel, tile, radii, side, slopes);
        }
        of_panel(local, &pairs);
    }
}

/// Adds the product of seeds at the points of a tile with what they are seeds of.
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

/// Sums over all points for one patch: of every edge and every row of seeds those of `(a, b, T)`, of every panel those of `omega` and the arm.
struct PatchSums {
    edges: Vec<[f64; 9]>,
    panels: Vec<[f64; 4]>,
}

/// The same for the wakes: of every strip and row, and of every ray and row (y and z).
struct WakeSums {
    strips: Vec<f64>,
    rays: Vec<[f64; 2]>,
}

/// Adds one patch's solid angles to the rows of a tile, and `4 pi` times the potential of its sources. `own` is the tile, if it is not an image.
#[inline(always)]
fn accumulate<const B: usize>(
    patch: &PatchRecord<B>,
    tile: &Tile,
    own: Option<usize>,
    radii: &mut Radii,
    rows: &mut [Lane],
    potential: &mut [Lane; B],
) {
    radii.fill(&patch.points, tile);
    for edge in &patch.edges {
        let [a, b] = [&radii.r[edge.ends[0]], &radii.r[edge.ends[1]]];
        for l in 0..LANES {
            let q = log_ratio(a[l] + b[l], edge.length);
            let [x, y, z] = [edge.a[0] - tile.0[0][l], edge.a[1] - tile.0[1][l], edge.a[2] - tile.0[2][l]];
            for k in 0..B {
                potential[k][l] += q * (edge.t[k][0] * x + edge.t[k][1] * y + edge.t[k][2] * z);
            }
        }
    }
    let near = tile.meets(&patch.reach);
    for panel in &patch.panels {
        let mut omega = if near && tile.meets(&panel.reach) {
            solid_angle_near(panel, tile, &patch.points, &radii.r)
        } else {
            solid_angle(panel, tile, &radii.r)
        };
        if own == Some(panel.index / LANES) {
            omega[panel.index % LANES] = panel.own;
        }
        let row = &mut rows[panel.index];
        for l in 0..LANES {
            row[l] += omega[l];
            let [x, y, z] = [
                panel.centre[0] - tile.0[0][l],
                panel.centre[1] - tile.0[1][l],
                panel.centre[2] - tile.0[2][l],
            ];
            for k in 0..B {
                potential[k][l] -= omega[l] * (panel.s[k][0] * x + panel.s[k][1] * y + panel.s[k][2] * z);
            }
        }
    }
}

/// The solid angle of a panel seen from its own centre, from inside: 2 pi if it is plane.
///
/// [`solid_angle`] has no meaning there: the centre lies on the panel, and mostly on the diagonal that cuts it.
fn own_solid_angle([a, b, c, d]: [Vector3; 4], centre: &Vector3, n: &Vector3) -> f64 {
    [(a, b), (b, c), (c, d), (d, a)]
        .into_iter()
        .map(|(p, q)| {
            let (p, q) = (p - centre, q - centre);
            let (rp, rq) = (p.norm(), q.norm());
            let real = rp * rq + p.dot(&q) + n.dot(&p) * rq + n.dot(&q) * rp;
            2.0 * argument(n.dot(&p.cross(&q)), real)
        })
        .sum()
}

/// The sums of one patch over all tiles.
fn patch_vjp<const B: usize>(
    patch: &PatchRecord<B>,
    terms: &Terms<B>,
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
                pairs(
                    patch,
                    terms,
                    images,
                    radii,
                    slopes,
                    #[inline(always)]
                    |local, pairs| {
                        for (row, (sums, psi)) in
                            edges[local * rows..][..rows].iter_mut().zip(psi).enumerate()
                        {
                            let ends = &pairs.ends[row % B];
                            for i in 0..6 {
                                gather(&mut sums[i], psi, &ends[i]);
                            }
                            for i in 0..3 {
                                gather(&mut sums[6 + i], psi, &pairs.t[i]);
                            }
                        }
                    },
                    #[inline(always)]
                    |local, pairs| {
                        for (sums, psi) in panels[local * rows..][..rows].iter_mut().zip(psi) {
                            gather(&mut sums[0], psi, &pairs.omega);
                            for i in 0..3 {
                                gather(&mut sums[1 + i], psi, &pairs.arm[i]);
                            }
                        }
                    },
                );
            },
        );
    }
    PatchSums { edges: edges.iter().map(gathered).collect(), panels: panels.iter().map(gathered).collect() }
}

/// An edge's change in one direction.
struct EdgeChange<const B: usize> {
    /// Of both ends.
    ends: [f64; 6],
    /// Of T.
    t: [[f64; 3]; B],
}

/// The same for a ray along x: `dOmega = g . (da - dP)` with y and z.
#[inline(always)]
fn ray_pairs(point: &Vector3, tile: &Tile) -> [Lane; 2] {
    let mut g = [[0.0; LANES]; 2];
    for l in 0..LANES {
        let a = [0, 1, 2].map(|k| point[k] - tile.0[k][l]);
        let r = norm(&a);
        let factor = -1.0 / (r * (r + a[0]));
        g[0][l] = factor * a[2];
        g[1][l] = -factor * a[1];
    }
    g
}

#[inline(always)]
fn norm(a: &[f64; 3]) -> f64 {
    (a[0] * a[0] + a[1] * a[1] + a[2] * a[2]).sqrt()
}

/// Real and imaginary part of a triangle's complex number, twice whose argument is its solid angle.
#[inline(always)]
fn triangle(a: &[f64; 3], b: &[f64; 3], c: &[f64; 3], [ra, rb, rc]: [f64; 3]) -> [f64; 2] {
    let dot = |x: &[f64; 3], y: &[f64; 3]| x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
    let imaginary = a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0]);
    [ra * rb * rc + dot(a, b) * rc + dot(a, c) * rb + dot(b, c) * ra, imaginary]
}

/// The solid angles of a panel from the points of a tile.
#[inline(always)]
fn solid_angle<const B: usize>(panel: &PanelRecord<B>, tile: &Tile, radii: &[Lane]) -> Lane {
    let [ra, rb, rc, rd] = [0, 1, 2, 3].map(|corner| &radii[panel.corners[corner]]);
    let [one, two] = &panel.twice_areas;
    let mut omega = [0.0; LANES];
    for l in 0..LANES {
        let [x, y, z] = [0, 1, 2].map(|k| panel.a[k] - tile.0[k][l]);
        let (a, b, c, d) = (ra[l], rb[l], rc[l], rd[l]);
        // 2 (|p||q| + p.q) of the sides and of the diagonal.
        let twice = |p: f64, q: f64, square: f64| (p + q) * (p + q) - square;
        let (ab, bc) = (twice(a, b, panel.squares[0]), twice(b, c, panel.squares[1]));
        let (cd, da) = (twice(c, d, panel.squares[2]), twice(d, a, panel.squares[3]));
        let ac = twice(a, c, panel.squares[4]);
        let real = [
            0.5 * (ab * c + ac * b + bc * a) - 2.0 * a * b * c,
            0.5 * (ac * d + da * c + cd * a) - 2.0 * a * c * d,
        ];
        let imaginary = [one[0] * x + one[1] * y + one[2] * z, two[0] * x + two[1] * y + two[2] * z];
        let re = real[0] * real[1] - imaginary[0] * imaginary[1];
        let im = real[0] * imaginary[1] + real[1] * imaginary[0];
        omega[l] = 2.0 * argument(im, re);
    }
    omega
}

/// The same from points that may be near. There the two triangles' numbers nearly vanish, and of [`solid_angle`] rounding leaves `r^3 / (area h)`
/// units in the last place at the height h; here it leaves r / h: triangles of the panel's normal with every side.
#[inline(always)]
fn solid_angle_near<const B: usize>(
    panel: &PanelRecord<B>,
    tile: &Tile,
    points: &[[f64; 3]],
    radii: &[Lane],
) -> Lane {
    let corners = panel.corners.map(|corner| &points[corner]);
    let radii = panel.corners.map(|corner| &radii[corner]);
    let dot = |p: &[f64; 3], q: &[f64; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
    let mut omega = [0.0; LANES];
    for l in 0..LANES {
        let ways = corners.map(|corner| [0, 1, 2].map(|k| corner[k] - tile.0[k][l]));
        let heights = ways.map(|way| dot(&way, &panel.normal));
        // Of both directions the one towards the panel.
        let side = 1.0_f64.copysign(heights[0] + heights[1] + heights[2] + heights[3]);
        let (mut re, mut im) = (1.0, 0.0);
        for i in 0..4 {
            let j = (i + 1) % 4;
            let (p, q) = (&ways[i], &ways[j]);
            let (rp, rq) = (radii[i][l], radii[j][l]);
            let real = rp * rq + dot(p, q) + side * (heights[i] * rq + heights[j] * rp);
            let cross = [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];
            let imaginary = side * dot(&panel.normal, &cross);
            (re, im) = (re * real - im * imaginary, re * imaginary + im * real);
        }
        omega[l] = 2.0 * argument(im, re);
    }
    omega
}

/// Progress of a parallel loop, and whether to go on.
struct Work<'a> {
    monitor: &'a dyn Monitor<Stage>,
    stage: Stage,
    total: usize,
    done: AtomicUsize,
}

impl<'a> Work<'a> {
    fn new(monitor: &'a dyn Monitor<Stage>, stage: Stage, total: usize) -> Self {
        monitor.progress(stage, 0.0);
        Self { monitor, stage, total, done: AtomicUsize::new(0) }
    }

    fn cancelled(&self) -> bool {
        self.monitor.cancelled()
    }

    fn done(&self, count: usize) {
        let before = self.done.fetch_add(count, Ordering::Relaxed);
        // Some twenty times.
        let step = self.total.div_ceil(20);
        if before / step != (before + count) / step {
            self.monitor.progress(self.stage, (before + count) as f64 / self.total as f64);
        }
    }

    fn finish(&self) -> Result<(), PanelError> {
        if self.done.load(Ordering::Relaxed) < self.total {
            return Err(PanelError::Cancelled);
        }
        self.monitor.progress(self.stage, 1.0);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{NoMonitor, Symmetry};
    use moldline_testing::{Random, Wing, partly_triangles, sphere};

    /// A closed surface is seen from inside under 4 pi: also if its quadrilaterals are warped, with its image, and where slender cells lie
    /// near to the opposite ones, over a thin trailing edge.
    #[test]
    fn rows_of_the_doublet_matrix_sum_to_minus_one() {
        let mut warped = sphere(6);
        let mut random = Random::new(3);
        warped.vertices.iter_mut().flatten().for_each(|x| *x += 0.03 * random.signed());
        let mixed = partly_triangles(&warped);
        let wing = |half| Wing { half, ..Wing::rectangular(24, 8) }.mesh();
        let thin = Wing { thickness: 0.01, ..Wing::rectangular(40, 8) }.mesh();
        let cases = [
            (sphere(8), Symmetry::Mirror),
            (warped, Symmetry::None),
            (mixed, Symmetry::None),
            (wing(false), Symmetry::None),
            (wing(false), Symmetry::Mirror),
            (wing(true), Symmetry::Half),
            (partly_triangles(&wing(true)), Symmetry::Half),
            (thin, Symmetry::Mirror),
        ];
        for (case, (mesh, symmetry)) in cases.iter().enumerate() {
            let panels = Panels::new(mesh, *symmetry).unwrap();
            let surface = Surface::new(&panels, &panels.gather(&mesh.vertices), 0.3).unwrap();
            let wakes = Wakes::default();
            let sums = if panels.symmetric {
                let (matrix, _) =
                    Influence::<2>::new(&panels, &wakes, &surface).assemble(&[], &NoMonitor).unwrap();
                matrix.times(&[vec![1.0; panels.len()]]).swap_remove(0)
            } else {
                let (matrix, _) =
                    Influence::<3>::new(&panels, &wakes, &surface).assemble(&[], &NoMonitor).unwrap();
                matrix.times(&[vec![1.0; panels.len()]]).swap_remove(0)
            };
            for (panel, sum) in sums.iter().enumerate() {
                assert!((sum + 1.0).abs() <= 1e-12, "case {case}, panel {panel}: {sum}");
            }
        }
    }
}
