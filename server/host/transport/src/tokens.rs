//! Bearer tokens: a file that holds their hashes, never the tokens.
//!
//! A token is `moldline_ID_SECRET`. The secret has 256 random bits, so a fast hash protects it. The file is JSON, rewritten
//! and renamed at every change, under a lock. A server checks it at every request and reads it again when it has changed: a
//! revoked token is rejected from then on.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Write},
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use moldline_host::{Principal, Role, Tenant};
use serde::{Deserialize, Serialize};

const PREFIX: &str = "moldline_";
const FORMAT: u32 = 1;

/// Why a token file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum TokenFileError {
    /// It cannot be read or written.
    #[error("{}: {error}", path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// The reason.
        error: io::Error,
    },
    /// It is not a token file.
    #[error("{}: {reason}", path.display())]
    Content {
        /// Path of the file.
        path: PathBuf,
        /// The reason.
        reason: String,
    },
    /// Others than its owner may read or change it.
    #[error("{}: others may use it (mode {mode:o}), who would have its tokens' rights; `chmod 600` it", path.display())]
    Open {
        /// Path of the file.
        path: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// The system provides no random numbers.
    #[error("no random numbers: {0}")]
    Random(getrandom::Error),
    /// There is no such token.
    #[error("there is no token `{0}`; `moldline token list` lists the tokens")]
    Unknown(String),
}

/// Why a token is rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InvalidToken {
    /// It is not in the file.
    Unknown,
    /// It has expired.
    Expired,
}

/// The entry of a token in the file.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Token {
    /// Identifies it in lists and for revocation; not secret.
    pub id: String,
    /// Its owner.
    pub tenant: String,
    /// Its permissions.
    pub role: String,
    /// Time of creation, seconds since 1970.
    pub created: u64,
    /// Time of expiry, seconds since 1970.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expires: Option<u64>,
    /// Digest of the whole token.
    hash: String,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    format: u32,
    tokens: Vec<Token>,
}

/// A token file.
#[derive(Debug)]
pub struct TokenFile {
    path: PathBuf,
    known: Mutex<Known>,
}

/// The content read last, and the state of the file then.
#[derive(Debug, Default)]
struct Known {
    stamp: Option<Stamp>,
    tokens: Vec<(blake3::Hash, Option<u64>, Principal)>,
}

#[derive(Debug, PartialEq, Eq)]
struct Stamp {
    modified: Option<SystemTime>,
    length: u64,
    /// Changes when another file replaces it.
    inode: u64,
}

impl Stamp {
    fn of(path: &Path) -> io::Result<Self> {
        let metadata = fs::metadata(path)?;
        #[cfg(unix)]
        let inode = std::os::unix::fs::MetadataExt::ino(&metadata);
        #[cfg(not(unix))]
        let inode = 0;
        Ok(Self { modified: metadata.modified().ok(), length: metadata.len(), inode })
    }
}

impl TokenFile {
    /// The file at `path`, which must exist.
    ///
    /// # Errors
    /// If it cannot be read, or is not a token file.
    pub fn open(path: impl Into<PathBuf>) -> Result<Self, TokenFileError> {
        let path = path.into();
        read(&path)?;
        let file = Self { path, known: Mutex::default() };
        file.refresh(&mut Known::default())?;
        Ok(file)
    }

    /// The principal of a token.
    ///
    /// # Errors
    /// If it is not in the file, or has expired.
    pub fn principal(&self, token: &str) -> Result<Principal, InvalidToken> {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Err(error) = self.refresh(&mut known) {
            // A file that is unreadable for a moment must neither open nor close the server.
            tracing::error!(%error, "cannot read the token file; the tokens read last stay in force");
        }
        let hash = blake3::hash(token.as_bytes());
        // Hashes are compared in constant time.
        let found = known.tokens.iter().find(|(other, ..)| *other == hash).ok_or(InvalidToken::Unknown)?;
        match found.1 {
            Some(end) if end <= now() => Err(InvalidToken::Expired),
            _ => Ok(found.2.clone()),
        }
    }

    fn refresh(&self, known: &mut Known) -> Result<(), TokenFileError> {
        let stamp = Stamp::of(&self.path).map_err(|error| file_error(&self.path, error))?;
        if known.stamp.as_ref() == Some(&stamp) {
            return Ok(());
        }
        let mut tokens = Vec::new();
        for token in read(&self.path)? {
            let content = |reason| TokenFileError::Content { path: self.path.clone(), reason };
            let hash = blake3::Hash::from_hex(&token.hash)
                .map_err(|error| content(format!("hash of token `{}`: {error}", token.id)))?;
            let tenant = Tenant::new(&token.tenant).map_err(|error| content(error.to_string()))?;
            let role = Role::named(&token.role)
                .ok_or_else(|| content(format!("role `{}` of token `{}`", token.role, token.id)))?;
            tokens.push((hash, token.expires, Principal { tenant, role }));
        }
        *known = Known { stamp: Some(stamp), tokens };
        Ok(())
    }
}

/// Creates a token, adds it to the file, which is created if it is missing, and returns it: the only time that it is visible.
///
/// # Errors
/// If the file cannot be changed.
pub fn create(
    path: &Path,
    principal: &Principal,
    lifetime: Option<Duration>,
) -> Result<String, TokenFileError> {
    let mut bytes = [0_u8; 38];
    getrandom::fill(&mut bytes).map_err(TokenFileError::Random)?;
    let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
    let id = hex(&bytes[..6]);
    let token = format!("{PREFIX}{id}_{}", hex(&bytes[6..]));
    change(path, |tokens| {
        tokens.push(Token {
            id,
            tenant: principal.tenant.as_str().to_owned(),
            role: principal.role.name().to_owned(),
            created: now(),
            expires: lifetime.map(|lifetime| now().saturating_add(lifetime.as_secs())),
            hash: blake3::hash(token.as_bytes()).to_hex().to_string(),
        });
        Ok(())
    })?;
    Ok(token)
}

/// The tokens of a file.
///
/// # Errors
/// If it cannot be read.
pub fn list(path: &Path) -> Result<Vec<Token>, TokenFileError> {
    read(path)
}

/// Removes a token from the file.
///
/// # Errors
/// If the token is not in it, or the file cannot be changed.
pub fn revoke(path: &Path, id: &str) -> Result<(), TokenFileError> {
    change(path, |tokens| {
        let before = tokens.len();
        tokens.retain(|token| token.id != id);
        if tokens.len() == before { Err(TokenFileError::Unknown(id.to_owned())) } else { Ok(()) }
    })
}

/// Seconds since 1970.
pub fn now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs())
}

fn read(path: &Path) -> Result<Vec<Token>, TokenFileError> {
    check_private(path)?;
    let text = fs::read(path).map_err(|error| file_error(path, error))?;
    let content = |reason| TokenFileError::Content { path: path.to_owned(), reason };
    let document: Document = serde_json::from_slice(&text).map_err(|error| content(error.to_string()))?;
    if document.format != FORMAT {
        return Err(content(format!("format {} is not {FORMAT}", document.format)));
    }
    Ok(document.tokens)
}

/// Refuses a file that others may read, or its group change. A group may read: so orchestrators hand out secrets.
#[cfg(unix)]
fn check_private(path: &Path) -> Result<(), TokenFileError> {
    use std::os::unix::fs::PermissionsExt;
    let metadata = fs::metadata(path).map_err(|error| file_error(path, error))?;
    let mode = metadata.permissions().mode() & 0o777;
    match mode & 0o027 {
        0 => Ok(()),
        _ => Err(TokenFileError::Open { path: path.to_owned(), mode }),
    }
}

#[cfg(not(unix))]
fn check_private(_: &Path) -> Result<(), TokenFileError> {
    Ok(())
}

/// Replaces the file atomically: others see it either before or after the change.
fn change(
    path: &Path,
    change: impl FnOnce(&mut Vec<Token>) -> Result<(), TokenFileError>,
) -> Result<(), TokenFileError> {
    let failed = |error| file_error(path, error);
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(failed)?;
    }
    let beside = |ending: &str| {
        let mut name = path.as_os_str().to_owned();
        name.push(ending);
        PathBuf::from(name)
    };
    // Held until the end of this function.
    let lock = private().open(beside(".lock")).map_err(failed)?;
    lock.lock().map_err(failed)?;
    let mut tokens = if path.exists() { read(path)? } else { Vec::new() };
    change(&mut tokens)?;
    let document = Document { format: FORMAT, tokens };
    let text = serde_json::to_string_pretty(&document).map_err(|error| failed(error.into()))?;
    let new = beside(".new");
    let write = || -> io::Result<()> {
        let mut file = private().truncate(true).open(&new)?;
        file.write_all(text.as_bytes())?;
        file.write_all(b"\n")?;
        file.sync_all()?;
        fs::rename(&new, path)?;
        match path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            Some(folder) if cfg!(unix) => File::open(folder)?.sync_all(),
            _ => Ok(()),
        }
    };
    write().map_err(failed)
}

/// A file that only its owner can read.
fn private() -> OpenOptions {
    let mut options = OpenOptions::new();
    options.create(true).write(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options
}

fn file_error(path: &Path, error: io::Error) -> TokenFileError {
    TokenFileError::File { path: path.to_owned(), error }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn principal(tenant: &str, role: Role) -> Principal {
        Principal { tenant: Tenant::new(tenant).unwrap(), role }
    }

    #[test]
    fn tokens_are_known_until_they_are_revoked() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/tokens.json");
        let anna = principal("anna", Role::User);
        let first = create(&path, &anna, None).unwrap();
        let file = TokenFile::open(&path).unwrap();
        assert_eq!(file.principal(&first), Ok(anna));
        // Created while the server runs.
        let bert = principal("bert", Role::Reader);
        let second = create(&path, &bert, Some(Duration::from_secs(1000))).unwrap();
        assert_eq!(file.principal(&second), Ok(bert));
        assert_eq!(file.principal(&second[..second.len() - 1]), Err(InvalidToken::Unknown));
        assert_eq!(file.principal(""), Err(InvalidToken::Unknown));
        let listed = list(&path).unwrap();
        assert_eq!(listed.len(), 2);
        assert_eq!(listed[1].expires, Some(listed[1].created + 1000));
        revoke(&path, &listed[0].id).unwrap();
        assert_eq!(file.principal(&first), Err(InvalidToken::Unknown));
        assert!(file.principal(&second).is_ok());
        assert!(matches!(revoke(&path, &listed[0].id), Err(TokenFileError::Unknown(_))));
    }

    #[test]
    fn the_file_holds_no_token_and_is_its_owners() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tokens.json");
        let token = create(&path, &principal("anna", Role::Admin), None).unwrap();
        let secret = token.rsplit('_').next().unwrap();
        assert_eq!(secret.len(), 64);
        assert!(!fs::read_to_string(&path).unwrap().contains(secret));
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        }
    }

    #[test]
    fn a_token_expires() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tokens.json");
        let token = create(&path, &principal("anna", Role::User), Some(Duration::ZERO)).unwrap();
        assert_eq!(TokenFile::open(&path).unwrap().principal(&token), Err(InvalidToken::Expired));
    }

    #[test]
    fn a_file_that_breaks_while_it_is_used_changes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tokens.json");
        let token = create(&path, &principal("anna", Role::User), None).unwrap();
        let file = TokenFile::open(&path).unwrap();
        assert!(file.principal(&token).is_ok());
        fs::write(&path, "{}").unwrap();
        assert!(file.principal(&token).is_ok());
        assert!(TokenFile::open(&path).is_err());
    }

    #[test]
    fn tokens_made_at_the_same_time_are_all_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tokens.json");
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| create(&path, &principal("anna", Role::User), None).unwrap());
            }
        });
        assert_eq!(list(&path).unwrap().len(), 8);
    }
}
