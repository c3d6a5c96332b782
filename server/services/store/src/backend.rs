//! Objects by name: create if absent, read, list, delete; none of them on a store that vanished.

use std::{
    io::{self, Read},
    path::{Path as FilePath, PathBuf},
    sync::{Arc, Mutex, OnceLock, PoisonError},
    time::{Duration, Instant, SystemTime},
};

use bytes::Bytes;
use futures::TryStreamExt;
use object_store::{
    ObjectStore, ObjectStoreExt, PutMode, PutPayload, local::LocalFileSystem, memory::InMemory, path::Path,
};

use crate::error::StoreError;

/// Name of the object that tells this store from others.
pub const IDENTITY: &str = "identity";
/// How long an answer about the identity of a remote store holds, which costs a request. That of a folder is always asked.
const SEEN: Duration = Duration::from_secs(5);

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
    identity: Arc<Identity>,
}

/// Which store was opened.
#[derive(Debug, Default)]
struct Identity {
    /// Content of its record; none before the store is identified, and in memory, which cannot vanish.
    expected: OnceLock<Bytes>,
    /// When a remote store was last seen to have it.
    seen: Mutex<Option<Instant>>,
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
            make_folder(FilePath::new(location)).map_err(|error| refused(location, error.to_string()))?;
        }
        Self::open(location)
    }

    /// A collection in memory, which ends with the process.
    pub fn in_memory() -> Self {
        Self::over(Arc::new(InMemory::new()), Path::default(), None)
    }

    fn over(objects: Arc<dyn ObjectStore>, prefix: Path, folder: Option<PathBuf>) -> Self {
        Self { objects, prefix, folder: folder.map(Arc::new), identity: Arc::default() }
    }

    fn folder(path: &FilePath) -> Result<Self, Box<dyn std::error::Error>> {
        let path = path.canonicalize()?;
        // Files are for the owner of the process alone. Programs that open a store write nothing that others should read.
        #[cfg(unix)]
        rustix::process::umask(rustix::fs::Mode::RWXG | rustix::fs::Mode::RWXO);
        let objects = LocalFileSystem::new_with_prefix(&path)?;
        // Acknowledged objects are on the disk: file and folder are synced before a write returns.
        Ok(Self::over(Arc::new(objects.with_fsync(true)), Path::default(), Some(path)))
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
            retry_timeout: Duration::from_secs(15),
            ..Default::default()
        };
        let objects =
            builder.with_retry(retry).build().map_err(|error| refused(location, error.to_string()))?;
        Ok(Self::over(Arc::new(objects), prefix, None))
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

    /// From now on, objects are read and written only while the store has this identity.
    pub fn identify(&self, content: Bytes) {
        // A store is identified once, when it is opened.
        let _ = self.identity.expected.set(content);
    }

    /// Makes sure that the store is still there, and the one that was opened: before every write, and after every read, so
    /// that no answer comes from elsewhere.
    ///
    /// # Errors
    /// `Vanished` if not.
    pub async fn present(&self) -> Result<(), StoreError> {
        let Some(expected) = self.identity.expected.get() else { return Ok(()) };
        let seen = *self.identity.seen.lock().unwrap_or_else(PoisonError::into_inner);
        if self.folder.is_none() && seen.is_some_and(|seen| seen.elapsed() < SEEN) {
            return Ok(());
        }
        if let Some(folder) = &self.folder {
            let (folder, expected) = (Arc::clone(folder), expected.clone());
            return blocking(IDENTITY, move || Ok(is_same(&folder, &expected))).await?;
        }
        let vanished = |reason: &str| Err(StoreError::Vanished { reason: reason.to_owned() });
        let found = match self.objects.get(&self.path(IDENTITY)).await {
            Ok(found) => found.bytes().await,
            Err(object_store::Error::NotFound { .. }) => return vanished(MISSING),
            Err(error) => Err(error),
        };
        if found.map_err(|error| StoreError::of(IDENTITY, &error))? != *expected {
            return vanished(ANOTHER);
        }
        *self.identity.seen.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
        Ok(())
    }

    /// Reads from the folder `folder`, if objects are files; then makes sure that it was the right one. All in one step.
    async fn local<T: Send + 'static>(
        &self,
        folder: &Arc<PathBuf>,
        name: &str,
        read: impl FnOnce(&FilePath) -> io::Result<T> + Send + 'static,
    ) -> Result<Option<T>, StoreError> {
        let (folder, expected, path) =
            (Arc::clone(folder), self.identity.expected.get().cloned(), name.to_owned());
        let read = move || {
            let found = match read(&folder.join(path)) {
                Ok(found) => Some(found),
                Err(error) if absent(&error) => None,
                Err(error) => return Err(error),
            };
            Ok(expected.map_or(Ok(()), |expected| is_same(&folder, &expected)).map(|()| found))
        };
        blocking(name, read).await?
    }

    /// Creates an object durably; `false` if the name exists.
    pub async fn create(&self, name: &str, data: Bytes) -> Result<bool, StoreError> {
        self.present().await?;
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
        self.present().await?;
        let written = self.objects.put(&self.path(name), PutPayload::from_bytes(data)).await;
        written.map(drop).map_err(|error| StoreError::of(name, &error))
    }

    /// Writes that many bytes, and removes them again.
    pub async fn try_write(&self, bytes: usize) -> Result<(), StoreError> {
        let Some(folder) = &self.folder else {
            let name = format!("probe/{}", uuid::Uuid::new_v4());
            self.renew(&name, Bytes::from(vec![0; bytes])).await?;
            return self.delete(&name).await;
        };
        // Named as a file that is being written: no list has it, and a collection removes what a crash leaves.
        let path = folder.join(format!("probe#{}", uuid::Uuid::new_v4().as_u128()));
        blocking("a probe", move || {
            let written = std::fs::write(&path, vec![0; bytes]);
            let removed = std::fs::remove_file(&path);
            written.and(removed)
        })
        .await
    }

    async fn sync_folder_of(&self, name: &str) -> Result<(), StoreError> {
        let Some(folder) = &self.folder else { return Ok(()) };
        let path = folder.join(name);
        let sync = move || match path.parent() {
            #[cfg(unix)]
            Some(parent) => std::fs::File::open(parent)?.sync_all(),
            _ => Ok(()),
        };
        blocking(name, sync).await
    }

    /// Content and age of an object, if it exists.
    pub async fn read(&self, name: &str) -> Result<Option<(Bytes, SystemTime)>, StoreError> {
        if let Some(folder) = &self.folder {
            let content = |path: &FilePath| {
                let mut file = std::fs::File::open(path)?;
                let about = file.metadata()?;
                if about.is_dir() {
                    return Err(io::ErrorKind::NotFound.into());
                }
                let mut data = Vec::with_capacity(usize::try_from(about.len()).unwrap_or(0));
                file.read_to_end(&mut data)?;
                Ok((data.into(), about.modified()?))
            };
            return self.local(folder, name, content).await;
        }
        let found = match self.objects.get(&self.path(name)).await {
            Ok(found) => found,
            Err(object_store::Error::NotFound { .. }) => return self.present().await.map(|()| None),
            Err(error) => return Err(StoreError::of(name, &error)),
        };
        let modified = found.meta.last_modified.into();
        let data = found.bytes().await.map_err(|error| StoreError::of(name, &error))?;
        self.present().await?;
        Ok(Some((data, modified)))
    }

    /// Whether an object exists.
    pub async fn exists(&self, name: &str) -> Result<bool, StoreError> {
        self.modified(name).await.map(|modified| modified.is_some())
    }

    /// Time of the last write of an object, if it exists.
    pub async fn modified(&self, name: &str) -> Result<Option<SystemTime>, StoreError> {
        if let Some(folder) = &self.folder {
            let modified = |path: &FilePath| match std::fs::metadata(path)? {
                about if about.is_file() => about.modified(),
                _ => Err(io::ErrorKind::NotFound.into()),
            };
            return self.local(folder, name, modified).await;
        }
        let found = match self.objects.head(&self.path(name)).await {
            Ok(meta) => Some(meta.last_modified.into()),
            Err(object_store::Error::NotFound { .. }) => None,
            Err(error) => return Err(StoreError::of(name, &error)),
        };
        self.present().await?;
        Ok(found)
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
        self.present().await?;
        found.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(found)
    }

    /// Names one level below a name, sorted. Their objects are not looked at.
    pub async fn children(&self, below: &str) -> Result<Vec<String>, StoreError> {
        let mut names = match &self.folder {
            Some(folder) => self.local(folder, below, names_in).await?.unwrap_or_default(),
            None => {
                let names = match self.objects.list_with_delimiter(Some(&self.path(below))).await {
                    Ok(found) => {
                        let objects = found.objects.iter().map(|meta| &meta.location);
                        let all = found.common_prefixes.iter().chain(objects);
                        all.filter_map(|path| path.filename().map(str::to_owned)).collect()
                    }
                    Err(object_store::Error::NotFound { .. }) => Vec::new(),
                    Err(error) => return Err(StoreError::of(below, &error)),
                };
                self.present().await?;
                names
            }
        };
        names.sort();
        Ok(names)
    }

    /// Removes the folder of objects that are all gone; object stores have none.
    pub async fn remove_folder(&self, name: &str) {
        let Some(folder) = &self.folder else { return };
        let path = folder.join(name);
        // If it is not empty, it stays.
        let _ = blocking(name, move || std::fs::remove_dir(path)).await;
    }

    /// Removes an object, if it exists.
    pub async fn delete(&self, name: &str) -> Result<(), StoreError> {
        self.present().await?;
        match self.objects.delete(&self.path(name)).await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(StoreError::of(name, &error)),
        }
    }
}

/// Runs a system call that may take its time.
pub(crate) async fn blocking<T: Send + 'static>(
    object: &str,
    call: impl FnOnce() -> io::Result<T> + Send + 'static,
) -> Result<T, StoreError> {
    let done = tokio::task::spawn_blocking(call).await.unwrap_or_else(|error| Err(io::Error::other(error)));
    done.map_err(|error| StoreError::of_system(object, &error))
}

/// Whether an error says that there is nothing of that name.
fn absent(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory)
}

const MISSING: &str = "its identity record is missing";
const ANOTHER: &str = "another store is in its place";

/// Whether a folder has the identity that is expected.
fn is_same(folder: &FilePath, expected: &[u8]) -> Result<(), StoreError> {
    let vanished = |reason: &str| Err(StoreError::Vanished { reason: reason.to_owned() });
    match std::fs::read(folder.join(IDENTITY)) {
        Ok(found) if found == expected => Ok(()),
        Ok(_) => vanished(ANOTHER),
        Err(error) if absent(&error) => vanished(MISSING),
        Err(error) => Err(StoreError::of_system(IDENTITY, &error)),
    }
}

/// Names in a folder, without those of files that are being written.
fn names_in(folder: &FilePath) -> io::Result<Vec<String>> {
    let names = std::fs::read_dir(folder)?.map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned()));
    names.filter(|name| !name.as_ref().is_ok_and(|name| is_staged(name))).collect()
}

/// Whether a file of that name is being written, or was when a process ended.
pub(crate) fn is_staged(name: &str) -> bool {
    name.rsplit_once('#').is_some_and(|(_, number)| number.bytes().all(|byte| byte.is_ascii_digit()))
}

/// Makes a folder for the owner of the process alone, and takes an existing one of its own away from others.
fn make_folder(path: &FilePath) -> io::Result<()> {
    let mut builder = std::fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
        builder.mode(0o700).create(path)?;
        let open = std::fs::metadata(path)?.permissions().mode() & 0o077 != 0;
        if open && let Err(error) = std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o700)) {
            tracing::warn!(folder = %path.display(), %error, "others may read the store");
        }
    }
    #[cfg(not(unix))]
    builder.create(path)?;
    Ok(())
}

/// The error that the store cannot be opened.
pub(crate) fn refused(location: &str, reason: impl Into<String>) -> StoreError {
    StoreError::Location { location: location.to_owned(), reason: reason.into() }
}
