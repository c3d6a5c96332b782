//! Errors of the service as gRPC statuses with google.rpc details.

use std::collections::HashMap;

use moldline_service::{Code, ServiceError};
use tonic::Status;
use tonic_types::{ErrorDetails, StatusExt};

/// Names whose errors these are in google.rpc.ErrorInfo.
const DOMAIN: &str = "moldline";

/// The status for an error. This is where errors are logged: faults of the service as errors, others for debugging.
pub fn refuse(error: ServiceError) -> Status {
    match error.code {
        Code::Internal => tracing::error!(%error, "request failed"),
        _ => tracing::debug!(%error, "request refused"),
    }
    let mut details = ErrorDetails::new();
    details.set_error_info(error.code.name(), DOMAIN, HashMap::new());
    for violation in &error.violations {
        details.add_bad_request_violation(&violation.field, &violation.description);
    }
    if error.retry_after.is_some() {
        details.set_retry_info(error.retry_after);
    }
    Status::with_error_details(code(error.code), error.message, details)
}

fn code(code: Code) -> tonic::Code {
    match code {
        Code::InvalidArgument => tonic::Code::InvalidArgument,
        Code::NotFound => tonic::Code::NotFound,
        Code::AlreadyExists => tonic::Code::AlreadyExists,
        Code::Aborted => tonic::Code::Aborted,
        Code::PermissionDenied => tonic::Code::PermissionDenied,
        Code::Unauthenticated => tonic::Code::Unauthenticated,
        Code::Unavailable => tonic::Code::Unavailable,
        Code::DeadlineExceeded => tonic::Code::DeadlineExceeded,
        Code::FailedPrecondition => tonic::Code::FailedPrecondition,
        Code::ResourceExhausted => tonic::Code::ResourceExhausted,
        Code::Cancelled => tonic::Code::Cancelled,
        Code::Internal => tonic::Code::Internal,
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn violations_and_delays_are_in_the_details() {
        let error = ServiceError::invalid("design[3]", "design[3] = NaN is not finite")
            .retry_after(Duration::from_secs(2));
        let status = refuse(error);
        assert_eq!(status.code(), tonic::Code::InvalidArgument);
        assert_eq!(status.message(), "design[3] = NaN is not finite");
        let details = status.get_error_details();
        let violations = &details.bad_request().unwrap().field_violations;
        assert_eq!(violations.len(), 1);
        assert_eq!(violations[0].field, "design[3]");
        assert_eq!(details.error_info().unwrap().reason, "INVALID_ARGUMENT");
        assert_eq!(details.retry_info().unwrap().retry_delay, Some(Duration::from_secs(2)));
    }
}
