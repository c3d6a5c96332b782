//! The set-up format, version 1. Every struct refuses unknown fields.
//!
//! Axes: x aft, y starboard, z up. Lengths in `parameterisation` and `options` are metres; geometry and mesh have a
//! `unit` of their own. Design variables declare theirs.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use crate::options::{OptionsDocument, SeamDocument, SmoothingDocument};
pub use crate::outputs::{LineDocument, OutputDocument, WeightedPointDocument};

/// `setup.toml` or `setup.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Moldline set-up")]
pub struct SetupDocument {
    /// Version of this format: 1.
    pub format: u32,
    /// A title for people.
    #[serde(default)]
    pub name: String,
    /// The reference mesh.
    pub mesh: MeshDocument,
    /// The components; control points follow their order.
    pub components: Vec<ComponentDocument>,
    /// Design variables and operations; without it the control points are given directly.
    #[serde(default)]
    pub parameterisation: ParameterisationDocument,
    /// Scalar outputs besides those that every set-up has.
    #[serde(default)]
    pub outputs: Vec<OutputDocument>,
    /// Options of the engine; each has a default.
    #[serde(default)]
    pub options: OptionsDocument,
}

/// A unit of length for coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum LengthUnit {
    /// Metre.
    #[default]
    #[serde(rename = "m")]
    Metre,
    /// Centimetre.
    #[serde(rename = "cm")]
    Centimetre,
    /// Millimetre.
    #[serde(rename = "mm")]
    Millimetre,
    /// Foot, 0.3048 m.
    #[serde(rename = "ft")]
    Foot,
    /// Inch, 0.0254 m.
    #[serde(rename = "in")]
    Inch,
}

impl LengthUnit {
    /// Metres per unit.
    pub fn metres(self) -> f64 {
        match self {
            Self::Metre => 1.0,
            Self::Centimetre => 0.01,
            Self::Millimetre => 0.001,
            Self::Foot => 0.3048,
            Self::Inch => 0.0254,
        }
    }
}

/// The reference mesh: a file, or inline vertices and cells.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MeshDocument {
    /// Path in the folder, with `/`: `.msh` (Gmsh 2.2 or 4.1), `.vtu` or `.stl`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Unit of the coordinates.
    #[serde(default)]
    pub unit: LengthUnit,
    /// Nodes within this distance of an earlier one, in the unit of the mesh, become one vertex, and cells that collapse are left out:
    /// at most 0.1 % of the area. 0, the default, merges only what a format cannot share: equal corners of STL, equal points of
    /// several pieces of VTU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub merge_tolerance: Option<f64>,
    /// Inline vertices, instead of a file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vertices: Option<Vec<[f64; 3]>>,
    /// Inline cells, instead of a file: three or four vertex indices each, from 0, counter-clockwise seen from outside.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cells: Option<Vec<Vec<u32>>>,
    /// Named vertex groups of an inline mesh, for constraints.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vertex_groups: Option<Vec<GroupDocument>>,
}

/// A named set of vertices.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GroupDocument {
    /// Its name.
    pub name: String,
    /// Indices from 0.
    pub indices: Vec<u32>,
}

/// A component: exactly one of `file`, `patches` and `primitive`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ComponentDocument {
    /// Unique name.
    pub name: String,
    /// Path of a geometry file in the folder (JSON, see `geometry.schema.json`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Inline patches, instead of a file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub patches: Option<Vec<PatchDocument>>,
    /// An analytic shape, made of exact rational patches.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub primitive: Option<PrimitiveDocument>,
    /// Unit of the coordinates.
    #[serde(default)]
    pub unit: LengthUnit,
    /// Edges between patches are sharp where their normals differ by more than this, degrees. Default: 20.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sharp_angle: Option<f64>,
    /// Patch edges within this distance of each other, relative to the component's size, are one. Default: 1e-7.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub edge_tolerance: Option<f64>,
    /// Whether the shell may be open (half model, cut at the plane of symmetry).
    #[serde(default)]
    pub open: bool,
}

/// A geometry file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(title = "Moldline geometry")]
pub struct GeometryDocument {
    /// For people; the component is called by its name in the set-up.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// The patches.
    pub patches: Vec<PatchDocument>,
}

/// An untrimmed tensor-product B-spline patch, S(u, v) = sum_ij N_i(u) N_j(v) P_ij. The outward side is found, not
/// prescribed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PatchDocument {
    /// For messages.
    #[serde(default)]
    pub name: String,
    /// Degree along u, 1 to 9.
    pub degree_u: usize,
    /// Degree along v, 1 to 9.
    pub degree_v: usize,
    /// n_u + degree_u + 1 non-decreasing numbers, clamped or not.
    pub knots_u: Vec<f64>,
    /// n_v + degree_v + 1 non-decreasing numbers, clamped or not.
    pub knots_v: Vec<f64>,
    /// Cartesian control points, `[i][j]`: n_u rows of n_v points.
    pub control_points: Vec<Vec<[f64; 3]>>,
    /// Positive weights `[i][j]`; all 1 if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weights: Option<Vec<Vec<f64>>>,
}

/// An analytic shape.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum PrimitiveDocument {
    /// A ball.
    Sphere {
        /// Its centre.
        center: [f64; 3],
        /// Its radius.
        radius: f64,
    },
    /// A box with sides along the axes.
    Box {
        /// Smallest coordinates.
        low: [f64; 3],
        /// Largest coordinates.
        high: [f64; 3],
    },
    /// A cylinder with flat ends.
    Cylinder {
        /// Centre of one end.
        start: [f64; 3],
        /// Centre of the other end.
        end: [f64; 3],
        /// Its radius.
        radius: f64,
    },
    /// A cylinder with half balls at its ends.
    Capsule {
        /// Centre of one half ball.
        start: [f64; 3],
        /// Centre of the other half ball.
        end: [f64; 3],
        /// Its radius.
        radius: f64,
    },
}

/// Design variables, and the operations that they drive, in order.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ParameterisationDocument {
    /// The design vector: these variables one after the other.
    #[serde(default)]
    pub variables: Vec<VariableDocument>,
    /// Each acts on the result of those before it.
    #[serde(default)]
    pub operations: Vec<OperationDocument>,
}

/// A design variable: a scalar, or several under one name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct VariableDocument {
    /// Unique name; scalars are called `name`, `name[i]` or `name[i][j]`.
    pub name: String,
    /// Unit of baseline, bounds and values.
    pub unit: UnitDocument,
    /// Empty for a scalar, `[n]`, or `[rows, stations]`.
    #[serde(default)]
    pub shape: Vec<usize>,
    /// The value that leaves the geometry as it is. Default: 0 for angles, lengths and fractions of chord; 1 for
    /// factors; the geometry's own value for planform area and aspect ratio. Required for a diameter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub baseline: Option<f64>,
    /// Lower bound; none if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lower: Option<f64>,
    /// Upper bound; none if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub upper: Option<f64>,
}

/// Unit of a design variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum UnitDocument {
    /// Dimensionless.
    #[serde(rename = "1")]
    One,
    /// 0.01.
    #[serde(rename = "percent")]
    Percent,
    /// Metre.
    #[serde(rename = "m")]
    Metre,
    /// Foot, 0.3048 m.
    #[serde(rename = "ft")]
    Foot,
    /// Square metre.
    #[serde(rename = "m^2")]
    SquareMetre,
    /// Square foot.
    #[serde(rename = "ft^2")]
    SquareFoot,
    /// Degree.
    #[serde(rename = "deg")]
    Degree,
    /// Radian.
    #[serde(rename = "rad")]
    Radian,
}

/// A coordinate axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum AxisDocument {
    /// Aft.
    X,
    /// Starboard.
    Y,
    /// Up.
    Z,
}

/// An operation: the effect of design variables on components.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum OperationDocument {
    /// Free-form deformation: a B-spline volume whose lattice stands in sections across the span, each with the local
    /// chord and the local quarter chord of the components.
    FreeForm {
        /// Components embedded.
        components: Vec<String>,
        /// Axis that the sections are perpendicular to.
        #[serde(default = "axis_y")]
        span: AxisDocument,
        /// Whether both sides of the plane 0 of the span axis mirror each other.
        #[serde(default = "yes")]
        symmetric: bool,
        /// Lattice points along chord, span (both sides together) and thickness.
        shape: [usize; 3],
        /// Degrees along chord, span and thickness.
        degree: [usize; 3],
        /// Section-level functions.
        sections: Vec<SectionDocument>,
    },
    /// Planform area and aspect ratio (span^2/area): span times sqrt(S A/(S0 A0)), chord and thickness times
    /// sqrt(S A0/(S0 A)), about a point of the root.
    Planform {
        /// Components scaled; the planform is the first one's.
        components: Vec<String>,
        /// The span axis.
        #[serde(default = "axis_y")]
        span: AxisDocument,
        /// Whether the root is the plane 0 of the span axis, or the lower end of the span.
        #[serde(default = "yes")]
        symmetric: bool,
        /// The fixed point, in reference coordinates, m (its coordinate along the span is that of the root); earlier
        /// operations carry it along. Default: the first component's root quarter chord.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pivot: Option<[f64; 3]>,
        /// Scalar variable, an area.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        area: Option<String>,
        /// Scalar variable, a ratio.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        aspect_ratio: Option<String>,
        /// How sweep and dihedral change.
        #[serde(default)]
        sweep: SweepDocument,
    },
    /// Rotation, right-handed about the axis: about +y positive is nose up.
    Rotation {
        /// Components that turn.
        components: Vec<String>,
        /// Direction of the axis.
        #[serde(default = "direction_y")]
        axis: [f64; 3],
        /// A point on the axis in reference coordinates, m; earlier operations carry it along. Default: the root quarter
        /// chord of the first component.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pivot: Option<[f64; 3]>,
        /// Scalar variable, an angle.
        variable: String,
    },
    /// Translation.
    Translation {
        /// Components that move.
        components: Vec<String>,
        /// Its direction.
        #[serde(default = "direction_x")]
        direction: [f64; 3],
        /// Scalar variable, a length.
        variable: String,
    },
    /// Radial scale of a body about its centre line, fading out at nose and tail.
    RadialScale {
        /// Components scaled.
        components: Vec<String>,
        /// The body's axis.
        #[serde(default = "axis_x")]
        axis: AxisDocument,
        /// A point on a straight centre line, m. Default: the middle of each cross-section of the first component.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        centre: Option<[f64; 3]>,
        /// Stations along the axis, m: no scaling before the first, full between second and third, none after the fourth.
        stations: [f64; 4],
        /// Scalar variable: a ratio, or a diameter with its baseline.
        variable: String,
    },
}

/// A function along the span, from root to tip: clamped uniform B-spline coefficients.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum SectionDocument {
    /// Ratio added to 1: chord, about the quarter chord.
    ChordStretch {
        /// Variable of shape `[stations]`.
        variable: String,
        /// Degree along the span; 0 with a single coefficient.
        degree: usize,
        /// Whether the thickness follows the chord.
        #[serde(default)]
        scales_thickness: bool,
    },
    /// Length outward; antisymmetric, zero at the root of a mirrored block.
    SpanStretch {
        /// Variable of shape `[stations]`, without the root's coefficient.
        variable: String,
        /// Degree along the span.
        degree: usize,
    },
    /// Length aft.
    Sweep {
        /// Variable of shape `[stations]`.
        variable: String,
        /// Degree along the span.
        degree: usize,
    },
    /// Length up.
    Dihedral {
        /// Variable of shape `[stations]`.
        variable: String,
        /// Degree along the span.
        degree: usize,
    },
    /// Angle about the quarter chord, leading edge up.
    Twist {
        /// Variable of shape `[stations]`.
        variable: String,
        /// Degree along the span.
        degree: usize,
    },
    /// Fraction of the local chord by which lattice rows move up.
    Camber {
        /// Variable of shape `[rows, stations]`.
        variable: String,
        /// Degree along the span.
        degree: usize,
        /// Chordwise lattice rows moved, from 0 at the leading edge. Default: all but the first and the last.
        #[serde(default)]
        rows: Vec<usize>,
    },
    /// Fraction of the local chord by which the upper layer moves up and the lower down.
    Thickness {
        /// Variable of shape `[rows, stations]`.
        variable: String,
        /// Degree along the span.
        degree: usize,
        /// The rows moved, as for camber.
        #[serde(default)]
        rows: Vec<usize>,
    },
}

/// How sweep and dihedral change with the planform.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SweepDocument {
    /// The component is scaled affinely: the tangents of sweep and dihedral go with chord over span.
    #[default]
    Scaled,
    /// The angles stay: each section is scaled about its own quarter chord.
    Kept,
}

fn yes() -> bool {
    true
}

fn axis_x() -> AxisDocument {
    AxisDocument::X
}

fn axis_y() -> AxisDocument {
    AxisDocument::Y
}

fn direction_x() -> [f64; 3] {
    [1.0, 0.0, 0.0]
}

fn direction_y() -> [f64; 3] {
    [0.0, 1.0, 0.0]
}
