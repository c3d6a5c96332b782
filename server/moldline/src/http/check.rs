//! Checks of derivatives over HTTP.

use axum::{body::Body, extract::State, http::HeaderMap, http::StatusCode, response::Response};
use moldline_host::{Code, ServiceError};
use moldline_proto::{
    json::read::Design,
    v1::{self, check_request::At, check_response::Event},
};
use moldline_transport::{
    Answer, Caller, Deadline, Id,
    media::{self, Media},
};
use serde::Deserialize;
use tokio::sync::mpsc;
use utoipa::ToSchema;

use super::{
    Http,
    events::{self, Tell},
    responses::Errors,
};

/// What to check. At the baseline if neither a number of designs nor a design is given.
///
/// A document of its own, and not the message: it can give two of the message's alternatives, which is an error of the field
/// `designs`, and its default seed is 1.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = CheckRequest, description = "What to check. At the baseline if neither a number of designs nor a design is given.")]
pub struct Check {
    /// Number of designs: the baseline, then random ones far from it.
    #[schema(nullable = false, format = Int64, maximum = 4294967295_u32)]
    designs: Option<u32>,
    /// This design: every variable in order, or some by name.
    #[schema(nullable = false)]
    design: Option<Design>,
    /// Seed of the random designs and vectors.
    #[serde(default = "first_seed")]
    seed: u64,
    /// Variables to compare with dual numbers and differences, by name or by the name of an array of them; all if empty.
    #[serde(default)]
    variables: Vec<String>,
}

fn first_seed() -> u64 {
    1
}

impl Check {
    /// The message.
    ///
    /// # Errors
    /// `InvalidArgument` for a number of designs beside a design.
    fn message(self, setup_id: String) -> Result<v1::CheckRequest, ServiceError> {
        let Self { designs, design, seed, variables } = self;
        let at = match (designs, design) {
            (Some(_), Some(_)) => {
                return Err(ServiceError::invalid("designs", "is given beside `design`; give one of them"));
            }
            (Some(count), None) => Some(At::Designs(count)),
            (None, Some(Design::Vector(vector))) => Some(At::Design(vector)),
            (None, Some(Design::Named(named))) => Some(At::Named(named)),
            (None, None) => None,
        };
        Ok(v1::CheckRequest { setup_id, at, seed, variables })
    }
}

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
        Errors,
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
