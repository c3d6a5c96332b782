//! Checks of derivatives over HTTP.

use axum::{body::Body, extract::State, http::HeaderMap, http::StatusCode, response::Response};
use moldline_proto::v1::{self, check_response::Event};
use moldline_service::{Code, ServiceError};
use moldline_transport::{
    Answer, Caller, Deadline, Id, Problem,
    media::{self, Media},
};
use tokio::sync::mpsc;

use super::{
    Http,
    documents::Check,
    events::{self, Tell},
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
    let request = http.bodies.document::<Check>(&headers, body).await?.message(setup_id)?;
    let events = http.api.check(caller, deadline, request);
    if media == Media::Events {
        return Ok(events::stream("report", deadline, |tell| Box::pin(report(events, tell))));
    }
    media::document(StatusCode::OK, &report(events, Box::new(|_| {})).await?)
}

async fn report(
    mut events: mpsc::UnboundedReceiver<Result<v1::CheckResponse, ServiceError>>,
    mut tell: Tell,
) -> Answer<v1::CheckReport> {
    while let Some(outcome) = events.recv().await {
        match outcome?.event {
            Some(Event::Progress(progress)) => tell(progress),
            Some(Event::Report(report)) => return Ok(report),
            None => {}
        }
    }
    Err(ServiceError::new(Code::Internal, "the check ended without a report").into())
}
