//! Scalar outputs of a set-up file: documents, and their conversion to the engine's declarations.

use moldline_deform::{ComponentPoint, OutputDeclaration};
use moldline_geometry::Component;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::SetupFileError;

/// A scalar output besides those that every set-up has (enclosed volume; wetted area and volume of each component).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum OutputDocument {
    /// `name.x`, `name.y`, `name.z` of a weighted sum of points that keep their parameters: a quarter-chord point is three
    /// quarters of a point on the leading edge and one quarter of one on the trailing edge.
    Point {
        /// Its name.
        name: String,
        /// The points.
        of: Vec<WeightedPointDocument>,
    },
    /// `name.planform_area`, `name.span`, `name.mean_aerodynamic_chord`, seen along z, chords along x.
    Planform {
        /// Its name.
        name: String,
        /// The component.
        component: String,
        /// The leading edge.
        leading_edge: LineDocument,
        /// The trailing edge, traversed in the same direction.
        trailing_edge: LineDocument,
        /// Stations, evenly spaced in the parameter; between them edges count as straight.
        #[serde(default = "stations")]
        stations: usize,
    },
}

/// A point of a component by its parameters, and its weight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WeightedPointDocument {
    /// The component.
    pub component: String,
    /// The patch; a component of one patch needs no name.
    #[serde(default)]
    pub patch: String,
    /// First parameter.
    pub u: f64,
    /// Second parameter.
    pub v: f64,
    /// Weight in the sum.
    #[serde(default = "one")]
    pub weight: f64,
}

/// A parameter line: `u` or `v` is given, the other one runs over its range.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LineDocument {
    /// The patch; a component of one patch needs no name.
    #[serde(default)]
    pub patch: String,
    /// Constant first parameter.
    #[serde(default)]
    pub u: Option<f64>,
    /// Constant second parameter.
    #[serde(default)]
    pub v: Option<f64>,
    /// Start and end of the other parameter; by default those of its range.
    #[serde(default)]
    pub range: Option<[f64; 2]>,
}

fn stations() -> usize {
    65
}

fn one() -> f64 {
    1.0
}

/// Stations of a planform at most.
const STATIONS: usize = 10_000;

/// The engine's declaration of output `index`.
pub(crate) fn output(
    index: usize,
    document: OutputDocument,
    components: &[Component],
) -> Result<OutputDeclaration, SetupFileError> {
    let field = format!("outputs[{index}]");
    match document {
        OutputDocument::Point { name, of } => {
            let point = |(k, p): (usize, WeightedPointDocument)| {
                let field = format!("{field}.of[{k}]");
                let component = component_index(&field, &p.component, components)?;
                let patch = patch_index(&field, &p.patch, &components[component])?;
                Ok((ComponentPoint { component, patch, u: p.u, v: p.v }, p.weight))
            };
            let of = of.into_iter().enumerate().map(point).collect::<Result<_, SetupFileError>>()?;
            Ok(OutputDeclaration::Point { name, of })
        }
        OutputDocument::Planform { name, component, leading_edge, trailing_edge, stations } => {
            if !(2..=STATIONS).contains(&stations) {
                return Err(SetupFileError::Value {
                    field: format!("{field}.stations"),
                    value: stations.to_string(),
                    requirement: format!("must be between 2 and {STATIONS}"),
                });
            }
            let component = component_index(&field, &component, components)?;
            let edge = |edge: &str, line: LineDocument| {
                points_of(&format!("{field}.{edge}"), &line, component, &components[component], stations)
            };
            Ok(OutputDeclaration::Planform {
                name,
                leading_edge: edge("leading_edge", leading_edge)?,
                trailing_edge: edge("trailing_edge", trailing_edge)?,
            })
        }
    }
}

fn points_of(
    field: &str,
    line: &LineDocument,
    component: usize,
    of: &Component,
    stations: usize,
) -> Result<Vec<ComponentPoint>, SetupFileError> {
    let patch = patch_index(field, &line.patch, of)?;
    let axis = match (line.u, line.v) {
        (Some(_), None) => 1,
        (None, Some(_)) => 0,
        _ => {
            return Err(SetupFileError::Value {
                field: field.into(),
                value: format!("u = {:?}, v = {:?}", line.u, line.v),
                requirement: "must hold exactly one of u and v".into(),
            });
        }
    };
    // A patch may have been split where it is only C0.
    let domains = of.patches().iter().filter(|p| p.source == patch).map(|p| p.surface.domain()[axis]);
    let whole = domains.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (a, b)| {
        (f64::min(low, a), f64::max(high, b))
    });
    let [first, last] = line.range.unwrap_or([whole.0, whole.1]);
    let at = |k: usize| {
        let t =
            if k + 1 == stations { last } else { first + (last - first) * k as f64 / (stations - 1) as f64 };
        let (u, v) = (line.u.unwrap_or(t), line.v.unwrap_or(t));
        ComponentPoint { component, patch, u, v }
    };
    Ok((0..stations).map(at).collect())
}

fn component_index(field: &str, name: &str, components: &[Component]) -> Result<usize, SetupFileError> {
    components.iter().position(|c| c.name() == name).ok_or_else(|| {
        let known: Vec<&str> = components.iter().map(Component::name).collect();
        SetupFileError::Value {
            field: format!("{field}.component"),
            value: format!("'{name}'"),
            requirement: format!("must be one of {}", known.join(", ")),
        }
    })
}

fn patch_index(field: &str, name: &str, component: &Component) -> Result<usize, SetupFileError> {
    let mut known: Vec<(&str, usize)> =
        component.patches().iter().map(|p| (p.name.as_str(), p.source)).collect();
    known.dedup();
    if let ("", [(_, only)]) = (name, &known[..]) {
        return Ok(*only);
    }
    known.iter().find(|(n, _)| *n == name).map(|(_, source)| *source).ok_or_else(|| {
        let names: Vec<&str> = known.iter().map(|(n, _)| *n).collect();
        SetupFileError::Value {
            field: format!("{field}.patch"),
            value: format!("'{name}'"),
            requirement: format!(
                "must be one of the patches of `{}`: {}",
                component.name(),
                names.join(", ")
            ),
        }
    })
}
