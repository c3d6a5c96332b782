//! Connected parts of the surface that are as thin as a wing, but shed no wake.

use moldline_mesh::Vector3;

use crate::{Warning, panels::Panels};

/// Largest mean thickness of a wing, as a fraction of its mean chord and of its span.
const THIN: f64 = 0.15;

/// Sums over a part.
#[derive(Clone)]
struct Part {
    cell: u32,
    area: f64,
    volume: f64,
    moment: Vector3,
    low: Vector3,
    high: Vector3,
    sheds: bool,
}

/// A warning for each part that is thin and sheds no wake. With the volume V and the area A of the surface, the mean thickness is `2 V / A`; the
/// span is the extent across the flow, and the mean chord `A / 2` over it.
pub(crate) fn without_wake(panels: &Panels, points: &[Vector3], trailing: &[bool]) -> Vec<Warning> {
    let count = panels.piece.iter().max().map_or(0, |piece| *piece as usize + 1);
    let (least, most) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    let none = Part {
        cell: u32::MAX,
        area: 0.0,
        volume: 0.0,
        moment: Vector3::zeros(),
        low: least,
        high: most,
        sheds: false,
    };
    let mut parts = vec![none; count];
    let piece_of = |panel: usize| panels.piece[panels.corners[panel][0] as usize] as usize;
    for (panel, corners) in panels.corners.iter().enumerate() {
        let part = &mut parts[piece_of(panel)];
        let at = corners.map(|v| points[v as usize]);
        let [a, b, c, d] = at;
        let area: Vector3 = 0.5 * (c - a).cross(&(d - b));
        let centre = 0.25 * (a + b + c + d);
        part.cell = part.cell.min(panels.cell_of[panel]);
        part.area += area.norm();
        // On the plane of symmetry y = 0, so that the missing cells of a half count nothing.
        part.volume += centre.y * area.y;
        part.moment += centre * area.norm();
        for point in at {
            part.low = part.low.inf(&point);
            part.high = part.high.sup(&point);
        }
    }
    for (edge, _) in panels.edges.iter().zip(trailing).filter(|(_, sheds)| **sheds) {
        parts[piece_of(edge.left as usize)].sheds = true;
    }
    let is_thin = |part: &&Part| {
        let span = (part.high.y - part.low.y).hypot(part.high.z - part.low.z);
        let (thickness, chord) = (2.0 * part.volume / part.area, 0.5 * part.area / span);
        !part.sheds && thickness < THIN * span.min(chord)
    };
    let warning =
        |part: Part| Warning::NoWake { cell: part.cell, position: (part.moment / part.area).into() };
    parts.iter().filter(is_thin).cloned().map(warning).collect()
}
