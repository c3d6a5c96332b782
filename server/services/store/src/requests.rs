//! Request ids of uploads; those of sessions stand in their records.

use std::time::Duration;

use crate::{error::StoreError, records::seal, store::Store};

/// Time for which request ids, and marks of closed sessions, are kept.
pub(crate) const REMEMBERED: Duration = Duration::from_secs(7 * 24 * 3600);
/// The most of each that is kept of one tenant; the oldest go first.
const KEPT: usize = 10_000;

/// The outcome of claiming a request id.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Claim {
    /// The id is new.
    New,
    /// The id named the same request before.
    Repeated,
    /// The id named another request.
    Taken,
}

impl Store {
    /// Binds a request id to the hash of a request. The empty id is always new.
    ///
    /// # Errors
    /// If it cannot be written.
    pub async fn claim(&self, tenant: &str, id: &str, request: &str) -> Result<Claim, StoreError> {
        if id.is_empty() {
            return Ok(Claim::New);
        }
        let below = format!("request/{tenant}");
        let name = format!("{below}/{}", blake3::hash(id.as_bytes()).to_hex());
        if self.backend.create(&name, seal(&request)?).await? {
            self.trim_now_and_then(below);
            return Ok(Claim::New);
        }
        let known: Option<String> = self.record(&name).await?;
        Ok(if known.as_deref() == Some(request) { Claim::Repeated } else { Claim::Taken })
    }

    /// With every 256th object on average, removes the oldest beyond those that are kept. So no count has to be agreed upon,
    /// whoever writes: there are never many more.
    pub(crate) fn trim_now_and_then(&self, below: String) {
        if uuid::Uuid::new_v4().as_bytes()[0] != 0 {
            return;
        }
        let store = self.clone();
        tokio::spawn(async move {
            if let Err(error) = store.trim(&below, KEPT).await {
                tracing::warn!(%error, "the oldest objects below {below} stay for the next time");
            }
        });
    }

    async fn trim(&self, below: &str, kept: usize) -> Result<(), StoreError> {
        let mut objects = self.backend.list(below).await?;
        objects.sort_by(|a, b| (b.modified, &b.name).cmp(&(a.modified, &a.name)));
        for object in objects.iter().skip(kept) {
            self.backend.delete(&object.name).await?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn the_newest_request_ids_are_remembered() {
        let store = Store::in_memory();
        for k in 0..20 {
            store.claim("a", &format!("id {k}"), "request").await.unwrap();
        }
        store.trim("request/a", 8).await.unwrap();
        for k in (0..20).rev() {
            let expected = if k < 12 { Claim::New } else { Claim::Repeated };
            assert_eq!(store.claim("a", &format!("id {k}"), "request").await.unwrap(), expected, "{k}");
        }
    }
}
