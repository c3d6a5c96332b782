//! Quotas of single tenants, from a file that is read at the start and at SIGHUP.
//!
//! ```json
//! { "format": 1, "tenants": { "anna": { "setups": 10, "sessions": 200, "stored_mib": 4096 } } }
//! ```
//!
//! What an entry leaves out, and a tenant without an entry, has the server's usual quota.

use std::{
    collections::{BTreeMap, HashMap},
    fs, io,
    path::{Path, PathBuf},
};

use moldline_host::Tenant;
use moldline_mesh_service::Quota;
use serde::Deserialize;

const FORMAT: u32 = 1;

/// A file of quotas that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum QuotaFileError {
    /// It cannot be read.
    #[error("{}: {error}", path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// The reason.
        error: io::Error,
    },
    /// Its content is not one of quotas.
    #[error(
        "{}: {reason}; expected {{\"format\": 1, \"tenants\": {{\"NAME\": {{\"setups\": COUNT, \"sessions\": COUNT, \
         \"stored_mib\": MIB}}}}}}", path.display()
    )]
    Content {
        /// Path of the file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    format: u32,
    tenants: BTreeMap<String, Entry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    setups: Option<usize>,
    sessions: Option<usize>,
    stored_mib: Option<u64>,
}

/// The quotas in a file, where `usual` is what tenants have without it.
///
/// # Errors
/// If the file cannot be read, or is not one of quotas.
pub fn read(path: &Path, usual: Quota) -> Result<HashMap<Tenant, Quota>, QuotaFileError> {
    let text = fs::read(path).map_err(|error| QuotaFileError::File { path: path.to_owned(), error })?;
    let content = |reason: String| QuotaFileError::Content { path: path.to_owned(), reason };
    let document: Document = serde_json::from_slice(&text).map_err(|error| content(error.to_string()))?;
    if document.format != FORMAT {
        return Err(content(format!("format {} is not {FORMAT}", document.format)));
    }
    let quota = |(name, entry): (String, Entry)| {
        let tenant = Tenant::new(&name).map_err(|error| content(error.to_string()))?;
        let quota = Quota {
            setups: entry.setups.unwrap_or(usual.setups),
            sessions: entry.sessions.unwrap_or(usual.sessions),
            bytes: entry.stored_mib.map_or(usual.bytes, |stored| stored.saturating_mul(1 << 20)),
        };
        Ok((tenant, quota))
    };
    document.tenants.into_iter().map(quota).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const USUAL: Quota = Quota { setups: 3, sessions: 4, bytes: 5 };

    fn reading(text: &str) -> Result<HashMap<Tenant, Quota>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("quotas.json");
        fs::write(&path, text).unwrap();
        read(&path, USUAL).map_err(|error| error.to_string())
    }

    #[test]
    fn what_an_entry_leaves_out_is_usual() {
        let quotas = reading(
            r#"{"format": 1, "tenants": {"anna": {"sessions": 0}, "ben": {"setups": 9, "stored_mib": 2}}}"#,
        );
        let quotas = quotas.unwrap();
        assert_eq!(quotas[&Tenant::new("anna").unwrap()], Quota { sessions: 0, ..USUAL });
        assert_eq!(quotas[&Tenant::new("ben").unwrap()], Quota { setups: 9, bytes: 2 << 20, ..USUAL });
        assert_eq!(reading(r#"{"format": 1, "tenants": {}}"#).unwrap().len(), 0);
    }

    #[test]
    fn another_content_is_refused_with_what_is_wrong() {
        for (text, words) in [
            ("", "EOF"),
            (r#"{"format": 2, "tenants": {}}"#, "format 2"),
            (r#"{"format": 1, "tenants": {"Anna S": {}}}"#, "Anna S"),
            (r#"{"format": 1, "tenants": {"anna": {"stored": 1}}}"#, "stored"),
            (r#"{"format": 1, "tenants": {"anna": {"setups": -1}}}"#, "-1"),
        ] {
            let error = reading(text).unwrap_err();
            assert!(error.contains(words) && error.contains("stored_mib"), "{error}");
        }
        assert!(read(Path::new("/nowhere/quotas.json"), USUAL).is_err());
    }
}
