//! The pass over all pairs that both products share: how `4 pi R` changes with the edges and panels of a patch, at the points of a tile.
//!
//! The derivative is linear in directions and in seeds, so a pair's geometry is evaluated once for all of them, and once for both images:
//! each direction or seed adds a few products with an [`EdgeGradient`] and a [`SourceGradient`]. The derivative with respect to the
//! collocation point itself, [`Slopes`], does not depend on either.
//!
//! By edges, with `s` of both panels in T and in the strength of the edge as a vortex filament:
//!
//! ```text
//! 4 pi dR = sum_e strength_e dOmega_e - d(Q_e T_e.(a_e - P)) + sum_j Omega_j d(s_j.(c_j - P))
//! strength_e(P) = left minus right panel's (s.(c - P) - mu), less the circulation of wakes that begin on the edge
//! ```

use super::{
    assembly::solid_angles,
    kernels::{EdgeDerivative, Vector, dot, ray_derivative},
    records::{EdgeRecord, Influence, PanelRecord, PatchRecord, Radii, Tile, across},
};
use crate::{
    lanes::{LANES, Lane},
    wake::Ray,
};

/// Strengths at which the residual is differentiated.
pub(crate) struct Strengths<'a, const B: usize> {
    /// mu of every panel.
    pub doublets: [&'a [f64]; B],
    /// Circulation of every strip.
    pub circulations: [&'a [f64]; B],
}

/// `4 pi` times the strengths of edges and rays as vortex filaments.
pub(super) struct Filaments<const B: usize> {
    pub edges: Vec<EdgeFilament<B>>,
    pub rays: Vec<[f64; B]>,
}

/// The strength of an edge, `constant - slope.P`.
pub(super) struct EdgeFilament<const B: usize> {
    constant: [f64; B],
    slope: [Vector; B],
}

impl<const B: usize> Influence<'_, B> {
    /// The filaments of the strengths.
    pub(super) fn filaments(&self, strengths: &Strengths<'_, B>) -> Filaments<B> {
        let mut edges: Vec<EdgeFilament<B>> = self
            .panels
            .edges
            .iter()
            .map(|e| EdgeFilament {
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
        let ray =
            |ray: &Ray| std::array::from_fn(|k| -ray.sign * strengths.circulations[k][ray.strip as usize]);
        Filaments { edges, rays: self.wakes.rays.iter().map(ray).collect() }
    }
}

/// The gradient of `4 pi R` with respect to the points of a tile, for every onset flow.
pub(super) type Slopes<const B: usize> = [[Lane; 3]; B];

/// Slopes of zero.
pub(super) const fn no_slopes<const B: usize>() -> Slopes<B> {
    [[[0.0; LANES]; 3]; B]
}

/// The gradient of `4 pi R` with respect to one edge, at the points of a tile and their images: `dR_k = ends[k].(da, db) + t.dT_k`.
pub(super) struct EdgeGradient<const B: usize> {
    pub ends: [[Lane; 6]; B],
    pub t: [Lane; 3],
}

impl<const B: usize> EdgeGradient<B> {
    /// Adds one image; `side` is -1 for the mirrored one.
    #[inline(always)]
    fn add(
        &mut self,
        edge: &EdgeRecord<B>,
        filament: &EdgeFilament<B>,
        tile: &Tile,
        radii: &Radii,
        side: f64,
        slopes: &mut Slopes<B>,
    ) {
        let [ra, rb] = [&radii.r[edge.ends[0]], &radii.r[edge.ends[1]]];
        let [by_ra, by_rb] = [&radii.by_r[edge.ends[0]], &radii.by_r[edge.ends[1]]];
        for l in 0..LANES {
            let p = tile.point(l);
            let derivative = EdgeDerivative::new(
                tile.way(&edge.a, l),
                &edge.along,
                edge.length,
                [ra[l], rb[l]],
                [by_ra[l], by_rb[l]],
            );
            for k in 0..B {
                let strength = filament.constant[k] - dot(&filament.slope[k], &p);
                let [by_a, by_b] = derivative.by_ends(strength, &edge.t[k]);
                for axis in 0..3 {
                    self.ends[k][axis][l] += by_a[axis];
                    self.ends[k][3 + axis][l] += by_b[axis];
                    let by_point = by_a[axis] + by_b[axis];
                    slopes[k][axis][l] -= if axis == 1 { side * by_point } else { by_point };
                }
            }
            let by_t = derivative.logarithm_times_a();
            for axis in 0..3 {
                self.t[axis][l] -= by_t[axis];
            }
        }
    }
}

/// The gradient of `4 pi R` with respect to one panel as a source, at the points of a tile and their images, at fixed solid angle:
/// `dR_k = arm.ds_k + omega s_k.dc`, `arm = omega (c - P)`.
pub(super) struct SourceGradient {
    pub omega: Lane,
    pub arm: [Lane; 3],
}

impl SourceGradient {
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
        let omega = solid_angles(panel, tile, radii);
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

/// What a product makes of the gradients of a patch's edges and panels, by their indices in it.
pub(super) trait Product<const B: usize> {
    fn edge(&mut self, local: usize, gradient: &EdgeGradient<B>);
    fn panel(&mut self, local: usize, gradient: &SourceGradient);
}

/// Gives a product the gradients of every edge and panel of a patch at the points of a tile, and adds to their slopes.
#[inline(always)]
pub(super) fn each_pair<const B: usize>(
    patch: &PatchRecord<B>,
    filaments: &Filaments<B>,
    images: &[Tile],
    radii: &mut [Radii; 2],
    slopes: &mut Slopes<B>,
    product: &mut impl Product<B>,
) {
    for (tile, radii) in images.iter().zip(radii.iter_mut()) {
        radii.fill(&patch.points, tile);
        radii.invert();
    }
    for (local, edge) in patch.edges.iter().enumerate() {
        let mut gradient = EdgeGradient { ends: [[[0.0; LANES]; 6]; B], t: [[0.0; LANES]; 3] };
        for ((tile, radii), side) in images.iter().zip(radii.iter()).zip([1.0, -1.0]) {
            gradient.add(edge, &filaments.edges[edge.index], tile, radii, side, slopes);
        }
        product.edge(local, &gradient);
    }
    for (local, panel) in patch.panels.iter().enumerate() {
        let mut gradient = SourceGradient { omega: [0.0; LANES], arm: [[0.0; LANES]; 3] };
        for ((tile, radii), side) in images.iter().zip(radii.iter()).zip([1.0, -1.0]) {
            gradient.add(panel, tile, radii, side, slopes);
        }
        product.panel(local, &gradient);
    }
}

impl<const B: usize> Influence<'_, B> {
    /// The y and z components of the gradient with respect to a ray's point, of unit strength and both images; adds to the slopes of the
    /// points.
    #[inline(always)]
    pub(super) fn ray_gradient(
        &self,
        ray: usize,
        filaments: &Filaments<B>,
        images: &[Tile],
        slopes: &mut Slopes<B>,
    ) -> [Lane; 2] {
        let point = self.surface.points[self.wakes.rays[ray].point as usize].into();
        let strength = &filaments.rays[ray];
        let mut sum = [[0.0; LANES]; 2];
        for (tile, side) in images.iter().zip([1.0, -1.0]) {
            for l in 0..LANES {
                let g = ray_derivative(&tile.way(&point, l));
                sum[0][l] += g[0];
                sum[1][l] += g[1];
                for k in 0..B {
                    slopes[k][1][l] -= side * strength[k] * g[0];
                    slopes[k][2][l] -= strength[k] * g[1];
                }
            }
        }
        sum
    }
}

#[cfg(test)]
impl<const B: usize> Influence<'_, B> {
    /// The velocities of all panels at points, without what the wakes add.
    pub fn velocities(
        &self,
        strengths: &Strengths<'_, B>,
        at: &[moldline_mesh::Vector3],
    ) -> Vec<[moldline_mesh::Vector3; B]> {
        use rayon::prelude::*;

        struct Nothing;
        impl<const B: usize> Product<B> for Nothing {
            fn edge(&mut self, _: usize, _: &EdgeGradient<B>) {}
            fn panel(&mut self, _: usize, _: &SourceGradient) {}
        }
        let filaments = self.filaments(strengths);
        let of_tile = |index: usize| {
            let images = Tile::new(at, LANES * index).images(self.panels.symmetric);
            let mut slopes = no_slopes::<B>();
            let mut radii = <[Radii; 2]>::default();
            for patch in &self.patches {
                each_pair(patch, &filaments, &images, &mut radii, &mut slopes, &mut Nothing);
            }
            let velocity = |l: usize| {
                std::array::from_fn(|k| {
                    super::kernels::BY_4_PI * moldline_mesh::Vector3::from(slopes[k].map(|axis| axis[l]))
                })
            };
            (0..LANES).map(velocity).collect::<Vec<_>>()
        };
        let mut velocities: Vec<_> =
            (0..at.len().div_ceil(LANES)).into_par_iter().flat_map_iter(of_tile).collect();
        velocities.truncate(at.len());
        velocities
    }
}
