//! The JSON of messages in requests, for those messages that answers describe otherwise (a field of an answer may be null, and
//! its lists have any depth), or whose JSON is not that of their fields.

use serde::Deserialize;
use utoipa::ToSchema;

use super::read::{Design, indices};
use crate::v1::{self, Array, trailing_edges::Rule};

/// A design: values of the variables, and given control points.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = RequestDesignPoint)]
pub struct DesignPoint {
    /// Every variable in order, or some by name; the others, or all, stay at their baseline.
    #[schema(nullable = false)]
    #[serde(default)]
    design: Option<Design>,
    /// Components whose control points are given, and not made from the design.
    #[serde(default)]
    control_points: Vec<ControlPoints>,
}

impl From<DesignPoint> for v1::DesignPoint {
    fn from(DesignPoint { design, control_points }: DesignPoint) -> Self {
        let control_points = control_points.into_iter().map(Into::into).collect();
        Self { input: design.map(Into::into), control_points }
    }
}

/// Control points of a component, metres: patch after patch, v fastest.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = RequestControlPoints)]
pub struct ControlPoints {
    /// Name of the component.
    component: String,
    /// A list of `[x, y, z]`.
    #[schema(value_type = Vec<Vec<f64>>)]
    points: Array,
}

impl From<ControlPoints> for v1::ControlPoints {
    fn from(ControlPoints { component, points }: ControlPoints) -> Self {
        Self { component, points: Some(points) }
    }
}

/// Vectors with an entry for every coordinate of a component's control points.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = RequestControlPointVectors)]
pub struct ControlPointVectors {
    /// Name of the component.
    component: String,
    /// One list of `[x, y, z]` for each vector.
    #[schema(value_type = Vec<Vec<Vec<f64>>>)]
    vectors: Array,
}

impl From<ControlPointVectors> for v1::ControlPointVectors {
    fn from(ControlPointVectors { component, vectors }: ControlPointVectors) -> Self {
        Self { component, vectors: Some(vectors) }
    }
}

/// Where wakes leave the surface.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = RequestTrailingEdges)]
pub enum TrailingEdges {
    /// Nowhere.
    None {},
    /// At these pairs of vertices.
    Edges(Vec<[u32; 2]>),
    /// At edges between vertices of these groups.
    Groups(Vec<String>),
    /// At edges across which the normal turns by at least so many degrees.
    Angle(f64),
}

impl From<TrailingEdges> for v1::TrailingEdges {
    fn from(edges: TrailingEdges) -> Self {
        let rule = match edges {
            TrailingEdges::None {} => Rule::None(v1::NoTrailingEdges {}),
            TrailingEdges::Edges(edges) => Rule::Edges(indices(&[edges.len(), 2], edges.as_flattened())),
            TrailingEdges::Groups(names) => Rule::Groups(v1::NameList { names }),
            TrailingEdges::Angle(degrees) => Rule::Angle(degrees),
        };
        Self { rule: Some(rule) }
    }
}

/// Directions of the inputs, in rows. Absent blocks are zero.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = RequestFlowInputs)]
pub struct FlowInputs {
    /// One list of `[x, y, z]` for each row, m.
    #[schema(value_type = Option<Vec<Vec<Vec<f64>>>>, nullable = false)]
    #[serde(default)]
    vertices: Option<Array>,
    /// rad.
    #[schema(value_type = Option<Vec<f64>>, nullable = false)]
    #[serde(default)]
    alpha: Option<Array>,
    /// rad.
    #[schema(value_type = Option<Vec<f64>>, nullable = false)]
    #[serde(default)]
    sideslip: Option<Array>,
    /// Mach number.
    #[schema(value_type = Option<Vec<f64>>, nullable = false)]
    #[serde(default)]
    mach: Option<Array>,
    /// m^2.
    #[schema(value_type = Option<Vec<f64>>, nullable = false)]
    #[serde(default)]
    area: Option<Array>,
    /// m.
    #[schema(value_type = Option<Vec<f64>>, nullable = false)]
    #[serde(default)]
    chord: Option<Array>,
    /// `[x, y, z]` for each row, m.
    #[schema(value_type = Option<Vec<Vec<f64>>>, nullable = false)]
    #[serde(default)]
    point: Option<Array>,
}

impl From<FlowInputs> for v1::FlowInputs {
    fn from(FlowInputs { vertices, alpha, sideslip, mach, area, chord, point }: FlowInputs) -> Self {
        Self { vertices, alpha, sideslip, mach, area, chord, point }
    }
}

/// Weights of the outputs, in rows. Absent blocks are zero.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = RequestFlowOutputs)]
pub struct FlowOutputs {
    /// One list for each row: lift, induced_drag, pressure_lift, pressure_drag, moment, lift_slope, moment_slope,
    /// pressure_lift_slope, neutral_point.
    #[schema(value_type = Option<Vec<Vec<f64>>>, nullable = false)]
    #[serde(default)]
    coefficients: Option<Array>,
    /// One list of all sections for each row, m.
    #[schema(value_type = Option<Vec<Vec<f64>>>, nullable = false)]
    #[serde(default)]
    section_loads: Option<Array>,
    /// One list of all cells for each row.
    #[schema(value_type = Option<Vec<Vec<f64>>>, nullable = false)]
    #[serde(default)]
    cp: Option<Array>,
}

impl From<FlowOutputs> for v1::FlowOutputs {
    fn from(FlowOutputs { coefficients, section_loads, cp }: FlowOutputs) -> Self {
        Self { coefficients, section_loads, cp }
    }
}
