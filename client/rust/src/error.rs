//! What goes wrong, one code for each class of failure.

use std::{error, fmt, io, path::Path, time::Duration};

use tonic_types::StatusExt;

/// The class of a failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Code {
    /// The request is wrong whatever the state of the server.
    InvalidArgument,
    /// There is no set-up or session of that id that the caller may see, or no linearisation any more for a bare id.
    NotFound,
    /// The request id named a request with other content before.
    AlreadyExists,
    /// Somebody else was faster: the session has another generation than was expected. Read it again.
    Aborted,
    /// The server does not know who this is: the token is missing, unknown or has expired.
    Unauthenticated,
    /// The server knows who this is, and that this is not theirs to do.
    PermissionDenied,
    /// The design is valid, but the mesh cannot follow it: a seam is lost, or a projection does not converge.
    FailedPrecondition,
    /// The server is full, or a quota is; where trying again may help, `retry_after` says when.
    ResourceExhausted,
    /// A message is larger than the server or the client accepts.
    OutOfRange,
    /// The call was cancelled.
    Cancelled,
    /// The call took longer than its timeout.
    DeadlineExceeded,
    /// The server cannot be reached, or is about to stop.
    Unavailable,
    /// A fault of the server, or an answer that cannot be understood.
    Internal,
    /// Nothing was sent: arguments contradict each other, or a file cannot be read.
    Client,
}

impl Code {
    /// A word in upper snake case, the same on the wire and in all languages.
    pub fn name(self) -> &'static str {
        match self {
            Self::InvalidArgument => "INVALID_ARGUMENT",
            Self::NotFound => "NOT_FOUND",
            Self::AlreadyExists => "ALREADY_EXISTS",
            Self::Aborted => "ABORTED",
            Self::Unauthenticated => "UNAUTHENTICATED",
            Self::PermissionDenied => "PERMISSION_DENIED",
            Self::FailedPrecondition => "FAILED_PRECONDITION",
            Self::ResourceExhausted => "RESOURCE_EXHAUSTED",
            Self::OutOfRange => "OUT_OF_RANGE",
            Self::Cancelled => "CANCELLED",
            Self::DeadlineExceeded => "DEADLINE_EXCEEDED",
            Self::Unavailable => "UNAVAILABLE",
            Self::Internal => "INTERNAL",
            Self::Client => "CLIENT",
        }
    }
}

impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// One fault of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FieldViolation {
    /// Path of the field, such as `design[3]`.
    pub field: String,
    /// What is wrong with it: index, value, limit and the way out.
    pub description: String,
}

/// A request failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{code}: {message}")]
pub struct Error {
    /// Its class.
    pub code: Code,
    /// What is wrong, in one sentence.
    pub message: String,
    /// The faults of the request, if it is the request's fault.
    pub violations: Vec<FieldViolation>,
    /// After which trying again may help, if it may.
    pub retry_after: Option<Duration>,
}

impl Error {
    pub(crate) fn new(code: Code, message: impl Into<String>) -> Self {
        Self { code, message: message.into(), violations: Vec::new(), retry_after: None }
    }

    pub(crate) fn client(message: impl Into<String>) -> Self {
        Self::new(Code::Client, message)
    }

    pub(crate) fn internal(message: impl Into<String>) -> Self {
        Self::new(Code::Internal, message)
    }

    pub(crate) fn file(path: &Path, error: &io::Error) -> Self {
        Self::client(format!("{}: {error}", path.display()))
    }

    /// Whether the same request may succeed later.
    pub(crate) fn may_pass(&self) -> bool {
        match self.code {
            Code::Unavailable => true,
            Code::ResourceExhausted => self.retry_after.is_some(),
            _ => false,
        }
    }
}

impl From<tonic::Status> for Error {
    fn from(status: tonic::Status) -> Self {
        let details = status.get_error_details();
        let violations = details.bad_request().map_or(&[][..], |request| &request.field_violations);
        Self {
            code: code(&status),
            message: status.message().to_owned(),
            violations: violations
                .iter()
                .map(|fault| FieldViolation {
                    field: fault.field.clone(),
                    description: fault.description.clone(),
                })
                .collect(),
            retry_after: details.retry_info().and_then(|retry| retry.retry_delay),
        }
    }
}

fn code(status: &tonic::Status) -> Code {
    match status.code() {
        tonic::Code::InvalidArgument => Code::InvalidArgument,
        tonic::Code::NotFound => Code::NotFound,
        tonic::Code::AlreadyExists => Code::AlreadyExists,
        tonic::Code::Aborted => Code::Aborted,
        tonic::Code::Unauthenticated => Code::Unauthenticated,
        tonic::Code::PermissionDenied => Code::PermissionDenied,
        tonic::Code::FailedPrecondition => Code::FailedPrecondition,
        tonic::Code::ResourceExhausted => Code::ResourceExhausted,
        tonic::Code::OutOfRange => Code::OutOfRange,
        tonic::Code::DeadlineExceeded => Code::DeadlineExceeded,
        tonic::Code::Unavailable => Code::Unavailable,
        // What has a cause has not come from the server: the connection broke before it answered.
        _ if error::Error::source(status).is_some() => Code::Unavailable,
        tonic::Code::Cancelled => Code::Cancelled,
        _ => Code::Internal,
    }
}
