//! Local descent to a foot point, over patch edges.

use crate::body::Body;
use crate::foot_point::FootPoint;
use crate::location::{Location, Side};
use crate::newton::{Iterate, Progress};
use crate::topology::Incidence;
use moldline_foundation::Vector3;

/// Most steps of a local descent; five are usual.
const MAX_STEPS: usize = 200;
/// Most patch sides that a descent crosses; then it stays on its patch.
const MAX_MOVES: usize = 50;

impl Body {
    /// The local minimum of the distance that descent from `hint` reaches. Descent crosses patch edges and stays on the
    /// hint's sheet of a thin body. `None` if it does not converge.
    pub fn closest_point_near(&self, x: &Vector3, hint: &Location) -> Option<FootPoint> {
        self.descend(x, hint).map(|l| self.foot_point(x, &l))
    }

    /// Descends to a local minimum of the distance, over patch edges.
    pub(crate) fn descend(&self, x: &Vector3, hint: &Location) -> Option<Location> {
        let size = self.size();
        let patches = self.component().patches();
        let start = |l: &Location| {
            let [u, v] = patches[l.patch as usize].surface.domain();
            let l = Location { patch: l.patch, u: l.u.clamp(u.0, u.1), v: l.v.clamp(v.0, v.1) };
            (l.patch, [u, v], Iterate::new(x, size, (l.u, l.v), self.jet(&l)))
        };
        let (mut patch, mut domain, mut i) = start(hint);
        let mut moves = 0;
        for _ in 0..MAX_STEPS {
            let held = i.held(domain);
            if held != [false; 2] && moves < MAX_MOVES {
                // At a side that the gradient pushes against: go on behind it if the distance decreases there.
                let l = Location { patch, u: i.u, v: i.v };
                if let Some(to) = self.descending_neighbour(&l, &i.r, held) {
                    moves += 1;
                    (patch, domain, i) = start(&to);
                    continue;
                }
            }
            let surface = &patches[patch as usize].surface;
            let points = self.patch_points(patch);
            if i.advance(domain, |u, v| surface.jet(points, u, v)) == Progress::Converged {
                return Some(Location { patch, u: i.u, v: i.v });
            }
        }
        None
    }

    /// A location at the same point behind one of the sides that `l` is held at, from which the distance decreases.
    fn descending_neighbour(&self, l: &Location, r: &Vector3, held: [bool; 2]) -> Option<Location> {
        let [u, v] = self.component().patches()[l.patch as usize].surface.domain();
        let side_u = if l.u <= u.0 { Side::UMin } else { Side::UMax };
        let side_v = if l.v <= v.0 { Side::VMin } else { Side::VMax };
        for (side, _) in [(side_u, held[0]), (side_v, held[1])].into_iter().filter(|(_, held)| *held) {
            let Some(crossing) = self.cross(l, side) else {
                if let Some(to) = self.leave_pole(l, side, r) {
                    return Some(to);
                }
                continue;
            };
            let (_, inward) = crossing.side.along_and_inward(&self.point(&crossing.to));
            if inward.dot(r) < -1e-12 * inward.norm() * (r.norm() + 1e-3 * self.size()) {
                return Some(crossing.to);
            }
        }
        None
    }

    /// If `side` is collapsed: a location close to the pole in the direction of steepest descent, if there is one.
    fn leave_pole(&self, l: &Location, side: Side, r: &Vector3) -> Option<Location> {
        let t = if side.holds_u() { l.v } else { l.u };
        let edge = self.component().piece(l.patch, side, t)?.edge;
        let edge = &self.component().edges()[edge as usize];
        if !edge.collapsed {
            return None;
        }
        let vertex = &self.component().vertices()[edge.vertices[0] as usize];
        let mut best = (-1e-9 * r.norm(), None);
        for incidence in &vertex.incidences {
            let Incidence::Pole { patch, side } = *incidence else { continue };
            let p = &self.component().patches()[patch as usize];
            let domain = p.surface.domain();
            let (low, high) = domain[usize::from(!side.holds_u())];
            let step = if side.is_min() { 1e-6 } else { -1e-6 } * (high - low);
            for t in p.side_samples(side, 4) {
                let at = p.on_side(patch, side, t);
                let (_, inward) = side.along_and_inward(&self.point(&at));
                let slope = inward.dot(r) / inward.norm();
                if slope < best.0 {
                    let (mut u, mut v) = (at.u, at.v);
                    if side.holds_u() {
                        u += step
                    } else {
                        v += step
                    }
                    let to = Location { patch, u, v };
                    let closer =
                        (self.position(&to) - (self.position(l) - r)).norm_squared() < r.norm_squared();
                    if closer {
                        best = (slope, Some(to));
                    }
                }
            }
        }
        best.1
    }
}
