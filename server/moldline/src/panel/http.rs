//! The HTTP transport of the panel method's service: a route for every RPC of [`PanelApi`].

use axum::{
    body::Body,
    extract::State,
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::Response,
};
use moldline_proto::v1;
use moldline_transport::{
    Answer, Caller, Deadline, Id, Problem, Query,
    media::{self, ARRAYS, Media},
};
use utoipa::OpenApi;
use utoipa_axum::{router::OpenApiRouter, routes};

use super::{
    api::PanelApi,
    documents::{Analyze, CreateConfiguration, FlowQuery, Jvp, OptionsQuery, Vjp},
};
use crate::http::{
    Bearer,
    bodies::{Bodies, Sent},
    events::{self, Tell, Work},
    replies::Reply,
};

/// The state of all handlers.
#[derive(Clone)]
pub struct Http {
    api: PanelApi,
    bodies: Bodies,
}

/// All routes, with their description. Bodies may have `max_body` bytes.
pub fn routes(api: PanelApi, max_body: usize) -> OpenApiRouter {
    OpenApiRouter::with_openapi(Description::openapi())
        .routes(routes!(create_configuration))
        .routes(routes!(get_configuration))
        .routes(routes!(analyze))
        .routes(routes!(apply_jacobian_vector))
        .routes(routes!(apply_adjoint))
        .with_state(Http { api, bodies: Bodies { most: max_body } })
}

/// The part of the description that all routes share.
#[derive(OpenApi)]
#[openapi(
    info(title = "Moldline panel method", description = include_str!("description.md"), license(name = "Apache-2.0", identifier = "Apache-2.0")),
    components(schemas(Problem)),
    modifiers(&Bearer),
    tags(
        (name = "configurations", description = "Meshes made ready: immutable, named by their content."),
        (name = "analyses", description = "Flow over a configuration's cells, and its derivatives."),
    )
)]
struct Description;

/// Makes a mesh ready
///
/// Finds trailing edges, wakes and stencils. The same content again gives the same configuration.
#[utoipa::path(
    post, path = "/v1/configurations", operation_id = "CreateConfiguration", tag = "configurations", params(OptionsQuery),
    request_body(content(
        (CreateConfiguration = "application/json"), (media::Binary = "application/x-npz"),
    ), description = "Arrays: `cells` (uint32, m by 4, a triangle's fourth 0xFFFFFFFF), `vertices`, `cell_groups.NAME`, `vertex_groups.NAME`."),
    responses(
        (status = 200, description = "The server had it.", body = v1::CreateConfigurationResponse),
        (status = 201, description = "It is new.", body = v1::CreateConfigurationResponse, headers(("Location" = String))),
        (status = "default", description = "An error.", body = Problem, content_type = "application/problem+json"),
    )
)]
pub async fn create_configuration(
    State(http): State<Http>,
    Caller(caller): Caller,
    Query(query): Query<OptionsQuery>,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let request = match http.bodies.numbers(&headers, body, "vertices", None).await? {
        Sent::Document(document) => CreateConfiguration::message(document)?,
        Sent::Arrays(arrays) => CreateConfiguration::of_arrays(arrays, query.options()?)?,
    };
    let answer = http.api.create_configuration(&caller, request).await?;
    let status = if answer.created { StatusCode::CREATED } else { StatusCode::OK };
    let mut response = media::document(status, &answer)?;
    let id = answer.configuration.map(|configuration| configuration.configuration_id).unwrap_or_default();
    if let Ok(location) = HeaderValue::from_str(&format!("/v1/configurations/{id}")) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    Ok(response)
}

/// Describes a configuration
#[utoipa::path(
    get, path = "/v1/configurations/{configuration_id}", operation_id = "GetConfiguration", tag = "configurations",
    params(("configuration_id" = String, Path)),
    responses(
        (status = 200, description = "The configuration.", body = v1::GetConfigurationResponse),
        (status = "default", description = "An error.", body = Problem, content_type = "application/problem+json"),
    )
)]
pub async fn get_configuration(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(configuration_id): Id,
) -> Answer<Response> {
    let request = v1::GetConfigurationRequest { configuration_id };
    media::document(StatusCode::OK, &http.api.get_configuration(&caller, request).await?)
}

/// Analyses the flow
///
/// With `Accept: text/event-stream` the answer is a stream of `progress` events and one `analysis` or `problem` at the end.
/// The main array of the request is `vertices`, that of the answer the pressure coefficient of every cell at the first angle;
/// `Moldline-Analysis-Id` names the analysis.
#[utoipa::path(
    post, path = "/v1/configurations/{configuration_id}/analyze", operation_id = "Analyze", tag = "analyses",
    params(("configuration_id" = String, Path), FlowQuery),
    request_body(content(
        (Analyze = "application/json"), (media::Binary = "application/x-npy"),
        (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
    ), description = "Arrays: `vertices`."),
    responses(
        (status = 200, description = "The analysis. Arrays, with the index of the angle: `cp.0`, `vertex_cp.0`, `sections.*.0`.", content(
            (v1::Analysis = "application/json"), (media::Binary = "application/x-npy"),
            (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"), (String = "text/event-stream"),
        )),
        (status = "default", description = "An error.", body = Problem, content_type = "application/problem+json"),
    )
)]
pub async fn analyze(
    State(http): State<Http>,
    Caller(caller): Caller,
    axum::Extension(deadline): axum::Extension<Deadline>,
    Id(id): Id,
    Query(query): Query<FlowQuery>,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let offered = [&ARRAYS[..], &[Media::Events]].concat();
    let media = Media::accepted(&headers, &offered)?;
    let request = match http.bodies.numbers(&headers, body, "vertices", query.shape.as_deref()).await? {
        Sent::Document(document) => Analyze::message(document, id),
        Sent::Arrays(arrays) => query.analyze(arrays, id)?,
    };
    if media == Media::Events {
        let work = move |tell: Tell| -> Work<v1::Analysis> {
            Box::pin(async move { Ok(http.api.analyze(&caller, request, tell).await?) })
        };
        return Ok(events::stream("analysis", deadline, work));
    }
    http.api.analyze(&caller, request, |_| {}).await?.respond(media)
}

/// Jacobian-vector products
///
/// How the outputs change along directions of the vertices, of flow and reference values.
#[utoipa::path(
    post, path = "/v1/configurations/{configuration_id}/jvp", operation_id = "ApplyJacobianVector", tag = "analyses",
    params(("configuration_id" = String, Path), FlowQuery),
    request_body(content(
        (Jvp = "application/json"), (media::Binary = "application/x-npy"),
        (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
    ), description = "Arrays: `vertices`, `alpha`, `sideslip`, `mach`, `area`, `chord`, `point`, `at.vertices`."),
    responses(
        (status = 200, description = "Changes. Arrays: `coefficients`, `section_loads`, `cp`.", content(
            (v1::PanelServiceApplyJacobianVectorResponse = "application/json"), (media::Binary = "application/x-npy"),
            (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
        )),
        (status = "default", description = "An error.", body = Problem, content_type = "application/problem+json"),
    )
)]
pub async fn apply_jacobian_vector(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(id): Id,
    Query(query): Query<FlowQuery>,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let media = Media::accepted(&headers, &ARRAYS)?;
    let request = match http.bodies.numbers(&headers, body, "vertices", query.shape.as_deref()).await? {
        Sent::Document(document) => Jvp::message(document, id),
        Sent::Arrays(arrays) => query.jvp(arrays, id)?,
    };
    http.api.apply_jacobian_vector(&caller, request).await?.respond(media)
}

/// Vector-Jacobian products: gradients
///
/// Gradients of weighted sums of the outputs by the vertices, by flow and reference values.
#[utoipa::path(
    post, path = "/v1/configurations/{configuration_id}/vjp", operation_id = "ApplyAdjoint", tag = "analyses",
    params(("configuration_id" = String, Path), FlowQuery),
    request_body(content(
        (Vjp = "application/json"), (media::Binary = "application/x-npy"),
        (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
    ), description = "Arrays: `coefficients`, `section_loads`, `cp`, `at.vertices`."),
    responses(
        (status = 200, description = "Gradients. Arrays: `vertices`, `alpha`, `sideslip`, `mach`, `area`, `chord`, `point`.", content(
            (v1::PanelServiceApplyAdjointResponse = "application/json"), (media::Binary = "application/x-npy"),
            (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
        )),
        (status = "default", description = "An error.", body = Problem, content_type = "application/problem+json"),
    )
)]
pub async fn apply_adjoint(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(id): Id,
    Query(query): Query<FlowQuery>,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let media = Media::accepted(&headers, &ARRAYS)?;
    let request = match http.bodies.numbers(&headers, body, "coefficients", query.shape.as_deref()).await? {
        Sent::Document(document) => Vjp::message(document, id),
        Sent::Arrays(arrays) => query.vjp(arrays, id)?,
    };
    http.api.apply_adjoint(&caller, request).await?.respond(media)
}
