//! The handle of a store, and how it is opened.

use std::{collections::BTreeSet, sync::Arc};

use bytes::Bytes;

use crate::{
    backend::{Backend, refused},
    error::StoreError,
    health::{Probed, identify},
    index::Turns,
};

/// Reads at a time.
pub(crate) const AT_ONCE: usize = 32;
/// Version of the layout described at the head of the crate.
const FORMAT: &str = "moldline store 2";
/// The layout without an index.
const WITHOUT_INDEX: &str = "moldline store 1";

/// A handle to a store. Clones, processes and machines share its objects.
#[derive(Clone, Debug)]
pub struct Store {
    pub(crate) backend: Backend,
    pub(crate) probed: Arc<Probed>,
    pub(crate) turns: Arc<Turns>,
}

/// What was found at a location.
enum Found {
    Nothing,
    WithoutIndex,
    Store,
}

impl Store {
    /// Opens `memory`, a folder (created if it is missing), or a URL such as `s3://bucket/prefix`. A store of the format
    /// before is brought to this one.
    ///
    /// # Errors
    /// If it cannot be reached, or is no store.
    pub async fn open(location: &str) -> Result<Self, StoreError> {
        let backend = Backend::make(location)?;
        let found = look(&backend, location).await?;
        if matches!(found, Found::Nothing) {
            // A store that cannot be written to can still be read; writes report the error.
            match backend.create("format", Bytes::from_static(FORMAT.as_bytes())).await {
                Ok(_) => tracing::info!(store = location, "beginning an empty store"),
                Err(StoreError::Full { .. } | StoreError::ReadOnly { .. }) => {}
                Err(error) => return Err(refused(location, error.to_string())),
            }
        }
        Self::over(backend, location, &found).await
    }

    /// Opens an existing store.
    ///
    /// # Errors
    /// If it does not exist, cannot be reached, or is no store.
    pub async fn open_existing(location: &str) -> Result<Self, StoreError> {
        let backend = Backend::open(location)?;
        match look(&backend, location).await? {
            Found::Nothing => Err(refused(location, "nothing was ever stored there")),
            found => Self::over(backend, location, &found).await,
        }
    }

    async fn over(backend: Backend, location: &str, found: &Found) -> Result<Self, StoreError> {
        let refuse = |error: StoreError| refused(location, error.to_string());
        if location != "memory" {
            identify(&backend).await.map_err(refuse)?;
        }
        let store = Self::on(backend);
        if matches!(found, Found::WithoutIndex) {
            tracing::info!(store = location, "making an index of the store");
            store.make_index().await.map_err(refuse)?;
            let written = store.backend.renew("format", Bytes::from_static(FORMAT.as_bytes())).await;
            written.map_err(refuse)?;
        }
        Ok(store)
    }

    fn on(backend: Backend) -> Self {
        Self { backend, probed: Arc::default(), turns: Arc::default() }
    }

    /// A store in memory, which ends with the process.
    pub fn in_memory() -> Self {
        Self::on(Backend::in_memory())
    }

    /// Tenants that have, or had, anything in the store.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn tenants(&self) -> Result<BTreeSet<String>, StoreError> {
        let mut tenants = BTreeSet::new();
        for below in ["access", "session", "closed", "request", "index"] {
            tenants.extend(self.backend.children(below).await?);
        }
        Ok(tenants)
    }
}

/// Whether a store exists there, and of which format.
async fn look(backend: &Backend, location: &str) -> Result<Found, StoreError> {
    match backend.read("format").await {
        Ok(Some((found, _))) if found == FORMAT.as_bytes() => Ok(Found::Store),
        Ok(Some((found, _))) if found == WITHOUT_INDEX.as_bytes() => Ok(Found::WithoutIndex),
        Ok(Some(_)) => Err(refused(location, format!("it is not of the format `{FORMAT}`"))),
        Ok(None) => Ok(Found::Nothing),
        Err(error) => Err(refused(location, error.to_string())),
    }
}
