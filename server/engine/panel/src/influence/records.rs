//! Geometry and sources in the order in which the loops over pairs read them: records of patches, and tiles of points.

use moldline_mesh::Vector3;

use super::kernels::{Shape, Vector, own_solid_angle};
use crate::{
    clusters::Patch,
    lanes::{LANES, Lane},
    panels::{Edge, Panels},
    surface::Surface,
    wake::{Corner, Piece, Wakes},
};

/// The distance within which a point is near a panel, as a part of the panel's diagonal.
const NEAR: f64 = 0.25;

/// The influence of a surface and its wakes on its collocation points, for the sources of `B` onset flows.
pub(crate) struct Influence<'a, const B: usize> {
    pub(super) panels: &'a Panels,
    pub(super) wakes: &'a Wakes,
    pub(super) surface: &'a Surface,
    /// `s = sigma n` of every panel.
    pub(super) sources: [Vec<Vector3>; B],
    pub(super) patches: Vec<PatchRecord<B>>,
    pub(super) pieces: Vec<PieceRecord>,
}

impl<'a, const B: usize> Influence<'a, B> {
    pub fn new(panels: &'a Panels, wakes: &'a Wakes, surface: &'a Surface) -> Self {
        let sources: [Vec<Vector3>; B] = std::array::from_fn(|k| surface.sources(panels.axes()[k]));
        let patches =
            panels.patches.iter().map(|patch| PatchRecord::new(patch, panels, surface, &sources)).collect();
        let mut pieces = Vec::new();
        for (strip, of_strip) in wakes.pieces.iter().enumerate() {
            pieces.extend(of_strip.iter().map(|piece| PieceRecord::new(strip, piece, surface)));
        }
        Self { panels, wakes, surface, sources, patches, pieces }
    }

    /// The tile of collocation points with that index, and its mirror image if there is one.
    pub(super) fn images(&self, index: usize) -> Vec<Tile> {
        Tile::new(&self.surface.centres, LANES * index).images(self.panels.symmetric)
    }
}

/// Left minus right of a vector field on the panels.
pub(super) fn across(field: &[Vector3], edge: &Edge) -> Vector3 {
    field[edge.left as usize] - edge.right.map_or_else(Vector3::zeros, |right| field[right as usize])
}

/// Points that are handled at once: x, y and z in lanes.
#[derive(Clone, Copy)]
pub(super) struct Tile(pub [Lane; 3]);

impl Tile {
    /// The points from `first` on; beyond the last one it is repeated.
    pub fn new(points: &[Vector3], first: usize) -> Self {
        let at = |axis: usize| std::array::from_fn(|l| points[(first + l).min(points.len() - 1)][axis]);
        Self([at(0), at(1), at(2)])
    }

    /// The tile, and its image in the plane y = 0 if there is one.
    pub fn images(self, symmetric: bool) -> Vec<Self> {
        let mut mirrored = self;
        mirrored.0[1].iter_mut().for_each(|y| *y = -*y);
        if symmetric { vec![self, mirrored] } else { vec![self] }
    }

    /// The point of a lane.
    #[inline(always)]
    pub fn point(&self, lane: usize) -> Vector {
        [self.0[0][lane], self.0[1][lane], self.0[2][lane]]
    }

    /// The way to `x` from the point of a lane.
    #[inline(always)]
    pub fn way(&self, x: &Vector, lane: usize) -> Vector {
        [x[0] - self.0[0][lane], x[1] - self.0[1][lane], x[2] - self.0[2][lane]]
    }

    /// Whether a point of the tile may lie in a box.
    pub fn meets(&self, [low, high]: &[Vector3; 2]) -> bool {
        (0..3).all(|axis| {
            self.0[axis].iter().any(|x| *x >= low[axis]) && self.0[axis].iter().any(|x| *x <= high[axis])
        })
    }
}

/// The distances of a patch's points from those of a tile, and their inverses.
#[derive(Default)]
pub(super) struct Radii {
    pub r: Vec<Lane>,
    pub by_r: Vec<Lane>,
}

impl Radii {
    #[inline(always)]
    pub fn fill(&mut self, points: &[Vector], tile: &Tile) {
        self.r.resize(points.len(), [0.0; LANES]);
        for (p, r) in points.iter().zip(&mut self.r) {
            for l in 0..LANES {
                let [x, y, z] = tile.way(p, l);
                r[l] = (x * x + y * y + z * z).sqrt();
            }
        }
    }

    #[inline(always)]
    pub fn invert(&mut self) {
        self.by_r.resize(self.r.len(), [0.0; LANES]);
        for (r, by_r) in self.r.iter().zip(&mut self.by_r) {
            for l in 0..LANES {
                by_r[l] = 1.0 / r[l];
            }
        }
    }
}

/// A patch.
pub(super) struct PatchRecord<const B: usize> {
    pub points: Vec<Vector>,
    pub edges: Vec<EdgeRecord<B>>,
    pub panels: Vec<PanelRecord<B>>,
    /// The box around [`PanelRecord::reach`] of its panels.
    pub reach: [Vector3; 2],
}

impl<const B: usize> PatchRecord<B> {
    fn new(patch: &Patch, panels: &Panels, surface: &Surface, sources: &[Vec<Vector3>; B]) -> Self {
        let edge = |local: usize| EdgeRecord::new(patch, local, panels, surface, sources);
        let panel = |local: usize| PanelRecord::new(patch, local, panels, surface, sources);
        let records: Vec<PanelRecord<B>> = (0..patch.panels.len()).map(panel).collect();
        let [mut low, mut high] = [f64::INFINITY, f64::NEG_INFINITY].map(Vector3::repeat);
        for panel in &records {
            (low, high) = (low.inf(&panel.reach[0]), high.sup(&panel.reach[1]));
        }
        Self {
            points: patch.points.iter().map(|p| surface.points[*p as usize].into()).collect(),
            edges: (0..patch.edges.len()).map(edge).collect(),
            panels: records,
            reach: [low, high],
        }
    }
}

/// An edge of a patch.
pub(super) struct EdgeRecord<const B: usize> {
    /// Index among all edges.
    pub index: usize,
    /// Indices among the patch's points.
    pub ends: [usize; 2],
    pub a: Vector,
    /// Unit vector.
    pub along: Vector,
    pub length: f64,
    /// `T = e x (s_left - s_right)` of every onset flow.
    pub t: [Vector; B],
}

impl<const B: usize> EdgeRecord<B> {
    fn new(
        patch: &Patch,
        local: usize,
        panels: &Panels,
        surface: &Surface,
        sources: &[Vec<Vector3>; B],
    ) -> Self {
        let index = patch.edges[local] as usize;
        let edge = &panels.edges[index];
        let along = surface.edges[index] / surface.lengths[index];
        Self {
            index,
            ends: patch.ends[local].map(|v| v as usize),
            a: surface.points[edge.a as usize].into(),
            along: along.into(),
            length: surface.lengths[index],
            t: std::array::from_fn(|k| along.cross(&across(&sources[k], edge)).into()),
        }
    }
}

/// A panel of a patch.
pub(super) struct PanelRecord<const B: usize> {
    /// Index among all panels.
    pub index: usize,
    /// Indices among the patch's points.
    pub corners: [usize; 4],
    pub a: Vector,
    pub shape: Shape,
    pub normal: Vector,
    /// A box beyond which no point is so near that [`solid_angle`](super::kernels::solid_angle) would lose digits.
    pub reach: [Vector3; 2],
    pub centre: Vector,
    /// `s` of every onset flow.
    pub s: [Vector; B],
    /// Solid angle from its own centre.
    pub own: f64,
}

impl<const B: usize> PanelRecord<B> {
    fn new(
        patch: &Patch,
        local: usize,
        panels: &Panels,
        surface: &Surface,
        sources: &[Vec<Vector3>; B],
    ) -> Self {
        let index = patch.panels[local] as usize;
        let [a, b, c, d] = panels.corners[index].map(|v| surface.points[v as usize]);
        let (centre, normal) = (surface.centres[index], surface.normals[index]);
        let margin = Vector3::repeat(NEAR * (c - a).norm().max((d - b).norm()));
        Self {
            index,
            corners: patch.corners[local].map(|v| v as usize),
            a: a.into(),
            shape: Shape::new([a, b, c, d]),
            normal: normal.into(),
            reach: [a.inf(&b).inf(&c).inf(&d) - margin, a.sup(&b).sup(&c).sup(&d) + margin],
            centre: centre.into(),
            s: std::array::from_fn(|k| sources[k][index].into()),
            own: own_solid_angle([a, b, c, d], &centre, &normal),
        }
    }
}

/// A piece of a wake.
pub(super) struct PieceRecord {
    pub strip: usize,
    pub corners: PieceCorners,
}

/// Corners of a piece.
pub(super) enum PieceCorners {
    /// From both corners along x to infinity.
    Strip([Vector; 2]),
    Quad([Vector; 4]),
}

impl PieceRecord {
    fn new(strip: usize, piece: &Piece, surface: &Surface) -> Self {
        let at = |corner: &Corner| <[f64; 3]>::from(corner.position(&surface.points));
        let corners = match piece {
            Piece::Strip(corners) => PieceCorners::Strip(corners.each_ref().map(at)),
            Piece::Quad(corners) => PieceCorners::Quad(corners.each_ref().map(at)),
        };
        Self { strip, corners }
    }
}
