//! The whole Jacobian over HTTP: streamed as one array, or collected into a document or several arrays.

use axum::{
    body::{Body, Bytes},
    extract::State,
    http::{HeaderMap, HeaderName, HeaderValue},
    response::Response,
};
use moldline_host::{Code, ServiceError};
use moldline_proto::v1::{self, Array, DataType};
use moldline_transport::{
    Answer, Caller, Deadline, Id, Query,
    media::{self, ARRAYS, Media},
    npy,
};
use tokio::sync::mpsc;
use tokio_stream::{StreamExt, wrappers::ReceiverStream};

use super::{
    Http,
    bodies::Sent,
    replies::{Reply, server_timing},
    responses::Errors,
    sessions::AtQuery,
};

type Block = Result<v1::JacobianResponse, ServiceError>;

/// The derivative of all outputs with respect to all design variables
///
/// The main array has one block of vertices for each variable and is streamed as it is computed. Documents and .npz files
/// have the functions too, and are for smaller ones.
#[utoipa::path(
    post, path = "/v1/sessions/{session_id}/jacobian", operation_id = "Jacobian", tag = "sessions",
    params(("session_id" = String, Path), AtQuery),
    request_body(content(
        (v1::JacobianRequest = "application/json"), (media::Binary = "application/x-npy"),
        (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
    ), description = "Arrays: `at.design`, `at.control_points.COMPONENT`."),
    responses(
        (status = 200, description = "All columns. Arrays: `vertices` (variables, n, 3), `functions`.", content(
            (v1::JacobianResponse = "application/json"), (media::Binary = "application/x-npy"),
            (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
        )),
        Errors,
    )
)]
pub async fn jacobian(
    State(http): State<Http>,
    Caller(caller): Caller,
    axum::Extension(deadline): axum::Extension<Deadline>,
    Id(session_id): Id,
    Query(query): Query<AtQuery>,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let media = Media::accepted(&headers, &ARRAYS)?;
    let request = match http.bodies.numbers(&headers, body, "at.design", query.shape.as_deref()).await? {
        Sent::Document(document) => v1::JacobianRequest { session_id, ..document },
        Sent::Arrays(arrays) => arrays.jacobian(session_id, query.linearisation_id)?,
    };
    let limit = http.bodies.most;
    let mut blocks = http.api.jacobian(caller, deadline, request);
    let first = blocks.recv().await.unwrap_or_else(|| Err(cut_off()))?;
    match media {
        Media::Npy | Media::Octets => stream(media, first, blocks),
        _ => collect(first, blocks, limit).await?.respond(media).await,
    }
}

fn cut_off() -> ServiceError {
    ServiceError::new(Code::Internal, "the columns ended before they began")
}

/// Streams the vertices' part of all columns.
fn stream(media: Media, first: v1::JacobianResponse, blocks: mpsc::Receiver<Block>) -> Answer<Response> {
    let shape = match first.vertices.as_ref().map(|vertices| &vertices.shape[..]) {
        Some(&[_, vertices, axes]) => [u64::from(first.columns), vertices, axes],
        _ => return Err(cut_off().into()),
    };
    let head = if media == Media::Npy { npy::header(DataType::Float64, &shape) } else { Vec::new() };
    let length = 8 * shape.iter().product::<u64>() + head.len() as u64;
    let timing = server_timing(first.timings);
    // A later error cuts the body off, which the client notices by its length.
    let blocks = tokio_stream::once(Ok(first)).chain(ReceiverStream::new(blocks));
    let data = blocks.map(|block| block.map(|block| block.vertices.unwrap_or_default().data));
    let frames = tokio_stream::once(Ok(Bytes::from(head))).chain(data);
    let mut response = Response::new(Body::from_stream(frames));
    media::set_array_headers(response.headers_mut(), media, &shape, length);
    if let Some((name, value)) = timing
        && let Ok(value) = HeaderValue::from_str(&value)
    {
        response.headers_mut().insert(HeaderName::from_static(name), value);
    }
    Ok(response)
}

/// Collects all columns in one message.
async fn collect(
    first: v1::JacobianResponse,
    mut blocks: mpsc::Receiver<Block>,
    limit: usize,
) -> Answer<v1::JacobianResponse> {
    let columns = first.columns;
    let bytes = |array: &Option<Array>| array.as_ref().map_or(0, |array| array.data.len());
    let each =
        bytes(&first.vertices) / first.vertices.as_ref().map_or(1, |array| array.shape[0].max(1) as usize);
    if each.saturating_mul(columns as usize) > limit {
        let description = format!(
            "{columns} columns of {each} bytes are more than the limit of {limit} bytes; accept application/x-npy, which \
             is streamed"
        );
        return Err(ServiceError::invalid("accept", description).into());
    }
    let mut all = [Vec::new(), Vec::new()];
    let mut shapes = [Vec::new(), Vec::new()];
    let (mut queue_seconds, mut engine_seconds) = (0.0, 0.0);
    let mut next = Some(first);
    while let Some(v1::JacobianResponse { vertices, functions, timings, .. }) = next {
        for (index, array) in [vertices, functions].into_iter().enumerate() {
            let array = array.unwrap_or_default();
            all[index].extend_from_slice(&array.data);
            shapes[index] = array.shape;
        }
        let timings = timings.unwrap_or_default();
        queue_seconds += timings.queue_seconds;
        engine_seconds += timings.engine_seconds;
        next = blocks.recv().await.transpose()?;
    }
    let [vertices, functions] = all;
    let whole = |data: Vec<u8>, mut shape: Vec<u64>| {
        if let Some(extent) = shape.first_mut() {
            *extent = u64::from(columns);
        }
        Some(Array { dtype: DataType::Float64.into(), shape, data: data.into() })
    };
    let [of_vertices, of_functions] = shapes;
    Ok(v1::JacobianResponse {
        first: 0,
        columns,
        vertices: whole(vertices, of_vertices),
        functions: whole(functions, of_functions),
        timings: Some(v1::Timings { queue_seconds, engine_seconds }),
    })
}
