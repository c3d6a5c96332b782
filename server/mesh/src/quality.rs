//! Cell quality: the measures of the Verdict library (as VTK evaluates them), and measures against the surface that the
//! cells lie on.

use std::fmt;

use crate::{Cell, Vector3};

/// Aspect ratios from here on are counted as bad.
pub const BAD_ASPECT_RATIO: f64 = 5.0;

/// Value of a ratio whose denominator vanishes; the largest ratio there is.
pub const DEGENERATE: f64 = 1e30;

/// The measures of one cell. A cell with a coordinate that is not finite gets the worst values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellQuality {
    /// Verdict: longest edge * perimeter / (4 area) of a quadrilateral, whose area is that of the triangles at its second
    /// and fourth vertex; longest edge * perimeter / (4 sqrt(3) area) of a triangle. 1 is best.
    pub aspect_ratio: f64,
    /// Longest over shortest edge.
    pub edge_ratio: f64,
    /// Smallest corner angle, degrees.
    pub min_angle: f64,
    /// Largest corner angle, degrees.
    pub max_angle: f64,
    /// Equiangle skew: `max((max_angle - e) / (180 - e), (e - min_angle) / e)` with e = 90 or 60 degrees. 0 is best.
    pub skew: f64,
    /// Least sine of a corner angle as seen along the surface normal n: `min (a x b) . n / (|a| |b|)` over the corners'
    /// edges a, b; of a triangle times 2/sqrt(3). 1 is best, negative is inverted.
    pub scaled_jacobian: f64,
    /// The cell's area vector (Newell) points against the surface normal.
    pub folded: bool,
}

/// Evaluates all cells into `out`, on rayon's current pool.
///
/// `normals`: unit outward normal of the owner's surface, in its current state, one per cell.
///
/// # Panics
/// If the slices' lengths differ, or a cell names no vertex.
pub fn evaluate(vertices: &[[f64; 3]], cells: &[Cell], normals: &[Vector3], out: &mut [CellQuality]) {
    let _ = (vertices, cells, normals, out);
    todo!()
}

/// A measure over many cells. Percentiles interpolate linearly between order statistics, like numpy's default.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distribution {
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest value.
    pub max: f64,
    /// Percentage of the cells above [`BAD_ASPECT_RATIO`].
    pub above_5_percent: f64,
}

/// What is said of a set of cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// How many cells.
    pub cells: usize,
    /// Verdict's aspect ratio.
    pub aspect_ratio: Distribution,
    /// Longest over shortest edge.
    pub edge_ratio: Distribution,
    /// Least scaled Jacobian against the owner's normal.
    pub min_scaled_jacobian: f64,
    /// Least corner angle, degrees.
    pub min_angle: f64,
    /// Largest corner angle, degrees.
    pub max_angle: f64,
    /// 95th percentile of equiangle skew.
    pub skew_p95: f64,
    /// Largest equiangle skew.
    pub skew_max: f64,
    /// Cells whose area vector points against the owner's normal.
    pub folded: usize,
    /// Cells with a corner that is turned against the owner's normal (negative scaled Jacobian).
    pub inverted: usize,
}

/// Summaries of all cells and of each component's. `Display` gives an aligned table.
#[derive(Clone, Debug, PartialEq)]
pub struct QualityReport {
    /// All cells.
    pub total: Summary,
    /// By component, in order; components without cells are left out.
    pub per_component: Vec<(String, Summary)>,
}

impl Summary {
    /// The summary of some cells; `None` if there are none.
    pub fn new(cells: &[CellQuality]) -> Option<Self> {
        let _ = cells;
        todo!()
    }
}

impl QualityReport {
    /// `owner[i]` is the component of `cells[i]`, an index into `names`.
    ///
    /// `None` if there are no cells.
    ///
    /// # Panics
    /// If the lengths differ.
    pub fn new(cells: &[CellQuality], owner: &[u32], names: &[String]) -> Option<Self> {
        let _ = (cells, owner, names);
        todo!()
    }

    /// This report beside a reference, such as that of the set-up mesh, as a table.
    pub fn compared_with<'a>(&'a self, reference: &'a QualityReport) -> impl fmt::Display + 'a {
        Comparison { report: self, reference }
    }
}

struct Comparison<'a> {
    report: &'a QualityReport,
    reference: &'a QualityReport,
}

impl fmt::Display for Comparison<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.report, self.reference)
    }
}

impl fmt::Display for QualityReport {
    fn fmt(&self, _: &mut fmt::Formatter<'_>) -> fmt::Result {
        todo!()
    }
}
