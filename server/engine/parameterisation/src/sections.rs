//! Cross-sections of the reference geometry: local chord, quarter-chord point, planform area, centre line.

use std::{cell::OnceCell, ops::Range};

use moldline_foundation::Vector3;

use crate::{axis::Axes, reference::ComponentReference};

/// Most samples kept per component, so that a huge control net does not become a huge sampling.
const SAMPLE_LIMIT: usize = 100_000;
/// Points of a sample line that a plane skips together.
const BLOCK: usize = 4;
/// Most slabs in which a plane looks for blocks, and most entries of blocks in all of them.
const SLABS: usize = 256;
const SLAB_ENTRIES: usize = 4_000_000;
/// Sections of the midpoint rule for the planform area.
const AREA_SECTIONS: usize = 256;

/// A cut of the planform: leading edge and the vector from there to the trailing edge, each `[chord, thickness]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Section {
    pub(crate) leading_edge: [f64; 2],
    pub(crate) chord: [f64; 2],
}

impl Section {
    pub(crate) fn quarter_chord(&self) -> [f64; 2] {
        [0, 1].map(|a| self.leading_edge[a] + 0.25 * self.chord[a])
    }
}

/// Grids of points on the surfaces of some components, to be cut by planes.
pub(crate) struct SampledSurfaces {
    grids: Vec<Grid>,
    /// The blocks of all grids, one grid after the other.
    blocks: Vec<Block>,
    /// Bounds of all points.
    bounds: Bounds,
    /// The slabs across each axis, made for the first cut.
    slabs: [OnceCell<Slabs>; 3],
}

/// A grid of points on a patch.
struct Grid {
    n_u: usize,
    n_v: usize,
    /// Second index fastest.
    points: Vec<Vector3>,
}

/// A part of a row of a grid.
struct Block {
    grid: usize,
    row: usize,
    /// First and last column (exclusive).
    columns: Range<usize>,
    /// Bounds of the lines that begin in it.
    bounds: Bounds,
}

impl Grid {
    /// The blocks of the grid, row by row.
    fn blocks(&self, grid: usize) -> impl Iterator<Item = Block> + '_ {
        let Self { n_u, n_v, ref points } = *self;
        (0..n_u).flat_map(move |row| {
            (0..n_v).step_by(BLOCK).map(move |from| {
                let columns = from..(from + BLOCK).min(n_v);
                // Lines lead to the next point of the row, and to the next row.
                let of_row = |row: usize, to: usize| &points[row * n_v + from..row * n_v + to.min(n_v)];
                let following = if row + 1 < n_u { of_row(row + 1, columns.end) } else { &[] };
                let bounds = Bounds::of(of_row(row, columns.end + 1).iter().chain(following));
                Block { grid, row, columns, bounds }
            })
        })
    }
}

/// Slabs of equal width between the smallest and the largest coordinate along an axis.
struct Slabs {
    low: f64,
    width: f64,
    /// Indices of the blocks that reach into each, in order.
    blocks: Vec<Vec<u32>>,
}

impl Slabs {
    fn new(axis: usize, all: &Bounds, blocks: &[Block]) -> Self {
        let count = (SLAB_ENTRIES / blocks.len().max(1)).clamp(1, SLABS);
        let (low, high) = (all.low[axis], all.high[axis]);
        let mut slabs = Self { low, width: (high - low) / count as f64, blocks: vec![Vec::new(); count] };
        for (index, Block { bounds, .. }) in (0..).zip(blocks) {
            for slab in slabs.number(bounds.low[axis])..=slabs.number(bounds.high[axis]) {
                slabs.blocks[slab].push(index);
            }
        }
        slabs
    }

    /// Index of the slab of a coordinate, or of the nearest one. It does not decrease with the coordinate, whatever the
    /// rounding.
    fn number(&self, x: f64) -> usize {
        (((x - self.low) / self.width) as usize).min(self.blocks.len() - 1)
    }
}

/// Smallest and largest coordinates.
#[derive(Clone, Copy)]
struct Bounds {
    low: Vector3,
    high: Vector3,
}

impl Bounds {
    fn of<'p>(points: impl IntoIterator<Item = &'p Vector3>) -> Self {
        let none = Self { low: Vector3::repeat(f64::INFINITY), high: Vector3::repeat(f64::NEG_INFINITY) };
        points.into_iter().fold(none, |all, p| Self { low: all.low.inf(p), high: all.high.sup(p) })
    }
}

impl SampledSurfaces {
    pub(crate) fn new(components: &[&ComponentReference]) -> Self {
        let patches = || components.iter().flat_map(|c| &c.patches);
        let intervals: usize = patches()
            .map(|p| {
                (p.surface.knots_u().breaks().len() - 1)
                    .saturating_mul(p.surface.knots_v().breaks().len() - 1)
            })
            .sum();
        let per_interval = ((SAMPLE_LIMIT / intervals.max(1)) as f64).sqrt().clamp(1.0, 8.0) as usize;
        let grids: Vec<Grid> = patches()
            .map(|patch| {
                let homogeneous: Vec<[f64; 4]> = patch
                    .control_points
                    .iter()
                    .enumerate()
                    .map(|(i, &[x, y, z])| {
                        let w = patch.weights.get(i).copied().unwrap_or(1.0);
                        [w * x, w * y, w * z, w]
                    })
                    .collect();
                let surface = &patch.surface;
                let us = subdivide(surface.knots_u().breaks(), per_interval);
                let vs = subdivide(surface.knots_v().breaks(), per_interval);
                let points = us
                    .iter()
                    .flat_map(|&u| vs.iter().map(move |&v| (u, v)))
                    .map(|(u, v)| surface.position(&homogeneous, u, v))
                    .collect();
                Grid { n_u: us.len(), n_v: vs.len(), points }
            })
            .collect();
        let bounds = Bounds::of(grids.iter().flat_map(|grid| &grid.points));
        let blocks = grids.iter().enumerate().flat_map(|(index, grid)| grid.blocks(index)).collect();
        Self { grids, blocks, bounds, slabs: Default::default() }
    }

    /// Smallest and largest coordinate along an axis.
    pub(crate) fn range(&self, axis: usize) -> (f64, f64) {
        (self.bounds.low[axis], self.bounds.high[axis])
    }

    /// Calls `visit` with every point where a sample line meets the plane `axis = station`.
    fn cut(&self, axis: usize, station: f64, mut visit: impl FnMut(Vector3)) {
        let mut edge = |a: &Vector3, b: &Vector3| {
            let (da, db) = (a[axis] - station, b[axis] - station);
            if da == 0.0 || db == 0.0 {
                if da == 0.0 {
                    visit(*a);
                }
                if db == 0.0 {
                    visit(*b);
                }
            } else if (da < 0.0) != (db < 0.0) {
                visit(a + (b - a) * (da / (da - db)));
            }
        };
        let slabs = self.slabs[axis].get_or_init(|| Slabs::new(axis, &self.bounds, &self.blocks));
        for &block in &slabs.blocks[slabs.number(station)] {
            let Block { grid, row, ref columns, ref bounds } = self.blocks[block as usize];
            if station < bounds.low[axis] || bounds.high[axis] < station {
                continue;
            }
            let Grid { n_u, n_v, ref points } = self.grids[grid];
            for column in columns.clone() {
                let p = &points[row * n_v + column];
                if column + 1 < n_v {
                    edge(p, &points[row * n_v + column + 1]);
                }
                if row + 1 < n_u {
                    edge(p, &points[(row + 1) * n_v + column]);
                }
            }
        }
    }

    /// Leading and trailing edge where the planes `span = station` (and `-station` when mirrored) cut the surfaces:
    /// the extreme points along the chord axis, averaged where there are several (a blunt edge). `station` is moved
    /// into the extent of the surfaces.
    pub(crate) fn section(&self, axes: Axes, station: f64, mirrored: bool) -> Option<Section> {
        let (low, high) = self.range(axes.span);
        // A hair inside, so that a flat end is cut just before it whatever the rounding of its coordinates.
        let hair = 1e-9 * (high - low);
        let (low, high) = (low + hair, high - hair);
        let mut points: Vec<[f64; 2]> = Vec::new();
        let mut add = |station: f64| {
            if low <= station && station <= high {
                self.cut(axes.span, station, |p| points.push([p[axes.chord], p[axes.thickness]]));
            }
        };
        if mirrored {
            let reach = low.abs().max(high.abs());
            let gap = if low > 0.0 { low } else { (-high).max(0.0) };
            let station = station.abs().clamp(gap, reach.max(gap));
            add(station);
            if station > 0.0 {
                add(-station);
            }
        } else {
            add(station.clamp(low, high.max(low)));
        }
        let (first, last) = points
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| (low.min(p[0]), high.max(p[0])));
        let tie = 1e-9 * (last - first);
        let mean = |extreme: f64| {
            let at: Vec<_> = points.iter().filter(|p| (p[0] - extreme).abs() <= tie).collect();
            let sum = at.iter().fold([0.0; 2], |s, p| [s[0] + p[0], s[1] + p[1]]);
            sum.map(|s| s / at.len() as f64)
        };
        if points.is_empty() || first >= last {
            return None;
        }
        let (leading_edge, trailing_edge) = (mean(first), mean(last));
        Some(Section { leading_edge, chord: [0, 1].map(|a| trailing_edge[a] - leading_edge[a]) })
    }

    /// Middle of the extent of the cross-section `axis = station`, with `station` as its coordinate along the axis.
    pub(crate) fn centre(&self, axis: usize, station: f64) -> Vector3 {
        let (low, high) = self.range(axis);
        let hair = 1e-9 * (high - low);
        let inside = station.clamp(low + hair, (high - hair).max(low + hair));
        let mut least = Vector3::repeat(f64::INFINITY);
        let mut most = -least;
        self.cut(axis, inside, |p| {
            least = least.inf(&p);
            most = most.sup(&p);
        });
        let mut centre = (least + most) * 0.5;
        centre[axis] = station;
        centre
    }

    /// Planform area (leading to trailing edge, through other components, both sides of a mirrored half model) and
    /// aspect ratio span^2/area, m^2 and 1.
    pub(crate) fn planform(&self, axes: Axes, mirrored: bool) -> Option<(f64, f64)> {
        let (low, high) = self.range(axes.span);
        let (start, end, sides) =
            if mirrored { (0.0, low.abs().max(high.abs()), 2.0) } else { (low, high, 1.0) };
        let width = (end - start) / AREA_SECTIONS as f64;
        let mut area = 0.0;
        for i in 0..AREA_SECTIONS {
            let station = start + (i as f64 + 0.5) * width;
            area += sides * width * self.section(axes, station, mirrored)?.chord[0];
        }
        let span = sides * (end - start);
        (area > 0.0).then(|| (area, span * span / area))
    }
}

/// Each interval of `breaks` cut into `parts` equal ones.
fn subdivide(breaks: &[f64], parts: usize) -> Vec<f64> {
    let mut all: Vec<f64> = breaks
        .windows(2)
        .flat_map(|w| (0..parts).map(move |i| w[0] + (w[1] - w[0]) * (i as f64 / parts as f64)))
        .collect();
    all.extend(breaks.last());
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{box_body, tapered_wing};

    const WING: Axes = Axes { span: 1, chord: 0, thickness: 2 };

    #[test]
    fn section_of_a_tapered_wing_is_the_closed_form() {
        // Leading edge x = 1 + 0.5 |y|, chord 4 - 0.4 |y|, z = 0.1 |y| on the chord line, half span 5.
        let wing = tapered_wing();
        let sampled = SampledSurfaces::new(&[&wing]);
        for y in [0.0, 0.7, -2.2, 4.9, 5.0, 17.0] {
            let eta = f64::min(5.0, f64::abs(y));
            let section = sampled.section(WING, y, true).expect("the plane cuts the wing");
            assert!((section.leading_edge[0] - (1.0 + 0.5 * eta)).abs() < 1e-7, "{y} {section:?}");
            assert!((section.leading_edge[1] - 0.1 * eta).abs() < 1e-7);
            assert!((section.chord[0] - (4.0 - 0.4 * eta)).abs() < 1e-7);
            assert!(section.chord[1].abs() < 1e-7);
        }
    }

    #[test]
    fn planform_of_a_tapered_wing_is_the_closed_form() {
        let wing = tapered_wing();
        // S = 2 * 5 * (4 + 2)/2 = 30, A = 100/30.
        let (area, aspect_ratio) =
            SampledSurfaces::new(&[&wing]).planform(WING, true).expect("has a planform");
        assert!((area - 30.0).abs() < 1e-6, "{area}");
        assert!((aspect_ratio - 100.0 / 30.0).abs() < 1e-6);
        // The starboard half alone, read as a half model, gives the same.
        let mut half = wing.clone();
        for patch in &mut half.patches {
            for p in &mut patch.control_points {
                p[1] = 0.5 * (p[1] + 5.0);
                let eta = p[1];
                // Re-shear: keep the relative chordwise place of the point at its new station.
                let old = 2.0 * eta - 5.0;
                let s = (p[0] - 1.0 - 0.5 * old.abs()) / (4.0 - 0.4 * old.abs());
                p[0] = 1.0 + 0.5 * eta + s * (4.0 - 0.4 * eta);
            }
        }
        let (area, aspect_ratio) =
            SampledSurfaces::new(&[&half]).planform(WING, true).expect("has a planform");
        assert!((area - 30.0).abs() < 0.02, "{area}");
        assert!((aspect_ratio - 100.0 / 30.0).abs() < 0.002);
    }

    #[test]
    fn blocks_leave_out_nothing_that_a_plane_meets() {
        let wing = tapered_wing();
        let sampled = SampledSurfaces::new(&[&wing]);
        // The same points, with bounds that hold everywhere.
        let everything =
            Bounds { low: -Vector3::repeat(f64::INFINITY), high: Vector3::repeat(f64::INFINITY) };
        let mut exhaustive = SampledSurfaces::new(&[&wing]);
        exhaustive.blocks.iter_mut().for_each(|block| block.bounds = everything);
        let vertex = sampled.grids[0].points[BLOCK];
        for axis in 0..3 {
            let (low, high) = sampled.range(axis);
            // Ends, planes through points, and planes between.
            let between = (0..40).map(|k| high.min(low + (high - low) * f64::from(k) / 39.0));
            for station in between.chain([vertex[axis], low - 1.0]) {
                let cut = |surfaces: &SampledSurfaces| {
                    let mut points = Vec::new();
                    surfaces.cut(axis, station, |p| points.push(p));
                    points
                };
                assert_eq!(cut(&sampled), cut(&exhaustive), "axis {axis}, {station}");
                assert_eq!(cut(&sampled).is_empty(), station < low, "axis {axis}, {station}");
            }
        }
    }

    #[test]
    fn centre_of_a_slanted_box() {
        // Unit square cross-section whose centre is (y, z) = (0, 0.3 x).
        let body = box_body();
        let sampled = SampledSurfaces::new(&[&body]);
        for x in [0.0, 3.3, 10.0] {
            let centre = sampled.centre(0, x);
            assert!((centre - Vector3::new(x, 0.0, 0.3 * x)).norm() < 1e-7, "{centre}");
        }
    }
}
