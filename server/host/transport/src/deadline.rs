//! Deadlines: `grpc-timeout` of gRPC, `Request-Timeout` in seconds over HTTP.
//!
//! When the deadline passes, the handler's future is dropped, which cancels its task, and the caller gets an error. A streaming
//! answer has to observe the [`Deadline`] itself.

use std::time::Duration;

use axum::{extract::Request, http::HeaderMap, middleware::Next, response::Response};
use moldline_host::{Code, ServiceError};
use tokio::time::{Instant, timeout_at};

use crate::error_response::{is_grpc, reject};

/// Header with the timeout of an HTTP client in seconds.
pub const REQUEST_TIMEOUT: &str = "request-timeout";

/// The time at which the caller stops waiting, in the extensions of a request; `None` if it waits for ever.
#[derive(Clone, Copy, Debug, Default)]
pub struct Deadline(Option<Instant>);

impl Deadline {
    /// Waits for `work` until the deadline; `failed` converts to an error of the transport.
    ///
    /// # Errors
    /// `DeadlineExceeded`, and what `work` returns.
    pub async fn limit<T, E>(
        self,
        work: impl Future<Output = Result<T, E>>,
        failed: impl FnOnce(ServiceError) -> E,
    ) -> Result<T, E> {
        match self.0 {
            None => work.await,
            Some(end) => timeout_at(end, work).await.unwrap_or_else(|_| Err(failed(passed()))),
        }
    }
}

fn passed() -> ServiceError {
    ServiceError::new(
        Code::DeadlineExceeded,
        "the deadline that came with the request has passed; what was under way is given up",
    )
}

/// Adds the deadline to the request, and ends the wait for an answer when it passes.
pub async fn layer(mut request: Request, next: Next) -> Response {
    let grpc = is_grpc(request.headers());
    let requested = if grpc { grpc_timeout(request.headers()) } else { request_timeout(request.headers()) };
    let timeout = match requested {
        Ok(timeout) => timeout,
        Err(error) => return reject(grpc, error),
    };
    let deadline = Deadline(timeout.and_then(|timeout| Instant::now().checked_add(timeout)));
    request.extensions_mut().insert(deadline);
    if timeout == Some(Duration::ZERO) {
        return reject(grpc, passed());
    }
    let answer = async { Ok(next.run(request).await) };
    deadline.limit(answer, |error| reject(grpc, error)).await.unwrap_or_else(|rejection| rejection)
}

fn request_timeout(headers: &HeaderMap) -> Result<Option<Duration>, ServiceError> {
    let Some(value) = headers.get(REQUEST_TIMEOUT) else { return Ok(None) };
    let seconds = value.to_str().ok().and_then(|text| text.trim().parse::<f64>().ok());
    seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok()).map(Some).ok_or_else(|| {
        ServiceError::invalid(REQUEST_TIMEOUT, "is not a number of seconds, such as `30` or `0.5`")
    })
}

fn grpc_timeout(headers: &HeaderMap) -> Result<Option<Duration>, ServiceError> {
    let Some(value) = headers.get("grpc-timeout") else { return Ok(None) };
    let parse = |text: &str| {
        let (digits, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
        let count: u64 = (digits.len() <= 8).then(|| digits.parse().ok())??;
        Some(match unit {
            "H" => Duration::from_secs(3600 * count),
            "M" => Duration::from_secs(60 * count),
            "S" => Duration::from_secs(count),
            "m" => Duration::from_millis(count),
            "u" => Duration::from_micros(count),
            "n" => Duration::from_nanos(count),
            _ => return None,
        })
    };
    value.to_str().ok().and_then(parse).map(Some).ok_or_else(|| {
        ServiceError::invalid("grpc-timeout", "is not up to eight digits and one of H, M, S, m, u, n")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(name: &'static str, value: &'static str) -> HeaderMap {
        [(axum::http::HeaderName::from_static(name), axum::http::HeaderValue::from_static(value))]
            .into_iter()
            .collect()
    }

    #[test]
    fn timeouts_are_parsed_and_nonsense_is_rejected() {
        let of = |value| grpc_timeout(&headers("grpc-timeout", value));
        assert_eq!(of("250m").unwrap(), Some(Duration::from_millis(250)));
        assert_eq!(of("99999999H").unwrap(), Some(Duration::from_secs(99_999_999 * 3600)));
        for wrong in ["", "S", "5", "-1S", "123456789S", "1 S", "1h"] {
            assert_eq!(of(wrong).unwrap_err().violations[0].field, "grpc-timeout", "{wrong:?}");
        }
        let of = |value| request_timeout(&headers(REQUEST_TIMEOUT, value));
        assert_eq!(of("0.5").unwrap(), Some(Duration::from_millis(500)));
        for wrong in ["", "-1", "NaN", "inf", "1e300", "soon"] {
            assert_eq!(of(wrong).unwrap_err().violations[0].field, REQUEST_TIMEOUT, "{wrong:?}");
        }
    }
}
