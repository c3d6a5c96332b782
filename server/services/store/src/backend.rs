//! Objects by name: create if absent, read, list, delete.

use std::{
    path::{Path as FilePath, PathBuf},
    sync::Arc,
    time::SystemTime,
};

use bytes::Bytes;
use futures::TryStreamExt;
use object_store::{
    ObjectStore, ObjectStoreExt, PutMode, PutPayload, local::LocalFileSystem, memory::InMemory, path::Path,
};

use crate::error::StoreError;

/// An object in a list.
#[derive(Clone, Debug)]
pub struct Listed {
    /// Its name, relative to the prefix of the store.
    pub name: String,
    /// Its size, bytes.
    pub size: u64,
    /// Time of the last write.
    pub modified: SystemTime,
}

/// A collection of objects.
#[derive(Clone, Debug)]
pub struct Backend {
    objects: Arc<dyn ObjectStore>,
    /// Prefix of all names.
    prefix: Path,
    /// The folder, if the objects are files.
    folder: Option<Arc<PathBuf>>,
}

impl Backend {
    /// `memory`, a URL such as `s3://bucket/prefix`, or a folder.
    pub fn open(location: &str) -> Result<Self, StoreError> {
        if location == "memory" {
            return Ok(Self::in_memory());
        }
        if location.contains("://") {
            return Self::remote(location);
        }
        Self::folder(FilePath::new(location)).map_err(|error| refused(location, error.to_string()))
    }

    /// Opens, and creates a missing folder.
    pub fn make(location: &str) -> Result<Self, StoreError> {
        if location != "memory" && !location.contains("://") {
            std::fs::create_dir_all(location).map_err(|error| refused(location, error.to_string()))?;
        }
        Self::open(location)
    }

    /// A collection in memory, which ends with the process.
    pub fn in_memory() -> Self {
        Self { objects: Arc::new(InMemory::new()), prefix: Path::default(), folder: None }
    }

    fn folder(path: &FilePath) -> Result<Self, Box<dyn std::error::Error>> {
        let path = path.canonicalize()?;
        let objects = LocalFileSystem::new_with_prefix(&path)?;
        // Acknowledged objects are on the disk: file and folder are synced before a write returns.
        let objects = Arc::new(objects.with_fsync(true));
        Ok(Self { objects, prefix: Path::default(), folder: Some(Arc::new(path)) })
    }

    #[cfg(feature = "s3")]
    fn remote(location: &str) -> Result<Self, StoreError> {
        let url = url::Url::parse(location).map_err(|error| refused(location, error.to_string()))?;
        if !matches!(url.scheme(), "s3" | "s3a") {
            return Err(refused(location, "only s3:// is known among URLs"));
        }
        let prefix = Path::from_url_path(url.path()).map_err(|error| refused(location, error.to_string()))?;
        // The process-wide provider of cryptography. An earlier installation is fine.
        let _ = tokio_rustls::rustls::crypto::ring::default_provider().install_default();
        // Endpoint, region and credentials come from the environment: AWS_ENDPOINT, AWS_REGION, AWS_ACCESS_KEY_ID, ...
        let builder = object_store::aws::AmazonS3Builder::from_env().with_url(location);
        // Callers wait: they learn soon that the store does not answer, and decide themselves whether to retry.
        let retry = object_store::RetryConfig {
            max_retries: 5,
            retry_timeout: std::time::Duration::from_secs(15),
            ..Default::default()
        };
        let objects =
            builder.with_retry(retry).build().map_err(|error| refused(location, error.to_string()))?;
        Ok(Self { objects: Arc::new(objects), prefix, folder: None })
    }

    #[cfg(not(feature = "s3"))]
    fn remote(location: &str) -> Result<Self, StoreError> {
        let _ = url::Url::parse(location).map_err(|error| refused(location, error.to_string()))?;
        Err(refused(location, "this program was built without object stores (feature `s3`)"))
    }

    /// The folder, if the objects are files.
    pub fn local_folder(&self) -> Option<&FilePath> {
        self.folder.as_deref().map(PathBuf::as_path)
    }

    fn path(&self, name: &str) -> Path {
        self.prefix.parts().chain(Path::from(name).parts()).collect()
    }

    /// Creates an object durably; `false` if the name exists.
    pub async fn create(&self, name: &str, data: Bytes) -> Result<bool, StoreError> {
        let path = self.path(name);
        match self.objects.put_opts(&path, PutPayload::from_bytes(data), PutMode::Create.into()).await {
            Ok(_) => Ok(true),
            Err(object_store::Error::AlreadyExists { .. } | object_store::Error::Precondition { .. }) => {
                // Its creator may not have synced the folder yet, and the caller is about to rely on the object.
                self.sync_folder_of(name).await?;
                Ok(false)
            }
            Err(error) => Err(StoreError::of(name, &error)),
        }
    }

    /// Rewrites an object that is named by its hash: the same content with a new date.
    pub async fn renew(&self, name: &str, data: Bytes) -> Result<(), StoreError> {
        let written = self.objects.put(&self.path(name), PutPayload::from_bytes(data)).await;
        written.map(drop).map_err(|error| StoreError::of(name, &error))
    }

    async fn sync_folder_of(&self, name: &str) -> Result<(), StoreError> {
        let Some(folder) = &self.folder else { return Ok(()) };
        let path = folder.join(name);
        let synced = tokio::task::spawn_blocking(move || match path.parent() {
            #[cfg(unix)]
            Some(parent) => std::fs::File::open(parent)?.sync_all(),
            _ => Ok(()),
        });
        let unavailable = |reason: String| StoreError::Unavailable { object: name.to_owned(), reason };
        synced
            .await
            .map_err(|error| unavailable(error.to_string()))?
            .map_err(|error| unavailable(error.to_string()))
    }

    /// Content and age of an object, if it exists.
    pub async fn read(&self, name: &str) -> Result<Option<(Bytes, SystemTime)>, StoreError> {
        let found = match self.objects.get(&self.path(name)).await {
            Ok(found) => found,
            Err(object_store::Error::NotFound { .. }) => return Ok(None),
            Err(error) => return Err(StoreError::of(name, &error)),
        };
        let modified = found.meta.last_modified.into();
        match found.bytes().await {
            Ok(data) => Ok(Some((data, modified))),
            Err(error) => Err(StoreError::of(name, &error)),
        }
    }

    /// All objects below a name, sorted.
    pub async fn list(&self, below: &str) -> Result<Vec<Listed>, StoreError> {
        let prefix = self.path(below);
        let strip = self.prefix.as_ref().len() + usize::from(!self.prefix.as_ref().is_empty());
        let found = self.objects.list(Some(&prefix)).map_ok(|meta| Listed {
            name: meta.location.as_ref()[strip..].to_owned(),
            size: meta.size,
            modified: meta.last_modified.into(),
        });
        let mut found: Vec<Listed> = match found.try_collect().await {
            Ok(found) => found,
            Err(object_store::Error::NotFound { .. }) => Vec::new(),
            Err(error) => return Err(StoreError::of(below, &error)),
        };
        found.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(found)
    }

    /// Names one level below a name, sorted.
    pub async fn children(&self, below: &str) -> Result<Vec<String>, StoreError> {
        let found = match self.objects.list_with_delimiter(Some(&self.path(below))).await {
            Ok(found) => found,
            Err(object_store::Error::NotFound { .. }) => return Ok(Vec::new()),
            Err(error) => return Err(StoreError::of(below, &error)),
        };
        let folders = found.common_prefixes.iter();
        let objects = found.objects.iter().map(|meta| &meta.location);
        let mut names: Vec<String> =
            folders.chain(objects).filter_map(|path| path.filename().map(str::to_owned)).collect();
        names.sort();
        Ok(names)
    }

    /// Removes an object, if it exists.
    pub async fn delete(&self, name: &str) -> Result<(), StoreError> {
        match self.objects.delete(&self.path(name)).await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(StoreError::of(name, &error)),
        }
    }
}

/// The error that the store cannot be opened.
pub(crate) fn refused(location: &str, reason: impl Into<String>) -> StoreError {
    StoreError::Location { location: location.to_owned(), reason: reason.into() }
}
