//! Assembly: the matrix of the doublets and wakes, and the right-hand sides of the sources.

use moldline_foundation::simd::widest;
use rayon::prelude::*;

use super::{
    kernels::{
        BY_4_PI, dot, edge_logarithm, solid_angle, solid_angle_near, strip_solid_angle, wake_solid_angle,
    },
    records::{Influence, PanelRecord, PatchRecord, PieceCorners, PieceRecord, Radii, Tile},
};
use crate::{
    Monitor, PanelError, Stage,
    lanes::{LANES, Lane},
    linear_system::Matrix,
    progress::Progress,
};

impl<const B: usize> Influence<'_, B> {
    /// The matrix A of the potential inside, and the right-hand sides `S sigma`. `circulation` has the circulation of every strip
    /// as a sum over doublet strengths.
    ///
    /// # Errors
    /// [`PanelError::Singular`] if the influence on a panel is not finite; cancelled.
    pub fn assemble(
        &self,
        circulation: &[Vec<(u32, f64)>],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<(Matrix, [Vec<f64>; B]), PanelError> {
        let n = self.panels.len();
        let mut matrix = Matrix::zeros(n);
        let progress = Progress::new(monitor, Stage::Influence, n.div_ceil(LANES));
        let potentials: Vec<[Lane; B]> = matrix
            .tiles_mut()
            .enumerate()
            .map_init(
                || (Radii::default(), vec![[0.0; LANES]; self.wakes.strips.len()]),
                |(radii, strips), (index, rows)| {
                    if progress.cancelled() {
                        return [[0.0; LANES]; B];
                    }
                    let potential = self.assemble_tile(index, radii, strips, rows);
                    add_wakes(circulation, strips, rows);
                    for row in rows.iter_mut() {
                        row.iter_mut().for_each(|x| *x *= -BY_4_PI);
                    }
                    progress.step();
                    potential
                },
            )
            .collect();
        progress.finish()?;
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

    /// Adds the solid angles of the panels to the rows of a tile and sets those of the strips; `4 pi` times the potential of the sources.
    fn assemble_tile(
        &self,
        index: usize,
        radii: &mut Radii,
        strips: &mut [Lane],
        rows: &mut [Lane],
    ) -> [Lane; B] {
        let mut potential = [[0.0; LANES]; B];
        strips.fill([0.0; LANES]);
        let images = self.images(index);
        widest(
            #[inline(always)]
            || {
                for patch in &self.patches {
                    for (image, tile) in images.iter().enumerate() {
                        let own = (image == 0).then_some(index);
                        assemble_patch(patch, tile, own, radii, rows, &mut potential);
                    }
                }
                images.iter().for_each(|tile| wake_angles(&self.pieces, tile, strips));
            },
        );
        potential
    }
}

/// Adds one patch's solid angles to the rows of a tile, and `4 pi` times the potential of its sources. `own` is the tile's index, if it
/// is not an image.
#[inline(always)]
fn assemble_patch<const B: usize>(
    patch: &PatchRecord<B>,
    tile: &Tile,
    own: Option<usize>,
    radii: &mut Radii,
    rows: &mut [Lane],
    potential: &mut [Lane; B],
) {
    radii.fill(&patch.points, tile);
    for edge in &patch.edges {
        let [ra, rb] = [&radii.r[edge.ends[0]], &radii.r[edge.ends[1]]];
        for l in 0..LANES {
            let q = edge_logarithm([ra[l], rb[l]], edge.length);
            let a = tile.way(&edge.a, l);
            for k in 0..B {
                potential[k][l] += q * dot(&edge.t[k], &a);
            }
        }
    }
    let near = tile.meets(&patch.reach);
    for panel in &patch.panels {
        let mut omega = if near && tile.meets(&panel.reach) {
            solid_angles_near(panel, tile, patch, radii)
        } else {
            solid_angles(panel, tile, radii)
        };
        if own == Some(panel.index / LANES) {
            omega[panel.index % LANES] = panel.own;
        }
        let row = &mut rows[panel.index];
        for l in 0..LANES {
            row[l] += omega[l];
            let arm = tile.way(&panel.centre, l);
            for k in 0..B {
                potential[k][l] -= omega[l] * dot(&panel.s[k], &arm);
            }
        }
    }
}

/// The solid angles of a panel from the points of a tile.
#[inline(always)]
pub(super) fn solid_angles<const B: usize>(panel: &PanelRecord<B>, tile: &Tile, radii: &Radii) -> Lane {
    let [ra, rb, rc, rd] = [0, 1, 2, 3].map(|corner| &radii.r[panel.corners[corner]]);
    let mut omega = [0.0; LANES];
    for l in 0..LANES {
        omega[l] = solid_angle(&tile.way(&panel.a, l), [ra[l], rb[l], rc[l], rd[l]], &panel.shape);
    }
    omega
}

/// The same where points of the tile are near.
#[inline(always)]
fn solid_angles_near<const B: usize>(
    panel: &PanelRecord<B>,
    tile: &Tile,
    patch: &PatchRecord<B>,
    radii: &Radii,
) -> Lane {
    let corners = panel.corners.map(|corner| &patch.points[corner]);
    let [ra, rb, rc, rd] = [0, 1, 2, 3].map(|corner| &radii.r[panel.corners[corner]]);
    let mut omega = [0.0; LANES];
    for l in 0..LANES {
        let ways = corners.map(|corner| tile.way(corner, l));
        omega[l] = solid_angle_near(&ways, [ra[l], rb[l], rc[l], rd[l]], &panel.normal);
    }
    omega
}

/// Adds the solid angles of the strips from the points of a tile.
#[inline(always)]
pub(super) fn wake_angles(pieces: &[PieceRecord], tile: &Tile, strips: &mut [Lane]) {
    for piece in pieces {
        let out = &mut strips[piece.strip];
        match &piece.corners {
            PieceCorners::Strip([p, q]) => {
                for l in 0..LANES {
                    out[l] += strip_solid_angle(&tile.way(p, l), &tile.way(q, l));
                }
            }
            PieceCorners::Quad(corners) => {
                for l in 0..LANES {
                    out[l] += wake_solid_angle(&corners.each_ref().map(|corner| tile.way(corner, l)));
                }
            }
        }
    }
}

/// Adds the strips' solid angles to the columns of the panels on whose doublets their circulation depends.
fn add_wakes(circulation: &[Vec<(u32, f64)>], strips: &[Lane], rows: &mut [Lane]) {
    for (row, omega) in circulation.iter().zip(strips) {
        for &(panel, factor) in row {
            for lane in 0..LANES {
                rows[panel as usize][lane] += omega[lane] * factor;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use moldline_testing::{Random, Wing, partly_triangles, sphere};

    use super::*;
    use crate::{NoMonitor, Symmetry, panels::Panels, surface::Surface, wake::Wakes};

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
            let panels = Panels::new(mesh, *symmetry, &crate::TrailingEdges::None).unwrap();
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
