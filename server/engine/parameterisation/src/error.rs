//! Typed errors; `field` is the path in the declaration, e.g. `operations[2].sections[0].variable`.

use moldline_foundation::Failure;
use moldline_spline::KnotError;

use crate::unit::{Dimension, Unit};

/// Why a parameterisation cannot be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ParameterisationError {
    /// The lists of a patch do not fit its basis.
    #[error("components[{component}].patches[{patch}]: {found} {what}, expected {expected}")]
    PatchSize {
        /// Index of the component.
        component: usize,
        /// Index of the patch.
        patch: usize,
        /// The list that is counted.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The length that the basis requires.
        expected: usize,
    },
    /// A control point, weight or number of the declaration is NaN or infinite.
    #[error("{field} = {value} is not finite")]
    NotFinite {
        /// Path of the number.
        field: String,
        /// The offending value.
        value: f64,
    },
    /// Two components, variables or references share a name.
    #[error("{field}: the name '{name}' is already taken; names must be unique")]
    DuplicateName {
        /// Path of the second one.
        field: String,
        /// The name.
        name: String,
    },
    /// A reference to a name that does not exist.
    #[error("{field} = '{name}' does not exist; there are: {known}")]
    UnknownName {
        /// Path of the reference.
        field: String,
        /// The name as written.
        name: String,
        /// Comma-separated list of names that exist.
        known: String,
    },
    /// A required list is empty.
    #[error("{field} is empty")]
    Empty {
        /// Path of the list.
        field: String,
    },
    /// A variable that no operation uses would be silently ignored.
    #[error("variables[{index}] '{name}' is used by no operation; use it or remove it")]
    UnusedVariable {
        /// Index in the declaration.
        index: usize,
        /// Its name.
        name: String,
    },
    /// The variable's unit is not of the dimension that the operation takes.
    #[error("{field}: variable '{variable}' is in {unit}, but this operation takes {expected}")]
    WrongUnit {
        /// Path of the reference to the variable.
        field: String,
        /// The variable.
        variable: String,
        /// Its declared unit.
        unit: Unit,
        /// The dimension required.
        expected: Dimension,
    },
    /// The variable's shape does not fit the operation.
    #[error("{field}: variable '{variable}' has shape {shape:?}, but this operation takes {expected}")]
    WrongShape {
        /// Path of the reference to the variable.
        field: String,
        /// The variable.
        variable: String,
        /// Its declared shape.
        shape: Vec<usize>,
        /// The shape required, in words.
        expected: String,
    },
    /// lower <= baseline <= upper does not hold.
    #[error("variables[{index}] '{name}': baseline {baseline} is outside its bounds {lower}..{upper} {unit}")]
    BaselineOutsideBounds {
        /// Index in the declaration.
        index: usize,
        /// Its name.
        name: String,
        /// Baseline in the declared unit.
        baseline: f64,
        /// Lower bound.
        lower: f64,
        /// Upper bound.
        upper: f64,
        /// Unit of the three.
        unit: Unit,
    },
    /// No baseline can be derived (a diameter, say), or two operations derive different ones.
    #[error("{field}: variable '{variable}' needs an explicit baseline: {reason}")]
    NeedsBaseline {
        /// Path of the reference to the variable.
        field: String,
        /// The variable.
        variable: String,
        /// Why.
        reason: &'static str,
    },
    /// A factor is taken relative to its baseline, which therefore has to be positive.
    #[error(
        "{field}: variable '{variable}' acts relative to its baseline, which is {baseline}; it must be positive"
    )]
    BaselineNotPositive {
        /// Path of the reference to the variable.
        field: String,
        /// The variable.
        variable: String,
        /// Its baseline.
        baseline: f64,
    },
    /// A count is outside the accepted range.
    #[error("{field} = {value} is outside {lowest}..={highest}")]
    OutOfRange {
        /// Path of the count.
        field: String,
        /// Its value.
        value: usize,
        /// Smallest accepted.
        lowest: usize,
        /// Largest accepted.
        highest: usize,
    },
    /// A degree and a number of coefficients that do not define a B-spline.
    #[error("{field}: {source}")]
    Knots {
        /// Path of the function or lattice direction.
        field: String,
        /// The reason.
        source: KnotError,
    },
    /// Geometry that the operation cannot work on.
    #[error("{field}: {reason}")]
    Geometry {
        /// Path of the operation.
        field: String,
        /// The problem and the remedy.
        reason: String,
    },
}

/// Why a design (or a vector of a derivative) is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DesignError {
    /// Wrong number of values.
    #[error("design has {found} values, the parameterisation has {expected} variables")]
    Length {
        /// Number of variables.
        expected: usize,
        /// Number of values given.
        found: usize,
    },
    /// NaN or infinite.
    #[error("design[{index}] ('{name}') = {value} is not finite")]
    NotFinite {
        /// Index in the design vector.
        index: usize,
        /// Name of the variable.
        name: String,
        /// The value.
        value: f64,
    },
    /// Outside the declared bounds.
    #[error("design[{index}] ('{name}') = {value} is outside its bounds {lower}..{upper} {unit}")]
    OutOfBounds {
        /// Index in the design vector.
        index: usize,
        /// Name of the variable.
        name: String,
        /// The value.
        value: f64,
        /// Lower bound.
        lower: f64,
        /// Upper bound.
        upper: f64,
        /// Unit of the three.
        unit: Unit,
    },
    /// Areas, aspect ratios, diameters and factors have to be positive whatever the bounds.
    #[error("design[{index}] ('{name}') = {value} must be positive")]
    NotPositive {
        /// Index in the design vector.
        index: usize,
        /// Name of the variable.
        name: String,
        /// The value.
        value: f64,
    },
    /// A value for a name that no variable has.
    #[error("there is no design variable '{name}'{}", suggestion(.nearest))]
    UnknownName {
        /// The name as given.
        name: String,
        /// The most similar existing name, if one is close.
        nearest: Option<String>,
    },
    /// An override names a component that does not exist, or gives it a wrong number of points.
    #[error("override of component {component}: {found} control points, expected {expected}")]
    OverrideSize {
        /// Index of the component as given.
        component: usize,
        /// Points given.
        found: usize,
        /// Points of that component; 0 if it does not exist.
        expected: usize,
    },
    /// A given control point is NaN or infinite.
    #[error("override of component {component}: control_points[{index}][{axis}] = {value} is not finite")]
    OverrideNotFinite {
        /// Index of the component.
        component: usize,
        /// Index of the control point.
        index: usize,
        /// 0, 1 or 2.
        axis: usize,
        /// The value.
        value: f64,
    },
    /// A direction or seed of a derivative has a wrong size.
    #[error("{what} has {found} values, expected {expected}")]
    VectorLength {
        /// Which vector.
        what: String,
        /// Size expected.
        expected: usize,
        /// Size given.
        found: usize,
    },
}

fn suggestion(nearest: &Option<String>) -> String {
    nearest.as_ref().map_or_else(String::new, |name| format!("; did you mean '{name}'?"))
}

/// Paths in a set-up, of which the declaration is the part `parameterisation` and the control points are in `components`.
impl Failure for ParameterisationError {
    fn field(&self) -> Option<String> {
        let field = match self {
            Self::PatchSize { component, patch, .. } => {
                return Some(format!("components[{component}].patches[{patch}]"));
            }
            Self::NotFinite { field, .. }
            | Self::DuplicateName { field, .. }
            | Self::UnknownName { field, .. }
            | Self::Empty { field }
            | Self::WrongUnit { field, .. }
            | Self::WrongShape { field, .. }
            | Self::NeedsBaseline { field, .. }
            | Self::BaselineNotPositive { field, .. }
            | Self::OutOfRange { field, .. }
            | Self::Knots { field, .. }
            | Self::Geometry { field, .. } => field.clone(),
            Self::UnusedVariable { index, .. } | Self::BaselineOutsideBounds { index, .. } => {
                format!("variables[{index}]")
            }
        };
        Some(format!("parameterisation.{field}"))
    }
}

impl Failure for DesignError {
    fn field(&self) -> Option<String> {
        Some(match self {
            Self::Length { .. } => "design".to_owned(),
            Self::NotFinite { index, .. }
            | Self::OutOfBounds { index, .. }
            | Self::NotPositive { index, .. } => {
                format!("design[{index}]")
            }
            Self::UnknownName { name, .. } => format!("design[\"{name}\"]"),
            Self::OverrideSize { component, .. } => format!("control_points[{component}]"),
            Self::OverrideNotFinite { component, index, axis, .. } => {
                format!("control_points[{component}][{index}][{axis}]")
            }
            Self::VectorLength { what, .. } => what.clone(),
        })
    }
}
