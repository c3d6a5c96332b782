//! Rows of generations: mutable state made of objects that never change. Of two writers of a number one loses. The last
//! generation counts; those before it answer retries, and only the last [`KEPT`] stay.

use serde::{Serialize, de::DeserializeOwned};

use crate::{
    error::StoreError,
    records::{seal, unseal},
    store::Store,
};

/// Generations of a row that are kept.
pub const KEPT: u64 = 8;
/// How often a row is listed anew because its last generation went between listing and reading.
const LISTED: usize = 16;

/// The latest record of a row of generations.
#[derive(Clone, Debug, PartialEq)]
pub struct Generation<T> {
    /// Its number, from 1.
    pub number: u64,
    /// The record.
    pub record: T,
}

impl Store {
    pub(crate) async fn latest<T: DeserializeOwned>(
        &self,
        row: &str,
    ) -> Result<Option<Generation<T>>, StoreError> {
        match self.latest_or_damage(row).await? {
            Some(Generation { number, record }) => Ok(Some(Generation { number, record: record? })),
            None => Ok(None),
        }
    }

    pub(crate) async fn latest_or_damage<T: DeserializeOwned>(
        &self,
        row: &str,
    ) -> Result<Option<Generation<Result<T, StoreError>>>, StoreError> {
        for _ in 0..LISTED {
            let names = self.backend.children(row).await?;
            if names.iter().any(|name| name == CLOSED) {
                return Ok(None);
            }
            let Some(number) = last(&names) else { return Ok(None) };
            let record = match self.record(&numbered(row, number)).await {
                Ok(None) => continue,
                Ok(Some(record)) => Ok(record),
                Err(error @ StoreError::Corrupt { .. }) => Err(error),
                Err(error) => return Err(error),
            };
            return Ok(Some(Generation { number, record }));
        }
        let reason = "it changes faster than it can be read".to_owned();
        Err(StoreError::Unavailable { object: row.to_owned(), reason })
    }

    pub(crate) async fn record<T: DeserializeOwned>(&self, name: &str) -> Result<Option<T>, StoreError> {
        let found = self.backend.read(name).await?;
        found.map(|(sealed, _)| unseal(name, &sealed)).transpose()
    }

    /// Writes a generation and removes the one that is too old; `false` if the number is, or was, taken.
    pub(crate) async fn append(
        &self,
        row: &str,
        number: u64,
        record: &impl Serialize,
    ) -> Result<bool, StoreError> {
        let name = numbered(row, number);
        if !self.backend.create(&name, seal(record)?).await? {
            return Ok(false);
        }
        // A writer that has slept through many others may have written a number that was removed.
        let last = last(&self.backend.children(row).await?);
        if last.is_some_and(|last| last >= number.saturating_add(KEPT)) {
            self.backend.delete(&name).await?;
            return Ok(false);
        }
        if let Some(old) = number.checked_sub(KEPT).filter(|&old| old > 0)
            && let Err(error) = self.backend.delete(&numbered(row, old)).await
        {
            tracing::warn!(%error, "an old generation stays for the next collection");
        }
        Ok(true)
    }
}

/// The largest number among the names of a row.
fn last(names: &[String]) -> Option<u64> {
    names.iter().filter_map(|name| name.parse().ok()).max()
}

/// In place of a generation's number, in stores of the format before: the session is closed.
pub(crate) const CLOSED: &str = "closed";

/// The name of a generation; names sort like the numbers.
pub(crate) fn numbered(row: &str, number: u64) -> String {
    format!("{row}/{number:020}")
}
