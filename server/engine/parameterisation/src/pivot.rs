//! Points to turn or scale about.

use moldline_foundation::Vector3;

use crate::axis::Axis;
use crate::compile::{Compiler, Site};
use crate::error::ParameterisationError;

/// A point to turn or scale about. It belongs to the operation's first component; earlier operations move it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pivot {
    /// Given in reference coordinates, m.
    Point([f64; 3]),
    /// A quarter of the root chord aft of the leading edge, in the plane 0 of the given span axis (or at the place of
    /// the component nearest to it).
    RootQuarterChord(Axis),
}

impl Pivot {
    /// The point in reference coordinates, m. If `symmetric`, the root is the plane 0 of the span axis, otherwise the
    /// lower end of the span.
    pub(crate) fn place(
        self,
        site: &Site,
        compiler: &Compiler<'_>,
        symmetric: bool,
    ) -> Result<Vector3, ParameterisationError> {
        match self {
            Self::Point(point) => site.point("pivot", point),
            Self::RootQuarterChord(span) => compiler.root_quarter_chord(site, span, symmetric),
        }
    }
}
