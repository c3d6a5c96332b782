//! Errors of the store.

use std::{error::Error, io, time::Duration};

use moldline_host::{Code, ServiceError};

/// Why an operation on the store fails. Its content is intact, except for `Corrupt` objects.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StoreError {
    /// No space.
    #[error("the store has no space left for {object}: {reason}")]
    Full {
        /// The object to be written.
        object: String,
        /// The system's message.
        reason: String,
    },
    /// No permission to write.
    #[error("the store cannot be written to, {object} is not stored: {reason}")]
    ReadOnly {
        /// The object to be written.
        object: String,
        /// The system's message.
        reason: String,
    },
    /// The bytes are not those that were written.
    #[error("{object} in the store is damaged: {reason}")]
    Corrupt {
        /// The object.
        object: String,
        /// How the damage was found.
        reason: String,
    },
    /// Anything else: a network that does not answer, say.
    #[error("the store does not answer for {object}: {reason}")]
    Unavailable {
        /// The object requested.
        object: String,
        /// The system's message.
        reason: String,
    },
    /// The store is gone, or is not the one that was opened.
    #[error(
        "the store has vanished, {reason}: bring it back (a folder that was moved, a disk that is not mounted); nothing is read \
         or written until then"
    )]
    Vanished {
        /// How that was found.
        reason: String,
    },
    /// The store cannot be opened.
    #[error("cannot open the store {location}: {reason}")]
    Location {
        /// The location as given.
        location: String,
        /// The reason.
        reason: String,
    },
}

impl StoreError {
    pub(crate) fn corrupt(object: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Corrupt { object: object.into(), reason: reason.into() }
    }

    /// Classified by the system's error at its root.
    pub(crate) fn of(object: &str, error: &object_store::Error) -> Self {
        let innermost = chain(error).last().map(ToString::to_string).unwrap_or_default();
        Self::classified(object, io_kind(error), innermost, error.to_string())
    }

    /// Classified by an error of the system.
    pub(crate) fn of_system(object: &str, error: &io::Error) -> Self {
        Self::classified(object, Some(error.kind()), error.to_string(), error.to_string())
    }

    fn classified(object: &str, kind: Option<io::ErrorKind>, reason: String, whole: String) -> Self {
        let object = object.to_owned();
        match kind {
            Some(io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge) => {
                Self::Full { object, reason }
            }
            Some(io::ErrorKind::ReadOnlyFilesystem | io::ErrorKind::PermissionDenied) => {
                Self::ReadOnly { object, reason }
            }
            _ => Self::Unavailable { object, reason: whole },
        }
    }
}

impl From<StoreError> for ServiceError {
    fn from(error: StoreError) -> Self {
        let code = match error {
            StoreError::Full { .. } => Code::ResourceExhausted,
            StoreError::Corrupt { .. } => Code::Internal,
            StoreError::ReadOnly { .. }
            | StoreError::Location { .. }
            | StoreError::Unavailable { .. }
            | StoreError::Vanished { .. } => Code::Unavailable,
        };
        let answer = Self::new(code, error.to_string());
        match error {
            StoreError::Unavailable { .. } | StoreError::Vanished { .. } => {
                answer.retry_after(Duration::from_secs(1))
            }
            _ => answer,
        }
    }
}

/// Skips a damaged record, for lists and sums. Reading it by its id still reports the damage.
///
/// # Errors
/// All errors but `Corrupt`.
pub fn unless_damaged<T>(found: Result<Option<T>, StoreError>) -> Result<Option<T>, StoreError> {
    match found {
        Err(error @ StoreError::Corrupt { .. }) => {
            tracing::error!(%error, "going on without it");
            Ok(None)
        }
        found => found,
    }
}

/// An error and its sources, outermost first.
fn chain<'e>(error: &'e (dyn Error + 'static)) -> impl Iterator<Item = &'e (dyn Error + 'static)> {
    std::iter::successors(Some(error), |&error| error.source())
}

fn io_kind(error: &(dyn Error + 'static)) -> Option<io::ErrorKind> {
    chain(error).filter_map(|error| error.downcast_ref::<io::Error>()).map(io::Error::kind).last()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn system_errors_are_classified_however_deeply_they_are_nested() {
        let of = |kind: io::ErrorKind| {
            let inner =
                object_store::Error::Generic { store: "test", source: Box::new(io::Error::from(kind)) };
            let error = object_store::Error::Generic { store: "test", source: Box::new(inner) };
            StoreError::of("blob/x", &error)
        };
        assert!(matches!(of(io::ErrorKind::StorageFull), StoreError::Full { .. }));
        assert!(matches!(of(io::ErrorKind::QuotaExceeded), StoreError::Full { .. }));
        assert!(matches!(of(io::ErrorKind::ReadOnlyFilesystem), StoreError::ReadOnly { .. }));
        assert!(matches!(of(io::ErrorKind::PermissionDenied), StoreError::ReadOnly { .. }));
        assert!(matches!(of(io::ErrorKind::TimedOut), StoreError::Unavailable { .. }));
    }
}
