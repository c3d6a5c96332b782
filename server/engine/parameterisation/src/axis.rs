//! Coordinate axes, and their roles on a lifting surface.

/// A coordinate axis: x aft, y starboard, z up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// Aft.
    X,
    /// Starboard.
    Y,
    /// Up.
    Z,
}

impl Axis {
    /// 0, 1, 2.
    pub fn index(self) -> usize {
        self as usize
    }
}

/// The axes of a lifting surface: span, chord (aft) and thickness (up), as indices of coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Axes {
    pub(crate) span: usize,
    pub(crate) chord: usize,
    pub(crate) thickness: usize,
}

impl Axes {
    /// Chord along x (y when the span is x), thickness along the remaining axis.
    pub(crate) fn of_span(span: Axis) -> Self {
        match span {
            Axis::X => Self { span: 0, chord: 1, thickness: 2 },
            Axis::Y => Self { span: 1, chord: 0, thickness: 2 },
            Axis::Z => Self { span: 2, chord: 0, thickness: 1 },
        }
    }
}
