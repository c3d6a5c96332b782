//! The declaration of a free-form block.

use crate::axis::Axis;

/// A B-spline volume around one or more components. Its control lattice stands in sections across the span; each has
/// the local chord of the embedded geometry and turns about the local quarter chord.
#[derive(Clone, Debug, PartialEq)]
pub struct FreeFormDeclaration {
    /// Embedded components; the planform is that of all of them together.
    pub components: Vec<String>,
    /// The axis that the sections are perpendicular to. The chord runs along x (along y when the span is x), the
    /// thickness along the remaining axis.
    pub span: Axis,
    /// Whether the two sides of the plane 0 of the span axis mirror each other.
    pub symmetric: bool,
    /// Lattice points along chord, span (both sides together) and thickness.
    pub shape: [usize; 3],
    /// B-spline degrees along chord, span and thickness.
    pub degree: [usize; 3],
    /// The section-level functions; contributions of the same kind add.
    pub sections: Vec<SectionDeclaration>,
}

/// One section-level quantity as a B-spline function along the span, from root (plane of symmetry, or the lower end
/// of the span axis when not symmetric) to tip. The variable holds its coefficients.
#[derive(Clone, Debug, PartialEq)]
pub struct SectionDeclaration {
    /// The quantity.
    pub kind: SectionKind,
    /// Name of the variable, of shape `[stations]`, or `[rows, stations]` for camber and thickness.
    pub variable: String,
    /// Degree of the function along the span (0 with a single coefficient).
    pub degree: usize,
}

/// The section-level operations. Fractions of the chord are ratios (`1` or `percent`).
#[derive(Clone, Debug, PartialEq)]
pub enum SectionKind {
    /// Ratio added to 1: stretches the section along its chord about the quarter chord; across it too when
    /// `scales_thickness` (which keeps the thickness ratio).
    ChordStretch {
        /// Whether the thickness follows the chord.
        scales_thickness: bool,
    },
    /// Length, outward along the span; antisymmetric when mirrored. With mirroring its root coefficient is fixed at
    /// zero and not in the variable, so that the root stays on the plane of symmetry.
    SpanStretch,
    /// Length, along the chord axis, aft positive.
    Sweep,
    /// Length, along the thickness axis, up positive.
    Dihedral,
    /// Angle about the section's quarter chord, leading edge up (towards the thickness axis) positive.
    Twist,
    /// Ratio: layers of the lattice move together across the chord, up positive, by this fraction of the local chord.
    Camber {
        /// The chordwise lattice rows that the variable's rows move; empty: all but the first and the last, so that
        /// leading and trailing edge stay.
        rows: Vec<usize>,
    },
    /// Ratio: the uppermost layer moves up and the lowest down by this fraction of the local chord.
    Thickness {
        /// The rows that move, as for camber.
        rows: Vec<usize>,
    },
}
