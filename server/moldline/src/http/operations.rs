//! Long-running operations: set-ups that are built while their clients poll. Operations end with the process; the set-ups are
//! stored, and posting the same content again finds them.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use axum::{
    extract::State,
    http::{HeaderValue, StatusCode, header},
    response::Response,
};
use moldline_host::{Principal, ServiceError, Share, Sharing, Supply, Tenant};
use moldline_proto::v1;
use moldline_transport::{Answer, Caller, ErrorResponse, Id, Problem, media};
use serde::Serialize;
use tokio::{sync::watch, task::AbortHandle};
use tracing::{Instrument, Span};
use utoipa::ToSchema;
use uuid::Uuid;

use super::{
    Http,
    events::{Tell, Work},
    responses::Errors,
};

/// The build of a set-up, or its outcome.
#[derive(Debug, Serialize, ToSchema)]
pub struct Operation {
    /// Id of the operation, as in `/v1/operations/{operation_id}`.
    operation_id: String,
    /// Whether the operation has ended; then it has `created` or `problem`.
    done: bool,
    /// The last progress.
    progress: v1::Progress,
    /// The set-up.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    created: Option<v1::CreatedSetup>,
    /// The error.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    problem: Option<Problem>,
}

/// Operations that run or ended recently.
#[derive(Debug)]
pub struct Operations {
    all: Mutex<Vec<Entry>>,
    places: Arc<Supply>,
}

#[derive(Debug)]
struct Entry {
    id: String,
    tenant: Tenant,
    course: watch::Receiver<Course>,
    task: AbortHandle,
    _place: Share,
}

#[derive(Debug, Default)]
struct Course {
    progress: v1::Progress,
    outcome: Option<Outcome>,
}

#[derive(Debug)]
struct Outcome {
    when: Instant,
    result: Result<v1::CreatedSetup, ErrorResponse>,
}

impl Operations {
    /// None yet. Tenants have shares of their number.
    pub fn new(sharing: Sharing) -> Self {
        const MOST: u64 = 256;
        let places = Supply::new("operations that run or are remembered", "none", MOST, sharing);
        Self { all: Mutex::default(), places }
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Entry>> {
        self.all.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Runs `work` in a task of its own, and answers when it has received the whole body, or has failed.
    ///
    /// # Errors
    /// `ResourceExhausted` if too many operations of the tenant run.
    pub async fn start(
        &self,
        caller: &Principal,
        work: impl FnOnce(Tell) -> Work<v1::CreatedSetup>,
    ) -> Answer<Response> {
        let (sender, mut course) = watch::channel(Course::default());
        let id = Uuid::new_v4().simple().to_string();
        let teller = sender.clone();
        let work = work(Box::new(move |progress| teller.send_modify(|course| course.progress = progress)));
        let run = async move {
            let result = work.await;
            sender.send_modify(|course| course.outcome = Some(Outcome { when: Instant::now(), result }));
        };
        {
            let mut all = self.lock();
            let _place = make_room(&self.places, &mut all, &caller.tenant)?;
            let task = tokio::spawn(run.instrument(Span::current())).abort_handle();
            all.push(Entry {
                id: id.clone(),
                tenant: caller.tenant.clone(),
                course: course.clone(),
                task,
                _place,
            });
        }
        // A client that leaves while it sends abandons the operation.
        let mut pending = Pending { operations: self, id: Some(&id) };
        let received = |course: &Course| {
            course.outcome.is_some() || !matches!(course.progress.stage.as_str(), "" | "receive")
        };
        let _ = course.wait_for(received).await;
        pending.id = None;
        let mut response = media::document(StatusCode::ACCEPTED, &describe(&id, &course.borrow()))?;
        if let Ok(location) = HeaderValue::from_str(&format!("/v1/operations/{id}")) {
            response.headers_mut().insert(header::LOCATION, location);
        }
        Ok(response)
    }
}

/// Cancels an operation whose client leaves before the answer.
struct Pending<'a> {
    operations: &'a Operations,
    id: Option<&'a str>,
}

impl Drop for Pending<'_> {
    fn drop(&mut self) {
        if let Some(id) = self.id {
            self.operations.remove(|entry| entry.id == id);
        }
    }
}

impl Operations {
    /// Removes an operation, and cancels it if it runs.
    fn remove(&self, which: impl Fn(&Entry) -> bool) -> bool {
        let mut all = self.lock();
        let Some(index) = all.iter().position(which) else { return false };
        let entry = all.swap_remove(index);
        entry.task.abort();
        true
    }
}

/// Removes operations that ended long ago, and if the tenant has no place left, its own that ended first.
fn make_room(places: &Arc<Supply>, all: &mut Vec<Entry>, tenant: &Tenant) -> Answer<Share> {
    const KEPT: Duration = Duration::from_secs(3600);
    let ended = |entry: &Entry| entry.course.borrow().outcome.as_ref().map(|outcome| outcome.when);
    all.retain(|entry| ended(entry).is_none_or(|when| when.elapsed() < KEPT));
    loop {
        let refused = match places.take(tenant, "the operation", 1) {
            Ok(place) => return Ok(place),
            Err(refused) => refused,
        };
        let own = |index: &usize| all[*index].tenant == *tenant;
        let first = (0..all.len()).filter(own).filter_map(|index| Some((ended(&all[index])?, index))).min();
        let Some((_, index)) = first else { return Err(refused.into()) };
        all.swap_remove(index);
    }
}

fn describe(id: &str, course: &Course) -> Operation {
    let result = course.outcome.as_ref().map(|outcome| &outcome.result);
    Operation {
        operation_id: id.to_owned(),
        done: result.is_some(),
        progress: course.progress.clone(),
        created: result.and_then(|result| result.as_ref().ok()).cloned(),
        problem: result.and_then(|result| result.as_ref().err()).map(ErrorResponse::problem),
    }
}

/// Progress of a set-up's build
#[utoipa::path(
    get, path = "/v1/operations/{operation_id}", operation_id = "GetOperation", tag = "set-ups",
    params(("operation_id" = String, Path)),
    responses(
        (status = 200, description = "Progress or outcome.", body = Operation),
        Errors,
    )
)]
pub async fn get_operation(State(http): State<Http>, Caller(caller): Caller, Id(id): Id) -> Answer<Response> {
    let all = http.operations.lock();
    let entry = all.iter().find(|entry| entry.id == id && entry.tenant == caller.tenant);
    let entry = entry.ok_or_else(|| ServiceError::not_found("operation", &id))?;
    media::document(StatusCode::OK, &describe(&id, &entry.course.borrow()))
}

/// Cancels the build of a set-up
#[utoipa::path(
    delete, path = "/v1/operations/{operation_id}", operation_id = "CancelOperation", tag = "set-ups",
    params(("operation_id" = String, Path)),
    responses(
        (status = 204, description = "The operation is removed. Its build is cancelled unless other requests wait for it."),
        Errors,
    )
)]
pub async fn cancel_operation(
    State(http): State<Http>,
    Caller(caller): Caller,
    Id(id): Id,
) -> Answer<StatusCode> {
    match http.operations.remove(|entry| entry.id == id && entry.tenant == caller.tenant) {
        true => Ok(StatusCode::NO_CONTENT),
        false => Err(ServiceError::not_found("operation", &id).into()),
    }
}
