//! The error type of all services: class of the failure, its cause, and the way out.

use std::{fmt, time::Duration};

use moldline_foundation::{Class, Failure};

/// The class of an error. Each transport maps it to its own codes in one place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Code {
    /// The request is wrong whatever the state of the service.
    InvalidArgument,
    /// The named object does not exist.
    NotFound,
    /// The request id was used before with other content.
    AlreadyExists,
    /// Another request came first: read again, then decide again.
    Aborted,
    /// The caller's role does not allow it. Objects that the caller may not see are `NotFound` instead.
    PermissionDenied,
    /// The caller is unknown.
    Unauthenticated,
    /// The request is valid, but the engine fails on it: a seam is lost, a projection does not converge.
    FailedPrecondition,
    /// The service is full; retrying later may help.
    ResourceExhausted,
    /// The service is stopping, or its store cannot be reached or written to; retrying later or elsewhere may help.
    Unavailable,
    /// The caller's deadline has passed.
    DeadlineExceeded,
    /// The caller disconnected.
    Cancelled,
    /// A fault of the service.
    Internal,
}

impl Code {
    /// Its name in upper snake case, the same for all transports.
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

/// An invalid field of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// Path of the field, such as `design[3]` or `mesh.cells[312][2]`.
    pub field: String,
    /// The fault: index, value, limit and the way out.
    pub description: String,
}

/// An error as the caller sees it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct ServiceError {
    /// Its class.
    pub code: Code,
    /// Cause and way out in one sentence.
    pub message: String,
    /// The invalid fields, if the request is at fault.
    pub violations: Vec<Violation>,
    /// Delay before a retry, if one may help.
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

    /// An `InvalidArgument`: `field` of the request is invalid for the reason in `description`.
    pub fn invalid(field: impl Into<String>, description: impl Into<String>) -> Self {
        Self::new(Code::InvalidArgument, "").at(field, description)
    }

    /// A `NotFound`: there is no `kind` of that id.
    pub fn not_found(kind: &str, id: &str) -> Self {
        let field = format!("{kind}_id");
        Self::new(Code::NotFound, "").at(field, format!("there is no {kind} `{}`", shorten(id)))
    }

    /// Adds a violation, which also becomes the message if there is none yet.
    #[must_use]
    pub fn at(mut self, field: impl Into<String>, description: impl Into<String>) -> Self {
        let (field, description) = (field.into(), description.into());
        if self.message.is_empty() {
            // The engine's descriptions often begin with the field already.
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
    pub fn within(mut self, field: &str) -> Self {
        self.violations
            .iter_mut()
            .for_each(|violation| violation.field = format!("{field}.{}", violation.field));
        self
    }

    /// The same error in other words: message and descriptions as `words` gives them.
    #[must_use]
    pub fn reworded(mut self, words: impl Fn(&str) -> String) -> Self {
        self.message = words(&self.message);
        self.violations
            .iter_mut()
            .for_each(|violation| violation.description = words(&violation.description));
        self
    }

    /// Sets the delay before a retry.
    #[must_use]
    pub fn retry_after(mut self, delay: Duration) -> Self {
        self.retry_after = Some(delay);
        self
    }
}

/// Errors of the engine keep their own text, which names field, index, value and limit.
impl<E: Failure> From<E> for ServiceError {
    fn from(error: E) -> Self {
        let code = match error.class() {
            Class::Input => Code::InvalidArgument,
            Class::Computation => Code::FailedPrecondition,
            Class::Memory => Code::ResourceExhausted,
            Class::Cancelled => Code::Cancelled,
        };
        let text = error.to_string();
        match error.field() {
            Some(field) => Self::new(code, "").at(field, text),
            None => Self::new(code, text),
        }
    }
}

/// `text`, truncated if it is too long to be repeated in an error.
pub fn shorten(text: &str) -> String {
    const LONGEST: usize = 80;
    match text.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    enum EngineError {
        #[error("design[3] = NaN is not finite")]
        Design,
        #[error("cancelled")]
        Cancelled,
    }

    impl Failure for EngineError {
        fn class(&self) -> Class {
            match self {
                Self::Design => Class::Input,
                Self::Cancelled => Class::Cancelled,
            }
        }

        fn field(&self) -> Option<String> {
            matches!(self, Self::Design).then(|| "design[3]".to_owned())
        }
    }

    #[test]
    fn errors_of_an_engine_keep_class_field_and_text() {
        let error = ServiceError::from(EngineError::Design);
        assert_eq!(error, ServiceError::invalid("design[3]", "design[3] = NaN is not finite"));
        assert_eq!(error.message, "design[3] = NaN is not finite");
        assert_eq!(
            ServiceError::from(EngineError::Cancelled),
            ServiceError::new(Code::Cancelled, "cancelled")
        );
    }
}
