//! One error type for all transports: what class of failure, what exactly, and what to do about it.

use std::{fmt, time::Duration};

/// The class of a failure. Each transport maps it to its own codes in one place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Code {
    /// The request is wrong whatever the state of the service.
    InvalidArgument,
    /// The set-up or session does not exist.
    NotFound,
    /// A request id was used before with other content.
    AlreadyExists,
    /// Somebody else was faster: read again, then decide again.
    Aborted,
    /// The caller's role does not allow it. Never said of what the caller may not see: that is `NotFound`.
    PermissionDenied,
    /// Nobody knows who calls.
    Unauthenticated,
    /// Valid, but the engine cannot do it from here: a seam is lost, a projection does not converge.
    FailedPrecondition,
    /// The service is full; later it may not be.
    ResourceExhausted,
    /// The service ends, or its store cannot be reached or written to; later or elsewhere it may work.
    Unavailable,
    /// The caller's deadline has passed.
    DeadlineExceeded,
    /// The caller went away.
    Cancelled,
    /// A fault of the service.
    Internal,
}

impl Code {
    /// A word in upper snake case, the same for all transports.
    pub fn name(self) -> &'static str {
        match self {
            Self::InvalidArgument => "INVALID_ARGUMENT",
            Self::NotFound => "NOT_FOUND",
            Self::AlreadyExists => "ALREADY_EXISTS",
            Self::Aborted => "ABORTED",
            Self::PermissionDenied => "PERMISSION_DENIED",
            Self::Unauthenticated => "UNAUTHENTICATED",
            Self::FailedPrecondition => "FAILED_PRECONDITION",
            Self::ResourceExhausted => "RESOURCE_EXHAUSTED",
            Self::Unavailable => "UNAVAILABLE",
            Self::DeadlineExceeded => "DEADLINE_EXCEEDED",
            Self::Cancelled => "CANCELLED",
            Self::Internal => "INTERNAL",
        }
    }
}

/// One fault in a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// Path of the field, such as `design[3]` or `mesh.cells[312][2]`.
    pub field: String,
    /// What is wrong with it: index, value, limit and the way out.
    pub description: String,
}

/// A failure as the caller sees it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct ServiceError {
    /// Its class.
    pub code: Code,
    /// The whole story in one sentence.
    pub message: String,
    /// The faults of the request, if it is one's fault.
    pub violations: Vec<Violation>,
    /// When to try again, if that may help.
    pub retry_after: Option<Duration>,
}

impl fmt::Display for ServiceError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.code.name(), self.message)
    }
}

impl ServiceError {
    /// An error of class `code` without further details.
    pub fn new(code: Code, message: impl Into<String>) -> Self {
        Self { code, message: message.into(), violations: Vec::new(), retry_after: None }
    }

    /// `field` of the request is wrong as `description` says.
    pub fn invalid(field: impl Into<String>, description: impl Into<String>) -> Self {
        Self::new(Code::InvalidArgument, "").at(field, description)
    }

    /// There is no `kind` of that id.
    pub fn not_found(kind: &str, id: &str) -> Self {
        let field = format!("{kind}_id");
        Self::new(Code::NotFound, "").at(field, format!("there is no {kind} `{}`", shorten(id)))
    }

    /// Adds a violation; it becomes the message if there is none yet.
    #[must_use]
    pub fn at(mut self, field: impl Into<String>, description: impl Into<String>) -> Self {
        let (field, description) = (field.into(), description.into());
        if self.message.is_empty() {
            // Descriptions of the engine begin with the field already.
            self.message = if description.starts_with(&field) {
                description.clone()
            } else {
                format!("{field}: {description}")
            };
        }
        self.violations.push(Violation { field, description });
        self
    }

    /// Puts the fields of all violations below `field`.
    #[must_use]
    pub(crate) fn within(mut self, field: &str) -> Self {
        self.violations
            .iter_mut()
            .for_each(|violation| violation.field = format!("{field}.{}", violation.field));
        self
    }

    /// Names the time after which trying again may help.
    #[must_use]
    pub fn retry_after(mut self, delay: Duration) -> Self {
        self.retry_after = Some(delay);
        self
    }
}

/// `text`, cut where it is too long to be repeated in an error.
pub(crate) fn shorten(text: &str) -> String {
    const LONGEST: usize = 80;
    match text.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}
