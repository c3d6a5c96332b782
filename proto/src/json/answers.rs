//! Writing of messages: arrays as nested lists, enumerations as words.

use serde::{
    Serialize, Serializer,
    ser::{Error, SerializeSeq},
};
use utoipa::{
    PartialSchema, ToSchema,
    openapi::{
        RefOr,
        schema::{ArrayBuilder, ObjectBuilder, Schema, SchemaType},
    },
};

use crate::v1::{Array, DataType};

/// Part of an array: its dimensions from some axis on, and their elements.
struct Part<'a> {
    dtype: DataType,
    shape: &'a [u64],
    data: &'a [u8],
}

impl Part<'_> {
    fn element(&self) -> usize {
        match self.dtype {
            DataType::Uint8 => 1,
            DataType::Uint32 => 4,
            DataType::Float64 | DataType::Unspecified => 8,
        }
    }
}

impl Serialize for Part<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Some((&extent, inner)) = self.shape.split_first() else {
            let wrong = || S::Error::custom("an array's data do not fill its shape");
            return match self.dtype {
                DataType::Uint8 => serializer.serialize_u8(*self.data.first().ok_or_else(wrong)?),
                DataType::Uint32 => {
                    let bytes = self.data.try_into().map_err(|_| wrong())?;
                    serializer.serialize_u32(u32::from_le_bytes(bytes))
                }
                DataType::Float64 | DataType::Unspecified => {
                    let bytes = self.data.try_into().map_err(|_| wrong())?;
                    serializer.serialize_f64(f64::from_le_bytes(bytes))
                }
            };
        };
        let step = self.element() * inner.iter().product::<u64>() as usize;
        let mut list = serializer.serialize_seq(Some(extent as usize))?;
        for index in 0..extent as usize {
            let data = self.data.get(index * step..(index + 1) * step).unwrap_or_default();
            list.serialize_element(&Part { dtype: self.dtype, shape: inner, data })?;
        }
        list.end()
    }
}

impl Serialize for Array {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        Part { dtype: self.dtype(), shape: &self.shape, data: &self.data }.serialize(serializer)
    }
}

impl PartialSchema for Array {
    fn schema() -> RefOr<Schema> {
        let description =
            "Numbers in nested lists, one level for each dimension. Numbers that are not finite are null.";
        let anything = ObjectBuilder::new().schema_type(SchemaType::AnyValue);
        ArrayBuilder::new().items(anything).description(Some(description)).build().into()
    }
}

impl ToSchema for Array {}

/// The word of an enumeration, which prost keeps as a number.
pub fn word<E: TryFrom<i32> + Default + Serialize, S: Serializer>(
    value: &i32,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    E::try_from(*value).unwrap_or_default().serialize(serializer)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_are_nested_lists() {
        let array = |dtype: DataType, shape: &[u64], data: &[u8]| Array {
            dtype: dtype.into(),
            shape: shape.to_vec(),
            data: data.to_vec().into(),
        };
        let text = |array| serde_json::to_string(&array).unwrap();
        let numbers: Vec<u8> =
            [1.5, -2.0, f64::INFINITY, 4.0].iter().flat_map(|x: &f64| x.to_le_bytes()).collect();
        assert_eq!(text(array(DataType::Float64, &[2, 2], &numbers)), "[[1.5,-2.0],[null,4.0]]");
        assert_eq!(text(array(DataType::Float64, &[2, 0, 3], &[])), "[[],[]]");
        assert_eq!(text(array(DataType::Uint32, &[1], &[255; 4])), "[4294967295]");
        assert_eq!(text(array(DataType::Uint8, &[3], &[0, 1, 0])), "[0,1,0]");
    }
}
