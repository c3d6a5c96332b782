//! Long work as server-sent events: `progress` as it goes on, and its result or a `problem` at the end.

use std::pin::Pin;

use axum::{
    body::{Body, Bytes},
    http::{HeaderValue, header},
    response::Response,
};
use moldline_proto::v1;
use moldline_transport::{Answer, Deadline, Refusal, media::Media};
use serde::Serialize;
use tokio::{
    sync::mpsc,
    time::{Duration, sleep},
};
use tokio_stream::{StreamExt, wrappers::UnboundedReceiverStream};
use tracing::{Instrument, Span};

/// Tells about progress.
pub type Tell = Box<dyn FnMut(v1::Progress) + Send>;

/// What goes on.
pub type Work<T> = Pin<Box<dyn Future<Output = Answer<T>> + Send>>;

/// The answer that tells of `work`, whose result is an event named `done`.
pub fn stream<T: Serialize + Send + 'static>(
    done: &'static str,
    deadline: Deadline,
    work: impl FnOnce(Tell) -> Work<T>,
) -> Response {
    /// Between words that keep proxies from closing a silent connection.
    const SILENCE: Duration = Duration::from_secs(15);
    let (sender, events) = mpsc::unbounded_channel();
    let teller = sender.clone();
    let work = work(Box::new(move |progress| {
        let _ = teller.send(event("progress", &progress));
    }));
    let work = async move {
        let work = deadline.limit(work, Refusal::from);
        tokio::pin!(work);
        let outcome = loop {
            tokio::select! {
                outcome = &mut work => break outcome,
                // The client has gone: the interest in the work goes with this future.
                () = sender.closed() => return,
                () = sleep(SILENCE) => { let _ = sender.send(Bytes::from_static(b":\n\n")); }
            }
        };
        let _ = sender.send(match outcome {
            Ok(result) => event(done, &result),
            Err(refusal) => event("problem", &refusal.problem()),
        });
    };
    tokio::spawn(work.instrument(Span::current()));
    let frames = UnboundedReceiverStream::new(events).map(Ok::<_, std::convert::Infallible>);
    let mut response = Response::new(Body::from_stream(frames));
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(Media::Events.name()));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    response
}

fn event(name: &str, content: &impl Serialize) -> Bytes {
    let content = serde_json::to_string(content).unwrap_or_default();
    format!("event: {name}\ndata: {content}\n\n").into()
}
