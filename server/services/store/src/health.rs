//! Identity and health of a store: whether it is there, the one that was opened, writable, and not full.

use std::time::{Duration, Instant};

use bytes::Bytes;
use tokio::sync::Mutex;

use crate::{
    backend::{Backend, IDENTITY, blocking},
    error::StoreError,
    store::Store,
};

/// How long a result holds: probes that come more often cost nothing.
const HOLDS: Duration = Duration::from_secs(1);
/// Bytes that a store must have room for.
const ROOM: usize = 64 << 10;

/// A store in working order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Health {
    /// Bytes that may still be written, if the store is a folder.
    pub free: Option<u64>,
}

/// The last probe, and when it was.
pub(crate) type Probed = Mutex<Option<(Instant, Result<Health, StoreError>)>>;

impl Store {
    /// Whether the store can be used: its identity record is read, and an object of 64 KiB is written and removed. Cheap: at
    /// most once a second, whoever asks.
    ///
    /// # Errors
    /// `Vanished` if it is gone or another one, `Full`, `ReadOnly`, `Unavailable` if it does not answer.
    pub async fn health(&self) -> Result<Health, StoreError> {
        let mut probed = self.probed.lock().await;
        if let Some((at, found)) = &*probed
            && at.elapsed() < HOLDS
        {
            return found.clone();
        }
        let found = self.probe().await;
        *probed = Some((Instant::now(), found.clone()));
        found
    }

    async fn probe(&self) -> Result<Health, StoreError> {
        self.backend.present().await?;
        self.backend.try_write(ROOM).await?;
        let Some(folder) = self.backend.local_folder().map(ToOwned::to_owned) else {
            return Ok(Health { free: None });
        };
        let free = blocking("the free space", move || {
            let space = rustix::fs::statvfs(&folder)?;
            Ok(space.f_bavail.saturating_mul(space.f_frsize))
        });
        Ok(Health { free: Some(free.await?) })
    }
}

/// Binds a handle to the store as it is found; one without an identity gets a random one.
pub(crate) async fn identify(backend: &Backend) -> Result<(), StoreError> {
    let own = Bytes::from(uuid::Uuid::new_v4().to_string());
    let found = match backend.read(IDENTITY).await? {
        Some((found, _)) => found,
        None => match backend.create(IDENTITY, own.clone()).await {
            Ok(true) => own,
            Ok(false) => backend.read(IDENTITY).await?.map_or(own, |(found, _)| found),
            // A store that cannot be written to can still be read.
            Err(StoreError::Full { .. } | StoreError::ReadOnly { .. }) => return Ok(()),
            Err(error) => return Err(error),
        },
    };
    backend.identify(found);
    Ok(())
}
