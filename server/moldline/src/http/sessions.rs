//! Sessions over HTTP: designs, deformations and products with derivatives.

use axum::{
    body::Body,
    extract::State,
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::Response,
};
use moldline_proto::v1;
use moldline_transport::{
    Answer, Caller, Id, Query,
    media::{self, ARRAYS, Media},
};
use serde::Deserialize;

use super::{Http, bodies::Sent, idempotency_key, replies::Reply, responses::Errors, setups::Page};

/// Opens a session on a set-up
///
/// The session and its design last until it is closed, and any server of the same store can continue it.
#[utoipa::path(
    post, path = "/v1/setups/{setup_id}/sessions", operation_id = "OpenSession", tag = "sessions",
    params(
        ("setup_id" = String, Path),
        ("Idempotency-Key" = Option<String>, Header, description = "Chosen by the client, so that a retry is recognised."),
    ),
    request_body = Option<v1::OpenSessionRequest>,
    responses(
        (status = 201, description = "The session.", body = v1::OpenSessionResponse, headers(("Location" = String))),
        Errors,
    )
)]
pub async fn open_session(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(setup_id): Id,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let document: v1::OpenSessionRequest = http.bodies.document(&headers, body).await?;
    let request = v1::OpenSessionRequest { setup_id, request_id: idempotency_key(&headers), ..document };
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
        Errors,
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
        Errors,
    )
)]
pub async fn get_session(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(session_id): Id,
    headers: HeaderMap,
) -> Answer<Response> {
    let media = Media::accepted(&headers, &ARRAYS)?;
    http.api.get_session(&caller, v1::GetSessionRequest { session_id }).await?.respond(media).await
}

/// Stores a session's design
///
/// An optimizer saves its progress this way. Of two updates of the same generation one is refused (ABORTED), and its client must
/// read the session again.
#[utoipa::path(
    patch, path = "/v1/sessions/{session_id}", operation_id = "UpdateSession", tag = "sessions",
    params(
        ("session_id" = String, Path),
        ("Idempotency-Key" = Option<String>, Header, description = "Chosen by the client, so that a retry is recognised."),
    ),
    request_body = v1::UpdateSessionRequest,
    responses(
        (status = 200, description = "The session as it is now.", body = v1::UpdateSessionResponse),
        Errors,
    )
)]
pub async fn update_session(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(session_id): Id,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let document: v1::UpdateSessionRequest = http.bodies.document(&headers, body).await?;
    let request = v1::UpdateSessionRequest { session_id, request_id: idempotency_key(&headers), ..document };
    media::document(StatusCode::OK, &http.api.update_session(&caller, request).await?)
}

/// Closes a session for good
#[utoipa::path(
    delete, path = "/v1/sessions/{session_id}", operation_id = "CloseSession", tag = "sessions",
    params(("session_id" = String, Path)),
    responses(
        (status = 204, description = "The session is closed."),
        Errors,
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

/// The fields of a deformation whose design comes as arrays.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct DeformQuery {
    /// Whether to return the measures of every cell too. (In JSON, a field of the document.)
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
        (Option<v1::DeformRequest> = "application/json"), (media::Binary = "application/x-npy"),
        (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
    ), description = "Arrays: `design`, `control_points.COMPONENT`."),
    responses(
        (status = 200, description = "The deformed mesh. Arrays: `vertices`, `functions`, `cell_quality.*`.", content(
            (v1::DeformResponse = "application/json"), (media::Binary = "application/x-npy"),
            (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
        )),
        Errors,
    )
)]
pub async fn deform(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(session_id): Id,
    Query(query): Query<DeformQuery>,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let media = Media::accepted(&headers, &ARRAYS)?;
    let request = match http.bodies.numbers(&headers, body, "design", query.shape.as_deref()).await? {
        Sent::Document(document) => v1::DeformRequest { session_id, ..document },
        Sent::Arrays(arrays) => arrays.deform(session_id, query.include_cell_quality)?,
    };
    http.api.deform(&caller, request).await?.respond(media).await
}

/// The point of a derivative, if the body comes as arrays.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct AtQuery {
    /// From the answer of Deform. (In JSON, a field of the document.)
    pub linearisation_id: Option<String>,
    /// Extents of an `application/octet-stream` body, such as `2,45`.
    pub shape: Option<String>,
}

/// Jacobian-vector products
///
/// Changes of vertices and functions along directions of the design variables, of control points, or of both together.
#[utoipa::path(
    post, path = "/v1/sessions/{session_id}/jvp", operation_id = "ApplyJacobianVector", tag = "sessions",
    params(("session_id" = String, Path), AtQuery),
    request_body(content(
        (v1::ApplyJacobianVectorRequest = "application/json"), (media::Binary = "application/x-npy"),
        (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
    ), description = "Arrays: `design`, `control_points.COMPONENT`, `at.design`, `at.control_points.COMPONENT`."),
    responses(
        (status = 200, description = "Tangents. Arrays: `vertices`, `functions`.", content(
            (v1::ApplyJacobianVectorResponse = "application/json"), (media::Binary = "application/x-npy"),
            (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
        )),
        Errors,
    )
)]
pub async fn apply_jacobian_vector(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(session_id): Id,
    Query(query): Query<AtQuery>,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let media = Media::accepted(&headers, &ARRAYS)?;
    let request = match http.bodies.numbers(&headers, body, "design", query.shape.as_deref()).await? {
        Sent::Document(document) => v1::ApplyJacobianVectorRequest { session_id, ..document },
        Sent::Arrays(arrays) => arrays.jvp(session_id, query.linearisation_id)?,
    };
    http.api.apply_jacobian_vector(&caller, request).await?.respond(media).await
}

/// The fields of an adjoint product whose seeds come as arrays.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct VjpQuery {
    /// From the answer of Deform. (In JSON, like all of these, a field of the document.)
    linearisation_id: Option<String>,
    /// Extents of an `application/octet-stream` body, such as `2,14824,3`.
    shape: Option<String>,
    /// Whether to return gradients with respect to the design variables; true if no others are requested.
    #[serde(default)]
    include_design: bool,
    /// Components with respect to whose control points to return gradients, separated by commas.
    control_points_of: Option<String>,
}

/// Vector-Jacobian products: gradients
///
/// Gradients of weighted sums of vertices and functions with respect to the design variables, control points, or both.
#[utoipa::path(
    post, path = "/v1/sessions/{session_id}/vjp", operation_id = "ApplyAdjoint", tag = "sessions",
    params(("session_id" = String, Path), VjpQuery),
    request_body(content(
        (v1::ApplyAdjointRequest = "application/json"), (media::Binary = "application/x-npy"),
        (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
    ), description = "Arrays: `vertices`, `functions`, `at.design`, `at.control_points.COMPONENT`."),
    responses(
        (status = 200, description = "Gradients. Arrays: `design`, `control_points.COMPONENT`.", content(
            (v1::ApplyAdjointResponse = "application/json"), (media::Binary = "application/x-npy"),
            (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
        )),
        Errors,
    )
)]
pub async fn apply_adjoint(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(session_id): Id,
    Query(query): Query<VjpQuery>,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let media = Media::accepted(&headers, &ARRAYS)?;
    let mut request = match http.bodies.numbers(&headers, body, "vertices", query.shape.as_deref()).await? {
        Sent::Document(document) => v1::ApplyAdjointRequest { session_id, ..document },
        Sent::Arrays(arrays) => {
            let components = query.control_points_of.as_deref().unwrap_or_default().split(',').map(str::trim);
            let components = components.filter(|name| !name.is_empty()).map(str::to_owned).collect();
            arrays.vjp(session_id, query.linearisation_id, query.include_design, components)?
        }
    };
    request.include_design |= request.control_points_of.is_empty();
    http.api.apply_adjoint(&caller, request).await?.respond(media).await
}
