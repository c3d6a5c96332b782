//! What a component is, by its shape: a wing has chordwise sections along a span, a body is long and about as wide as high.

use moldline_foundation::Vector3;

use crate::measure::Samples;

/// Sections looked at.
const SECTIONS: usize = 9;
/// Sections of a wing are at most this thick, relative to their chord (the median counts).
const THICKNESS: f64 = 0.4;
/// A wing's side is at least this long, relative to its mean chord.
const SPAN: f64 = 0.6;
/// A body is at least this long, relative to its larger width.
const FINENESS: f64 = 1.2;

/// What a component is.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Shape {
    /// A wing, tail, fin, strut or pylon.
    Wing(Wing),
    /// A fuselage, nacelle or boom.
    Body(Long),
    /// Something else.
    Other,
}

/// A wing-like component.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Wing {
    /// Axis of the span: 1 (y) or 2 (z).
    pub(crate) span_axis: usize,
    /// Whether the root is the plane 0 of the span axis, or the place nearest to it; otherwise it is the lower end.
    pub(crate) symmetric: bool,
    /// Span, m, as the planform operation counts it (both sides if symmetric).
    pub(crate) span: f64,
    /// Planform area, m^2, likewise.
    pub(crate) area: f64,
    /// Quarter-chord point of the root.
    pub(crate) root_quarter_chord: Vector3,
}

/// A body-like component.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Long {
    /// Axis of the length.
    pub(crate) axis: usize,
    pub(crate) start: f64,
    pub(crate) end: f64,
    /// Larger width of the cross-section in the middle, m.
    pub(crate) diameter: f64,
    /// Whether it is one body, and not one on each side.
    pub(crate) single: bool,
}

/// Finds what a component is.
pub(crate) fn shape(samples: &Samples) -> Shape {
    let wings = [1, 2].into_iter().filter_map(|axis| wing(samples, axis));
    if let Some(wing) = wings.max_by(|a, b| a.span.total_cmp(&b.span)) {
        return Shape::Wing(wing);
    }
    let extent = samples.high - samples.low;
    let axis = (0..3).max_by(|&a, &b| extent[a].total_cmp(&extent[b])).unwrap_or(0);
    let single = !apart(samples);
    let middle = 0.5 * (samples.low[axis] + samples.high[axis]);
    let (low, high) = bounds(&samples.section(axis, middle));
    let width = |k: usize| if k == axis { 0.0 } else { high[k] - low[k] };
    let diameter = (0..3).map(width).fold(0.0, f64::max);
    let one_side = if single { diameter } else { 0.0 };
    if diameter > 0.0 && extent[axis] >= FINENESS * one_side {
        let (start, end) = (samples.low[axis], samples.high[axis]);
        return Shape::Body(Long { axis, start, end, diameter, single });
    }
    Shape::Other
}

/// Whether it has a part on each side of the plane of symmetry, and nothing at it.
fn apart(samples: &Samples) -> bool {
    let (low, high) = (samples.low.y, samples.high.y);
    low < 0.0 && high > 0.0 && samples.section(1, 0.0).is_empty()
}

fn wing(samples: &Samples, span_axis: usize) -> Option<Wing> {
    let thickness_axis = 3 - span_axis;
    let (low, high) = (samples.low[span_axis], samples.high[span_axis]);
    let extent = high - low;
    let mirrored = span_axis == 1 && (low + high).abs() <= 1e-6 * extent;
    let symmetric = mirrored || (span_axis == 1 && high <= 1e-6 * extent);
    let (start, end) = if symmetric { (samples.gap(1), low.abs().max(high.abs())) } else { (low, high) };
    let side = if high <= 0.0 && symmetric { -1.0 } else { 1.0 };
    let sections: Vec<(Vector3, Vector3)> = (0..SECTIONS)
        .map(|k| start + (end - start) * (k as f64 + 0.5) / SECTIONS as f64)
        .map(|station| samples.section(span_axis, side * station))
        .filter(|points| !points.is_empty())
        .map(|points| bounds(&points))
        .collect();
    if sections.len() < SECTIONS {
        return None;
    }
    let chords = sections.iter().map(|(low, high)| high.x - low.x);
    let mean_chord = chords.sum::<f64>() / SECTIONS as f64;
    let ratio =
        |(low, high): &(Vector3, Vector3)| (high[thickness_axis] - low[thickness_axis]) / (high.x - low.x);
    let mut ratios: Vec<f64> = sections.iter().map(ratio).collect();
    ratios.sort_by(f64::total_cmp);
    let thick = ratios[SECTIONS / 2];
    if !(thick <= THICKNESS && end - start >= SPAN * mean_chord) {
        return None;
    }
    // As the planform operation has it: from the plane of symmetry, with the first chord up to there.
    let (span, area) = if symmetric {
        let inner = sections[0].1.x - sections[0].0.x;
        (2.0 * end, 2.0 * ((end - start) * mean_chord + start * inner))
    } else {
        (end - start, (end - start) * mean_chord)
    };
    let root = samples.section(span_axis, side * (start + 1e-6 * (end - start)));
    let (low, high) = bounds(&root);
    let at = |x: f64| root.iter().min_by(|a, b| (a.x - x).abs().total_cmp(&(b.x - x).abs()));
    let mut quarter = at(low.x)? * 0.75 + at(high.x)? * 0.25;
    quarter[span_axis] = if mirrored { 0.0 } else { side * start };
    Some(Wing { span_axis, symmetric, span, area, root_quarter_chord: quarter })
}

fn bounds(points: &[Vector3]) -> (Vector3, Vector3) {
    let none = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    points.iter().fold(none, |(low, high), p| (low.inf(p), high.sup(p)))
}
