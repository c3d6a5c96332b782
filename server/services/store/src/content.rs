//! Content of set-ups: files, manifests, and data derived from them.

use std::time::Duration;

use bytes::Bytes;
use futures::{StreamExt, TryStreamExt, stream};

use crate::{
    error::StoreError,
    records::{Manifest, check_hash, seal, seal_bytes, unseal, unseal_bytes},
    store::{AT_ONCE, Store},
};

/// Objects older than this are rewritten when they are used, so that garbage collection does not remove them.
const RENEW: Duration = Duration::from_secs(3600);

impl Store {
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
    pub(crate) async fn put_named(&self, name: &str, data: Bytes) -> Result<(), StoreError> {
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

    /// Whether data that a build of the engine derived from a set-up are stored.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn has_derived(&self, setup: &str, build: &str) -> Result<bool, StoreError> {
        self.backend.exists(&format!("derived/{setup}/{build}")).await
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
}
