//! Crossing an edge: from a side of a patch to the patch behind it.

use crate::body::Body;
use crate::location::{Location, Side};

/// The continuation of a body behind a side of a patch.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Crossing {
    pub edge: u32,
    pub side: Side,
    pub to: Location,
    /// Derivative of the parameter along the side behind it with respect to that before it.
    pub slope: f64,
}

impl Body {
    /// The same point seen from the patch behind a side, if there is one.
    pub(crate) fn cross(&self, l: &Location, side: Side) -> Option<Crossing> {
        let t = if side.holds_u() { l.v } else { l.u };
        let piece = self.component().piece(l.patch, side, t)?;
        let edge = &self.component().edges()[piece.edge as usize];
        let (here, there) = match (&edge.sides[..], piece.index) {
            ([a, b], 0) => (a, b),
            ([a, b], _) => (b, a),
            _ => return None,
        };
        let fraction = ((t - here.range.0) / (here.range.1 - here.range.0)).clamp(0.0, 1.0);
        let patch = &self.component().patches()[there.patch as usize];
        let mut other = there.range.0 + fraction * (there.range.1 - there.range.0);
        let mut slope = (there.range.1 - there.range.0) / (here.range.1 - here.range.0);
        if !edge.affine {
            let range = (there.range.0.min(there.range.1), there.range.0.max(there.range.1));
            other = patch.closest_on_side(self.control_points(), there.side, range, &self.position(l)).0;
            let (before, _) = side.along_and_inward(&self.point(l));
            let (behind, _) =
                there.side.along_and_inward(&self.point(&patch.on_side(there.patch, there.side, other)));
            slope = behind.dot(&before) / behind.norm_squared();
        }
        Some(Crossing {
            edge: piece.edge,
            side: there.side,
            to: patch.on_side(there.patch, there.side, other),
            slope,
        })
    }
}
