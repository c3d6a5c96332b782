//! Checks of derivatives over HTTP.

use axum::{body::Body, extract::State, http::HeaderMap, http::StatusCode, response::Response};
use moldline_proto::v1::{self, check_response::Event};
use moldline_service::{Code, ServiceError};
use moldline_transport::{
    Answer, Caller, Deadline, Id, Problem, Refusal,
    media::{self, Media},
};
use tokio::sync::mpsc;
use tokio_stream::{StreamExt, wrappers::UnboundedReceiverStream};

use super::{
    Http,
    documents::Check,
    setups::{event, stream},
};

/// Checks the derivatives of a set-up
///
/// Dot products, an evaluation in dual numbers, central differences. The answer is the report; with
/// `Accept: text/event-stream` it is a stream of `progress` events and one `report` or `problem` at the end.
#[utoipa::path(
    post, path = "/v1/setups/{setup_id}/check", operation_id = "Check", tag = "set-ups",
    params(("setup_id" = String, Path)), request_body = Check,
    responses(
        (status = 200, description = "The report.", content(
            (v1::CheckReport = "application/json"), (String = "text/event-stream"),
        )),
        (status = "default", description = "An error.", body = Problem, content_type = "application/problem+json"),
    )
)]
pub async fn check(
    State(http): State<Http>,
    Caller(caller): Caller,
    axum::Extension(deadline): axum::Extension<Deadline>,
    Id(setup_id): Id,
    headers: HeaderMap,
    body: Body,
) -> Answer<Response> {
    let media = Media::accepted(&headers, &[Media::Json, Media::Events])?;
    let request = http.document::<Check>(&headers, body).await?.message(setup_id)?;
    let mut events = http.meshes.check(caller, deadline, request);
    if media == Media::Events {
        return Ok(stream(UnboundedReceiverStream::new(events).map(
            |outcome| match outcome.map(|e| e.event) {
                Ok(Some(Event::Progress(progress))) => event("progress", &progress),
                Ok(Some(Event::Report(report))) => event("report", &report),
                Ok(None) => String::new(),
                Err(error) => event("problem", &Refusal::from(error).problem()),
            },
        )));
    }
    media::document(StatusCode::OK, &report(&mut events).await?)
}

async fn report(
    events: &mut mpsc::UnboundedReceiver<Result<v1::CheckResponse, ServiceError>>,
) -> Answer<v1::CheckReport> {
    while let Some(outcome) = events.recv().await {
        if let Some(Event::Report(report)) = outcome?.event {
            return Ok(report);
        }
    }
    Err(ServiceError::new(Code::Internal, "the check ended without a report").into())
}
