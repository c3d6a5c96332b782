//! The sheet of a strip: its pieces, the edges of the surface on which it begins, and its borders along x.

use moldline_mesh::Vector3;

use super::strips::Strip;
use crate::{PanelError, panels::Panels};

/// A corner of a wake: `x` of one point (not ahead of the other), `y` and `z` of another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Corner {
    pub x: u32,
    pub yz: u32,
}

impl Corner {
    fn of(point: u32) -> Self {
        Self { x: point, yz: point }
    }

    pub fn position(&self, points: &[Vector3]) -> Vector3 {
        let (x, at) = (&points[self.x as usize], &points[self.yz as usize]);
        Vector3::new(x.x.max(at.x), at.y, at.z)
    }
}

/// A piece of a strip, counter-clockwise as seen from its upper side.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Piece {
    /// From `[p, q]` along x to infinity.
    Strip([Corner; 2]),
    /// A quadrilateral.
    Quad([Corner; 4]),
}

/// A jump of the potential across an edge, by a strip's circulation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Jump {
    pub edge: u32,
    pub strip: u32,
    /// -1 if the edge's left panel is the upper one, else 1.
    pub sign: f64,
}

/// The border of a strip along x.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray {
    pub point: u32,
    pub strip: u32,
    /// 1 if the strip's border runs downstream here.
    pub sign: f64,
}

/// The pieces of a strip with the paths over bodies at its ends; adds its jumps and rays.
pub(super) fn lay(
    panels: &Panels,
    index: u32,
    strip: &Strip,
    paths: [Option<Vec<u32>>; 2],
    jumps: &mut Vec<Jump>,
    rays: &mut Vec<Ray>,
) -> Result<Vec<Piece>, PanelError> {
    let jump = |edge: u32, left_is_upper: bool| {
        let sign = if left_is_upper { -1.0 } else { 1.0 };
        Jump { edge, strip: index, sign }
    };
    jumps.push(jump(strip.edge, panels.edges[strip.edge as usize].left == strip.upper));
    let (a, b) = (strip.a, strip.b);
    let mut ends = [a, b];
    let pieces = match paths {
        [None, None] => vec![Piece::Strip([Corner::of(b), Corner::of(a)])],
        [Some(_), Some(_)] => {
            return Err(PanelError::NoCarryOver { vertex: panels.vertex_of[a as usize] });
        }
        [Some(path), None] | [None, Some(path)] => {
            let at_a = path[0] == a;
            for pair in path.windows(2) {
                let (q, next) = (pair[0], pair[1]);
                // The upper panel runs against the sheet's border: from `q` on if the border comes back along `b`.
                let upper_from = if at_a { next } else { q };
                let edge = panels
                    .edge_between(q, next)
                    .ok_or(PanelError::NoCarryOver { vertex: panels.vertex_of[q as usize] })?;
                jumps.push(jump(edge, panels.edges[edge as usize].a == upper_from));
            }
            ends[usize::from(!at_a)] = path[path.len() - 1];
            beside_body(&path, if at_a { b } else { a }, at_a)
        }
    };
    rays.push(Ray { point: ends[0], strip: index, sign: 1.0 });
    rays.push(Ray { point: ends[1], strip: index, sign: -1.0 });
    Ok(pieces)
}

/// The pieces between a path over a body, which begins at the strip's `a` or at its `b`, and the ray from the strip's other end.
fn beside_body(path: &[u32], outer: u32, at_a: bool) -> Vec<Piece> {
    // The sheet begins with the whole trailing edge, also if that runs upstream from the body on.
    let beside = |q: u32| Corner { x: if q == path[0] { outer } else { q }, yz: outer };
    let quad = |pair: &[u32]| {
        let (q, next) = (pair[0], pair[1]);
        let (inner, inner_next) = (Corner::of(q), Corner::of(next));
        Piece::Quad(if at_a {
            [beside(q), inner, inner_next, beside(next)]
        } else {
            [inner_next, inner, beside(q), beside(next)]
        })
    };
    let last = path[path.len() - 1];
    let border = [beside(last), Corner::of(last)];
    let rest = Piece::Strip(if at_a { border } else { [border[1], border[0]] });
    path.windows(2).map(quad).chain([rest]).collect()
}
