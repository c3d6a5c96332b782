//! Places on a component: a patch and its parameters, and the sides of a patch.

use moldline_foundation::Vector3;
use moldline_spline::{SurfaceJet, SurfacePoint};

/// An interval of each parameter.
pub(crate) type Rectangle = [(f64, f64); 2];

/// A point of a component: `mu = (i, u, v)` with the parameters in the patch's own domain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Location {
    /// Index of the internal patch.
    pub patch: u32,
    /// First parameter.
    pub u: f64,
    /// Second parameter.
    pub v: f64,
}

/// A side of a patch's parameter rectangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Side {
    /// `u` at its first value.
    UMin,
    /// `u` at its last value.
    UMax,
    /// `v` at its first value.
    VMin,
    /// `v` at its last value.
    VMax,
}

impl Side {
    /// All four sides.
    pub const ALL: [Side; 4] = [Side::UMin, Side::UMax, Side::VMin, Side::VMax];

    /// Whether `u` is constant along the side.
    #[inline]
    pub fn holds_u(self) -> bool {
        matches!(self, Side::UMin | Side::UMax)
    }

    /// Whether the held parameter is at its first value, so that the patch lies in the increasing direction.
    #[inline]
    pub fn is_min(self) -> bool {
        matches!(self, Side::UMin | Side::VMin)
    }

    /// Whether the side's increasing parameter runs counter-clockwise around the rectangle.
    pub(crate) fn counter_clockwise(self) -> bool {
        matches!(self, Side::VMin | Side::UMax)
    }

    /// The derivative along the side and the one across it, pointing into the patch.
    #[inline]
    pub(crate) fn along_and_inward(self, point: &SurfacePoint) -> (Vector3, Vector3) {
        let (along, across) = if self.holds_u() { (point.d_v, point.d_u) } else { (point.d_u, point.d_v) };
        (along, if self.is_min() { across } else { -across })
    }

    /// The derivative along the side of the derivative across it that points into the patch.
    pub(crate) fn inward_along(self, jet: &SurfaceJet) -> Vector3 {
        if self.is_min() { jet.d_uv } else { -jet.d_uv }
    }
}
