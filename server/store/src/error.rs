//! Errors of the store.

use std::{error::Error, io};

/// An error of the store. Stored objects are intact, except with `Corrupt`.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StoreError {
    /// No space is left.
    #[error("the store has no space left for {object}: {reason}")]
    Full {
        /// What was to be written.
        object: String,
        /// In the words of the system.
        reason: String,
    },
    /// No permission to write.
    #[error("the store cannot be written to, {object} is not stored: {reason}")]
    ReadOnly {
        /// What was to be written.
        object: String,
        /// In the words of the system.
        reason: String,
    },
    /// Bytes that differ from those that were written.
    #[error("{object} in the store is damaged: {reason}")]
    Corrupt {
        /// Name of the object.
        object: String,
        /// The evidence.
        reason: String,
    },
    /// Anything else, such as a network that does not answer.
    #[error("the store does not answer for {object}: {reason}")]
    Unavailable {
        /// Name of the requested object.
        object: String,
        /// In the words of the system.
        reason: String,
    },
    /// The store cannot be opened.
    #[error("cannot open the store {location}: {reason}")]
    Location {
        /// Location, as given.
        location: String,
        /// The reason.
        reason: String,
    },
}

impl StoreError {
    pub(crate) fn corrupt(object: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Corrupt { object: object.into(), reason: reason.into() }
    }

    /// Classifies an error by the system's error below it.
    pub(crate) fn of(object: &str, error: &object_store::Error) -> Self {
        let innermost = chain(error).last().map(ToString::to_string).unwrap_or_default();
        let (object, reason) = (object.to_owned(), innermost);
        match io_kind(error) {
            Some(io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge) => {
                Self::Full { object, reason }
            }
            Some(io::ErrorKind::ReadOnlyFilesystem | io::ErrorKind::PermissionDenied) => {
                Self::ReadOnly { object, reason }
            }
            _ => Self::Unavailable { object, reason: error.to_string() },
        }
    }
}

/// The value for a list or a total: nothing in place of a damaged object, which is reported only when it is read by name.
///
/// # Errors
/// All but `Corrupt`.
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
    fn errors_of_the_system_are_told_apart_however_deep_they_lie() {
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
