//! Closes gaps between the edges of patches: control points of two sides that run along each other become one.

use moldline_geometry::PatchInput;
use moldline_spline::KnotVector;

/// A side of a patch as indices into the control points of all patches.
struct Side {
    patch: usize,
    points: Vec<usize>,
    /// Degree, and knots mapped to 0..1.
    degree: usize,
    knots: Vec<f64>,
}

/// Moves control points so that sides within `tolerance` of each other coincide; returns the largest move. Each side is
/// paired with its nearest, so that the two edges of a thin trailing edge stay apart.
pub(crate) fn weld(patches: &mut [PatchInput], tolerance: f64) -> f64 {
    let mut points: Vec<[f64; 3]> = Vec::new();
    let mut sides = Vec::new();
    for (index, patch) in patches.iter().enumerate() {
        add_sides(index, patch, points.len(), &mut sides);
        points.extend_from_slice(&patch.control_points);
    }
    let mut clusters: Vec<usize> = (0..points.len()).collect();
    let extent = |side: &Side| {
        let first = points[side.points[0]];
        side.points.iter().map(|&i| distance(&points[i], &first)).fold(0.0, f64::max)
    };
    let collapsed: Vec<bool> = sides.iter().map(|side| extent(side) <= 1e-3 * tolerance).collect();
    for (side, _) in sides.iter().zip(&collapsed).filter(|(_, collapsed)| **collapsed) {
        side.points.iter().for_each(|&i| unite(&mut clusters, side.points[0], i));
    }
    // (partner, gap, reversed)
    let mut best: Vec<Option<(usize, f64, bool)>> = vec![None; sides.len()];
    for i in 0..sides.len() {
        for j in i + 1..sides.len() {
            if collapsed[i] || collapsed[j] {
                continue;
            }
            let Some((gap, reversed)) = gap(&sides[i], &sides[j], &points, tolerance) else { continue };
            for (side, partner) in [(i, j), (j, i)] {
                if best[side].is_none_or(|(_, least, _)| gap < least) {
                    best[side] = Some((partner, gap, reversed));
                }
            }
        }
    }
    for i in 0..sides.len() {
        let Some((j, _, reversed)) = best[i] else { continue };
        if j < i || best[j].is_none_or(|(back, ..)| back != i) {
            continue;
        }
        let n = sides[i].points.len();
        for k in 0..n {
            unite(&mut clusters, sides[i].points[k], sides[j].points[if reversed { n - 1 - k } else { k }]);
        }
    }
    let extents: Vec<f64> = patches
        .iter()
        .flat_map(|patch| std::iter::repeat_n(extent_of(&patch.control_points), patch.control_points.len()))
        .collect();
    let moved = close_clusters(&mut points, &extents, &mut clusters, tolerance);
    let mut rest = &points[..];
    for patch in patches {
        let (own, others) = rest.split_at(patch.control_points.len());
        patch.control_points.copy_from_slice(own);
        rest = others;
    }
    moved
}

fn add_sides(index: usize, patch: &PatchInput, base: usize, sides: &mut Vec<Side>) {
    let (n_u, n_v) = (patch.knots_u.control_point_count(), patch.knots_v.control_point_count());
    let mut add = |knots: &KnotVector, points: Vec<usize>| {
        if knots.is_clamped() {
            let (a, b) = knots.domain();
            let knots_of = knots.knots().iter().map(|t| (t - a) / (b - a)).collect();
            sides.push(Side { patch: index, points, degree: knots.degree(), knots: knots_of });
        }
    };
    for j in [0, n_v - 1] {
        add(&patch.knots_u, (0..n_u).map(|i| base + i * n_v + j).collect());
    }
    for i in [0, n_u - 1] {
        add(&patch.knots_v, (0..n_v).map(|j| base + i * n_v + j).collect());
    }
}

/// The largest distance between control points of two sides, and whether one runs backwards; none if they do not match.
fn gap(a: &Side, b: &Side, points: &[[f64; 3]], tolerance: f64) -> Option<(f64, bool)> {
    let n = a.points.len();
    // Two sides of one patch with two control points between them may close a tube; more is not asked.
    if b.points.len() != n || a.degree != b.degree || (a.patch == b.patch && n < 3) {
        return None;
    }
    let largest = |reversed: bool| {
        let at = |k: usize| b.points[if reversed { n - 1 - k } else { k }];
        (0..n).try_fold(0.0_f64, |gap, k| {
            let gap = gap.max(distance(&points[a.points[k]], &points[at(k)]));
            (gap <= tolerance).then_some(gap)
        })
    };
    let same_knots = |reversed: bool| {
        let m = b.knots.len();
        let knot = |k: usize| if reversed { 1.0 - b.knots[m - 1 - k] } else { b.knots[k] };
        a.knots.iter().enumerate().all(|(k, t)| (t - knot(k)).abs() <= 1e-6)
    };
    [false, true]
        .into_iter()
        .filter_map(|reversed| Some((largest(reversed).filter(|_| same_knots(reversed))?, reversed)))
        .min_by(|a, b| a.0.total_cmp(&b.0))
}

/// Moves each cluster to its points of the largest patch (a cap follows the skin, which stays smooth), or to the middle of the
/// box around those of several. That does not depend on order, and is mirrored as the points are.
fn close_clusters(points: &mut [[f64; 3]], extents: &[f64], clusters: &mut [usize], tolerance: f64) -> f64 {
    let mut largest = vec![0.0_f64; points.len()];
    for i in 0..points.len() {
        let root = find(clusters, i);
        largest[root] = largest[root].max(extents[i]);
    }
    let mut boxes: Vec<Option<[[f64; 3]; 2]>> = vec![None; points.len()];
    for i in 0..points.len() {
        let root = find(clusters, i);
        if extents[i] < (1.0 - 1e-6) * largest[root] {
            continue;
        }
        let p = points[i];
        let [low, high] = boxes[root].get_or_insert([p, p]);
        for d in 0..3 {
            low[d] = low[d].min(p[d]);
            high[d] = high[d].max(p[d]);
        }
    }
    let mut moved = 0.0_f64;
    for i in 0..points.len() {
        let Some([low, high]) = boxes[find(clusters, i)] else { continue };
        let middle = [0, 1, 2].map(|d| low[d] + 0.5 * (high[d] - low[d]));
        let distance = distance(&middle, &points[i]);
        if distance <= 2.0 * tolerance {
            moved = moved.max(distance);
            points[i] = middle;
        }
    }
    moved
}

/// Diagonal of the box around points.
fn extent_of(points: &[[f64; 3]]) -> f64 {
    let side = |d: usize| {
        let (low, high) = points
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| (low.min(p[d]), high.max(p[d])));
        high - low
    };
    (0..3).map(|d| side(d).powi(2)).sum::<f64>().sqrt()
}

fn distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|d| (a[d] - b[d]).powi(2)).sum::<f64>().sqrt()
}

fn find(clusters: &mut [usize], mut i: usize) -> usize {
    while clusters[i] != i {
        clusters[i] = clusters[clusters[i]];
        i = clusters[i];
    }
    i
}

fn unite(clusters: &mut [usize], a: usize, b: usize) {
    let (a, b) = (find(clusters, a), find(clusters, b));
    clusters[a.max(b)] = a.min(b);
}
