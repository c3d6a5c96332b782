//! What requests say in JSON, as messages of the protocol. Answers are the messages themselves.

use std::{collections::BTreeMap, fmt};

use moldline_proto::v1::{self, deform_request, design_point};
use moldline_transport::media::Numbers;
use serde::{Deserialize, de};
use utoipa::ToSchema;

/// A design: values of the variables, and control points from outside.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = RequestDesignPoint)]
pub struct DesignPoint {
    /// Every variable in order, or some by name; those not named, or all, stay at their baseline.
    #[schema(value_type = Option<DesignValues>, nullable = false)]
    #[serde(default)]
    design: Option<Values>,
    /// Components whose control points come from elsewhere, in place of what the design makes of them.
    #[serde(default)]
    control_points: Vec<ControlPoints>,
}

/// How values of the variables are described.
#[derive(ToSchema)]
#[schema(as = DesignValues)]
#[allow(dead_code, reason = "describes `Values`, whose reader names the path of a fault")]
pub enum DesignValues {
    /// Every variable in order, each in its unit.
    #[schema(title = "vector")]
    Vector(Vec<f64>),
    /// Some by name.
    #[schema(title = "by name")]
    Named(BTreeMap<String, f64>),
}

/// Values of the variables.
#[derive(Debug)]
enum Values {
    Vector(Numbers),
    Named(BTreeMap<String, f64>),
}

impl<'de> Deserialize<'de> for Values {
    fn deserialize<D: de::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Either;
        impl<'de> de::Visitor<'de> for Either {
            type Value = Values;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of numbers, or an object of names and numbers")
            }

            fn visit_seq<A: de::SeqAccess<'de>>(self, list: A) -> Result<Values, A::Error> {
                Deserialize::deserialize(de::value::SeqAccessDeserializer::new(list)).map(Values::Vector)
            }

            fn visit_map<A: de::MapAccess<'de>>(self, map: A) -> Result<Values, A::Error> {
                Deserialize::deserialize(de::value::MapAccessDeserializer::new(map)).map(Values::Named)
            }
        }
        deserializer.deserialize_any(Either)
    }
}

/// Control points of a component, metres: patch after patch, v fastest.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = RequestControlPoints)]
pub struct ControlPoints {
    /// Its name.
    component: String,
    /// A list of `[x, y, z]`.
    #[schema(value_type = Vec<Vec<f64>>)]
    points: Numbers,
}

/// Vectors with an entry for every coordinate of a component's control points.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = RequestControlPointVectors)]
pub struct ControlPointVectors {
    /// Its name.
    component: String,
    /// One list of `[x, y, z]` for each vector.
    #[schema(value_type = Vec<Vec<Vec<f64>>>)]
    vectors: Numbers,
}

/// Where a derivative is taken: by id, by design, or best by both.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = RequestLinearisationPoint)]
pub struct At {
    /// As Deform returned it.
    #[serde(default)]
    linearisation_id: String,
    /// Linearised again if the server does not hold it any more.
    #[schema(nullable = false)]
    #[serde(default)]
    design_point: Option<DesignPoint>,
}

/// What to deform to.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({ "design": { "wing.translation": 0.5 } }))]
#[schema(as = DeformRequest)]
pub struct Deform {
    /// Every variable in order, or some by name; those not named, or all, stay at their baseline.
    #[schema(value_type = Option<DesignValues>, nullable = false)]
    #[serde(default)]
    design: Option<Values>,
    /// Components whose control points come from elsewhere, in place of what the design makes of them.
    #[serde(default)]
    control_points: Vec<ControlPoints>,
    /// Whether the measures of every cell are wanted too.
    #[serde(default)]
    include_cell_quality: bool,
}

/// Directions of the inputs; what is absent is zero. Parts that are given have as many.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = ApplyJacobianVectorRequest)]
pub struct Jvp {
    /// Where the derivative is taken.
    #[serde(default)]
    at: At,
    /// One list of all variables for each direction.
    #[schema(value_type = Option<Vec<Vec<f64>>>, nullable = false)]
    #[serde(default)]
    design: Option<Numbers>,
    /// Of the control points of some components.
    #[serde(default)]
    control_points: Vec<ControlPointVectors>,
}

/// Weights of the outputs; what is absent is zero. Parts that are given have as many.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = ApplyAdjointRequest)]
pub struct Vjp {
    /// Where the derivative is taken.
    #[serde(default)]
    at: At,
    /// One list of `[x, y, z]` for each vector of weights, per metre.
    #[schema(value_type = Option<Vec<Vec<Vec<f64>>>>, nullable = false)]
    #[serde(default)]
    vertices: Option<Numbers>,
    /// One list of all functions for each vector of weights.
    #[schema(value_type = Option<Vec<Vec<f64>>>, nullable = false)]
    #[serde(default)]
    functions: Option<Numbers>,
    /// Whether gradients by the design variables are wanted; they are if no others are.
    #[serde(default)]
    include_design: bool,
    /// Components by whose control points gradients are wanted.
    #[serde(default)]
    control_points_of: Vec<String>,
}

/// Which Jacobian.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = JacobianRequest)]
pub struct Jacobian {
    /// Where the derivative is taken.
    #[serde(default)]
    at: At,
}

/// A session to open.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = OpenSessionRequest)]
pub struct OpenSession {
    /// For people; may be empty.
    #[serde(default)]
    pub label: String,
}

/// What to change of a session.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = UpdateSessionRequest)]
pub struct UpdateSession {
    /// The generation that the update is based on. Any other than the current one is refused (ABORTED).
    pub expected_generation: u64,
    /// The design; as it was if absent.
    #[schema(nullable = false)]
    pub design: Option<DesignPoint>,
    /// For people; as it was if absent.
    #[schema(nullable = false)]
    pub label: Option<String>,
}

/// Who else may use a set-up.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = ShareSetupRequest)]
pub struct ShareSetup {
    /// Nobody, tenants that are named, or every tenant of the server.
    #[schema(inline)]
    pub visibility: Visibility,
    /// Tenants, with `tenants`.
    #[serde(default)]
    pub shared_with: Vec<String>,
}

/// Who may use a set-up besides its owner.
#[derive(Clone, Copy, Debug, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = RequestVisibility)]
pub enum Visibility {
    /// Nobody.
    Private,
    /// Tenants that are named.
    Tenants,
    /// Every tenant of the server.
    Public,
}

impl From<Visibility> for v1::Visibility {
    fn from(visibility: Visibility) -> Self {
        match visibility {
            Visibility::Private => Self::Private,
            Visibility::Tenants => Self::Tenants,
            Visibility::Public => Self::Public,
        }
    }
}

fn control_points(given: Vec<ControlPoints>) -> Vec<v1::ControlPoints> {
    let message =
        |ControlPoints { component, points }| v1::ControlPoints { component, points: Some(points.0) };
    given.into_iter().map(message).collect()
}

fn vectors(given: Vec<ControlPointVectors>) -> Vec<v1::ControlPointVectors> {
    let message = |ControlPointVectors { component, vectors }: ControlPointVectors| v1::ControlPointVectors {
        component,
        vectors: Some(vectors.0),
    };
    given.into_iter().map(message).collect()
}

impl From<DesignPoint> for v1::DesignPoint {
    fn from(DesignPoint { design, control_points }: DesignPoint) -> Self {
        let input = design.map(|values| match values {
            Values::Vector(vector) => design_point::Input::Design(vector.0),
            Values::Named(values) => {
                design_point::Input::Named(v1::NamedDesign { values: values.into_iter().collect() })
            }
        });
        Self { input, control_points: self::control_points(control_points) }
    }
}

impl From<At> for v1::LinearisationPoint {
    fn from(At { linearisation_id, design_point }: At) -> Self {
        Self { linearisation_id, design_point: design_point.map(Into::into) }
    }
}

impl Deform {
    pub fn message(self, session_id: String) -> v1::DeformRequest {
        let input = self.design.map(|values| match values {
            Values::Vector(vector) => deform_request::Input::Design(vector.0),
            Values::Named(values) => {
                deform_request::Input::Named(v1::NamedDesign { values: values.into_iter().collect() })
            }
        });
        v1::DeformRequest {
            session_id,
            input,
            control_points: control_points(self.control_points),
            include_cell_quality: self.include_cell_quality,
        }
    }
}

impl Jvp {
    pub fn message(self, session_id: String) -> v1::ApplyJacobianVectorRequest {
        v1::ApplyJacobianVectorRequest {
            session_id,
            at: Some(self.at.into()),
            design: self.design.map(|numbers| numbers.0),
            control_points: vectors(self.control_points),
        }
    }
}

impl Vjp {
    pub fn message(self, session_id: String) -> v1::ApplyAdjointRequest {
        v1::ApplyAdjointRequest {
            session_id,
            at: Some(self.at.into()),
            vertices: self.vertices.map(|numbers| numbers.0),
            functions: self.functions.map(|numbers| numbers.0),
            include_design: self.include_design || self.control_points_of.is_empty(),
            control_points_of: self.control_points_of,
        }
    }
}

impl Jacobian {
    pub fn message(self, session_id: String) -> v1::JacobianRequest {
        v1::JacobianRequest { session_id, at: Some(self.at.into()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_design_is_a_list_or_an_object() {
        let read = |text| serde_json::from_str::<Deform>(text).unwrap().message("s".to_owned()).input;
        let Some(deform_request::Input::Design(vector)) = read("{\"design\": [1, 2]}") else {
            panic!("a vector")
        };
        assert_eq!(vector.shape, [2]);
        let Some(deform_request::Input::Named(named)) = read("{\"design\": {\"x\": 1}}") else {
            panic!("names")
        };
        assert_eq!(named.values["x"], 1.0);
        assert!(read("{}").is_none());
        assert!(serde_json::from_str::<Deform>("{\"design\": 1}").is_err());
    }
}
