//! Cell quality: the measures of the Verdict library (as VTK evaluates them), and measures against the surface that the
//! cells lie on.

use std::fmt;

use rayon::prelude::*;

use crate::{Cell, Csr, Vector3};

/// Aspect ratios above this count as bad.
pub const BAD_ASPECT_RATIO: f64 = 5.0;

/// Value of a ratio whose denominator vanishes; no ratio is larger.
pub const DEGENERATE: f64 = 1e30;

/// Least number of cells of one task.
const MIN_CELLS: usize = 512;

/// The measures of one cell. A cell with a coordinate that is not finite gets the worst values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellQuality {
    /// Verdict: longest edge * perimeter / (4 area) of a quadrilateral, whose area is that of its area vector (Newell; the
    /// mean of its signed corner areas, as VTK 9.7 has it); longest edge * perimeter / (4 sqrt(3) area) of a triangle. 1
    /// is best.
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
    /// Whether the cell's area vector (Newell) points against the surface normal.
    pub folded: bool,
}

/// Measures of all cells, on rayon's current pool.
///
/// `normals`: unit outward normal of the owner's surface, in its current state, one per cell.
///
/// # Panics
/// If the slices' lengths differ, or a cell names no vertex.
pub fn evaluate(vertices: &[[f64; 3]], cells: &[Cell], normals: &[Vector3]) -> Vec<CellQuality> {
    assert_eq!(cells.len(), normals.len(), "one normal per cell");
    let measured = cells.par_iter().zip(normals).with_min_len(MIN_CELLS);
    measured.map(|(cell, normal)| CellQuality::of_cell(vertices, cell, normal)).collect()
}

impl CellQuality {
    /// The measures of one cell, whose owner's unit normal is `normal`.
    ///
    /// # Panics
    /// If the cell names no vertex.
    pub fn of_cell(vertices: &[[f64; 3]], cell: &Cell, normal: &Vector3) -> Self {
        let at = |vertex: u32| Vector3::from(vertices[vertex as usize]);
        match *cell.vertices() {
            [a, b, c] => {
                let x = [at(a), at(b), at(c)];
                // 2 area / sin 60: an equilateral triangle's sides enclose 60 degrees.
                let scale = 2.0 / 3.0_f64.sqrt();
                let area_vector = (x[1] - x[0]).cross(&(x[2] - x[0]));
                // longest * perimeter / (4 sqrt(3) area), the area vector being twice as long as the area
                let denominator = 2.0 * 3.0_f64.sqrt() * area_vector.norm();
                Self::of_polygon(&x, normal, &area_vector, denominator, scale, 60.0)
            }
            [a, b, c, d] => {
                let x = [at(a), at(b), at(c), at(d)];
                let area_vector = (x[2] - x[0]).cross(&(x[3] - x[1]));
                // longest * perimeter / (4 area), the area vector being twice as long as the area
                Self::of_polygon(&x, normal, &area_vector, 2.0 * area_vector.norm(), 1.0, 90.0)
            }
            _ => Self::WORST,
        }
    }

    const WORST: Self = Self {
        aspect_ratio: DEGENERATE,
        edge_ratio: DEGENERATE,
        min_angle: 0.0,
        max_angle: 360.0,
        skew: 1.0,
        scaled_jacobian: -1.0,
        folded: true,
    };

    fn of_polygon<const N: usize>(
        x: &[Vector3; N],
        normal: &Vector3,
        area_vector: &Vector3,
        aspect_denominator: f64,
        jacobian_scale: f64,
        best_angle: f64,
    ) -> Self {
        let edges: [Vector3; N] = std::array::from_fn(|k| x[(k + 1) % N] - x[k]);
        let lengths = edges.map(|edge| edge.norm());
        let perimeter: f64 = lengths.iter().sum();
        if !perimeter.is_finite() {
            return Self::WORST;
        }
        let longest = lengths.iter().fold(0.0, |a: f64, &b| a.max(b));
        let shortest = lengths.iter().fold(f64::INFINITY, |a: f64, &b| a.min(b));
        let folded = area_vector.dot(normal) < 0.0;
        // A corner at an edge of length zero has no angle: it takes the worst of both ends.
        let (mut largest_cosine, mut least_cosine, mut least_sine) = (-1.0_f64, 1.0_f64, 1.0_f64);
        let mut reflex_cosine: Option<f64> = None;
        if shortest < TINY {
            (largest_cosine, least_cosine, least_sine) = (1.0, -1.0, 0.0);
        }
        for k in 0..N {
            let before = (k + N - 1) % N;
            let product = lengths[before] * lengths[k];
            if product < TINY * TINY {
                continue;
            }
            let cross = edges[before].cross(&edges[k]);
            let cosine = (-edges[before].dot(&edges[k]) / product).clamp(-1.0, 1.0);
            largest_cosine = largest_cosine.max(cosine);
            least_cosine = least_cosine.min(cosine);
            least_sine = least_sine.min(cross.dot(normal) / product);
            if N > 3 && cross.dot(area_vector) < 0.0 {
                reflex_cosine = Some(reflex_cosine.map_or(cosine, |other| other.max(cosine)));
            }
        }
        let min_angle = largest_cosine.acos().to_degrees();
        let max_angle = match reflex_cosine {
            // The most reflex corner is the one with the least exterior angle between its sides.
            Some(cosine) => 360.0 - cosine.acos().to_degrees(),
            None => least_cosine.acos().to_degrees(),
        };
        let skew =
            ((max_angle - best_angle) / (180.0 - best_angle)).max((best_angle - min_angle) / best_angle);
        Self {
            aspect_ratio: ratio(longest * perimeter, aspect_denominator),
            edge_ratio: ratio(longest, shortest),
            min_angle,
            max_angle,
            skew: skew.clamp(0.0, 1.0),
            scaled_jacobian: jacobian_scale * least_sine,
            folded,
        }
    }
}

/// Lengths and areas below this count as zero, as in Verdict.
const TINY: f64 = 1e-30;

fn ratio(numerator: f64, denominator: f64) -> f64 {
    // Written so that NaN is degenerate.
    if denominator > TINY { (numerator / denominator).min(DEGENERATE) } else { DEGENERATE }
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

/// The quality of a set of cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// Number of cells.
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

impl Distribution {
    /// The distribution of some values, which are reordered; `None` if there are none.
    pub fn new(values: &mut [f64]) -> Option<Self> {
        let above = values.iter().filter(|&&value| value > BAD_ASPECT_RATIO).count();
        let count = values.len();
        let max = values.iter().copied().max_by(f64::total_cmp)?;
        // From the lowest up: after each selection `values[start..]` holds all order statistics from `start` on.
        let mut start = 0;
        let mut percentile = |fraction: f64| {
            let position = fraction * (count - 1) as f64;
            let index = position as usize;
            let (_, &mut lower, larger) =
                values[start..].select_nth_unstable_by(index - start, f64::total_cmp);
            let upper = larger.iter().copied().min_by(f64::total_cmp).unwrap_or(lower);
            start = index;
            interpolate(lower, upper, position - index as f64)
        };
        Some(Self {
            p50: percentile(0.50),
            p95: percentile(0.95),
            p99: percentile(0.99),
            max,
            above_5_percent: 100.0 * above as f64 / count as f64,
        })
    }
}

/// Linear interpolation from the nearer end, so that both ends are exact.
fn interpolate(lower: f64, upper: f64, t: f64) -> f64 {
    if t < 0.5 { lower + t * (upper - lower) } else { upper - (1.0 - t) * (upper - lower) }
}

impl Summary {
    /// The summary of some cells; `None` if there are none.
    pub fn new(cells: &[CellQuality]) -> Option<Self> {
        let mut scratch = Vec::with_capacity(cells.len());
        let mut distribution = |measure: fn(&CellQuality) -> f64| {
            scratch.clear();
            scratch.extend(cells.iter().map(measure));
            Distribution::new(&mut scratch)
        };
        let skew = distribution(|cell| cell.skew)?;
        let least = |measure: fn(&CellQuality) -> f64| {
            cells.iter().map(measure).fold(f64::INFINITY, |least, value| least.min(value))
        };
        Some(Self {
            cells: cells.len(),
            aspect_ratio: distribution(|cell| cell.aspect_ratio)?,
            edge_ratio: distribution(|cell| cell.edge_ratio)?,
            min_scaled_jacobian: least(|cell| cell.scaled_jacobian),
            min_angle: least(|cell| cell.min_angle),
            max_angle: -least(|cell| -cell.max_angle),
            skew_p95: skew.p95,
            skew_max: skew.max,
            folded: cells.iter().filter(|cell| cell.folded).count(),
            inverted: cells.iter().filter(|cell| cell.scaled_jacobian < 0.0).count(),
        })
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
        assert_eq!(cells.len(), owner.len(), "one owner per cell");
        let total = Summary::new(cells)?;
        let order = Csr::from_pairs(names.len(), owner.iter().copied().zip(0..));
        let summarise = |component: usize| {
            let of_component: Vec<CellQuality> =
                order.row(component).iter().map(|&cell| cells[cell as usize]).collect();
            Some((names[component].clone(), Summary::new(&of_component)?))
        };
        let per_component: Vec<_> = (0..names.len()).into_par_iter().filter_map(summarise).collect();
        Some(Self { total, per_component })
    }

    /// A table of this report beside a reference, such as that of the set-up mesh.
    pub fn compared_with<'a>(&'a self, reference: &'a QualityReport) -> impl fmt::Display + 'a {
        Comparison { report: self, reference }
    }
}

struct Comparison<'a> {
    report: &'a QualityReport,
    reference: &'a QualityReport,
}

impl QualityReport {
    fn rows(&self) -> impl Iterator<Item = (&str, &Summary)> {
        let components = self.per_component.iter().map(|(name, summary)| (name.as_str(), summary));
        components.chain(std::iter::once(("total", &self.total)))
    }
}

impl fmt::Display for QualityReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_table(f, self.rows().map(|(name, summary)| row(name, summary)).collect())
    }
}

impl fmt::Display for Comparison<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut rows = Vec::new();
        for (name, summary) in self.report.rows() {
            rows.push(row(name, summary));
            if let Some((_, before)) = self.reference.rows().find(|(other, _)| *other == name) {
                rows.push(row("  reference", before));
            }
        }
        write_table(f, rows)
    }
}

const COLUMNS: usize = 18;

fn row(name: &str, summary: &Summary) -> [String; COLUMNS] {
    let Summary { aspect_ratio: aspect, edge_ratio: edges, .. } = summary;
    let ratio = |value: f64| if value < 1e4 { format!("{value:.3}") } else { format!("{value:.1e}") };
    let percent = |value: f64| format!("{value:.3}");
    [
        name.to_owned(),
        summary.cells.to_string(),
        ratio(aspect.p50),
        ratio(aspect.p95),
        ratio(aspect.p99),
        ratio(aspect.max),
        percent(aspect.above_5_percent),
        ratio(edges.p50),
        ratio(edges.p95),
        ratio(edges.p99),
        ratio(edges.max),
        percent(edges.above_5_percent),
        format!("{:.3}", summary.min_scaled_jacobian),
        format!("{:.1}", summary.min_angle),
        format!("{:.1}", summary.max_angle),
        format!("{:.3}", summary.skew_p95),
        format!("{:.3}", summary.skew_max),
        format!("{}/{}", summary.folded, summary.inverted),
    ]
}

fn write_table(f: &mut fmt::Formatter<'_>, rows: Vec<[String; COLUMNS]>) -> fmt::Result {
    let over = [
        "",
        "",
        "aspect ratio",
        "",
        "",
        "",
        "",
        "edge ratio",
        "",
        "",
        "",
        "",
        "",
        "angle",
        "",
        "skew",
        "",
        "",
    ];
    let names = [
        "component",
        "cells",
        "p50",
        "p95",
        "p99",
        "max",
        ">5 %",
        "p50",
        "p95",
        "p99",
        "max",
        ">5 %",
        "min sJ",
        "min",
        "max",
        "p95",
        "max",
        "folded/inverted",
    ];
    /// Longer names stand out of their column: formats have a limit of their own for widths.
    const WIDEST: usize = 200;
    let widths: [usize; COLUMNS] = std::array::from_fn(|k| {
        let cells = rows.iter().map(|row| row[k].chars().count());
        // A heading of two words extends over the columns to its right.
        cells.chain([names[k].len()]).max().unwrap_or(0).min(WIDEST)
    });
    let mut heading = String::new();
    let mut column = 0;
    for k in 0..COLUMNS {
        if !over[k].is_empty() {
            heading.push_str(&" ".repeat(column - heading.len()));
            heading.push_str(over[k]);
        }
        column += widths[k] + 2;
    }
    writeln!(f, "{heading}")?;
    for row in std::iter::once(names.map(str::to_owned)).chain(rows) {
        let mut line = String::new();
        for k in 0..COLUMNS {
            let width = widths[k];
            let cell = &row[k];
            match k {
                0 => line.push_str(&format!("{cell:<width$}")),
                _ => line.push_str(&format!("  {cell:>width$}")),
            }
        }
        writeln!(f, "{}", line.trim_end())?;
    }
    Ok(())
}
