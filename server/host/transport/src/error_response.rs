//! Errors on the wire: a gRPC status with google.rpc details, or a problem document (RFC 9457) over HTTP.

use std::collections::HashMap;

use axum::{
    body::Body,
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use moldline_host::{Code, ServiceError};
use serde::Serialize;
use tonic::Status;
use tonic_types::{ErrorDetails, StatusExt};
use utoipa::ToSchema;

use crate::code::codes;

/// The error domain in google.rpc.ErrorInfo and in the type of a problem.
const DOMAIN: &str = "moldline";

/// Cuts what a caller may have sent itself: names in errors would else come back in headers and log lines of any length.
fn bounded(mut error: ServiceError) -> ServiceError {
    const MESSAGE: usize = 2000;
    const FIELD: usize = 300;
    const VIOLATIONS: usize = 20;
    let cut = |text: &mut String, most: usize| {
        if text.len() > most {
            let end = (0..=most).rev().find(|&end| text.is_char_boundary(end)).unwrap_or(0);
            text.truncate(end);
            text.push_str("...");
        }
    };
    cut(&mut error.message, MESSAGE);
    error.violations.truncate(VIOLATIONS);
    for violation in &mut error.violations {
        cut(&mut violation.field, FIELD);
        cut(&mut violation.description, MESSAGE);
    }
    error
}

/// The gRPC status of an error.
pub fn status(error: ServiceError) -> Status {
    let error = bounded(error);
    log(&error);
    let mut details = ErrorDetails::new();
    details.set_error_info(error.code.name(), DOMAIN, HashMap::new());
    for violation in &error.violations {
        details.add_bad_request_violation(&violation.field, &violation.description);
    }
    if error.retry_after.is_some() {
        details.set_retry_info(error.retry_after);
    }
    Status::with_error_details(codes(error.code).0, error.message, details)
}

/// Logs an error: faults of the service at level `error`, others at level `debug`.
fn log(error: &ServiceError) {
    match error.code {
        Code::Internal => tracing::error!(%error, "request failed"),
        _ => tracing::debug!(%error, "request rejected"),
    }
}

/// An error over HTTP, with the status of its code or a more specific one.
#[derive(Debug)]
pub struct ErrorResponse {
    error: ServiceError,
    status: StatusCode,
}

/// A handler's answer over HTTP.
pub type Answer<T> = Result<T, ErrorResponse>;

/// An error as a problem document (RFC 9457).
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "type": "urn:moldline:error:INVALID_ARGUMENT", "title": "Bad Request", "status": 400,
    "detail": "design[3] = NaN is not finite", "code": "INVALID_ARGUMENT",
    "violations": [{ "field": "design[3]", "description": "design[3] = NaN is not finite" }],
}))]
pub struct Problem {
    /// `urn:moldline:error:` and the code.
    r#type: String,
    /// The HTTP status in words.
    title: String,
    /// The HTTP status.
    status: u16,
    /// Cause and way out in one sentence.
    detail: String,
    /// The class of the error, the same as over gRPC, such as `INVALID_ARGUMENT`.
    code: &'static str,
    /// The invalid fields, if the request is at fault.
    violations: Vec<FieldViolation>,
    /// Seconds to wait before a retry, if one may help; also in the header `Retry-After`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    retry_after_seconds: Option<f64>,
}

/// An invalid field of a request.
#[derive(Debug, Serialize, ToSchema)]
pub struct FieldViolation {
    /// Path of the field, such as `design[3]`.
    field: String,
    /// The fault: value, limit and the way out.
    description: String,
}

impl ErrorResponse {
    /// `error` with a specific HTTP status.
    pub fn with(status: StatusCode, error: ServiceError) -> Self {
        Self { error: bounded(error), status }
    }

    /// Its problem document.
    pub fn problem(&self) -> Problem {
        let ServiceError { code, message, violations, retry_after } = &self.error;
        let violations = violations.iter().map(|violation| FieldViolation {
            field: violation.field.clone(),
            description: violation.description.clone(),
        });
        Problem {
            r#type: format!("urn:{DOMAIN}:error:{}", code.name()),
            title: self.status.canonical_reason().unwrap_or("Client Closed Request").to_owned(),
            status: self.status.as_u16(),
            detail: message.clone(),
            code: code.name(),
            violations: violations.collect(),
            retry_after_seconds: retry_after.map(|delay| delay.as_secs_f64()),
        }
    }
}

impl From<ServiceError> for ErrorResponse {
    fn from(error: ServiceError) -> Self {
        Self::with(codes(error.code).1, error)
    }
}

impl IntoResponse for ErrorResponse {
    fn into_response(self) -> Response {
        log(&self.error);
        let body = serde_json::to_vec(&self.problem()).unwrap_or_default();
        let mut response = Response::new(Body::from(body));
        *response.status_mut() = self.status;
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/problem+json"));
        if let Some(delay) = self.error.retry_after {
            headers.insert(header::RETRY_AFTER, (delay.as_secs_f64().ceil() as u64).into());
        }
        if self.status == StatusCode::UNAUTHORIZED {
            headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        response.extensions_mut().insert(self.error.code);
        response
    }
}

/// Whether a request speaks gRPC or gRPC-Web.
pub fn is_grpc(headers: &HeaderMap) -> bool {
    headers.get(header::CONTENT_TYPE).is_some_and(|kind| kind.as_bytes().starts_with(b"application/grpc"))
}

/// The error response to a request that no handler has seen, for its protocol.
pub fn reject(grpc: bool, error: ServiceError) -> Response {
    match grpc {
        true => status(error).into_http(),
        false => ErrorResponse::from(error).into_response(),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::code::grpc_name;

    fn error() -> ServiceError {
        ServiceError::invalid("design[3]", "design[3] = NaN is not finite")
            .retry_after(Duration::from_millis(1500))
    }

    #[test]
    fn violations_and_delays_are_in_the_details() {
        let status = status(error());
        assert_eq!(status.code(), tonic::Code::InvalidArgument);
        assert_eq!(status.message(), "design[3] = NaN is not finite");
        let details = status.get_error_details();
        let violations = &details.bad_request().unwrap().field_violations;
        assert_eq!(violations.len(), 1);
        assert_eq!(violations[0].field, "design[3]");
        assert_eq!(details.error_info().unwrap().reason, "INVALID_ARGUMENT");
        assert_eq!(details.retry_info().unwrap().retry_delay, Some(Duration::from_millis(1500)));
    }

    #[test]
    fn a_problem_has_the_same_content() {
        let response = ErrorResponse::from(error());
        assert_eq!(
            serde_json::to_value(response.problem()).unwrap(),
            serde_json::json!({
                "type": "urn:moldline:error:INVALID_ARGUMENT", "title": "Bad Request", "status": 400,
                "detail": "design[3] = NaN is not finite", "code": "INVALID_ARGUMENT",
                "violations": [{ "field": "design[3]", "description": "design[3] = NaN is not finite" }],
                "retry_after_seconds": 1.5,
            })
        );
        let response = response.into_response();
        assert_eq!(response.headers()[header::CONTENT_TYPE], "application/problem+json");
        // Whole seconds, and never too early.
        assert_eq!(response.headers()[header::RETRY_AFTER], "2");
    }

    #[test]
    fn what_the_caller_sent_comes_back_short() {
        let name = "ä".repeat(1 << 20);
        let mut error = ServiceError::invalid(format!("points[\"{name}\"]"), format!("there is no `{name}`"));
        error.violations = vec![error.violations[0].clone(); 1000];
        let problem = serde_json::to_vec(&ErrorResponse::from(error.clone()).problem()).unwrap();
        assert!(problem.len() < 64 << 10, "{}", problem.len());
        let status = status(error);
        assert!(status.message().len() < 2100 && status.details().len() < 64 << 10);
    }

    #[test]
    fn codes_have_the_same_name_everywhere() {
        for code in
            [Code::Aborted, Code::Unavailable, Code::PermissionDenied, Code::DeadlineExceeded, Code::Internal]
        {
            assert_eq!(grpc_name(codes(code).0), code.name());
        }
        let unauthenticated = reject(false, ServiceError::new(Code::Unauthenticated, "who?"));
        assert_eq!(unauthenticated.headers()[header::WWW_AUTHENTICATE], "Bearer");
    }
}
