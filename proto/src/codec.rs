//! The codec of the generated services: Protocol Buffers, with a bound on what a request becomes in memory.

use std::marker::PhantomData;

use bytes::{Buf, Bytes};
use prost::{Message, Name};
use tonic::{
    Status,
    codec::{DecodeBuf, Decoder},
};
use tonic_prost::ProstEncoder;

use crate::weight::Weight;

/// Messages as Protocol Buffers.
#[derive(Debug)]
pub struct Codec<T, U>(PhantomData<(T, U)>);

impl<T, U> Default for Codec<T, U> {
    fn default() -> Self {
        Self(PhantomData)
    }
}

impl<T, U> tonic::codec::Codec for Codec<T, U>
where
    T: Message + Send + 'static,
    U: Message + Name + Default + Send + 'static,
{
    type Encode = T;
    type Decode = U;
    type Encoder = ProstEncoder<T>;
    type Decoder = Bounded<U>;

    fn encoder(&mut self) -> Self::Encoder {
        ProstEncoder::default()
    }

    fn decoder(&mut self) -> Self::Decoder {
        Bounded(PhantomData)
    }
}

/// Decodes messages. A request whose parts would take many times the bytes that came is refused before they are made.
#[derive(Debug)]
pub struct Bounded<U>(PhantomData<U>);

impl<U: Message + Name + Default> Decoder for Bounded<U> {
    type Item = U;
    type Error = Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<U>, Status> {
        let length = buffer.remaining();
        decode(buffer.copy_to_bytes(length)).map(Some)
    }
}

/// A message. Its byte fields share `bytes`.
fn decode<U: Message + Name + Default>(bytes: Bytes) -> Result<U, Status> {
    let malformed = |why: &dyn std::fmt::Display| {
        Status::invalid_argument(format!("the message is not a `{}`: {why}", U::NAME))
    };
    // Answers come from a server that the client has chosen, and leave out what is zero.
    if U::NAME.ends_with("Request") {
        let most = crate::decoded(bytes.len() as u64);
        match Weight::of(U::NAME).bytes(&bytes, most) {
            Ok(weight) if weight > most => {
                return Err(Status::resource_exhausted(format!(
                    "the message has {} bytes, and its parts would take more than {most} in memory, which is the limit for \
                     its length; send fewer and larger parts",
                    bytes.len()
                )));
            }
            Ok(_) => {}
            Err(error) => return Err(malformed(&error)),
        }
    }
    U::decode(bytes).map_err(|error| malformed(&error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v1;

    /// A field of length-delimited `content`.
    fn field(number: u32, content: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        prost::encoding::encode_key(number, prost::encoding::WireType::LengthDelimited, &mut bytes);
        prost::encoding::encode_varint(content.len() as u64, &mut bytes);
        bytes.extend_from_slice(content);
        bytes
    }

    #[test]
    fn many_empty_parts_are_refused() {
        let number = |message: &str, name: &str| crate::weight::number(message, name).unwrap();
        let points = number("DeformRequest", "control_points");
        let bomb = field(points, &[]).repeat(1 << 20);
        let refused = decode::<v1::DeformRequest>(bomb.into()).unwrap_err();
        assert_eq!(refused.code(), tonic::Code::ResourceExhausted);
        // Within a message in a message, and as packed numbers.
        let shape = field(2, &vec![1; 1 << 20]);
        let vertices = number("ApplyAdjointRequest", "vertices");
        let refused = decode::<v1::ApplyAdjointRequest>(field(vertices, &shape).into()).unwrap_err();
        assert_eq!(refused.code(), tonic::Code::ResourceExhausted);
        let names = number("ApplyAdjointRequest", "control_points_of");
        let refused =
            decode::<v1::ApplyAdjointRequest>(field(names, &[]).repeat(1 << 20).into()).unwrap_err();
        assert_eq!(refused.code(), tonic::Code::ResourceExhausted);
    }

    #[test]
    fn usual_messages_pass() {
        let data = vec![0; 24 * 15_000];
        let array =
            v1::Array { dtype: v1::DataType::Float64.into(), shape: vec![15_000, 3], data: data.into() };
        let points: Vec<_> = (0..20)
            .map(|i| v1::ControlPoints { component: format!("c{i}"), points: Some(array.clone()) })
            .collect();
        let values = (0..2000).map(|i| (format!("wing.section.{i}.twist"), 0.5)).collect();
        let request = v1::DeformRequest {
            session_id: "s".repeat(32),
            input: Some(v1::deform_request::Input::Named(v1::NamedDesign { values })),
            control_points: points,
            include_cell_quality: true,
        };
        assert_eq!(decode::<v1::DeformRequest>(request.encode_to_vec().into()).unwrap(), request);
        let files =
            (0..1000).map(|i| v1::FileEntry { path: format!("part/{i}.json"), size: 1000 + i }).collect();
        let header = v1::SetupHeader {
            source: Some(v1::setup_header::Source::Files(v1::FileList { files })),
            ..Default::default()
        };
        let part = Some(v1::create_setup_request::Part::Header(header));
        let request = v1::CreateSetupRequest { part };
        assert_eq!(decode::<v1::CreateSetupRequest>(request.encode_to_vec().into()).unwrap(), request);
    }

    #[test]
    fn malformed_messages_are_the_callers_fault() {
        for bytes in [&[0xff; 20][..], &[0x0a, 0xff, 0xff, 0x03, 1], &[0x0b, 0x0c], &[0x07]] {
            let refused = decode::<v1::DeformRequest>(Bytes::copy_from_slice(bytes)).unwrap_err();
            assert_eq!(refused.code(), tonic::Code::InvalidArgument, "{refused}");
            assert!(refused.message().contains("DeformRequest"));
        }
    }
}
