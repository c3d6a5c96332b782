//! Sessions. A closed one leaves a mark, so that late retries of its opening are told that it is closed.

use crate::{
    error::StoreError,
    index::Kind,
    records::{SessionRecord, seal},
    rows::{CLOSED, Generation, numbered},
    store::Store,
};

fn row(tenant: &str, id: &str) -> String {
    format!("session/{tenant}/{id}")
}

fn mark(tenant: &str, id: &str) -> String {
    format!("closed/{tenant}/{id}")
}

impl Store {
    /// The latest generation of an open session.
    ///
    /// # Errors
    /// If the store does not answer or the record is damaged.
    pub async fn session(
        &self,
        tenant: &str,
        id: &str,
    ) -> Result<Option<Generation<SessionRecord>>, StoreError> {
        let (row, mark) = (row(tenant, id), mark(tenant, id));
        let (latest, closed) = tokio::join!(self.latest(&row), self.backend.exists(&mark));
        if closed? { Ok(None) } else { latest }
    }

    /// One generation of a session, if it exists (still).
    ///
    /// # Errors
    /// If the store does not answer or the record is damaged.
    pub async fn session_at(
        &self,
        tenant: &str,
        id: &str,
        number: u64,
    ) -> Result<Option<SessionRecord>, StoreError> {
        self.record(&numbered(&row(tenant, id), number)).await
    }

    /// Writes a generation of a session; `false` if the number is, or was, taken, and if the session is closed.
    ///
    /// # Errors
    /// If it cannot be written.
    pub async fn put_session(
        &self,
        tenant: &str,
        id: &str,
        number: u64,
        record: &SessionRecord,
    ) -> Result<bool, StoreError> {
        let row = row(tenant, id);
        if !self.append(&row, number, record).await? {
            return Ok(false);
        }
        // The mark comes before the generations go: one of the two sides sees the other.
        if self.backend.exists(&mark(tenant, id)).await? {
            self.backend.delete(&numbered(&row, number)).await?;
            self.backend.remove_folder(&row).await;
            return Ok(false);
        }
        Ok(true)
    }

    /// Closes a session for good. `opened`: the hash of the request that opened it, for late retries.
    ///
    /// # Errors
    /// If it cannot be written.
    pub async fn close_session(&self, tenant: &str, id: &str, opened: &str) -> Result<(), StoreError> {
        self.backend.create(&mark(tenant, id), seal(&opened)?).await?;
        self.trim_now_and_then(format!("closed/{tenant}"));
        let row = row(tenant, id);
        let removed = async {
            for name in self.backend.children(&row).await? {
                self.backend.delete(&format!("{row}/{name}")).await?;
            }
            self.backend.remove_folder(&row).await;
            self.forget(tenant, Kind::Session, id).await
        };
        if let Err(error) = removed.await {
            tracing::warn!(%error, "what is left of a closed session stays for the next collection");
        }
        Ok(())
    }

    /// The hash of the request that opened a session which is closed by now; empty if it is not known.
    ///
    /// # Errors
    /// If the store does not answer or the record is damaged.
    pub async fn closed_session(&self, tenant: &str, id: &str) -> Result<Option<String>, StoreError> {
        if let Some(opened) = self.record(&mark(tenant, id)).await? {
            return Ok(Some(opened));
        }
        let before = self.backend.exists(&format!("{}/{CLOSED}", row(tenant, id))).await?;
        Ok(before.then(String::new))
    }
}
