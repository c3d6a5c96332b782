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
    query::{FlowQuery, OptionsQuery},
};
use crate::http::{
    Bearer,
    bodies::{Bodies, Sent},
    events::{self, Tell, Work},
    replies::Reply,
    responses::Errors,
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
        (name = "configurations", description = "Prepared meshes: immutable, named by their content."),
        (name = "analyses", description = "Flow over a configuration's cells, and its derivatives."),
    )
)]
struct Description;

/// Prepares a mesh
///
/// Finds trailing edges, wakes and stencils. The same content again gives the same configuration.
#[utoipa::path(
    post, path = "/v1/configurations", operation_id = "CreateConfiguration", tag = "configurations", params(OptionsQuery),
    request_body(content(
        (v1::CreateConfigurationRequest = "application/json"), (media::Binary = "application/x-npz"),
    ), description = "Arrays: `cells` (uint32, m by 4, a triangle's fourth 0xFFFFFFFF), `vertices`, `cell_groups.NAME`, `vertex_groups.NAME`."),
    responses(
        (status = 200, description = "The server already had the configuration.", body = v1::CreateConfigurationResponse),
        (status = 201, description = "The configuration is new.", body = v1::CreateConfigurationResponse, headers(("Location" = String))),
        Errors,
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
        Sent::Document(document) => document,
        Sent::Arrays(arrays) => query.create_configuration(arrays)?,
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
        Errors,
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
        (v1::AnalyzeRequest = "application/json"), (media::Binary = "application/x-npy"),
        (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
    ), description = "Arrays: `vertices`."),
    responses(
        (status = 200, description = "The analysis. Arrays, with the index of the angle: `cp.0`, `vertex_cp.0`, `sections.*.0`.", content(
            (v1::Analysis = "application/json"), (media::Binary = "application/x-npy"),
            (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"), (String = "text/event-stream"),
        )),
        Errors,
    )
)]
pub async fn analyze(
    State(http): State<Http>,
    Caller(caller): Caller,
    axum::Extension(deadline): axum::Extension<Deadline>,
    Id(configuration_id): Id,
    Query(query): Query<FlowQuery>,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let offered = [&ARRAYS[..], &[Media::Events]].concat();
    let media = Media::accepted(&headers, &offered)?;
    let request = match http.bodies.numbers(&headers, body, "vertices", query.shape.as_deref()).await? {
        Sent::Document(document) => v1::AnalyzeRequest { configuration_id, ..document },
        Sent::Arrays(arrays) => query.analyze(arrays, configuration_id)?,
    };
    if media == Media::Events {
        let work = move |tell: Tell| -> Work<v1::Analysis> {
            Box::pin(async move { Ok(http.api.analyze(&caller, request, tell).await?) })
        };
        return Ok(events::stream("analysis", deadline, work));
    }
    http.api.analyze(&caller, request, |_| {}).await?.respond(media).await
}

/// Jacobian-vector products
///
/// Changes of the outputs along directions of the vertices, the flow and the reference values.
#[utoipa::path(
    post, path = "/v1/configurations/{configuration_id}/jvp", operation_id = "ApplyJacobianVector", tag = "analyses",
    params(("configuration_id" = String, Path), FlowQuery),
    request_body(content(
        (v1::PanelServiceApplyJacobianVectorRequest = "application/json"), (media::Binary = "application/x-npy"),
        (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
    ), description = "Arrays: `vertices`, `alpha`, `sideslip`, `mach`, `area`, `chord`, `point`, `at.vertices`."),
    responses(
        (status = 200, description = "Changes. Arrays: `coefficients`, `section_loads`, `cp`.", content(
            (v1::PanelServiceApplyJacobianVectorResponse = "application/json"), (media::Binary = "application/x-npy"),
            (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
        )),
        Errors,
    )
)]
pub async fn apply_jacobian_vector(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(configuration_id): Id,
    Query(query): Query<FlowQuery>,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let media = Media::accepted(&headers, &ARRAYS)?;
    let request = match http.bodies.numbers(&headers, body, "vertices", query.shape.as_deref()).await? {
        Sent::Document(document) => {
            v1::PanelServiceApplyJacobianVectorRequest { configuration_id, ..document }
        }
        Sent::Arrays(arrays) => query.jvp(arrays, configuration_id)?,
    };
    http.api.apply_jacobian_vector(&caller, request).await?.respond(media).await
}

/// Vector-Jacobian products: gradients
///
/// Gradients of weighted sums of the outputs with respect to the vertices, the flow and the reference values.
#[utoipa::path(
    post, path = "/v1/configurations/{configuration_id}/vjp", operation_id = "ApplyAdjoint", tag = "analyses",
    params(("configuration_id" = String, Path), FlowQuery),
    request_body(content(
        (v1::PanelServiceApplyAdjointRequest = "application/json"), (media::Binary = "application/x-npy"),
        (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
    ), description = "Arrays: `coefficients`, `section_loads`, `cp`, `at.vertices`."),
    responses(
        (status = 200, description = "Gradients. Arrays: `vertices`, `alpha`, `sideslip`, `mach`, `area`, `chord`, `point`.", content(
            (v1::PanelServiceApplyAdjointResponse = "application/json"), (media::Binary = "application/x-npy"),
            (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
        )),
        Errors,
    )
)]
pub async fn apply_adjoint(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(configuration_id): Id,
    Query(query): Query<FlowQuery>,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let media = Media::accepted(&headers, &ARRAYS)?;
    let request = match http.bodies.numbers(&headers, body, "coefficients", query.shape.as_deref()).await? {
        Sent::Document(document) => v1::PanelServiceApplyAdjointRequest { configuration_id, ..document },
        Sent::Arrays(arrays) => query.vjp(arrays, configuration_id)?,
    };
    http.api.apply_adjoint(&caller, request).await?.respond(media).await
}
