//! Set-ups and their owners, sessions, and request ids.

use std::{
    collections::BTreeSet,
    sync::Arc,
    time::{Duration, SystemTime},
};

use bytes::Bytes;
use futures::{StreamExt, TryStreamExt, stream};
use serde::{Serialize, de::DeserializeOwned};

use crate::{
    backend::{Backend, refused},
    error::{StoreError, unless_damaged},
    health::{Probed, identify},
    records::{AccessRecord, Manifest, SessionRecord, Shared, seal, seal_bytes, unseal, unseal_bytes},
};

/// Objects older than this are rewritten when they are used, so that garbage collection does not remove them.
const RENEW: Duration = Duration::from_secs(3600);
/// Reads at a time.
const AT_ONCE: usize = 32;
/// Stands for all tenants. No tenant can have this name.
const EVERYBODY: &str = "@public";
/// Version of the layout described at the head of the crate.
const FORMAT: &str = "moldline store 1";

/// The latest record of a row of generations.
#[derive(Clone, Debug, PartialEq)]
pub struct Generation<T> {
    /// Its number, from 1.
    pub number: u64,
    /// The record.
    pub record: T,
}

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

/// A handle to a store. Clones, processes and machines share its objects.
#[derive(Clone, Debug)]
pub struct Store {
    pub(crate) backend: Backend,
    pub(crate) probed: Arc<Probed>,
}

impl Store {
    /// Opens `memory`, a folder (created if it is missing), or a URL such as `s3://bucket/prefix`.
    ///
    /// # Errors
    /// If it cannot be reached, or is no store.
    pub async fn open(location: &str) -> Result<Self, StoreError> {
        let backend = Backend::make(location)?;
        if !is_made(&backend, location).await? {
            // A store that cannot be written to can still be read; writes report the error.
            match backend.create("format", Bytes::from_static(FORMAT.as_bytes())).await {
                Ok(_) => tracing::info!(store = location, "beginning an empty store"),
                Err(StoreError::Full { .. } | StoreError::ReadOnly { .. }) => {}
                Err(error) => return Err(refused(location, error.to_string())),
            }
        }
        Self::over(backend, location).await
    }

    async fn over(backend: Backend, location: &str) -> Result<Self, StoreError> {
        if location != "memory" {
            identify(&backend).await.map_err(|error| refused(location, error.to_string()))?;
        }
        Ok(Self { backend, probed: Arc::default() })
    }

    /// Opens an existing store.
    ///
    /// # Errors
    /// If it does not exist, cannot be reached, or is no store.
    pub async fn open_existing(location: &str) -> Result<Self, StoreError> {
        let backend = Backend::open(location)?;
        match is_made(&backend, location).await? {
            true => Self::over(backend, location).await,
            false => Err(refused(location, "nothing was ever stored there")),
        }
    }

    /// A store in memory, which ends with the process.
    pub fn in_memory() -> Self {
        Self { backend: Backend::in_memory(), probed: Arc::default() }
    }

    /// Stores the files of a set-up, the set-up file first, and returns its id.
    ///
    /// # Errors
    /// If they cannot be written.
    pub async fn put_setup(&self, files: &[(String, Vec<u8>)]) -> Result<String, StoreError> {
        let manifest = Manifest::of(files.iter().map(|(path, content)| (path.as_str(), content.as_slice())));
        let id = manifest.id();
        for (_, content) in files {
            let hash = blake3::hash(content).to_hex();
            self.put_named(&format!("blob/{hash}"), Bytes::copy_from_slice(content)).await?;
        }
        self.put_named(&format!("setup/{id}"), seal(&manifest)?).await?;
        Ok(id)
    }

    /// Writes an object that is named by its hash, unless it exists, is intact and is young.
    async fn put_named(&self, name: &str, data: Bytes) -> Result<(), StoreError> {
        if let Some((found, modified)) = self.backend.read(name).await? {
            if found != data {
                tracing::warn!(object = name, "mending an object of the store that was damaged");
            } else if modified.elapsed().unwrap_or_default() < RENEW {
                return Ok(());
            }
            return self.backend.renew(name, data).await;
        }
        self.backend.create(name, data).await.map(drop)
    }

    /// The files of a set-up, the set-up file first.
    ///
    /// # Errors
    /// `Corrupt` naming the object whose content does not fit its name.
    pub async fn setup(&self, id: &str) -> Result<Option<Vec<(String, Bytes)>>, StoreError> {
        let Some(manifest) = self.manifest(id).await? else { return Ok(None) };
        let files = stream::iter(manifest.files).map(|file| async move {
            let name = format!("blob/{}", file.hash);
            let Some((content, _)) = self.backend.read(&name).await? else {
                return Err(StoreError::corrupt(name, format!("it is missing, and set-up {id} needs it")));
            };
            check_hash(&name, &file.hash, &content)?;
            Ok((file.path, content))
        });
        files.buffered(AT_ONCE).try_collect().await.map(Some)
    }

    pub(crate) async fn manifest(&self, id: &str) -> Result<Option<Manifest>, StoreError> {
        let name = format!("setup/{id}");
        let Some((sealed, _)) = self.backend.read(&name).await? else { return Ok(None) };
        let manifest: Manifest = unseal(&name, &sealed)?;
        match manifest.id() == id {
            true => Ok(Some(manifest)),
            false => Err(StoreError::corrupt(name, "it is the manifest of another set-up")),
        }
    }

    /// Stores the data that a build of the engine derived from a set-up.
    ///
    /// # Errors
    /// If it cannot be written.
    pub async fn put_derived(&self, setup: &str, build: &str, data: Vec<u8>) -> Result<(), StoreError> {
        let name = format!("derived/{setup}/{build}");
        let sealed = seal_bytes(data);
        match self.backend.create(&name, sealed.clone()).await? {
            true => Ok(()),
            // Its writer has found no usable object there.
            false => self.backend.renew(&name, sealed).await,
        }
    }

    /// The data that a build of the engine derived from a set-up, if they are stored.
    ///
    /// # Errors
    /// `Corrupt` if they are damaged.
    pub async fn derived(&self, setup: &str, build: &str) -> Result<Option<Bytes>, StoreError> {
        let name = format!("derived/{setup}/{build}");
        let Some((sealed, _)) = self.backend.read(&name).await? else { return Ok(None) };
        unseal_bytes(&name, sealed).map(Some)
    }

    /// The access of a tenant that uploaded a set-up.
    ///
    /// # Errors
    /// If the store does not answer or the record is damaged.
    pub async fn access(
        &self,
        tenant: &str,
        setup: &str,
    ) -> Result<Option<Generation<AccessRecord>>, StoreError> {
        self.latest(&format!("access/{tenant}/{setup}")).await
    }

    /// As [`access`](Self::access), with the error in place of a damaged record, so that it can be rewritten.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn access_or_damage(
        &self,
        tenant: &str,
        setup: &str,
    ) -> Result<Option<Generation<Result<AccessRecord, StoreError>>>, StoreError> {
        self.latest_or_damage(&format!("access/{tenant}/{setup}")).await
    }

    /// Writes the next generation of a tenant's access to a set-up; `false` if it exists already.
    ///
    /// # Errors
    /// If it cannot be written.
    pub async fn put_access(
        &self,
        tenant: &str,
        setup: &str,
        number: u64,
        record: &AccessRecord,
    ) -> Result<bool, StoreError> {
        // The grant comes first: the record decides.
        let grantees: Vec<&str> = match &record.shared {
            _ if !record.owned => Vec::new(),
            Shared::Private => Vec::new(),
            Shared::Tenants(tenants) => tenants.iter().map(String::as_str).collect(),
            Shared::Public => vec![EVERYBODY],
        };
        for grantee in grantees {
            let name = format!("grant/{grantee}/{setup}/{tenant}");
            self.put_named(&name, Bytes::from_static(b"look at the owner's record")).await?;
        }
        self.append(&format!("access/{tenant}/{setup}"), number, record).await
    }

    /// The access to a set-up that another tenant has granted to a tenant, if any.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn granted(&self, tenant: &str, setup: &str) -> Result<Option<AccessRecord>, StoreError> {
        for grantee in [tenant, EVERYBODY] {
            for owner in self.backend.children(&format!("grant/{grantee}/{setup}")).await? {
                // A damaged record grants nothing.
                let found = unless_damaged(self.access(&owner, setup).await)?;
                let record = found.map(|generation| generation.record);
                if let Some(record) = record.filter(|record| record.owned)
                    && match &record.shared {
                        Shared::Private => false,
                        Shared::Tenants(tenants) => tenants.iter().any(|other| other == tenant),
                        Shared::Public => true,
                    }
                {
                    return Ok(Some(record));
                }
            }
        }
        Ok(None)
    }

    /// Ids of all set-ups to which a tenant may have access, sorted.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn setups_of(&self, tenant: &str) -> Result<Vec<String>, StoreError> {
        let mut names = BTreeSet::new();
        for below in [format!("access/{tenant}"), format!("grant/{tenant}"), format!("grant/{EVERYBODY}")] {
            names.extend(self.backend.children(&below).await?);
        }
        Ok(names.into_iter().collect())
    }

    /// All set-ups that a tenant owns, except those with a damaged record.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn owned(&self, tenant: &str) -> Result<Vec<(String, AccessRecord)>, StoreError> {
        let names = self.backend.children(&format!("access/{tenant}")).await?;
        let records = stream::iter(names).map(|setup| async move {
            let latest = unless_damaged(self.access(tenant, &setup).await)?;
            Ok(latest.filter(|latest| latest.record.owned).map(|latest| (setup, latest.record)))
        });
        let records: Vec<Option<_>> = records.buffered(AT_ONCE).try_collect().await?;
        Ok(records.into_iter().flatten().collect())
    }

    /// Tenants that own or owned set-ups or sessions.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn tenants(&self) -> Result<BTreeSet<String>, StoreError> {
        let mut tenants = BTreeSet::new();
        for below in ["access", "session"] {
            tenants.extend(self.backend.children(below).await?);
        }
        Ok(tenants)
    }

    /// Number and size of the set-ups in the store.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn size(&self) -> Result<(usize, u64), StoreError> {
        let objects = self.backend.list("").await?;
        let setups = objects.iter().filter(|object| object.name.starts_with("setup/")).count();
        Ok((setups, objects.iter().map(|object| object.size).sum()))
    }

    /// The latest generation of an open session.
    ///
    /// # Errors
    /// If the store does not answer or the record is damaged.
    pub async fn session(
        &self,
        tenant: &str,
        id: &str,
    ) -> Result<Option<Generation<SessionRecord>>, StoreError> {
        self.latest(&format!("session/{tenant}/{id}")).await
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
        self.record(&numbered(&format!("session/{tenant}/{id}"), number)).await
    }

    /// Writes a generation of a session; `false` if the number exists.
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
        self.append(&format!("session/{tenant}/{id}"), number, record).await
    }

    /// Closes a session for good.
    ///
    /// # Errors
    /// If it cannot be written.
    pub async fn close_session(&self, tenant: &str, id: &str) -> Result<(), StoreError> {
        let name = format!("session/{tenant}/{id}/{CLOSED}");
        self.backend.create(&name, Bytes::from_static(b"closed")).await.map(drop)
    }

    /// Ids of the open sessions of a tenant, sorted.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn sessions(&self, tenant: &str) -> Result<Vec<String>, StoreError> {
        let below = format!("session/{tenant}/");
        let (mut all, mut closed) = (BTreeSet::new(), BTreeSet::new());
        for object in self.backend.list(&below).await? {
            let Some((id, name)) = object.name[below.len()..].split_once('/') else { continue };
            if name == CLOSED {
                closed.insert(id.to_owned());
            }
            all.insert(id.to_owned());
        }
        Ok(all.difference(&closed).cloned().collect())
    }

    /// Binds a request id to the hash of a request. The empty id is always new.
    ///
    /// # Errors
    /// If it cannot be written.
    pub async fn claim(&self, tenant: &str, id: &str, request: &str) -> Result<Claim, StoreError> {
        if id.is_empty() {
            return Ok(Claim::New);
        }
        let name = format!("request/{tenant}/{}", blake3::hash(id.as_bytes()).to_hex());
        if self.backend.create(&name, seal(&request)?).await? {
            return Ok(Claim::New);
        }
        let known: Option<String> = self.record(&name).await?;
        Ok(if known.as_deref() == Some(request) { Claim::Repeated } else { Claim::Taken })
    }

    async fn latest<T: DeserializeOwned>(&self, row: &str) -> Result<Option<Generation<T>>, StoreError> {
        match self.latest_or_damage(row).await? {
            Some(Generation { number, record }) => Ok(Some(Generation { number, record: record? })),
            None => Ok(None),
        }
    }

    async fn latest_or_damage<T: DeserializeOwned>(
        &self,
        row: &str,
    ) -> Result<Option<Generation<Result<T, StoreError>>>, StoreError> {
        let names = self.backend.children(row).await?;
        if names.iter().any(|name| name == CLOSED) {
            return Ok(None);
        }
        let Some(number) = names.iter().filter_map(|name| name.parse().ok()).max() else { return Ok(None) };
        let record = match self.record(&numbered(row, number)).await {
            Ok(record) => record.map(Ok),
            Err(error @ StoreError::Corrupt { .. }) => Some(Err(error)),
            Err(error) => return Err(error),
        };
        Ok(record.map(|record| Generation { number, record }))
    }

    async fn record<T: DeserializeOwned>(&self, name: &str) -> Result<Option<T>, StoreError> {
        let found = self.backend.read(name).await?;
        found.map(|(sealed, _)| unseal(name, &sealed)).transpose()
    }

    async fn append(&self, row: &str, number: u64, record: &impl Serialize) -> Result<bool, StoreError> {
        self.backend.create(&numbered(row, number), seal(record)?).await
    }
}

/// Whether a store exists there.
async fn is_made(backend: &Backend, location: &str) -> Result<bool, StoreError> {
    match backend.read("format").await {
        Ok(Some((found, _))) if found == FORMAT.as_bytes() => Ok(true),
        Ok(Some(_)) => Err(refused(location, format!("it is not of the format `{FORMAT}`"))),
        Ok(None) => Ok(false),
        Err(error) => Err(refused(location, error.to_string())),
    }
}

/// In place of a generation's number: the session is closed.
pub(crate) const CLOSED: &str = "closed";

/// The name of a generation; names sort like the numbers.
fn numbered(row: &str, number: u64) -> String {
    format!("{row}/{number:020}")
}

pub(crate) fn check_hash(name: &str, hash: &str, content: &[u8]) -> Result<(), StoreError> {
    if blake3::hash(content).to_hex().as_str() == hash {
        return Ok(());
    }
    Err(StoreError::corrupt(name, format!("the hash of its {} bytes is not its name", content.len())))
}

/// Whether the last write was at least that long ago.
pub(crate) fn older(modified: SystemTime, grace: Duration) -> bool {
    modified.elapsed().unwrap_or_default() >= grace
}
