//! Long work as server-sent events: `progress` while it runs, and its result or a `problem` at the end.

use std::{convert::Infallible, pin::Pin, time::Duration};

use axum::{
    http::header,
    response::{
        IntoResponse, Response,
        sse::{Event, KeepAlive, Sse},
    },
};
use moldline_proto::v1;
use moldline_transport::{Answer, Deadline, ErrorResponse};
use serde::Serialize;
use tokio::sync::mpsc;
use tokio_stream::{StreamExt, wrappers::UnboundedReceiverStream};
use tracing::{Instrument, Span};

/// Reports progress.
pub type Tell = Box<dyn FnMut(v1::Progress) + Send>;

/// Work that runs while its events are sent.
pub type Work<T> = Pin<Box<dyn Future<Output = Answer<T>> + Send>>;

/// Interval of comments that keep proxies from closing a silent connection.
const SILENCE: Duration = Duration::from_secs(15);

/// Streams the events of `work`. The event of its result is named `done`.
pub fn stream<T: Serialize + Send + 'static>(
    done: &'static str,
    deadline: Deadline,
    work: impl FnOnce(Tell) -> Work<T>,
) -> Response {
    let (sender, events) = mpsc::unbounded_channel();
    let teller = sender.clone();
    let work = work(Box::new(move |progress| {
        let _ = teller.send(event("progress", &progress));
    }));
    let work = async move {
        let outcome = tokio::select! {
            outcome = deadline.limit(work, ErrorResponse::from) => outcome,
            // The client has left: dropping this future cancels the work.
            () = sender.closed() => return,
        };
        let _ = sender.send(match outcome {
            Ok(result) => event(done, &result),
            Err(refusal) => event("problem", &refusal.problem()),
        });
    };
    tokio::spawn(work.instrument(Span::current()));
    let events = UnboundedReceiverStream::new(events).map(Ok::<_, Infallible>);
    let events = Sse::new(events).keep_alive(KeepAlive::new().interval(SILENCE));
    ([(header::CACHE_CONTROL, "no-store")], events).into_response()
}

fn event(name: &str, content: &impl Serialize) -> Event {
    Event::default().event(name).json_data(content).unwrap_or_default()
}
