//! Observation of every request: id, tracing span, log line and metrics.
//!
//! A request ends when the last byte of its answer is sent, or its client disconnects.

use std::{
    pin::Pin,
    task::{Context, Poll},
    time::Instant,
};

use axum::{
    body::{Body, Bytes},
    extract::{Request, State},
    http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header},
    middleware::Next,
    response::Response,
};
use http_body::{Body as _, Frame, SizeHint};
use metrics::{counter, gauge, histogram};
use moldline_host::Code;
use tracing::{Instrument, Span, field::Empty};
use uuid::Uuid;

use crate::{code::grpc_name, error_response::is_grpc};

/// Header of the request id in logs. A client may choose it; the answer repeats it.
pub const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

/// Names of metrics.
pub mod names {
    /// Completed requests, by rpc, transport and code.
    pub const REQUESTS: &str = "moldline_requests_total";
    /// Time from a request's arrival to the end of its answer, s, by rpc and transport.
    pub const SECONDS: &str = "moldline_request_duration_seconds";
    /// Requests in progress, by transport.
    pub const IN_FLIGHT: &str = "moldline_requests_in_flight";
}

/// Name of the RPC, the same on all transports, in the extensions of an answer.
#[derive(Clone, Debug)]
pub struct Rpc(pub String);

/// Links the new span of a request to the trace in its headers.
pub type Trace = fn(&Span, &HeaderMap);

/// Gives the request an id and a span, and observes its answer to the end.
pub async fn layer(State(trace): State<Trace>, mut request: Request, next: Next) -> Response {
    let start = Instant::now();
    let id = request_id(request.headers());
    let transport = if is_grpc(request.headers()) { "grpc" } else { "http" };
    // At level `error`, so that a log of errors alone still names the request.
    let span = tracing::error_span!(
        "request",
        otel.name = Empty,
        otel.kind = "server",
        otel.status_code = Empty,
        rpc = Empty,
        transport,
        request_id = id.to_str().unwrap_or_default(),
        tenant = Empty,
        setup = Empty,
        session = Empty,
    );
    trace(&span, request.headers());
    let in_flight = InFlight::new(transport);
    request.headers_mut().insert(REQUEST_ID, id.clone());
    let quiet = quiet(request.uri().path());
    let mut watch =
        Watch { start, span, transport, quiet, rpc: "unknown".to_owned(), code: None, _in_flight: in_flight };
    let mut response = next.run(request).instrument(watch.span.clone()).await;
    response.headers_mut().insert(REQUEST_ID, id);
    let status = response.status();
    let grpc = response.headers().get("grpc-status").and_then(grpc_code);
    // A method of another service is none of this one.
    if let Some(Rpc(name)) = response.extensions_mut().remove::<Rpc>()
        && grpc != Some(tonic::Code::Unimplemented)
    {
        watch.rpc = name;
    }
    watch.code = match response.extensions().get::<Code>() {
        Some(code) => Some(code.name()),
        None if transport == "grpc" => grpc.map(grpc_name),
        None => Some(http_name(status)),
    };
    let length = response.headers().get(header::CONTENT_LENGTH);
    let left = length.and_then(|length| length.to_str().ok()?.parse().ok());
    response.map(|inner| Body::new(Observed { inner, left, watch: Some(watch) }))
}

/// The client's request id if it is short and plain, or a new one.
fn request_id(headers: &HeaderMap) -> HeaderValue {
    let plain = |value: &&HeaderValue| {
        (1..=64).contains(&value.len())
            && value.as_bytes().iter().all(|byte| byte.is_ascii_alphanumeric() || b"-_.:/+=".contains(byte))
    };
    headers.get(REQUEST_ID).filter(plain).cloned().unwrap_or_else(|| {
        let id = Uuid::new_v4().simple().to_string();
        HeaderValue::from_str(&id).unwrap_or(HeaderValue::from_static("none"))
    })
}

/// Probes, which are frequent, are not logged.
fn quiet(path: &str) -> bool {
    matches!(path, "/healthz" | "/readyz" | "/metrics") || path.starts_with("/grpc.health.")
}

fn grpc_code(value: &HeaderValue) -> Option<tonic::Code> {
    Some(tonic::Code::from_bytes(value.as_bytes()))
}

fn http_name(status: StatusCode) -> &'static str {
    match status {
        status if status.is_success() || status.is_redirection() => "OK",
        StatusCode::NOT_FOUND => "NOT_FOUND",
        status if status.is_client_error() => "INVALID_ARGUMENT",
        _ => "INTERNAL",
    }
}

struct InFlight(&'static str);

impl InFlight {
    fn new(transport: &'static str) -> Self {
        gauge!(names::IN_FLIGHT, "transport" => transport).increment(1.0);
        Self(transport)
    }
}

impl Drop for InFlight {
    fn drop(&mut self) {
        gauge!(names::IN_FLIGHT, "transport" => self.0).decrement(1.0);
    }
}

/// A request in progress; if it is dropped before its end, the client has disconnected.
struct Watch {
    start: Instant,
    span: Span,
    transport: &'static str,
    quiet: bool,
    rpc: String,
    code: Option<&'static str>,
    _in_flight: InFlight,
}

impl Watch {
    fn end(&self, code: &'static str) {
        let seconds = self.start.elapsed().as_secs_f64();
        let (rpc, transport) = (self.rpc.clone(), self.transport);
        counter!(names::REQUESTS, "rpc" => rpc.clone(), "transport" => transport, "code" => code)
            .increment(1);
        histogram!(names::SECONDS, "rpc" => rpc.clone(), "transport" => transport).record(seconds);
        self.span.record("otel.name", &rpc).record("rpc", &rpc);
        if matches!(code, "INTERNAL" | "UNKNOWN" | "DATA_LOSS") {
            self.span.record("otel.status_code", "ERROR");
        }
        let _entered = self.span.enter();
        match self.quiet {
            true => tracing::trace!(code, seconds, "request"),
            false => tracing::info!(code, seconds, "request"),
        }
    }
}

/// The body of an answer, observed to its end.
struct Observed {
    inner: Body,
    /// Bytes to come, where that is known.
    left: Option<u64>,
    watch: Option<Watch>,
}

impl http_body::Body for Observed {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let this = &mut *self;
        let polled = match &this.watch {
            Some(watch) => watch.span.in_scope(|| Pin::new(&mut this.inner).poll_frame(context)),
            None => Pin::new(&mut this.inner).poll_frame(context),
        };
        match &polled {
            Poll::Ready(None) => {
                if let Some(watch) = this.watch.take() {
                    watch.end(watch.code.unwrap_or("OK"));
                }
            }
            Poll::Ready(Some(Ok(frame))) => {
                if let (Some(left), Some(data)) = (&mut this.left, frame.data_ref()) {
                    *left = left.saturating_sub(data.len() as u64);
                }
                let trailer = frame.trailers_ref().and_then(|trailers| trailers.get("grpc-status"));
                if let (Some(watch), Some(code)) = (&mut this.watch, trailer.and_then(grpc_code)) {
                    watch.code = Some(grpc_name(code));
                }
            }
            Poll::Ready(Some(Err(_))) => {
                if let Some(watch) = this.watch.take() {
                    watch.end("INTERNAL");
                }
            }
            Poll::Pending => {}
        }
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}

impl Drop for Observed {
    fn drop(&mut self) {
        // A body of known length is not polled again after its last byte.
        let Some(watch) = self.watch.take() else { return };
        if self.inner.is_end_stream() || self.left == Some(0) {
            watch.end(watch.code.unwrap_or("OK"));
        } else {
            watch.end("CANCELLED");
        }
    }
}
