//! Sessions over HTTP, and what they compute.

use axum::{
    body::Body,
    extract::State,
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::Response,
};
use moldline_proto::v1;
use moldline_transport::{
    Answer, Caller, Id, Problem, Query,
    media::{self, ARRAYS, Media},
};
use serde::Deserialize;

use super::{
    Http,
    bodies::Sent,
    documents::{Deform, Jvp, OpenSession, UpdateSession, Vjp},
    idempotency_key,
    replies::Reply,
    setups::Page,
};

/// Opens a session on a set-up
///
/// It lasts, with its design, until it is closed: any server of the same store can go on with it.
#[utoipa::path(
    post, path = "/v1/setups/{setup_id}/sessions", operation_id = "OpenSession", tag = "sessions",
    params(
        ("setup_id" = String, Path),
        ("Idempotency-Key" = Option<String>, Header, description = "Chosen by the client, so that a retry is recognised."),
    ),
    request_body = Option<OpenSession>,
    responses(
        (status = 201, description = "The session.", body = v1::OpenSessionResponse, headers(("Location" = String))),
        (status = "default", description = "An error.", body = Problem, content_type = "application/problem+json"),
    )
)]
pub async fn open_session(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(setup_id): Id,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let OpenSession { label } = http.bodies.document(&headers, body).await?;
    let request = v1::OpenSessionRequest { setup_id, request_id: idempotency_key(&headers), label };
    let opened = http.api.open_session(&caller, request).await?;
    let mut response = media::document(StatusCode::CREATED, &opened)?;
    if let Ok(location) = HeaderValue::from_str(&format!("/v1/sessions/{}", opened.session_id)) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    Ok(response)
}

/// Lists the caller's open sessions
#[utoipa::path(
    get, path = "/v1/sessions", operation_id = "ListSessions", tag = "sessions", params(Page),
    responses(
        (status = 200, description = "Sessions in the order of their ids.", body = v1::ListSessionsResponse),
        (status = "default", description = "An error.", body = Problem, content_type = "application/problem+json"),
    )
)]
pub async fn list_sessions(
    State(http): State<Http>,
    Caller(caller): Caller,
    Query(Page { page_size, page_token }): Query<Page>,
) -> Answer<Response> {
    let listed = http.api.list_sessions(&caller, v1::ListSessionsRequest { page_size, page_token }).await?;
    media::document(StatusCode::OK, &listed)
}

/// Describes a session: its set-up, its design
///
/// The main array is the design.
#[utoipa::path(
    get, path = "/v1/sessions/{session_id}", operation_id = "GetSession", tag = "sessions",
    params(("session_id" = String, Path)),
    responses(
        (status = 200, description = "The session.", content(
            (v1::GetSessionResponse = "application/json"), (media::Binary = "application/x-npy"),
            (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
        )),
        (status = "default", description = "An error.", body = Problem, content_type = "application/problem+json"),
    )
)]
pub async fn get_session(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(session_id): Id,
    headers: HeaderMap,
) -> Answer<Response> {
    let media = Media::accepted(&headers, &ARRAYS)?;
    http.api.get_session(&caller, v1::GetSessionRequest { session_id }).await?.respond(media)
}

/// Stores a session's design
///
/// How an optimizer saves where it has got to. Of two updates of the same generation one is refused (ABORTED) and has to
/// read the session again.
#[utoipa::path(
    patch, path = "/v1/sessions/{session_id}", operation_id = "UpdateSession", tag = "sessions",
    params(
        ("session_id" = String, Path),
        ("Idempotency-Key" = Option<String>, Header, description = "Chosen by the client, so that a retry is recognised."),
    ),
    request_body = UpdateSession,
    responses(
        (status = 200, description = "The session as it is now.", body = v1::UpdateSessionResponse),
        (status = "default", description = "An error.", body = Problem, content_type = "application/problem+json"),
    )
)]
pub async fn update_session(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(session_id): Id,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let UpdateSession { expected_generation, design, label } = http.bodies.document(&headers, body).await?;
    let request = v1::UpdateSessionRequest {
        session_id,
        expected_generation,
        design: design.map(Into::into),
        label,
        request_id: idempotency_key(&headers),
    };
    media::document(StatusCode::OK, &http.api.update_session(&caller, request).await?)
}

/// Closes a session for good
#[utoipa::path(
    delete, path = "/v1/sessions/{session_id}", operation_id = "CloseSession", tag = "sessions",
    params(("session_id" = String, Path)),
    responses(
        (status = 204, description = "It is closed."),
        (status = "default", description = "An error.", body = Problem, content_type = "application/problem+json"),
    )
)]
pub async fn close_session(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(session_id): Id,
) -> Answer<StatusCode> {
    http.api.close_session(&caller, v1::CloseSessionRequest { session_id }).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// What a design that comes as arrays does not say.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct DeformQuery {
    /// Whether the measures of every cell are wanted too. (In JSON, a field of the document.)
    #[serde(default)]
    include_cell_quality: bool,
    /// Extents of an `application/octet-stream` body, such as `45`.
    shape: Option<String>,
}

/// Deforms the session's mesh to a design
///
/// The server keeps the linearisation for derivatives, and stores nothing. The main array of the request is the design,
/// that of the answer the vertices; `Moldline-Linearisation-Id` names the linearisation.
#[utoipa::path(
    post, path = "/v1/sessions/{session_id}/deform", operation_id = "Deform", tag = "sessions",
    params(("session_id" = String, Path), DeformQuery),
    request_body(content(
        (Option<Deform> = "application/json"), (media::Binary = "application/x-npy"),
        (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
    ), description = "Arrays: `design`, `control_points.COMPONENT`."),
    responses(
        (status = 200, description = "The deformed mesh. Arrays: `vertices`, `functions`, `cell_quality.*`.", content(
            (v1::DeformResponse = "application/json"), (media::Binary = "application/x-npy"),
            (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
        )),
        (status = "default", description = "An error.", body = Problem, content_type = "application/problem+json"),
    )
)]
pub async fn deform(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(id): Id,
    Query(query): Query<DeformQuery>,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let media = Media::accepted(&headers, &ARRAYS)?;
    let request = match http.bodies.numbers(&headers, body, "design", query.shape.as_deref()).await? {
        Sent::Document(document) => Deform::message(document, id),
        Sent::Arrays(arrays) => arrays.deform(id, query.include_cell_quality)?,
    };
    http.api.deform(&caller, request).await?.respond(media)
}

/// Where a derivative is taken, if the body comes as arrays.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct AtQuery {
    /// As Deform returned it. (In JSON, a field of the document.)
    pub linearisation_id: Option<String>,
    /// Extents of an `application/octet-stream` body, such as `2,45`.
    pub shape: Option<String>,
}

/// Jacobian-vector products
///
/// How vertices and functions change along directions of the design variables, of control points, or both together.
#[utoipa::path(
    post, path = "/v1/sessions/{session_id}/jvp", operation_id = "ApplyJacobianVector", tag = "sessions",
    params(("session_id" = String, Path), AtQuery),
    request_body(content(
        (Jvp = "application/json"), (media::Binary = "application/x-npy"),
        (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
    ), description = "Arrays: `design`, `control_points.COMPONENT`, `at.design`, `at.control_points.COMPONENT`."),
    responses(
        (status = 200, description = "Tangents. Arrays: `vertices`, `functions`.", content(
            (v1::ApplyJacobianVectorResponse = "application/json"), (media::Binary = "application/x-npy"),
            (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
        )),
        (status = "default", description = "An error.", body = Problem, content_type = "application/problem+json"),
    )
)]
pub async fn apply_jacobian_vector(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(id): Id,
    Query(query): Query<AtQuery>,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let media = Media::accepted(&headers, &ARRAYS)?;
    let request = match http.bodies.numbers(&headers, body, "design", query.shape.as_deref()).await? {
        Sent::Document(document) => Jvp::message(document, id),
        Sent::Arrays(arrays) => arrays.jvp(id, query.linearisation_id)?,
    };
    http.api.apply_jacobian_vector(&caller, request).await?.respond(media)
}

/// What seeds that come as arrays do not say.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct VjpQuery {
    /// As Deform returned it. (In JSON, like all of these, a field of the document.)
    linearisation_id: Option<String>,
    /// Extents of an `application/octet-stream` body, such as `2,14824,3`.
    shape: Option<String>,
    /// Whether gradients by the design variables are wanted; they are if no others are.
    #[serde(default)]
    include_design: bool,
    /// Components by whose control points gradients are wanted, separated by commas.
    control_points_of: Option<String>,
}

/// Vector-Jacobian products: gradients
///
/// Gradients of weighted sums of vertices and functions by the design variables, by control points, or both.
#[utoipa::path(
    post, path = "/v1/sessions/{session_id}/vjp", operation_id = "ApplyAdjoint", tag = "sessions",
    params(("session_id" = String, Path), VjpQuery),
    request_body(content(
        (Vjp = "application/json"), (media::Binary = "application/x-npy"),
        (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
    ), description = "Arrays: `vertices`, `functions`, `at.design`, `at.control_points.COMPONENT`."),
    responses(
        (status = 200, description = "Gradients. Arrays: `design`, `control_points.COMPONENT`.", content(
            (v1::ApplyAdjointResponse = "application/json"), (media::Binary = "application/x-npy"),
            (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
        )),
        (status = "default", description = "An error.", body = Problem, content_type = "application/problem+json"),
    )
)]
pub async fn apply_adjoint(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(id): Id,
    Query(query): Query<VjpQuery>,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let media = Media::accepted(&headers, &ARRAYS)?;
    let request = match http.bodies.numbers(&headers, body, "vertices", query.shape.as_deref()).await? {
        Sent::Document(document) => Vjp::message(document, id),
        Sent::Arrays(arrays) => {
            let components = query.control_points_of.as_deref().unwrap_or_default().split(',').map(str::trim);
            let components = components.filter(|name| !name.is_empty()).map(str::to_owned).collect();
            arrays.vjp(id, query.linearisation_id, query.include_design, components)?
        }
    };
    http.api.apply_adjoint(&caller, request).await?.respond(media)
}
