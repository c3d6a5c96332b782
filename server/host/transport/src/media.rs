//! Media types of bodies over HTTP: JSON for people; .npy, .npz and plain little-endian bytes for programs.
//!
//! | type | request | answer |
//! |---|---|---|
//! | `application/json` | a document | a document, arrays as nested lists |
//! | `application/x-npy` | the main array; the rest in the query | the main array; the rest in headers |
//! | `application/octet-stream` | the same without its header; `shape` in the query | the same; `Moldline-Shape` |
//! | `application/x-npz` | all arrays by name; the rest in the query | all arrays by name, and `info.json` |

use std::{
    pin::Pin,
    task::{Context, Poll, ready},
};

use axum::{
    body::{Body, Bytes},
    http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header},
    response::Response,
};
use http_body::Body as _;
use moldline_host::{Code, ServiceError};
use moldline_proto::v1::{Array, DataType};
use serde::{Serialize, de};
use tokio::sync::Semaphore;
use tokio_stream::{Stream, StreamExt};

use crate::{
    error_response::{Answer, ErrorResponse},
    npy,
    received::refusal,
};

/// A type of body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Media {
    /// `application/json`
    Json,
    /// `application/x-npy`
    Npy,
    /// `application/x-npz`
    Npz,
    /// `application/octet-stream`
    Octets,
    /// `text/event-stream`
    Events,
}

/// Types of answers with arrays.
pub const ARRAYS: [Media; 4] = [Media::Json, Media::Npy, Media::Npz, Media::Octets];

/// Extents of the array in an `application/octet-stream` answer, separated by commas.
pub const SHAPE: HeaderName = HeaderName::from_static("moldline-shape");

impl Media {
    /// Its name in headers.
    pub fn name(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Npy => "application/x-npy",
            Self::Npz => "application/x-npz",
            Self::Octets => "application/octet-stream",
            Self::Events => "text/event-stream",
        }
    }

    /// The type of that name.
    fn named(name: &str) -> Option<Self> {
        let all = [Self::Json, Self::Npy, Self::Npz, Self::Octets, Self::Events];
        all.into_iter().find(|media| media.name().eq_ignore_ascii_case(name)).or(match name {
            "application/zip" => Some(Self::Npz),
            "application/npy" => Some(Self::Npy),
            _ => None,
        })
    }

    /// The type that the client prefers among `offered`; the first one without a preference.
    ///
    /// # Errors
    /// 406 if it accepts none.
    pub fn accepted(headers: &HeaderMap, offered: &[Self]) -> Answer<Self> {
        let mut best: Option<(f32, Self)> = None;
        let mut restricted = false;
        let values = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok());
        for range in
            values.flat_map(|value| value.split(',')).map(str::trim).filter(|range| !range.is_empty())
        {
            restricted = true;
            let mut parts = range.split(';').map(str::trim);
            let name = parts.next().unwrap_or_default();
            let quality =
                parts.find_map(|part| part.strip_prefix("q=")).map_or(1.0, |q| q.parse().unwrap_or(0.0));
            let media = match name.split_once('/') {
                Some(("*", "*")) => offered.first().copied(),
                Some((kind, "*")) => {
                    offered.iter().copied().find(|media| media.name().split('/').next() == Some(kind))
                }
                _ => Self::named(name).filter(|media| offered.contains(media)),
            };
            if let Some(media) = media
                && quality > best.map_or(0.0, |(quality, _)| quality)
            {
                best = Some((quality, media));
            }
        }
        match (best, restricted, offered.first()) {
            (Some((_, media)), ..) => Ok(media),
            (None, false, Some(&first)) => Ok(first),
            _ => {
                let names: Vec<&str> = offered.iter().map(|media| media.name()).collect();
                let error = ServiceError::invalid("accept", format!("this answers {}", names.join(", ")));
                Err(ErrorResponse::with(StatusCode::NOT_ACCEPTABLE, error))
            }
        }
    }

    /// The type of the request's body; JSON if there is no body.
    ///
    /// # Errors
    /// 415 for a type other than those of arrays.
    pub fn sent(headers: &HeaderMap) -> Answer<Self> {
        let Some(value) = headers.get(header::CONTENT_TYPE) else {
            let empty = headers.get(header::CONTENT_LENGTH).is_none_or(|length| length == "0")
                && !headers.contains_key(header::TRANSFER_ENCODING);
            return if empty { Ok(Self::Json) } else { Err(unsupported("it is missing")) };
        };
        let name = value.to_str().unwrap_or_default().split(';').next().unwrap_or_default().trim();
        Self::named(name)
            .filter(|media| ARRAYS.contains(media))
            .ok_or_else(|| unsupported(&format!("this takes {}", ARRAYS.map(Self::name).join(", "))))
    }
}

/// 415.
pub fn unsupported(why: &str) -> ErrorResponse {
    ErrorResponse::with(StatusCode::UNSUPPORTED_MEDIA_TYPE, ServiceError::invalid("content-type", why))
}

/// The announced length of a body.
///
/// # Errors
/// 413 beyond `limit`.
pub fn length(headers: &HeaderMap, limit: u64) -> Answer<Option<u64>> {
    let announced = headers.get(header::CONTENT_LENGTH).and_then(|value| value.to_str().ok()?.parse().ok());
    match announced {
        Some(length) if length > limit => Err(too_large(limit)),
        length => Ok(length),
    }
}

fn too_large(limit: u64) -> ErrorResponse {
    let error = ServiceError::invalid("body", format!("is longer than the limit of {limit} bytes"));
    ErrorResponse::with(StatusCode::PAYLOAD_TOO_LARGE, error)
}

/// A body, piece by piece.
pub struct Chunks {
    body: Body,
    rest: Bytes,
    most: usize,
}

impl Chunks {
    /// Chunks of `most` bytes at most.
    pub fn new(body: Body, most: usize) -> Self {
        Self { body, rest: Bytes::new(), most }
    }
}

/// Fails if the client disconnects, or the body is refused on its way.
impl Stream for Chunks {
    type Item = Answer<Bytes>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Answer<Bytes>>> {
        loop {
            if !self.rest.is_empty() {
                let length = self.rest.len().min(self.most);
                return Poll::Ready(Some(Ok(self.rest.split_to(length))));
            }
            match ready!(Pin::new(&mut self.body).poll_frame(context)) {
                None => return Poll::Ready(None),
                Some(Ok(frame)) => self.rest = frame.into_data().unwrap_or_default(),
                Some(Err(error)) => {
                    let cut = || {
                        let message = format!("the body was cut off: {error}");
                        ServiceError::new(Code::Cancelled, message).into()
                    };
                    return Poll::Ready(Some(Err(refusal(&error).unwrap_or_else(cut))));
                }
            }
        }
    }
}

/// The whole body, `limit` bytes at most. Memory grows with the bytes received, not with the announced length.
///
/// # Errors
/// 413 beyond the limit.
pub async fn read(headers: &HeaderMap, body: Body, limit: usize) -> Answer<Bytes> {
    length(headers, limit as u64)?;
    let mut chunks = Chunks::new(body, usize::MAX);
    let Some(first) = chunks.next().await.transpose()? else { return Ok(Bytes::new()) };
    let Some(second) = chunks.next().await.transpose()? else {
        return if first.len() > limit { Err(too_large(limit as u64)) } else { Ok(first) };
    };
    let mut whole = [first, second].concat();
    while whole.len() <= limit {
        match chunks.next().await.transpose()? {
            Some(data) => whole.extend_from_slice(&data),
            None => return Ok(whole.into()),
        }
    }
    Err(too_large(limit as u64))
}

/// Reads or writes a body of about `bytes`: a long one beside the threads that answer requests, at most two at a time.
///
/// # Errors
/// Those of `work`.
pub async fn beside<T: Send + 'static, E: From<ServiceError> + Send + 'static>(
    bytes: usize,
    work: impl FnOnce() -> Result<T, E> + Send + 'static,
) -> Result<T, E> {
    /// Read within a fraction of a millisecond.
    const SHORT: usize = 64 << 10;
    /// As many as there are threads for requests.
    static PLACES: Semaphore = Semaphore::const_new(2);
    if bytes <= SHORT {
        return work();
    }
    let _place = PLACES.acquire().await;
    let failed = |_| {
        ServiceError::new(
            Code::Internal,
            "a body could not be read or written; the server's log has the cause",
        )
    };
    tokio::task::spawn_blocking(work).await.map_err(failed)?
}

/// Reads a JSON document. An empty body is an empty document.
///
/// # Errors
/// `InvalidArgument` naming the path of the fault.
pub fn json<T: de::DeserializeOwned>(body: &Bytes) -> Answer<T> {
    let text: &[u8] = if body.is_empty() { b"{}" } else { body };
    let mut reader = serde_json::Deserializer::from_slice(text);
    let document = serde_path_to_error::deserialize(&mut reader).map_err(|error| {
        let path = error.path().to_string();
        let field = match path.as_str() {
            // A truncated text has an unknown path.
            "." | "?" => "body".to_owned(),
            list if list.starts_with('[') => format!("body{list}"),
            _ => path,
        };
        ServiceError::invalid(field, error.into_inner().to_string())
    })?;
    reader.end().map_err(|error| ServiceError::invalid("body", error.to_string()))?;
    Ok(document)
}

/// The arrays of a binary body, by name: all of a .npz file, or one called `main`. `shape` is the shape of plain bytes, by
/// default one-dimensional.
///
/// # Errors
/// `InvalidArgument` naming the array.
pub fn arrays(
    media: Media,
    body: Bytes,
    main: &str,
    shape: Option<&str>,
    limit: usize,
) -> Answer<Vec<(String, Array)>> {
    if media == Media::Npz {
        return Ok(npy::read_npz(body, limit)?);
    }
    if media == Media::Npy {
        return Ok(vec![(main.to_owned(), npy::read(main, &body)?)]);
    }
    let shape = match shape {
        None => vec![(body.len() / size_of::<f64>()) as u64],
        Some(text) => {
            let extents = text.split(',').map(|extent| extent.trim().parse());
            extents.collect::<Result<_, _>>().map_err(|_| {
                ServiceError::invalid("shape", "is not a list of extents separated by commas, such as `2,45`")
            })?
        }
    };
    Ok(vec![(main.to_owned(), Array { dtype: DataType::Float64.into(), shape, data: body })])
}

/// An answer as a document, as its main array, or as all its arrays. `take` removes the arrays from it, each with its name,
/// the main one first; `headers` carry the rest of a binary answer.
///
/// # Errors
/// If there is no array to send.
pub fn reply<R: Serialize>(
    media: Media,
    mut reply: R,
    take: impl FnOnce(&mut R) -> Vec<(String, Array)>,
    headers: &[(&'static str, String)],
) -> Answer<Response> {
    if media == Media::Json {
        return document(StatusCode::OK, &reply);
    }
    let mut arrays = take(&mut reply);
    if arrays.is_empty() {
        return Err(ServiceError::invalid(
            "accept",
            "there is no array to answer with; ask for application/json",
        )
        .into());
    }
    let mut response = match media {
        Media::Npz => Response::new(Body::from(npy::write_npz(&arrays, &text(&reply)?)?)),
        _ => {
            let (_, main) = arrays.swap_remove(0);
            binary(media, main.dtype(), &main.shape, [main.data])
        }
    };
    let fields = response.headers_mut();
    fields.insert(header::CONTENT_TYPE, HeaderValue::from_static(media.name()));
    for (name, value) in headers {
        if let Ok(value) = HeaderValue::from_str(value) {
            fields.insert(HeaderName::from_static(name), value);
        }
    }
    Ok(response)
}

/// One array as .npy or plain bytes, in parts, without copying.
pub fn binary(
    media: Media,
    dtype: DataType,
    shape: &[u64],
    parts: impl IntoIterator<Item = Bytes, IntoIter: Send + 'static>,
) -> Response {
    let head = (media == Media::Npy).then(|| Bytes::from(npy::header(dtype, shape)));
    let element = match dtype {
        DataType::Uint8 => 1,
        DataType::Uint32 => 4,
        DataType::Float64 | DataType::Unspecified => 8,
    };
    let length = element * shape.iter().product::<u64>() + head.as_ref().map_or(0, |head| head.len() as u64);
    let parts = head.into_iter().chain(parts).map(Ok::<_, std::convert::Infallible>);
    let mut response = Response::new(Body::from_stream(tokio_stream::iter(parts)));
    set_array_headers(response.headers_mut(), media, shape, length);
    response
}

/// Type, length and shape of a binary answer.
pub fn set_array_headers(headers: &mut HeaderMap, media: Media, shape: &[u64], length: u64) {
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(media.name()));
    headers.insert(header::CONTENT_LENGTH, length.into());
    let shape: Vec<String> = shape.iter().map(u64::to_string).collect();
    if let Ok(shape) = HeaderValue::from_str(&shape.join(",")) {
        headers.insert(SHAPE, shape);
    }
}

/// A JSON document.
///
/// # Errors
/// If it cannot be serialised.
pub fn document(status: StatusCode, document: &impl Serialize) -> Answer<Response> {
    let mut response = Response::new(Body::from(text(document)?));
    *response.status_mut() = status;
    let json = HeaderValue::from_static(Media::Json.name());
    response.headers_mut().insert(header::CONTENT_TYPE, json);
    Ok(response)
}

fn text(document: &impl Serialize) -> Answer<String> {
    serde_json::to_string(document).map_err(|error| {
        ServiceError::new(Code::Internal, format!("cannot write the document: {error}")).into()
    })
}

/// Describes a binary body.
pub struct Binary;

impl utoipa::PartialSchema for Binary {
    fn schema() -> utoipa::openapi::RefOr<utoipa::openapi::schema::Schema> {
        use utoipa::openapi::schema::{KnownFormat, ObjectBuilder, SchemaFormat, Type};
        let format = SchemaFormat::KnownFormat(KnownFormat::Binary);
        ObjectBuilder::new().schema_type(Type::String).format(Some(format)).build().into()
    }
}

impl utoipa::ToSchema for Binary {}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[test]
    fn the_best_common_type_is_chosen() {
        let accepted = |value: &'static str| {
            let headers = [(header::ACCEPT, HeaderValue::from_static(value))].into_iter().collect();
            Media::accepted(&headers, &ARRAYS).ok()
        };
        assert_eq!(accepted("*/*"), Some(Media::Json));
        assert_eq!(accepted(""), Some(Media::Json));
        assert_eq!(accepted("application/x-npy"), Some(Media::Npy));
        assert_eq!(accepted("application/json;q=0.5, application/x-npz"), Some(Media::Npz));
        assert_eq!(accepted("text/html, application/*;q=0.8"), Some(Media::Json));
        assert_eq!(accepted("application/octet-stream, */*;q=0.1"), Some(Media::Octets));
        assert_eq!(accepted("text/html"), None);
        assert_eq!(accepted("application/json;q=0"), None);
        assert_eq!(Media::accepted(&HeaderMap::new(), &ARRAYS).unwrap(), Media::Json);
    }

    #[test]
    fn the_path_of_a_fault_is_named() {
        #[derive(Debug, Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Document {
            #[allow(dead_code, reason = "only read")]
            design: Option<Array>,
        }
        let fault = |text: &'static str| {
            let error = json::<Document>(&Bytes::from_static(text.as_bytes())).unwrap_err();
            serde_json::to_value(error.problem()).unwrap()["violations"][0]["field"].clone()
        };
        assert!(json::<Document>(&Bytes::new()).is_ok());
        assert_eq!(fault("{\"design\": [1, \"a\"]}"), "design[1]");
        assert_eq!(fault("{\"colour\": 1}"), "colour");
        assert_eq!(fault("{}{}"), "body");
        assert_eq!(fault("{"), "body");
        assert_eq!(fault("[1]"), "body[0]");
    }
}
