//! Lines of one parameter over the patches of a body (`docs/derivation.md`, section 4).

use crate::body::Body;
use crate::location::{Location, Side};

/// A parameter of a patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ParameterDirection {
    /// `v` held, `u` moving.
    U,
    /// `u` held, `v` moving.
    V,
}

/// The end of a line of one parameter, with its derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Walk {
    /// The end of the line.
    pub end: Location,
    /// Derivative of the end's `(u, v)` with respect to the start's `(u, v)`.
    pub by_start: [[f64; 2]; 2],
    /// Derivative of the end's `(u, v)` with respect to the length.
    pub by_length: [f64; 2],
}

impl Body {
    /// Continues a line of one parameter by `delta` (in that parameter), over smooth edges into the neighbouring patches;
    /// it ends at sharp and boundary edges and at poles. Behind an edge the parameter advances at the speed that keeps
    /// the line's speed in space.
    pub fn walk(&self, from: &Location, along: ParameterDirection, delta: f64) -> Location {
        self.follow(from, along, delta, None)
    }

    /// [`walk`](Self::walk) with its derivative. Where the line ends at an edge, its end no longer depends on its length.
    pub fn walk_derivative(&self, from: &Location, along: ParameterDirection, delta: f64) -> Walk {
        let mut d = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let end = self.follow(from, along, delta, Some(&mut d));
        Walk { end, by_start: d.map(|row| [row[0], row[1]]), by_length: d.map(|row| row[2]) }
    }

    /// The end of a line of one parameter. `derivative` is carried along: that of `(u, v)` with respect to the start's `u`
    /// and `v` and to the length.
    fn follow(
        &self,
        from: &Location,
        along: ParameterDirection,
        delta: f64,
        mut derivative: Option<&mut [[f64; 3]; 2]>,
    ) -> Location {
        let mut l = *from;
        let mut along = along;
        let mut delta = delta;
        let mut d_delta = [0.0, 0.0, 1.0];
        // The limit is reached only by an absurd `delta` around a closed body.
        for _ in 0..1000 {
            let domain = self.component().patches()[l.patch as usize].surface.domain();
            let moves_u = along == ParameterDirection::U;
            let moving = usize::from(!moves_u);
            let (value, (low, high)) = if moves_u { (l.u, domain[0]) } else { (l.v, domain[1]) };
            let target = value + delta;
            let reached = target.clamp(low, high);
            if moves_u {
                l.u = reached
            } else {
                l.v = reached
            }
            let rest = target - reached;
            let mut d_rest = [0.0; 3];
            if let Some(d) = &mut derivative {
                d_rest = std::array::from_fn(|k| d[moving][k] + d_delta[k]);
                d[moving] = if rest == 0.0 { d_rest } else { [0.0; 3] };
            }
            if rest == 0.0 || !rest.is_finite() {
                return l;
            }
            let side = match (moves_u, rest < 0.0) {
                (true, true) => Side::UMin,
                (true, false) => Side::UMax,
                (false, true) => Side::VMin,
                (false, false) => Side::VMax,
            };
            let Some(crossing) = self.cross(&l, side) else { return l };
            if self.component().edges()[crossing.edge as usize].sharp {
                return l;
            }
            let (_, here) = side.along_and_inward(&self.point(&l));
            let (_, there) = crossing.side.along_and_inward(&self.point(&crossing.to));
            let ratio = here.norm() / there.norm();
            if !ratio.is_finite() {
                return l;
            }
            let inwards = if crossing.side.is_min() { 1.0 } else { -1.0 };
            let holds_u = crossing.side.holds_u();
            if let Some(d) = &mut derivative {
                let held = d[1 - moving];
                let behind = held.map(|x| crossing.slope * x);
                // How fast the speeds across the side change along it.
                let growth_here = here.dot(&side.inward_along(&self.jet(&l))) / here.norm_squared();
                let twist = crossing.side.inward_along(&self.jet(&crossing.to));
                let growth_there = there.dot(&twist) / there.norm_squared();
                d_delta = std::array::from_fn(|k| {
                    let d_ratio = ratio * (growth_here * held[k] - growth_there * behind[k]);
                    inwards * (rest.signum() * ratio * d_rest[k] + rest.abs() * d_ratio)
                });
                **d = if holds_u { [[0.0; 3], behind] } else { [behind, [0.0; 3]] };
            }
            delta = rest.abs() * ratio * inwards;
            along = if holds_u { ParameterDirection::U } else { ParameterDirection::V };
            l = crossing.to;
        }
        l
    }
}
