//! Reading of fields whose JSON is not that of their type in Rust.

use std::{collections::BTreeMap, fmt};

use serde::{
    Deserialize, Deserializer,
    de::{self, Error},
};
use utoipa::{
    PartialSchema, ToSchema,
    openapi::{
        RefOr,
        schema::{OneOfBuilder, Schema},
    },
};

use crate::v1::{Array, DataType, IndexGroup, NameList, NamedDesign, deform_request, design_point};

/// Deepest nesting of lists.
const DEPTH: usize = 8;

/// An array of float64, as nested lists of numbers.
impl<'de> Deserialize<'de> for Array {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (mut data, mut shape) = (Vec::new(), Vec::new());
        de::DeserializeSeed::deserialize(
            Level { depth: 0, data: &mut data, shape: &mut shape },
            deserializer,
        )?;
        Ok(Self { dtype: DataType::Float64.into(), shape, data: data.into() })
    }
}

/// A number or a list at one depth. The first list at a depth sets its extent.
struct Level<'a> {
    depth: usize,
    data: &'a mut Vec<u8>,
    shape: &'a mut Vec<u64>,
}

impl Level<'_> {
    fn number<E: Error>(self, value: f64) -> Result<(), E> {
        if self.depth == 0 {
            return Err(E::custom("a number, expected a list of numbers"));
        }
        if self.depth == self.shape.len() {
            self.data.extend_from_slice(&value.to_le_bytes());
            return Ok(());
        }
        Err(E::custom("a number, expected a list as before it"))
    }
}

impl<'de> de::DeserializeSeed<'de> for Level<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> de::Visitor<'de> for Level<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("nested lists of numbers")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<(), E> {
        self.number(value)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<(), E> {
        self.number(value as f64)
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<(), E> {
        self.number(value as f64)
    }

    fn visit_seq<A: de::SeqAccess<'de>>(self, mut list: A) -> Result<(), A::Error> {
        let Self { depth, data, shape } = self;
        if depth >= DEPTH {
            return Err(Error::custom("lists are nested too deeply"));
        }
        let first = shape.len() == depth;
        if first {
            if !data.is_empty() {
                return Err(Error::custom("a list, expected a number as before it"));
            }
            shape.push(0);
        }
        let mut extent = 0;
        while list.next_element_seed(Level { depth: depth + 1, data, shape })?.is_some() {
            extent += 1;
        }
        if first {
            shape[depth] = extent;
        } else if shape[depth] != extent {
            let expected = shape[depth];
            return Err(Error::custom(format!(
                "a list of {extent}, expected {expected} as in those before it"
            )));
        }
        Ok(())
    }
}

/// Values of the design variables: all in order, or some by name.
#[derive(Clone, Debug, PartialEq)]
pub enum Design {
    /// Every variable in order.
    Vector(Array),
    /// Some variables by name.
    Named(NamedDesign),
}

impl<'de> Deserialize<'de> for Design {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Either;
        impl<'de> de::Visitor<'de> for Either {
            type Value = Design;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of numbers, or an object of names and numbers")
            }

            fn visit_seq<A: de::SeqAccess<'de>>(self, list: A) -> Result<Design, A::Error> {
                Deserialize::deserialize(de::value::SeqAccessDeserializer::new(list)).map(Design::Vector)
            }

            fn visit_map<A: de::MapAccess<'de>>(self, map: A) -> Result<Design, A::Error> {
                let values = Deserialize::deserialize(de::value::MapAccessDeserializer::new(map))?;
                Ok(Design::Named(NamedDesign { values }))
            }
        }
        deserializer.deserialize_any(Either)
    }
}

impl PartialSchema for Design {
    fn schema() -> RefOr<Schema> {
        let description = "Every variable in order, each in its unit, or some by name.";
        OneOfBuilder::new()
            .item(Vec::<f64>::schema())
            .item(BTreeMap::<String, f64>::schema())
            .description(Some(description))
            .into()
    }
}

impl ToSchema for Design {
    fn name() -> std::borrow::Cow<'static, str> {
        "DesignValues".into()
    }
}

impl From<Design> for design_point::Input {
    fn from(design: Design) -> Self {
        match design {
            Design::Vector(vector) => Self::Design(vector),
            Design::Named(named) => Self::Named(named),
        }
    }
}

impl From<Design> for deform_request::Input {
    fn from(design: Design) -> Self {
        match design {
            Design::Vector(vector) => Self::Design(vector),
            Design::Named(named) => Self::Named(named),
        }
    }
}

/// The design of a deformation.
pub(crate) fn design<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<deform_request::Input>, D::Error> {
    Ok(Option::<Design>::deserialize(deserializer)?.map(Into::into))
}

/// A part of a request that may be absent but not null.
pub(crate) fn given<'de, T: Deserialize<'de>, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<T>, D::Error> {
    T::deserialize(deserializer).map(Some)
}

/// The word of an enumeration, which prost keeps as a number.
pub(crate) fn word<'de, E: Deserialize<'de> + Into<i32>, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<i32, D::Error> {
    E::deserialize(deserializer).map(Into::into)
}

/// The word of an enumeration, which is unspecified if null.
pub(crate) fn optional_word<'de, E: Deserialize<'de> + Into<i32> + Default, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<i32, D::Error> {
    Ok(Option::<E>::deserialize(deserializer)?.unwrap_or_default().into())
}

/// A list of names.
pub(crate) fn names<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<NameList>, D::Error> {
    Ok(Option::deserialize(deserializer)?.map(|names| NameList { names }))
}

/// A point.
pub(crate) fn point<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
    <[f64; 3]>::deserialize(deserializer).map(Vec::from)
}

/// Groups of indices by name.
pub(crate) fn groups<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<IndexGroup>, D::Error> {
    let groups = BTreeMap::<String, Vec<u32>>::deserialize(deserializer)?;
    let group =
        |(name, list): (String, Vec<u32>)| IndexGroup { name, indices: Some(indices(&[list.len()], &list)) };
    Ok(groups.into_iter().map(group).collect())
}

/// Three or four vertices for each cell.
pub(crate) fn cells<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Array>, D::Error> {
    struct Cell([u32; 4]);

    impl<'de> Deserialize<'de> for Cell {
        fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
            match Vec::deserialize(deserializer)?[..] {
                [a, b, c] => Ok(Self([a, b, c, u32::MAX])),
                [a, b, c, d] => Ok(Self([a, b, c, d])),
                ref other => Err(D::Error::custom(format!("{} vertices, expected 3 or 4", other.len()))),
            }
        }
    }

    let cells = Vec::<Cell>::deserialize(deserializer)?;
    let corners: Vec<u32> = cells.iter().flat_map(|cell| cell.0).collect();
    Ok(Some(indices(&[cells.len(), 4], &corners)))
}

/// The cells of a request without any.
pub(crate) fn no_cells() -> Option<Array> {
    Some(indices(&[0, 4], &[]))
}

/// An array of uint32.
pub(crate) fn indices(shape: &[usize], indices: &[u32]) -> Array {
    let data: Vec<u8> = indices.iter().flat_map(|index| index.to_le_bytes()).collect();
    let shape = shape.iter().map(|&extent| extent as u64).collect();
    Array { dtype: DataType::Uint32.into(), shape, data: data.into() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v1::{
        CreateConfigurationRequest, DeformRequest, PanelOptions, PanelSolver, ShareSetupRequest,
    };

    fn array(text: &str) -> Result<Array, String> {
        serde_json::from_str(text).map_err(|error| error.to_string())
    }

    #[test]
    fn nested_lists_become_arrays() {
        for (text, shape) in [
            ("[]", &[0][..]),
            ("[1, 2.5, -3]", &[3]),
            ("[[1,2,3],[4,5,6]]", &[2, 3]),
            ("[[[1]],[[2]]]", &[2, 1, 1]),
            ("[[],[]]", &[2, 0]),
        ] {
            let array = array(text).unwrap();
            assert_eq!(array.shape, shape, "{text}");
            assert_eq!(array.data.len() as u64, 8 * shape.iter().product::<u64>(), "{text}");
        }
        assert_eq!(array("[[1,2],[3,4]]").unwrap().data[24..], 4.0_f64.to_le_bytes());
        for text in
            ["1", "[[1],[2,3]]", "[1,[2]]", "[[1],2]", "[null]", "[\"a\"]", "{}", "[[],1]", "[[1,2],[]]"]
        {
            assert!(array(text).is_err(), "{text}");
        }
        assert!(array(&"[".repeat(100)).is_err());
        assert!(array(&format!("{}1{}", "[".repeat(9), "]".repeat(9))).unwrap_err().contains("deeply"));
    }

    #[test]
    fn a_design_is_a_list_or_an_object() {
        let read = |text| serde_json::from_str::<DeformRequest>(text).unwrap().input;
        let Some(deform_request::Input::Design(vector)) = read("{\"design\": [1, 2]}") else {
            panic!("a vector")
        };
        assert_eq!(vector.shape, [2]);
        let Some(deform_request::Input::Named(named)) = read("{\"design\": {\"x\": 1}}") else {
            panic!("names")
        };
        assert_eq!(named.values["x"], 1.0);
        assert!(read("{}").is_none());
        assert!(serde_json::from_str::<DeformRequest>("{\"design\": 1}").is_err());
    }

    #[test]
    fn the_ids_of_an_address_are_no_fields_of_a_document() {
        let error = serde_json::from_str::<DeformRequest>("{\"session_id\": \"a\"}").unwrap_err();
        assert!(error.to_string().starts_with("unknown field `session_id`"), "{error}");
    }

    #[test]
    fn enumerations_are_words_without_the_unspecified() {
        let read = |text| serde_json::from_str::<PanelOptions>(text).map(|options| options.solver);
        assert_eq!(read("{\"solver\": \"single\"}").unwrap(), i32::from(PanelSolver::Single));
        assert_eq!(read("{}").unwrap(), 0);
        assert!(read("{\"solver\": \"unspecified\"}").is_err());
        assert!(serde_json::from_str::<ShareSetupRequest>("{}").is_err(), "the visibility is required");
    }

    #[test]
    fn cells_have_three_or_four_vertices() {
        let read = |text| serde_json::from_str::<CreateConfigurationRequest>(text);
        let cells = read("{\"cells\": [[0, 1, 2], [0, 1, 2, 3]]}").unwrap().cells.unwrap();
        assert_eq!(cells, indices(&[2, 4], &[0, 1, 2, u32::MAX, 0, 1, 2, 3]));
        assert!(read("{\"cells\": [[0, 1]]}").unwrap_err().to_string().contains("expected 3 or 4"));
    }
}
