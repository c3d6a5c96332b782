//! Errors, with one code for each class of failure.

use std::{error, fmt, io, iter, path::Path, time::Duration};

use tonic_types::StatusExt;

/// Class of a failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Code {
    /// The request is invalid, whatever the state of the server.
    InvalidArgument,
    /// The caller can see nothing with this id, or the server no longer holds it.
    NotFound,
    /// An earlier request with other content had this request id.
    AlreadyExists,
    /// A concurrent update won: the session has a generation other than expected. Read it again.
    Aborted,
    /// The caller is not authenticated: the token is missing, unknown or expired.
    Unauthenticated,
    /// The caller is authenticated, but lacks the permission.
    PermissionDenied,
    /// The input is valid, but the method fails on it, such as a mesh that loses a seam or a wake that cuts the body.
    FailedPrecondition,
    /// The server or a quota is full; `retry_after` is set if a retry may succeed.
    ResourceExhausted,
    /// A message exceeds the size limit of server or client.
    OutOfRange,
    /// The call was cancelled.
    Cancelled,
    /// The call exceeded its timeout.
    DeadlineExceeded,
    /// The server cannot be reached, or is stopping.
    Unavailable,
    /// A fault of the server, or a malformed answer.
    Internal,
    /// Nothing was sent: arguments contradict each other, or a file cannot be read.
    Client,
}

impl Code {
    /// Name in upper snake case, the same in the protocol and in all clients.
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
    /// The fault: index, value, limit and the remedy.
    pub description: String,
}

/// Failure of a request.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{code}: {message}")]
pub struct Error {
    /// Class of the failure.
    pub code: Code,
    /// The failure in one sentence.
    pub message: String,
    /// Faults of the request's fields, if any.
    pub violations: Vec<FieldViolation>,
    /// Delay after which a retry may succeed, if any.
    pub retry_after: Option<Duration>,
    /// Where the error comes from.
    pub origin: Origin,
}

/// Where an error comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Origin {
    /// The server answered so.
    #[default]
    Server,
    /// This side, and the server has not seen the call.
    Unsent,
    /// The connection broke after the call was sent: the server may have carried it out, or died of it.
    Lost,
    /// One side does not trust the other.
    Trust,
}

impl Error {
    pub(crate) fn new(code: Code, message: impl Into<String>) -> Self {
        Self {
            code,
            message: message.into(),
            violations: Vec::new(),
            retry_after: None,
            origin: Origin::default(),
        }
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

    /// Whether a retry may succeed.
    pub(crate) fn may_pass(&self) -> bool {
        match self.code {
            Code::Unavailable => self.origin != Origin::Trust,
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
            origin: origin(&status),
        }
    }
}

/// A server sends details with every error; without them it is the error of this side, or of a proxy.
fn origin(status: &tonic::Status) -> Origin {
    if code(status) != Code::Unavailable || !status.details().is_empty() {
        return Origin::Server;
    }
    let says = |text: &str| causes(status).any(|cause| cause.to_string().contains(text));
    if says("invalid peer certificate") {
        return Origin::Trust;
    }
    // A call that was cancelled before it was written, or that the server has refused to begin with.
    let unsent = causes(status).any(|cause| cause.is::<tonic::ConnectError>())
        || says("operation was canceled")
        || says("refused stream")
        || says("connection refused");
    if unsent { Origin::Unsent } else { Origin::Lost }
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
        _ if causes(status).any(|cause| cause.is::<tonic::TimeoutExpired>()) => Code::DeadlineExceeded,
        // A status with a cause is local: the connection broke before the server answered.
        _ if causes(status).next().is_some() => Code::Unavailable,
        tonic::Code::Cancelled => Code::Cancelled,
        _ => Code::Internal,
    }
}

fn causes(status: &tonic::Status) -> impl Iterator<Item = &(dyn error::Error + 'static)> {
    iter::successors(error::Error::source(status), |cause| cause.source())
}
