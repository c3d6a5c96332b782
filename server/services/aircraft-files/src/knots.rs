//! Takes out knots at which a patch is only continuous in form, without changing its surface.
//!
//! Exporters write chains of Bezier pieces with every knot of multiplicity p, though the curves behind them are smooth. At such a
//! knot the derivative jumps only because the lengths of the knot intervals are arbitrary: with the legs a = P_k - P_(k-1) and
//! b = P_(k+1) - P_k of the control polygon, and b = r a for one ratio r in all rows, the surface is C1 once the intervals
//! on both sides have the ratio r. P_k = (r P_(k-1) + P_(k+1)) / (1 + r) is then implied and goes, with one of the p knots.

use moldline_geometry::PatchInput;
use moldline_spline::KnotVector;

/// Knots whose first or last one differs from p equal ones beside it, as OpenVSP's IGES has them: no value depends on it.
pub(crate) fn with_clamped_ends(degree: usize, mut knots: Vec<f64>) -> Vec<f64> {
    let n = knots.len();
    if degree > 0 && n >= 2 * degree + 2 {
        if knots[1..=degree].iter().all(|t| *t == knots[1]) {
            knots[0] = knots[1];
        }
        if knots[n - 1 - degree..n - 1].iter().all(|t| *t == knots[n - 2]) {
            knots[n - 1] = knots[n - 2];
        }
    }
    knots
}

/// What was taken out of a patch.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Removal {
    /// Knots taken out.
    pub(crate) removed: usize,
    /// Largest change of a control point that was implied, in the patch's unit; the surface changes by less.
    pub(crate) change: f64,
}

/// Rows of homogeneous control points along the direction that is looked at.
type Rows = Vec<Vec<[f64; 4]>>;

/// The patch without knots that change its surface by at most `tolerance`.
pub(crate) fn remove_false_corners(patch: PatchInput, tolerance: f64) -> (PatchInput, Removal) {
    let (n_u, n_v) = (patch.knots_u.control_point_count(), patch.knots_v.control_point_count());
    let weight = |at: usize| patch.weights.as_ref().map_or(1.0, |w| w[at]);
    let homogeneous = |at: usize| {
        let ([x, y, z], w) = (patch.control_points[at], weight(at));
        [w * x, w * y, w * z, w]
    };
    let along_v: Rows = (0..n_u).map(|i| (0..n_v).map(|j| homogeneous(i * n_v + j)).collect()).collect();
    let (knots_v, along_v, in_v) = smooth_direction(&patch.knots_v, along_v, tolerance);
    let (knots_u, along_u, in_u) = smooth_direction(&patch.knots_u, transpose(&along_v), tolerance);
    let removal = Removal { removed: in_u.removed + in_v.removed, change: in_u.change.max(in_v.change) };
    if removal.removed == 0 {
        return (patch, removal);
    }
    let points = transpose(&along_u).concat();
    let weights = patch.weights.is_some().then(|| points.iter().map(|p| p[3]).collect());
    let cartesian = |p: &[f64; 4]| [0, 1, 2].map(|k| if p[3] == 1.0 { p[k] } else { p[k] / p[3] });
    let control_points = points.iter().map(cartesian).collect();
    (PatchInput { name: patch.name, knots_u, knots_v, control_points, weights }, removal)
}

fn transpose(rows: &Rows) -> Rows {
    let length = rows.first().map_or(0, Vec::len);
    (0..length).map(|j| rows.iter().map(|row| row[j]).collect()).collect()
}

fn smooth_direction(knots: &KnotVector, rows: Rows, tolerance: f64) -> (KnotVector, Rows, Removal) {
    let p = knots.degree();
    let unchanged = |rows| (knots.clone(), rows, Removal::default());
    // Straight segments are one piece each; their corners are what they seem.
    if p < 2 {
        return unchanged(rows);
    }
    let t = knots.knots();
    let (a, b) = knots.domain();
    let mut smooth = Vec::with_capacity(t.len());
    let mut gone = Vec::new();
    let mut removal = Removal::default();
    // New knot = origin.1 + scale (old knot - origin.0).
    let (mut origin, mut scale) = ((t[0], t[0]), 1.0);
    let mut index = 0;
    while index < t.len() {
        let value = t[index];
        let multiplicity = t[index..].iter().take_while(|&&k| k == value).count();
        let place = origin.1 + scale * (value - origin.0);
        let mut kept = multiplicity;
        if value > a && value < b && multiplicity == p {
            // The control point on the knot, and the lengths of the intervals beside it.
            let k = index - 1;
            let (before, after) = (scale * (value - t[index - 1]), t[index + p] - value);
            origin = (value, place);
            match ratio(&rows, k, tolerance) {
                Some((ratio, change)) => {
                    scale = ratio * before / after;
                    kept -= 1;
                    gone.push(k);
                    removal.removed += 1;
                    removal.change = removal.change.max(change);
                }
                None => scale = before / (value - t[index - 1]),
            }
        }
        smooth.extend(std::iter::repeat_n(place, kept));
        index += multiplicity;
    }
    if removal.removed == 0 {
        return unchanged(rows);
    }
    // Ratios far from 1 may leave intervals that vanish in rounding; such a patch stays as it is.
    let Ok(smooth) = KnotVector::new(p, smooth) else { return unchanged(rows) };
    let mut keep = vec![true; knots.control_point_count()];
    gone.iter().for_each(|&k| keep[k] = false);
    let rows = rows
        .into_iter()
        .map(|row| row.into_iter().zip(&keep).filter(|(_, keep)| **keep).map(|(p, _)| p).collect());
    (smooth, rows.collect(), removal)
}

/// The ratio of the legs after and before control point `k`, and the largest distance of that point from where it implies it to
/// be, unless that is beyond the tolerance.
fn ratio(rows: &Rows, k: usize, tolerance: f64) -> Option<(f64, f64)> {
    let (mut across, mut squared) = (0.0, 0.0);
    for row in rows {
        for d in 0..4 {
            let (before, after) = (row[k][d] - row[k - 1][d], row[k + 1][d] - row[k][d]);
            across += before * after;
            squared += before * before;
        }
    }
    let ratio = across / squared;
    if !(1e-6..=1e6).contains(&ratio) {
        return None;
    }
    let distance = |row: &Vec<[f64; 4]>| {
        let implied = |d: usize| (ratio * row[k - 1][d] + row[k + 1][d]) / (1.0 + ratio) - row[k][d];
        (0..4).map(|d| implied(d).powi(2)).sum::<f64>().sqrt()
    };
    let change = rows.iter().map(distance).fold(0.0, f64::max);
    (change <= tolerance).then_some((ratio, change))
}
