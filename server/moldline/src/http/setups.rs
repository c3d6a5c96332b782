//! Set-ups over HTTP.

use std::sync::Arc;

use axum::{
    body::Body,
    extract::State,
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::Response,
};
use moldline_host::{Principal, ServiceError};
use moldline_proto::v1;
use moldline_transport::{
    Answer, Caller, Deadline, ErrorResponse, Id, Query,
    media::{self, ARRAYS, Chunks, Media},
};
use serde::Deserialize;
use tokio_stream::StreamExt;

use super::{
    Http,
    events::{self, Tell, Work},
    idempotency_key,
    operations::Operation,
    replies::Reply,
    responses::Errors,
};
use crate::convert;

/// The description of an upload.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct Upload {
    /// The file in the archive that describes the set-up; `setup.toml` or `setup.json` if absent.
    setup_file: Option<String>,
    /// Who else may use it. If absent: nobody for a new set-up, no change for a known one.
    #[param(inline)]
    visibility: Option<v1::Visibility>,
    /// Tenants, separated by commas, with `visibility=tenants`.
    shared_with: Option<String>,
}

/// Uploads and builds a set-up
///
/// The body is an archive of the set-up's folder, or a set-up file that needs no others. The answer comes when it is
/// built; with `Accept: text/event-stream` it is a stream of `progress` events and one `created` or `problem` at the end;
/// with `Prefer: respond-async` it is an operation to poll. The same content again gives the existing set-up.
#[utoipa::path(
    post, path = "/v1/setups", operation_id = "CreateSetup", tag = "set-ups",
    params(
        Upload,
        ("Idempotency-Key" = Option<String>, Header, description = "Chosen by the client, so that a retry is recognised."),
        ("Prefer" = Option<String>, Header, description = "`respond-async`: answer with an operation as soon as the body is received."),
    ),
    request_body(content(
        (media::Binary = "application/x-tar"), (media::Binary = "application/gzip"), (media::Binary = "application/zip"),
        (serde_json::Value = "application/json"), (String = "application/toml"),
    ), description = "An archive (tar, tar.gz, zip), or `setup.json` or `setup.toml` alone. The length of the body must be announced."),
    responses(
        (status = 200, description = "The set-up exists already.", content(
            (v1::CreatedSetup = "application/json"), (String = "text/event-stream"),
        )),
        (status = 201, description = "The set-up is new to the caller.", body = v1::CreatedSetup, headers(("Location" = String))),
        (status = 202, description = "The set-up is being built.", body = Operation, headers(("Location" = String))),
        Errors,
    )
)]
pub async fn create_setup(
    State(http): State<Http>,
    Caller(caller): Caller,
    axum::Extension(deadline): axum::Extension<Deadline>,
    Query(upload): Query<Upload>,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let media = Media::accepted(&headers, &[Media::Json, Media::Events])?;
    let header = announced(&http, upload, &headers)?;
    if media == Media::Events {
        let work = move |tell: Tell| -> Work<v1::CreatedSetup> {
            Box::pin(async move { receive(&http, &caller, header, body, tell).await })
        };
        return Ok(events::stream("created", deadline, work));
    }
    let prefer = headers.get_all("prefer").iter();
    if prefer.filter_map(|value| value.to_str().ok()).any(|value| value.contains("respond-async")) {
        let (operations, owner) = (Arc::clone(&http.operations), caller.clone());
        let work = move |tell: Tell| -> Work<v1::CreatedSetup> {
            Box::pin(async move { receive(&http, &caller, header, body, tell).await })
        };
        return operations.start(&owner, work).await;
    }
    let created = receive(&http, &caller, header, body, |_| {}).await?;
    answer(&created)
}

fn answer(created: &v1::CreatedSetup) -> Answer<Response> {
    let status = if created.built { StatusCode::CREATED } else { StatusCode::OK };
    let mut response = media::document(status, created)?;
    let location = format!("/v1/setups/{}", created.setup_id);
    if let Ok(location) = HeaderValue::from_str(&location) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    Ok(response)
}

/// The header of the upload, from the request's query and headers.
fn announced(http: &Http, upload: Upload, headers: &HeaderMap) -> Answer<v1::SetupHeader> {
    use v1::ArchiveKind::{Tar, TarGz, Zip};
    let limit = http.api.service().limits().upload_bytes;
    let length = media::length(headers, limit)?.ok_or_else(|| {
        let error = ServiceError::invalid("content-length", "is missing: announce the length of the upload");
        ErrorResponse::with(StatusCode::LENGTH_REQUIRED, error)
    })?;
    let kind = headers.get(header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or_default();
    let archive = |kind: v1::ArchiveKind| {
        v1::setup_header::Source::Archive(v1::Archive { kind: kind.into(), size: length })
    };
    let file = |path: &str| {
        let files = vec![v1::FileEntry { path: path.to_owned(), size: length }];
        v1::setup_header::Source::Files(v1::FileList { files })
    };
    let source = match kind.split(';').next().unwrap_or_default().trim().to_ascii_lowercase().as_str() {
        "application/x-tar" => archive(Tar),
        "application/gzip" | "application/x-gzip" | "application/x-tgz" => archive(TarGz),
        "application/zip" => archive(Zip),
        "application/json" => file("setup.json"),
        "application/toml" => file("setup.toml"),
        _ => {
            return Err(media::unsupported(
                "this takes application/x-tar, application/gzip, application/zip, application/json and application/toml",
            ));
        }
    };
    let shared_with = upload.shared_with.as_deref().unwrap_or_default().split(',').map(str::trim);
    Ok(v1::SetupHeader {
        request_id: idempotency_key(headers),
        setup_file: upload.setup_file.unwrap_or_default(),
        source: Some(source),
        visibility: upload.visibility.unwrap_or_default().into(),
        shared_with: shared_with.filter(|name| !name.is_empty()).map(str::to_owned).collect(),
    })
}

/// Receives and builds a set-up.
async fn receive(
    http: &Http,
    caller: &Principal,
    header: v1::SetupHeader,
    body: Body,
    tell: impl FnMut(v1::Progress),
) -> Answer<v1::CreatedSetup> {
    let header = convert::setups::upload(header)?;
    let most = http.api.service().limits().chunk_bytes;
    let parts = Chunks::new(body, most).map(|data| Ok((0, data?)));
    http.api.create_setup(caller, header, parts, tell, ErrorResponse::from).await
}

/// A page of a list.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct Page {
    /// Largest number of entries in the answer; 0 and numbers above the server's limit give that limit.
    #[serde(default)]
    #[param(format = Int64, maximum = 4294967295_u32)]
    pub page_size: u32,
    /// From the previous answer; empty for the first page.
    #[serde(default)]
    pub page_token: String,
}

/// Lists the set-ups that the caller may use
///
/// Its own, those shared with it, and public ones.
#[utoipa::path(
    get, path = "/v1/setups", operation_id = "ListSetups", tag = "set-ups", params(Page),
    responses(
        (status = 200, description = "Set-ups in the order of their ids.", body = v1::ListSetupsResponse),
        Errors,
    )
)]
pub async fn list_setups(
    State(http): State<Http>,
    Caller(caller): Caller,
    Query(Page { page_size, page_token }): Query<Page>,
) -> Answer<Response> {
    let listed = http.api.list_setups(&caller, v1::ListSetupsRequest { page_size, page_token }).await?;
    media::document(StatusCode::OK, &listed)
}

/// Optional parts of a set-up's description.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct GetSetup {
    /// Whether to return the reference mesh too. Binary answers are its arrays, the vertices first.
    #[serde(default)]
    include_mesh: bool,
    /// Whether to return the control points of the baseline too.
    #[serde(default)]
    include_control_points: bool,
}

/// Describes a set-up
///
/// Report, variables, sizes; on request its reference mesh and control points.
#[utoipa::path(
    get, path = "/v1/setups/{setup_id}", operation_id = "GetSetup", tag = "set-ups",
    params(("setup_id" = String, Path), GetSetup),
    responses(
        (status = 200, description = "The set-up.", content(
            (v1::GetSetupResponse = "application/json"), (media::Binary = "application/x-npy"),
            (media::Binary = "application/x-npz"), (media::Binary = "application/octet-stream"),
        )),
        Errors,
    )
)]
pub async fn get_setup(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(setup_id): Id,
    Query(GetSetup { include_mesh, include_control_points }): Query<GetSetup>,
    headers: HeaderMap,
) -> Answer<Response> {
    let media = Media::accepted(&headers, &ARRAYS)?;
    let request = v1::GetSetupRequest { setup_id, include_mesh, include_control_points };
    http.api.get_setup(&caller, request).await?.respond(media).await
}

/// Deletes a set-up of the caller's own
///
/// The caller's open sessions go on; those of tenants with which it was shared end. Other tenants that uploaded the same
/// content keep it.
#[utoipa::path(
    delete, path = "/v1/setups/{setup_id}", operation_id = "DeleteSetup", tag = "set-ups",
    params(("setup_id" = String, Path)),
    responses(
        (status = 204, description = "The set-up is deleted."),
        Errors,
    )
)]
pub async fn delete_setup(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(setup_id): Id,
) -> Answer<StatusCode> {
    http.api.delete_setup(&caller, v1::DeleteSetupRequest { setup_id }).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Changes who else may use a set-up of the caller's own
///
/// Who may not use it any more is refused within a second, in open sessions too.
#[utoipa::path(
    put, path = "/v1/setups/{setup_id}/access", operation_id = "ShareSetup", tag = "set-ups",
    params(("setup_id" = String, Path)), request_body = v1::ShareSetupRequest,
    responses(
        (status = 200, description = "Who may use it now.", body = v1::ShareSetupResponse),
        Errors,
    )
)]
pub async fn share_setup(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(setup_id): Id,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let document: v1::ShareSetupRequest = http.bodies.document(&headers, body).await?;
    let request = v1::ShareSetupRequest { setup_id, ..document };
    media::document(StatusCode::OK, &http.api.share_setup(&caller, request).await?)
}

/// Load and contents of the server
///
/// Those of the caller's tenant; for administrators those of all tenants.
#[utoipa::path(
    get, path = "/v1/status", operation_id = "GetStatus", tag = "server",
    responses(
        (status = 200, description = "Load, memory and running work.", body = v1::GetStatusResponse),
        Errors,
    )
)]
pub async fn get_status(State(http): State<Http>, Caller(caller): Caller) -> Answer<Response> {
    media::document(StatusCode::OK, &http.api.get_status(&caller, v1::GetStatusRequest {}).await?)
}
