//! What a user declares: variables and, in order, the operations that they drive.
//!
//! Plain data without behaviour; [`Parameterisation::new`](crate::Parameterisation::new) checks and compiles it.

use moldline_spline::Surface;

use crate::Unit;

/// One patch in its reference state, as the user gave it.
#[derive(Clone, Debug)]
pub struct PatchReference {
    /// The tensor-product basis; its shape is `(n_u, n_v)`.
    pub surface: Surface,
    /// Cartesian control points, `n_u * n_v` of them, index `i * n_v + j`.
    pub control_points: Vec<[f64; 3]>,
    /// Weights in the same order; empty for a non-rational patch.
    pub weights: Vec<f64>,
}

/// One component in its reference state. Its control points are those of its patches, one patch after the other.
#[derive(Clone, Debug)]
pub struct ComponentReference {
    /// The name that operations refer to.
    pub name: String,
    /// Its patches.
    pub patches: Vec<PatchReference>,
}

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

/// A named design variable: a scalar, a vector or a table of them, in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub struct VariableDeclaration {
    /// Unique name; the scalars are called `name`, `name[i]` or `name[i][j]`.
    pub name: String,
    /// Empty for a scalar, `[n]`, or `[rows, stations]`.
    pub shape: Vec<usize>,
    /// Unit of baseline, bounds and values.
    pub unit: Unit,
    /// The value at which the reference geometry is left as it is. Default: 0 for what is added, 1 for factors, the
    /// reference geometry's own value for planform area and aspect ratio.
    pub baseline: Option<f64>,
    /// Lower bound of each scalar; may be `-INFINITY`.
    pub lower: f64,
    /// Upper bound of each scalar; may be `INFINITY`.
    pub upper: f64,
}

/// An operation on the control points of some components. Operations act in the declared order, each on what the ones
/// before it made; the points that they turn or scale about are carried along by the earlier ones.
#[derive(Clone, Debug, PartialEq)]
pub enum OperationDeclaration {
    /// Free-form deformation by a B-spline volume organised by sections.
    FreeForm(FreeFormDeclaration),
    /// Planform area and aspect ratio.
    Planform(PlanformDeclaration),
    /// Rigid rotation.
    Rotation(RotationDeclaration),
    /// Rigid translation.
    Translation(TranslationDeclaration),
    /// Scaling of a body about its centre line.
    RadialScale(RadialScaleDeclaration),
}

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
    /// What is done to the sections; contributions of the same kind add.
    pub sections: Vec<SectionDeclaration>,
}

/// One section-level quantity as a B-spline function along the span, from root (plane of symmetry, or the lower end
/// of the span axis when not symmetric) to tip. The variable holds its coefficients.
#[derive(Clone, Debug, PartialEq)]
pub struct SectionDeclaration {
    /// What the quantity does.
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
        /// As for camber.
        rows: Vec<usize>,
    },
}

/// Area S and aspect ratio A = b^2/S of the planform: scales the span by sqrt(S A/(S0 A0)), chord and thickness by
/// sqrt(S A0/(S0 A)), about a point of the root.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanformDeclaration {
    /// Components that are scaled; the planform is that of the first.
    pub components: Vec<String>,
    /// The span axis.
    pub span: Axis,
    /// Whether the root is the plane 0 of the span axis (mirrored or half model) or the lower end of the span.
    pub symmetric: bool,
    /// The point that the scaling leaves where it is, its coordinate along the span apart: that of the root.
    pub pivot: Pivot,
    /// Variable of the area, if it varies.
    pub area: Option<String>,
    /// Variable of the aspect ratio, if it varies.
    pub aspect_ratio: Option<String>,
    /// What happens to sweep and dihedral.
    pub sweep: SweepRule,
}

/// How the sections of a scaled planform move along chord and thickness axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SweepRule {
    /// The whole component is scaled affinely: the tangents of sweep and dihedral go with chord over span.
    Scaled,
    /// Each section is scaled about its own quarter chord, and the quarter-chord line with the span: sweep and
    /// dihedral angles stay.
    Kept,
}

/// A point to turn or scale about. It belongs to the first component named and is moved by the operations declared before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pivot {
    /// Given in reference coordinates, m.
    Point([f64; 3]),
    /// A quarter of the root chord aft of the leading edge, in the plane 0 of the given span axis (or at the nearest
    /// place of the component to it).
    RootQuarterChord(Axis),
}

/// Rotation about an axis through a point, right-handed: about +y positive is nose up.
#[derive(Clone, Debug, PartialEq)]
pub struct RotationDeclaration {
    /// Components that turn together.
    pub components: Vec<String>,
    /// Direction of the axis; need not be of unit length.
    pub axis: [f64; 3],
    /// A point on the axis.
    pub pivot: Pivot,
    /// Scalar variable, an angle.
    pub variable: String,
}

/// Translation along a direction.
#[derive(Clone, Debug, PartialEq)]
pub struct TranslationDeclaration {
    /// Components that move together.
    pub components: Vec<String>,
    /// The direction; need not be of unit length.
    pub direction: [f64; 3],
    /// Scalar variable, a length.
    pub variable: String,
}

/// The line about which a body is scaled.
#[derive(Clone, Debug, PartialEq)]
pub enum CentreLine {
    /// Parallel to the body's axis through this point (the coordinate along the axis does not matter).
    Point([f64; 3]),
    /// The middle of the extent of each cross-section of the reference geometry.
    Sections,
}

/// Scales a body perpendicular to its axis. The factor is value / baseline (of a ratio or of a diameter) between the
/// two inner stations and fades to 1 at the outer ones, twice continuously differentiable.
#[derive(Clone, Debug, PartialEq)]
pub struct RadialScaleDeclaration {
    /// Components scaled; the centre line is that of the first.
    pub components: Vec<String>,
    /// The body's axis.
    pub axis: Axis,
    /// The centre line.
    pub centre: CentreLine,
    /// Non-decreasing coordinates along the axis, m: no scaling before the first, full between second and third,
    /// none after the fourth.
    pub stations: [f64; 4],
    /// Scalar variable: a ratio (baseline 1 unless given) or a diameter (baseline required).
    pub variable: String,
}
