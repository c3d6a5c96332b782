//! The table of error codes on each transport.

use axum::http::StatusCode;
use moldline_host::Code;

/// The gRPC code and the HTTP status of an error code.
pub fn codes(code: Code) -> (tonic::Code, StatusCode) {
    match code {
        Code::InvalidArgument => (tonic::Code::InvalidArgument, StatusCode::BAD_REQUEST),
        Code::Unauthenticated => (tonic::Code::Unauthenticated, StatusCode::UNAUTHORIZED),
        Code::PermissionDenied => (tonic::Code::PermissionDenied, StatusCode::FORBIDDEN),
        Code::NotFound => (tonic::Code::NotFound, StatusCode::NOT_FOUND),
        Code::AlreadyExists => (tonic::Code::AlreadyExists, StatusCode::CONFLICT),
        Code::Aborted => (tonic::Code::Aborted, StatusCode::CONFLICT),
        Code::FailedPrecondition => (tonic::Code::FailedPrecondition, StatusCode::UNPROCESSABLE_ENTITY),
        Code::ResourceExhausted => (tonic::Code::ResourceExhausted, StatusCode::TOO_MANY_REQUESTS),
        Code::Cancelled => (tonic::Code::Cancelled, client_closed_request()),
        Code::DeadlineExceeded => (tonic::Code::DeadlineExceeded, StatusCode::GATEWAY_TIMEOUT),
        Code::Unavailable => (tonic::Code::Unavailable, StatusCode::SERVICE_UNAVAILABLE),
        Code::Internal => (tonic::Code::Internal, StatusCode::INTERNAL_SERVER_ERROR),
    }
}

/// 499, as proxies log it; the client has gone.
fn client_closed_request() -> StatusCode {
    StatusCode::from_u16(499).unwrap_or(StatusCode::BAD_REQUEST)
}

/// The name of a gRPC code, in the style of [`Code::name`].
pub fn grpc_name(code: tonic::Code) -> &'static str {
    match code {
        tonic::Code::Ok => "OK",
        tonic::Code::Cancelled => "CANCELLED",
        tonic::Code::Unknown => "UNKNOWN",
        tonic::Code::InvalidArgument => "INVALID_ARGUMENT",
        tonic::Code::DeadlineExceeded => "DEADLINE_EXCEEDED",
        tonic::Code::NotFound => "NOT_FOUND",
        tonic::Code::AlreadyExists => "ALREADY_EXISTS",
        tonic::Code::PermissionDenied => "PERMISSION_DENIED",
        tonic::Code::ResourceExhausted => "RESOURCE_EXHAUSTED",
        tonic::Code::FailedPrecondition => "FAILED_PRECONDITION",
        tonic::Code::Aborted => "ABORTED",
        tonic::Code::OutOfRange => "OUT_OF_RANGE",
        tonic::Code::Unimplemented => "UNIMPLEMENTED",
        tonic::Code::Internal => "INTERNAL",
        tonic::Code::Unavailable => "UNAVAILABLE",
        tonic::Code::DataLoss => "DATA_LOSS",
        tonic::Code::Unauthenticated => "UNAUTHENTICATED",
    }
}
