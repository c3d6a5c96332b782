//! The HTTP transport of the mesh service: a route for every RPC of [`MeshApi`]. Bodies are read in `bodies` and `arrays`,
//! and written in `replies`.

pub mod arrays;
pub mod bodies;
mod check;
pub mod events;
mod jacobian;
mod operations;
pub mod replies;
pub mod responses;
mod sessions;
mod setups;

use std::sync::Arc;

use moldline_transport::Problem;
use utoipa::OpenApi;
use utoipa_axum::{router::OpenApiRouter, routes};

use crate::api::MeshApi;
use bodies::Bodies;
use operations::Operations;

/// The state of all handlers.
#[derive(Clone)]
pub struct Http {
    api: MeshApi,
    operations: Arc<Operations>,
    /// Reads bodies other than uploads.
    bodies: Bodies,
}

/// The request id that a client chose for a change, so that a retry is recognised.
fn idempotency_key(headers: &axum::http::HeaderMap) -> String {
    let key = headers.get("idempotency-key").and_then(|key| key.to_str().ok());
    key.unwrap_or_default().to_owned()
}

/// All routes, with their description. Bodies may have `max_body` bytes.
pub fn routes(api: MeshApi, max_body: usize) -> OpenApiRouter {
    let operations = Arc::new(Operations::new(api.service().limits().sharing));
    let http = Http { api, operations, bodies: Bodies { most: max_body } };
    OpenApiRouter::with_openapi(Description::openapi())
        .routes(routes!(setups::create_setup, setups::list_setups))
        .routes(routes!(setups::get_setup, setups::delete_setup))
        .routes(routes!(setups::share_setup))
        .routes(routes!(check::check))
        .routes(routes!(operations::get_operation, operations::cancel_operation))
        .routes(routes!(sessions::open_session))
        .routes(routes!(sessions::list_sessions))
        .routes(routes!(sessions::get_session, sessions::update_session, sessions::close_session))
        .routes(routes!(sessions::deform))
        .routes(routes!(sessions::apply_jacobian_vector))
        .routes(routes!(sessions::apply_adjoint))
        .routes(routes!(jacobian::jacobian))
        .routes(routes!(setups::get_status))
        .with_state(http)
}

/// The part of the description that all routes share.
#[derive(OpenApi)]
#[openapi(
    info(title = "Moldline", description = include_str!("description.md"), license(name = "Apache-2.0", identifier = "Apache-2.0")),
    components(schemas(Problem)),
    modifiers(&Bearer),
    tags(
        (name = "set-ups", description = "Geometry, mesh, parameterisation and options: immutable, named by their content."),
        (name = "sessions", description = "Work on a set-up: a design that is stored, deformations, derivatives."),
        (name = "server", description = "Load and contents of the server."),
    )
)]
struct Description;

/// Describes bearer tokens, which a server may require.
pub struct Bearer;

impl utoipa::Modify for Bearer {
    fn modify(&self, openapi: &mut utoipa::openapi::OpenApi) {
        use utoipa::openapi::security::{Http, HttpAuthScheme, SecurityRequirement, SecurityScheme};
        let scheme = SecurityScheme::Http(Http::new(HttpAuthScheme::Bearer));
        let components = openapi.components.get_or_insert_default();
        components.add_security_scheme("token", scheme);
        let none = SecurityRequirement::default();
        openapi.security = Some(vec![none, SecurityRequirement::new("token", Vec::<String>::new())]);
    }
}
