//! The router around a service: everything that does not depend on what the service does.
//!
//! ```text
//! request -> id, span, metrics -> deadline -> route -> credential -> role, memory -> handler -> answer observed to its end
//! ```

use std::{collections::HashMap, pin::Pin, sync::Arc, time::Duration};

use axum::{
    Router,
    extract::{MatchedPath, Request, State},
    http::{HeaderName, HeaderValue, StatusCode, header},
    middleware::{self, Next},
    response::{IntoResponse, Response},
    routing::get,
};
use metrics_exporter_prometheus::PrometheusHandle;
use moldline_host::{Code, ServiceError};
use tonic::service::Routes;
use tonic_web::GrpcWebLayer;
use tower_http::cors::{AllowOrigin, CorsLayer};
use utoipa::openapi::OpenApi;
use utoipa_axum::router::OpenApiRouter;

use crate::{
    access::{self, Access},
    admit::{self, Admission},
    deadline,
    error_response::{ErrorResponse, is_grpc, reject},
    health::Health,
    local,
    media::SHAPE,
    methods,
    observe::{self, REQUEST_ID, Rpc, Trace},
};

/// The routes of a service.
pub struct Served {
    /// HTTP routes with their description, behind authentication.
    pub http: OpenApiRouter,
    /// Files for browsers, without authentication.
    pub pages: Router,
    /// gRPC services behind authentication.
    pub grpc: Routes,
    /// gRPC services without authentication: health, reflection.
    pub open: Routes,
    /// What is asked of a request before its body is read.
    pub admission: Admission,
}

/// Updates the gauges of /metrics.
pub type Gauges = Arc<dyn Fn() -> Pin<Box<dyn Future<Output = ()> + Send>> + Send + Sync>;

/// Configuration of the router around a service.
pub struct Surroundings {
    /// Authentication.
    pub access: Arc<Access>,
    /// State of the probes.
    pub health: Health,
    /// The metrics.
    pub metrics: PrometheusHandle,
    /// Gauges, updated whenever /metrics is read.
    pub gauges: Gauges,
    /// Link from a span to the caller's trace.
    pub trace: Trace,
    /// Origins of web pages that may call (CORS).
    pub origins: Vec<HeaderValue>,
    /// Whether callers are trusted because they are on this machine: then web pages that they visit are kept out.
    pub local: bool,
}

/// The router of probes and metrics on a port of its own, without credentials.
pub fn administration(health: Health, metrics: PrometheusHandle, gauges: Gauges) -> Router {
    let scrape = move || scrape(Arc::clone(&gauges), metrics.clone());
    Router::new()
        .route("/healthz", get(|| async { "alive\n" }))
        .route("/readyz", get(move || async move { health.ready() }))
        .route("/metrics", get(scrape))
}

async fn scrape(gauges: Gauges, metrics: PrometheusHandle) -> impl IntoResponse {
    gauges().await;
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4")], metrics.render())
}

/// The router of everything on the port.
pub fn router(served: Served, surroundings: Surroundings) -> Router {
    let Surroundings { access, health, metrics, gauges, trace, origins, local } = surroundings;
    let (http, openapi) = served.http.split_for_parts();
    let operations = Arc::new(operations(&openapi));
    let described: Arc<str> = openapi.to_json().unwrap_or_default().into();

    let scrape = move || scrape(Arc::clone(&gauges), metrics.clone());
    let authenticate = middleware::from_fn_with_state(access, access::layer);
    let admit = middleware::from_fn_with_state(served.admission, admit::layer);
    let administrators =
        Router::new().route("/metrics", get(scrape)).route_layer(middleware::from_fn(access::administrators));
    let http = http
        .route_layer(admit.clone())
        .merge(administrators)
        .route_layer(authenticate.clone())
        .route_layer(middleware::from_fn_with_state(operations, name_http));
    let grpc =
        only_routes(served.grpc).route_layer(admit).route_layer(authenticate).merge(only_routes(served.open));
    let grpc = grpc.layer(GrpcWebLayer::new()).route_layer(middleware::from_fn(name_grpc));
    let open = Router::new()
        .route("/healthz", get(|| async { "alive\n" }))
        .route("/readyz", get(move || async move { health.ready() }))
        .route("/openapi.json", get(move || openapi_json(Arc::clone(&described))))
        .route("/docs", get(docs));
    let mut router = http
        .merge(open)
        .merge(served.pages)
        .merge(grpc)
        .fallback(unknown)
        .method_not_allowed_fallback(method_not_allowed)
        .layer(middleware::from_fn(deadline::layer));
    if local {
        router = router.layer(middleware::from_fn_with_state(Arc::from(origins.clone()), local::layer));
    }
    if !origins.is_empty() {
        router = router.layer(cors(origins));
    }
    router.layer(middleware::from_fn_with_state(trace, observe::layer))
}

/// The services' routes without tonic's fallback.
fn only_routes(routes: Routes) -> Router {
    routes.into_axum_router().reset_fallback()
}

/// Operation ids by method and path.
fn operations(openapi: &OpenApi) -> HashMap<(String, String), String> {
    let mut names = HashMap::new();
    for (path, item) in &openapi.paths.paths {
        let methods = [
            ("GET", &item.get),
            ("PUT", &item.put),
            ("POST", &item.post),
            ("DELETE", &item.delete),
            ("PATCH", &item.patch),
        ];
        for (method, operation) in methods {
            if let Some(name) = operation.as_ref().and_then(|operation| operation.operation_id.clone()) {
                names.insert((method.to_owned(), path.clone()), name);
            }
        }
    }
    names
}

async fn name_http(
    State(operations): State<Arc<HashMap<(String, String), String>>>,
    mut request: Request,
    next: Next,
) -> Response {
    let path = request.extensions().get::<MatchedPath>().map(|path| path.as_str().to_owned());
    let key = (request.method().as_str().to_owned(), path.unwrap_or_default());
    let rpc = Rpc(operations.get(&key).cloned().unwrap_or(key.1));
    request.extensions_mut().insert(rpc.clone());
    let mut response = next.run(request).await;
    response.extensions_mut().insert(rpc);
    response
}

async fn name_grpc(mut request: Request, next: Next) -> Response {
    let rpc = methods::name_of(request.uri().path()).map(|name| Rpc(name.to_owned()));
    if let Some(rpc) = &rpc {
        request.extensions_mut().insert(rpc.clone());
    }
    let mut response = next.run(request).await;
    if let Some(rpc) = rpc {
        response.extensions_mut().insert(rpc);
    }
    response
}

async fn openapi_json(described: Arc<str>) -> impl IntoResponse {
    ([(header::CONTENT_TYPE, "application/json")], described.to_string())
}

async fn docs() -> impl IntoResponse {
    const POLICY: &str =
        "default-src 'none'; connect-src 'self'; script-src 'unsafe-inline'; style-src 'unsafe-inline'";
    (
        [(header::CONTENT_TYPE, "text/html; charset=utf-8"), (header::CONTENT_SECURITY_POLICY, POLICY)],
        include_str!("docs.html"),
    )
}

async fn unknown(request: Request) -> Response {
    if is_grpc(request.headers()) {
        return tonic::Status::unimplemented("there is no such method").into_http();
    }
    reject(false, ServiceError::new(Code::NotFound, "there is nothing at this path; /docs lists the paths"))
}

async fn method_not_allowed(request: Request) -> Response {
    if is_grpc(request.headers()) {
        return tonic::Status::unimplemented("there is no such method").into_http();
    }
    let message = format!("{} is not allowed for this path; /docs lists the methods", request.method());
    let error = ServiceError::new(Code::InvalidArgument, message);
    ErrorResponse::with(StatusCode::METHOD_NOT_ALLOWED, error).into_response()
}

/// Lets pages of these origins call, and read the headers of answers.
fn cors(origins: Vec<HeaderValue>) -> CorsLayer {
    let exposed = [
        "grpc-status",
        "grpc-message",
        "grpc-status-details-bin",
        "location",
        "server-timing",
        "retry-after",
    ];
    let exposed = exposed.map(HeaderName::from_static).into_iter().chain([REQUEST_ID, SHAPE]);
    CorsLayer::new()
        .allow_origin(AllowOrigin::list(origins))
        .allow_methods(tower_http::cors::AllowMethods::mirror_request())
        .allow_headers(tower_http::cors::AllowHeaders::mirror_request())
        .expose_headers(exposed.collect::<Vec<_>>())
        .max_age(Duration::from_secs(3600))
}
