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
//! multiplied as complex numbers, which leaves one arc tangent. Sources are summed by edges: `Q_e = ln((r_a + r_b + L) / (r_a + r_b - L))` belongs to
//! an edge, and both of its panels enter through `T_e = e x (s_left - s_right)`. The solid angle's derivative is a sum over edges as well
//! ([`EdgePairs`]), with the difference of the strengths on both sides.
//!
//! Loops run over the collocation points of a tile. Nothing is approximated at a distance, so nothing jumps.

use std::{
    f64::consts::PI,
    sync::atomic::{AtomicUsize, Ordering},
};

use moldline_mesh::Vector3;
use pulp::Arch;
use rayon::prelude::*;

use crate::{
    Monitor, PanelError, Stage,
    lanes::{LANES, Lane, argument, dot_add, log_ratio, total},
    matrix::Matrix,
    surface::Surface,
    topology::Panels,
    wake::{Piece, Wakes},
};

/// Parts of the collocation points that gather seeds of the surface on their own. Fixed, so that sums do not depend on threads.
const PARTS: usize = 8;
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
}

/// An edge as the loops need it.
struct EdgeRecord<const B: usize> {
    ends: [u32; 2],
    a: [f64; 3],
    length: f64,
    /// `T`, for every onset flow.
    t: [[f64; 3]; B],
}

/// A panel as the loops need it.
struct PanelRecord<const B: usize> {
    corners: [u32; 4],
    a: [f64; 3],
    /// `(b - a) x (c - a)` and `(c - a) x (d - a)`.
    twice_areas: [[f64; 3]; 2],
    /// Squared lengths ab, bc, cd, da, ac.
    squares: [f64; 5],
    centre: [f64; 3],
    /// `s`, for every onset flow.
    s: [[f64; 3]; B],
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
    edges: Vec<EdgeRecord<B>>,
    records: Vec<PanelRecord<B>>,
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
        let edges = panels
            .edges
            .iter()
            .enumerate()
            .map(|(index, e)| EdgeRecord {
                ends: [e.a, e.b],
                a: surface.points[e.a as usize].into(),
                length: surface.lengths[index],
                t: std::array::from_fn(|k| {
                    let along = surface.edges[index] / surface.lengths[index];
                    along.cross(&across(&sources[k], e)).into()
                }),
            })
            .collect();
        let records = panels
            .corners
            .iter()
            .enumerate()
            .map(|(panel, corners)| {
                let [a, b, c, d] = corners.map(|v| surface.points[v as usize]);
                PanelRecord {
                    corners: *corners,
                    a: a.into(),
                    twice_areas: [(b - a).cross(&(c - a)).into(), (c - a).cross(&(d - a)).into()],
                    squares: [b - a, c - b, d - c, a - d, c - a].map(|v| v.norm_squared()),
                    centre: surface.centres[panel].into(),
                    s: std::array::from_fn(|k| sources[k][panel].into()),
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
        Self { panels, wakes, surface, sources, edges, records, pieces }
    }

    /// The matrix of the potential inside (`circulation` maps doublet strengths to those of the wakes), and the right-hand sides `S sigma`.
    pub fn assemble(
        &self,
        circulation: &[Vec<(u32, f64)>],
        monitor: &dyn Monitor,
    ) -> Result<(Matrix, [Vec<f64>; B]), PanelError> {
        let n = self.panels.len();
        let mut matrix = Matrix::zeros(n);
        let tiles = n.div_ceil(LANES);
        let arch = Arch::new();
        let work = Work::new(monitor, Stage::Influence, tiles);
        let potentials: Vec<[Lane; B]> = matrix
            .tiles_mut()
            .enumerate()
            .map_init(
                || (vec![[0.0; LANES]; self.surface.points.len()], vec![[0.0; LANES]; self.wakes.strips.len()]),
                |(radii, strips), (index, rows)| {
                    let mut potential = [[0.0; LANES]; B];
                    if work.cancelled() {
                        return potential;
                    }
                    strips.fill([0.0; LANES]);
                    let tile = Tile::new(&self.surface.centres, LANES * index);
                    arch.dispatch(
                        #[inline(always)]
                        || self.accumulate(&tile, radii, rows, &mut potential, strips),
                    );
                    for lane in 0..LANES.min(n - LANES * index) {
                        let own = LANES * index + lane;
                        rows[own][lane] = self.own_solid_angle(own);
                    }
                    if self.panels.symmetric {
                        let tile = tile.mirrored();
                        arch.dispatch(
                            #[inline(always)]
                            || self.accumulate(&tile, radii, rows, &mut potential, strips),
                        );
                    }
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

    /// Adds the solid angles of panels and of strips, and `4 pi` times the potential of the sources.
    #[inline(always)]
    fn accumulate(
        &self,
        tile: &Tile,
        radii: &mut [Lane],
        rows: &mut [Lane],
        potential: &mut [Lane; B],
        strips: &mut [Lane],
    ) {
        self.radii(tile, radii);
        for edge in &self.edges {
            let [a, b] = edge.ends.map(|v| &radii[v as usize]);
            for l in 0..LANES {
                let q = log_ratio(a[l] + b[l], edge.length);
                let a = [0, 1, 2].map(|k| edge.a[k] - tile.0[k][l]);
                for k in 0..B {
                    potential[k][l] = q.mul_add(dot_add(&edge.t[k], &a, 0.0), potential[k][l]);
                }
            }
        }
        for (panel, row) in self.records.iter().zip(rows) {
            let omega = solid_angle(panel, tile, radii);
            for l in 0..LANES {
                row[l] += omega[l];
                let c = [0, 1, 2].map(|k| panel.centre[k] - tile.0[k][l]);
                for k in 0..B {
                    potential[k][l] = (-omega[l]).mul_add(dot_add(&panel.s[k], &c, 0.0), potential[k][l]);
                }
            }
        }
        self.wake_angles(tile, strips);
    }

    #[inline(always)]
    fn radii(&self, tile: &Tile, radii: &mut [Lane]) {
        for (p, r) in self.surface.points.iter().zip(radii) {
            for l in 0..LANES {
                r[l] = norm(&[0, 1, 2].map(|k| p[k] - tile.0[k][l]));
            }
        }
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

    /// The solid angle of a panel seen from its own centre, from inside: 2 pi if it is plane.
    ///
    /// [`solid_angle`] has no meaning there: the centre lies on the panel, and mostly on the diagonal that cuts it.
    fn own_solid_angle(&self, panel: usize) -> f64 {
        let [a, b, c, d] = self.panels.corners[panel].map(|v| self.surface.points[v as usize]);
        let centre = self.surface.centres[panel];
        let n = &self.surface.normals[panel];
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

    /// The directional derivatives of `R` at fixed doublet strengths: for each direction and onset flow, one number a panel.
    pub fn jvp(
        &self,
        strengths: &Strengths<'_, B>,
        changes: &[PairChange<'_, B>],
        monitor: &dyn Monitor,
    ) -> Result<Vec<[Vec<f64>; B]>, PanelError> {
        let n = self.panels.len();
        let terms = self.terms(strengths);
        // Of every direction and edge: changes of length and of T.
        let edge_changes: Vec<Vec<(f64, [[f64; 3]; B])>> = changes
            .iter()
            .map(|change| {
                let of_edge = |(index, e): (usize, &crate::topology::Edge)| {
                    let d = change.points[e.b as usize] - change.points[e.a as usize];
                    let (along, length) =
                        (self.surface.edges[index] / self.surface.lengths[index], self.surface.lengths[index]);
                    let stretch = along.dot(&d);
                    let turn = (d - along * stretch) / length;
                    let t = std::array::from_fn(|k| {
                        let difference = across(&self.sources[k], e);
                        (turn.cross(&difference) + along.cross(&across(&change.sources[k], e))).into()
                    });
                    (stretch, t)
                };
                self.panels.edges.iter().enumerate().map(of_edge).collect()
            })
            .collect();
        let tiles = n.div_ceil(LANES);
        let arch = Arch::new();
        let work = Work::new(monitor, Stage::Derivative, tiles);
        let rows: Vec<Vec<[Lane; B]>> = (0..tiles)
            .into_par_iter()
            .map_init(
                || vec![[0.0; LANES]; self.surface.points.len()],
                |radii, index| {
                    let mut out = vec![[[0.0; LANES]; B]; changes.len()];
                    if work.cancelled() {
                        return out;
                    }
                    let tile = Tile::new(&self.surface.centres, LANES * index);
                    let moved: Vec<Tile> =
                        changes.iter().map(|c| Tile::new(c.centres, LANES * index)).collect();
                    arch.dispatch(
                        #[inline(always)]
                        || self.tile_jvp(&tile, &moved, &terms, changes, &edge_changes, radii, &mut out),
                    );
                    if self.panels.symmetric {
                        let (tile, moved) =
                            (tile.mirrored(), moved.iter().map(|m| m.mirrored()).collect::<Vec<_>>());
                        arch.dispatch(
                            #[inline(always)]
                            || self.tile_jvp(&tile, &moved, &terms, changes, &edge_changes, radii, &mut out),
                        );
                    }
                    work.done(1);
                    out
                },
            )
            .collect();
        work.finish()?;
        let of = |direction: usize, k: usize| {
            rows.iter().flat_map(|tile| tile[direction][k].iter().map(|x| x * BY_4_PI)).take(n).collect()
        };
        Ok((0..changes.len()).map(|direction| std::array::from_fn(|k| of(direction, k))).collect())
    }

    #[inline(always)]
    #[allow(clippy::type_complexity)]
    fn tile_jvp(
        &self,
        tile: &Tile,
        moved: &[Tile],
        terms: &Terms<B>,
        changes: &[PairChange<'_, B>],
        edge_changes: &[Vec<(f64, [[f64; 3]; B])>],
        radii: &mut [Lane],
        out: &mut [[Lane; B]],
    ) {
        self.radii(tile, radii);
        for (index, edge) in self.edges.iter().enumerate() {
            let pairs = EdgePairs::new(edge, &terms.edges[index], tile, radii, &self.surface.points);
            for (direction, change) in changes.iter().enumerate() {
                let [da, db] = edge.ends.map(|v| &change.points[v as usize]);
                let (dl, dt) = &edge_changes[direction][index];
                let p = &moved[direction].0;
                for l in 0..LANES {
                    let (mut d_omega, mut d_q) = (0.0, pairs.q_l[l] * dl);
                    let mut a = [0.0; 3];
                    for k in 0..3 {
                        let (va, vb) = (da[k] - p[k][l], db[k] - p[k][l]);
                        a[k] = va;
                        d_omega += pairs.g_a[k][l] * va + pairs.g_b[k][l] * vb;
                        d_q += pairs.q_a[k][l] * va + pairs.q_b[k][l] * vb;
                    }
                    for k in 0..B {
                        let (t, dt) = (&edge.t[k], &dt[k]);
                        let change_of_t: f64 = dt[0] * pairs.a[0][l]
                            + dt[1] * pairs.a[1][l]
                            + dt[2] * pairs.a[2][l]
                            + t[0] * a[0]
                            + t[1] * a[1]
                            + t[2] * a[2];
                        out[direction][k][l] += pairs.strength[k][l] * d_omega
                            - pairs.t_a[k][l] * d_q
                            - pairs.q[l] * change_of_t;
                    }
                }
            }
        }
        for (index, panel) in self.records.iter().enumerate() {
            let omega = solid_angle(panel, tile, radii);
            for (direction, change) in changes.iter().enumerate() {
                let dc = &change.centres[index];
                let p = &moved[direction].0;
                for k in 0..B {
                    let (s, ds) = (&panel.s[k], &change.sources[k][index]);
                    for l in 0..LANES {
                        let mut height = 0.0;
                        for axis in 0..3 {
                            height += ds[axis] * (panel.centre[axis] - tile.0[axis][l])
                                + s[axis] * (dc[axis] - p[axis][l]);
                        }
                        out[direction][k][l] += omega[l] * height;
                    }
                }
            }
        }
        for (ray, strength) in self.wakes.rays.iter().zip(&terms.rays) {
            let g = ray_pairs(&self.surface.points[ray.point as usize], tile);
            for (direction, change) in changes.iter().enumerate() {
                let da = &change.points[ray.point as usize];
                let p = &moved[direction].0;
                for l in 0..LANES {
                    let d = g[0][l] * (da.y - p[1][l]) + g[1][l] * (da.z - p[2][l]) + g[2][l] * (da.x - p[0][l]);
                    for k in 0..B {
                        out[direction][k][l] += strength[k] * d;
                    }
                }
            }
        }
        let mut angles = vec![[0.0; LANES]; self.wakes.strips.len()];
        self.wake_angles(tile, &mut angles);
        for (strip, omega) in angles.iter().enumerate() {
            for (direction, change) in changes.iter().enumerate() {
                for k in 0..B {
                    let circulation = change.strips[k][strip];
                    for l in 0..LANES {
                        out[direction][k][l] -= omega[l] * circulation;
                    }
                }
            }
        }
    }

    /// The transpose of [`jvp`](Self::jvp): `seeds[s][k]` are those of `R` for onset flow k.
    pub fn vjp(
        &self,
        strengths: &Strengths<'_, B>,
        seeds: &[[Vec<f64>; B]],
        monitor: &dyn Monitor,
    ) -> Result<Vec<PairSeeds<B>>, PanelError> {
        let n = self.panels.len();
        let terms = self.terms(strengths);
        let tiles = n.div_ceil(LANES);
        let arch = Arch::new();
        let work = Work::new(monitor, Stage::Derivative, tiles);
        let per_part = tiles.div_ceil(PARTS).max(1);
        let parts: Vec<Vec<Gathered<B>>> = (0..tiles.div_ceil(per_part))
            .into_par_iter()
            .map(|part| {
                let mut radii = vec![[0.0; LANES]; self.surface.points.len()];
                let mut gathered = vec![Gathered::new(self); seeds.len()];
                for index in per_part * part..(per_part * (part + 1)).min(tiles) {
                    if work.cancelled() {
                        break;
                    }
                    let first = LANES * index;
                    let tile = Tile::new(&self.surface.centres, first);
                    let psi: Vec<[Lane; B]> = seeds
                        .iter()
                        .map(|seed| {
                            std::array::from_fn(|k| {
                                std::array::from_fn(|l| {
                                    BY_4_PI * seed[k].get(first + l).copied().unwrap_or(0.0)
                                })
                            })
                        })
                        .collect();
                    let mut points = vec![[[0.0; LANES]; 3]; seeds.len()];
                    arch.dispatch(
                        #[inline(always)]
                        || self.tile_vjp(&tile, &psi, &terms, &mut radii, &mut gathered, &mut points),
                    );
                    if self.panels.symmetric {
                        let mut images = vec![[[0.0; LANES]; 3]; seeds.len()];
                        arch.dispatch(
                            #[inline(always)]
                            || {
                                self.tile_vjp(
                                    &tile.mirrored(),
                                    &psi,
                                    &terms,
                                    &mut radii,
                                    &mut gathered,
                                    &mut images,
                                )
                            },
                        );
                        for (point, image) in points.iter_mut().zip(&images) {
                            for l in 0..LANES {
                                point[0][l] += image[0][l];
                                point[1][l] -= image[1][l];
                                point[2][l] += image[2][l];
                            }
                        }
                    }
                    for (gathered, point) in gathered.iter_mut().zip(&points) {
                        for lane in 0..LANES.min(n - first) {
                            gathered.collocation.push([0, 1, 2].map(|k| point[k][lane]).into());
                        }
                    }
                    work.done(1);
                }
                gathered
            })
            .collect();
        work.finish()?;
        Ok((0..seeds.len())
            .map(|seed| {
                let mut sum: Option<Gathered<B>> = None;
                for part in &parts {
                    match &mut sum {
                        None => sum = Some(part[seed].clone()),
                        Some(sum) => sum.add(&part[seed]),
                    }
                }
                self.edge_chain(sum.unwrap_or_else(|| Gathered::new(self)))
            })
            .collect())
    }

    #[inline(always)]
    fn tile_vjp(
        &self,
        tile: &Tile,
        psi: &[[Lane; B]],
        terms: &Terms<B>,
        radii: &mut [Lane],
        gathered: &mut [Gathered<B>],
        points: &mut [[Lane; 3]],
    ) {
        self.radii(tile, radii);
        for (index, edge) in self.edges.iter().enumerate() {
            let pairs = EdgePairs::new(edge, &terms.edges[index], tile, radii, &self.surface.points);
            for (seed, psi) in psi.iter().enumerate() {
                let (mut omega, mut q) = ([0.0; LANES], [0.0; LANES]);
                let mut direct = [[0.0; LANES]; B];
                for k in 0..B {
                    for l in 0..LANES {
                        omega[l] = psi[k][l].mul_add(pairs.strength[k][l], omega[l]);
                        q[l] = (-psi[k][l]).mul_add(pairs.t_a[k][l], q[l]);
                        direct[k][l] = -psi[k][l] * pairs.q[l];
                    }
                }
                let out = &mut gathered[seed].edges[index];
                let point = &mut points[seed];
                for axis in 0..3 {
                    let (mut va, mut vb) = ([0.0; LANES], [0.0; LANES]);
                    for l in 0..LANES {
                        va[l] = omega[l].mul_add(pairs.g_a[axis][l], q[l] * pairs.q_a[axis][l]);
                        vb[l] = omega[l].mul_add(pairs.g_b[axis][l], q[l] * pairs.q_b[axis][l]);
                        for k in 0..B {
                            va[l] = direct[k][l].mul_add(edge.t[k][axis], va[l]);
                        }
                        point[axis][l] -= va[l] + vb[l];
                    }
                    out.a[axis] += total(&va);
                    out.b[axis] += total(&vb);
                    for k in 0..B {
                        let mut t = [0.0; LANES];
                        for l in 0..LANES {
                            t[l] = direct[k][l] * pairs.a[axis][l];
                        }
                        out.t[k][axis] += total(&t);
                    }
                }
                let mut length = [0.0; LANES];
                for l in 0..LANES {
                    length[l] = q[l] * pairs.q_l[l];
                }
                out.length += total(&length);
            }
        }
        for (index, panel) in self.records.iter().enumerate() {
            let omega = solid_angle(panel, tile, radii);
            for (seed, psi) in psi.iter().enumerate() {
                let out = &mut gathered[seed].panels[index];
                let point = &mut points[seed];
                for k in 0..B {
                    let mut o = [0.0; LANES];
                    for l in 0..LANES {
                        o[l] = psi[k][l] * omega[l];
                    }
                    let sum = total(&o);
                    for axis in 0..3 {
                        let mut s = [0.0; LANES];
                        for l in 0..LANES {
                            s[l] = o[l] * (panel.centre[axis] - tile.0[axis][l]);
                            point[axis][l] -= o[l] * panel.s[k][axis];
                        }
                        out.s[k][axis] += total(&s);
                        out.centre[axis] += sum * panel.s[k][axis];
                    }
                }
            }
        }
        for (index, (ray, strength)) in self.wakes.rays.iter().zip(&terms.rays).enumerate() {
            let g = ray_pairs(&self.surface.points[ray.point as usize], tile);
            for (seed, psi) in psi.iter().enumerate() {
                let out = &mut gathered[seed].rays[index];
                // Of y, z, x.
                for (axis, g) in [1, 2, 0].into_iter().zip(&g) {
                    let mut v = [0.0; LANES];
                    for l in 0..LANES {
                        let mut omega = 0.0;
                        for k in 0..B {
                            omega += psi[k][l] * strength[k];
                        }
                        v[l] = omega * g[l];
                        points[seed][axis][l] -= v[l];
                    }
                    out[axis] += total(&v);
                }
            }
        }
        let mut angles = vec![[0.0; LANES]; self.wakes.strips.len()];
        self.wake_angles(tile, &mut angles);
        for (strip, omega) in angles.iter().enumerate() {
            for (seed, psi) in psi.iter().enumerate() {
                for k in 0..B {
                    let mut v = [0.0; LANES];
                    for l in 0..LANES {
                        v[l] = psi[k][l] * omega[l];
                    }
                    gathered[seed].strips[k][strip] -= total(&v);
                }
            }
        }
    }

    /// From ends, lengths and T of the edges to points and sources.
    fn edge_chain(&self, gathered: Gathered<B>) -> PairSeeds<B> {
        let mut points = vec![Vector3::zeros(); self.surface.points.len()];
        let mut centres = gathered.collocation;
        let mut sources: [Vec<Vector3>; B] = std::array::from_fn(|_| vec![Vector3::zeros(); centres.len()]);
        for (index, (e, seed)) in self.panels.edges.iter().zip(&gathered.edges).enumerate() {
            let length = self.surface.lengths[index];
            let along = self.surface.edges[index] / length;
            let mut of_along = Vector3::zeros();
            for k in 0..B {
                let t = Vector3::from(seed.t[k]);
                of_along += across(&self.sources[k], e).cross(&t);
                let difference = t.cross(&along);
                sources[k][e.left as usize] += difference;
                if let Some(right) = e.right {
                    sources[k][right as usize] -= difference;
                }
            }
            let vector = (of_along - along * along.dot(&of_along)) / length + along * seed.length;
            points[e.a as usize] += Vector3::from(seed.a) - vector;
            points[e.b as usize] += Vector3::from(seed.b) + vector;
        }
        for (panel, seed) in gathered.panels.iter().enumerate() {
            centres[panel] += Vector3::from(seed.centre);
            for k in 0..B {
                sources[k][panel] += Vector3::from(seed.s[k]);
            }
        }
        for (ray, seed) in self.wakes.rays.iter().zip(&gathered.rays) {
            points[ray.point as usize] += Vector3::from(*seed);
        }
        PairSeeds { points, centres, sources, strips: gathered.strips }
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

/// One edge and the points of a tile: what derivatives need.
///
/// `dOmega = g_a . (da - dP) + g_b . (db - dP)` with `g_a = -(a x b) / (|a| (|a||b| + a.b))` and `g_b` likewise; `dQ = q_a . (da - dP)
/// + q_b . (db - dP) + q_l dL`.
struct EdgePairs<const B: usize> {
    a: [Lane; 3],
    g_a: [Lane; 3],
    g_b: [Lane; 3],
    q: Lane,
    q_a: [Lane; 3],
    q_b: [Lane; 3],
    q_l: Lane,
    /// `T . a`
    t_a: [Lane; B],
    strength: [Lane; B],
}

impl<const B: usize> EdgePairs<B> {
    #[inline(always)]
    fn new(
        edge: &EdgeRecord<B>,
        term: &EdgeTerm<B>,
        tile: &Tile,
        radii: &[Lane],
        points: &[Vector3],
    ) -> Self {
        let zero = [0.0; LANES];
        let mut pairs = Self {
            a: [zero; 3],
            g_a: [zero; 3],
            g_b: [zero; 3],
            q: zero,
            q_a: [zero; 3],
            q_b: [zero; 3],
            q_l: zero,
            t_a: [zero; B],
            strength: [zero; B],
        };
        let end = &points[edge.ends[1] as usize];
        let [ra, rb] = edge.ends.map(|v| &radii[v as usize]);
        for l in 0..LANES {
            let a = [0, 1, 2].map(|k| edge.a[k] - tile.0[k][l]);
            let b = [0, 1, 2].map(|k| end[k] - tile.0[k][l]);
            let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
            let sum = ra[l] + rb[l];
            // 2 (|a||b| + a.b)
            let product = (sum + edge.length) * (sum - edge.length);
            let by_product = 1.0 / product;
            let (by_ra, by_rb) = (1.0 / ra[l], 1.0 / rb[l]);
            let by_sum = -2.0 * edge.length * by_product;
            for k in 0..3 {
                pairs.a[k][l] = a[k];
                pairs.g_a[k][l] = -2.0 * cross[k] * by_product * by_ra;
                pairs.g_b[k][l] = -2.0 * cross[k] * by_product * by_rb;
                pairs.q_a[k][l] = by_sum * by_ra * a[k];
                pairs.q_b[k][l] = by_sum * by_rb * b[k];
            }
            pairs.q[l] = log_ratio(sum, edge.length);
            pairs.q_l[l] = 2.0 * sum * by_product;
            for k in 0..B {
                let (t, slope) = (&edge.t[k], &term.slope[k]);
                pairs.t_a[k][l] = dot_add(t, &a, 0.0);
                pairs.strength[k][l] = dot_add(slope, &[0, 1, 2].map(|k| -tile.0[k][l]), term.constant[k]);
            }
        }
        pairs
    }
}

/// The same for a ray along x: `dOmega = g . (da - dP)`, in the order y, z, x (which is zero).
#[inline(always)]
fn ray_pairs(point: &Vector3, tile: &Tile) -> [Lane; 3] {
    let mut g = [[0.0; LANES]; 3];
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
    dot_add(a, a, 0.0).sqrt()
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
    let [ra, rb, rc, rd] = panel.corners.map(|v| &radii[v as usize]);
    let [one, two] = &panel.twice_areas;
    let mut omega = [0.0; LANES];
    for l in 0..LANES {
        let to_a = [0, 1, 2].map(|k| panel.a[k] - tile.0[k][l]);
        let (a, b, c, d) = (ra[l], rb[l], rc[l], rd[l]);
        // 2 (|p||q| + p.q) of the sides and of the diagonal.
        let twice = |p: f64, q: f64, square: f64| (p + q).mul_add(p + q, -square);
        let (ab, bc) = (twice(a, b, panel.squares[0]), twice(b, c, panel.squares[1]));
        let (cd, da) = (twice(c, d, panel.squares[2]), twice(d, a, panel.squares[3]));
        let ac = twice(a, c, panel.squares[4]);
        let real = [
            0.5 * ab.mul_add(c, ac.mul_add(b, (bc - 4.0 * b * c) * a)),
            0.5 * ac.mul_add(d, da.mul_add(c, (cd - 4.0 * c * d) * a)),
        ];
        let imaginary = [dot_add(one, &to_a, 0.0), dot_add(two, &to_a, 0.0)];
        let re = real[0].mul_add(real[1], -(imaginary[0] * imaginary[1]));
        let im = real[0].mul_add(imaginary[1], real[1] * imaginary[0]);
        omega[l] = 2.0 * argument(im, re);
    }
    omega
}

/// Seeds of an edge's ends, length and T.
#[derive(Clone)]
struct EdgeSeed<const B: usize> {
    a: [f64; 3],
    b: [f64; 3],
    length: f64,
    t: [[f64; 3]; B],
}

/// Seeds of a panel's centre (as a source panel) and of s.
#[derive(Clone)]
struct PanelSeed<const B: usize> {
    centre: [f64; 3],
    s: [[f64; 3]; B],
}

/// Sums over collocation points.
#[derive(Clone)]
struct Gathered<const B: usize> {
    edges: Vec<EdgeSeed<B>>,
    panels: Vec<PanelSeed<B>>,
    rays: Vec<[f64; 3]>,
    strips: [Vec<f64>; B],
    /// Of the collocation points of this part, in their order.
    collocation: Vec<Vector3>,
}

impl<const B: usize> Gathered<B> {
    fn new(influence: &Influence<'_, B>) -> Self {
        let edge = EdgeSeed { a: [0.0; 3], b: [0.0; 3], length: 0.0, t: [[0.0; 3]; B] };
        let panel = PanelSeed { centre: [0.0; 3], s: [[0.0; 3]; B] };
        Self {
            edges: vec![edge; influence.edges.len()],
            panels: vec![panel; influence.records.len()],
            rays: vec![[0.0; 3]; influence.wakes.rays.len()],
            strips: std::array::from_fn(|_| vec![0.0; influence.wakes.strips.len()]),
            collocation: Vec::new(),
        }
    }

    fn add(&mut self, other: &Self) {
        let add = |to: &mut [f64; 3], from: &[f64; 3]| (0..3).for_each(|k| to[k] += from[k]);
        for (to, from) in self.edges.iter_mut().zip(&other.edges) {
            add(&mut to.a, &from.a);
            add(&mut to.b, &from.b);
            to.length += from.length;
            (0..B).for_each(|k| add(&mut to.t[k], &from.t[k]));
        }
        for (to, from) in self.panels.iter_mut().zip(&other.panels) {
            add(&mut to.centre, &from.centre);
            (0..B).for_each(|k| add(&mut to.s[k], &from.s[k]));
        }
        self.rays.iter_mut().zip(&other.rays).for_each(|(to, from)| add(to, from));
        for k in 0..B {
            self.strips[k].iter_mut().zip(&other.strips[k]).for_each(|(to, from)| *to += from);
        }
        self.collocation.extend_from_slice(&other.collocation);
    }
}

/// Progress of a parallel loop, and whether to go on.
struct Work<'a> {
    monitor: &'a dyn Monitor,
    stage: Stage,
    total: usize,
    done: AtomicUsize,
}

impl<'a> Work<'a> {
    fn new(monitor: &'a dyn Monitor, stage: Stage, total: usize) -> Self {
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

