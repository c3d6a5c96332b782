//! Garbage collection and verification.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
    time::Duration,
};

use crate::{
    backend::Listed,
    error::StoreError,
    records::{AccessRecord, SessionRecord, unseal, unseal_bytes},
    store::{CLOSED, Store, check_hash, older},
};

/// Minimum time for which request ids are kept, whatever the grace period.
const REQUESTS: Duration = Duration::from_secs(7 * 24 * 3600);

/// Objects that a collection removed or, in a dry run, would remove.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Collected {
    /// Their names.
    pub objects: Vec<String>,
    /// Their size.
    pub bytes: u64,
}

/// The result of a verification.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Verified {
    /// Number of objects read.
    pub objects: usize,
    /// Their size.
    pub bytes: u64,
    /// Damaged and missing objects.
    pub faults: Vec<StoreError>,
}

impl Store {
    /// Removes unreachable objects that have not been written for `grace`; with `dry_run` only lists them. Under a running
    /// service `grace` must be longer than any upload takes, and than an hour.
    ///
    /// # Errors
    /// If the store does not answer, or a record that decides is damaged; nothing is removed then.
    pub async fn collect(&self, grace: Duration, dry_run: bool) -> Result<Collected, StoreError> {
        let objects = self.backend.list("").await?;
        let mut garbage: Vec<&Listed> = Vec::new();
        let mut needed = BTreeSet::new();

        for (row, generations) in rows(&objects, "access/") {
            let setup = row.rsplit('/').next().unwrap_or_default();
            let last = generations[generations.len() - 1];
            let record: Option<AccessRecord> = self.read_record(&last.name).await?;
            garbage.extend(&generations[..generations.len() - 1]);
            match record {
                Some(record) if !record.owned => garbage.push(last),
                _ => drop(needed.insert(setup.to_owned())),
            }
        }
        for (_, generations) in rows(&objects, "session/") {
            if generations.iter().any(|object| object.name.ends_with(CLOSED)) {
                // The mark that it is closed is removed last.
                garbage.extend(generations);
                continue;
            }
            let last = generations[generations.len() - 1];
            // The first generation reserves the id.
            garbage.extend(&generations[1.min(generations.len() - 1)..generations.len() - 1]);
            if let Some(record) = self.read_record::<SessionRecord>(&last.name).await? {
                needed.insert(record.setup);
            }
        }
        let mut blobs = BTreeSet::new();
        for object in objects.iter().filter(|object| object.name.starts_with("setup/")) {
            let id = &object.name["setup/".len()..];
            // A young set-up may be about to get an owner: its blobs stay with it.
            if needed.contains(id) || !older(object.modified, grace) {
                let files = self.manifest(id).await?.map(|manifest| manifest.files).unwrap_or_default();
                blobs.extend(files.into_iter().map(|file| file.hash));
            } else {
                garbage.push(object);
            }
        }
        for object in &objects {
            let name = object.name.as_str();
            let unreachable = match name.split_once('/') {
                Some(("blob", hash)) => !blobs.contains(hash),
                Some(("derived", rest)) => match rest.split_once('/') {
                    Some((setup, _)) => !needed.contains(setup),
                    None => true,
                },
                Some(("grant", rest)) => {
                    let mut parts = rest.split('/').skip(1);
                    let (setup, owner) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
                    !needed.contains(setup) || !has_row(&objects, &format!("access/{owner}/{setup}/"))
                }
                Some(("request", _)) => older(object.modified, REQUESTS),
                _ => false,
            };
            if unreachable {
                garbage.push(object);
            }
        }

        let mut collected = Collected::default();
        for object in garbage.into_iter().filter(|object| older(object.modified, grace)) {
            if !dry_run {
                // It may have been rewritten since it was listed.
                match self.backend.read(&object.name).await? {
                    Some((_, modified)) if older(modified, grace) => {
                        self.backend.delete(&object.name).await?
                    }
                    _ => continue,
                }
            }
            collected.objects.push(object.name.clone());
            collected.bytes += object.size;
        }
        if let Some(folder) = self.backend.local_folder() {
            leftovers(folder, folder, grace, dry_run, &mut collected);
        }
        Ok(collected)
    }

    async fn read_record<T: serde::de::DeserializeOwned>(&self, name: &str) -> Result<Option<T>, StoreError> {
        let found = self.backend.read(name).await?;
        found.map(|(sealed, _)| unseal(name, &sealed)).transpose()
    }

    /// Reads all objects, and reports damaged and missing ones.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn verify(&self) -> Result<Verified, StoreError> {
        let objects = self.backend.list("").await?;
        let mut verified = Verified::default();
        for object in &objects {
            let Some((content, _)) = self.backend.read(&object.name).await? else { continue };
            verified.objects += 1;
            verified.bytes += content.len() as u64;
            let name = object.name.as_str();
            let fault = match name.split_once('/') {
                Some(("blob", hash)) => check_hash(name, hash, &content).err(),
                Some(("setup", id)) => match self.manifest(id).await {
                    Ok(manifest) => {
                        let files = manifest.map(|manifest| manifest.files).unwrap_or_default();
                        let is_missing = |hash: &str| {
                            let name = format!("blob/{hash}");
                            objects.binary_search_by(|object| object.name.as_str().cmp(&name)).is_err()
                        };
                        files.iter().find(|file| is_missing(&file.hash)).map(|file| {
                            let name = format!("blob/{}", file.hash);
                            StoreError::corrupt(name, format!("it is missing, and set-up {id} needs it"))
                        })
                    }
                    Err(error) => Some(error),
                },
                Some(("derived", _)) => unseal_bytes(name, content).err(),
                Some(("access", _)) => unseal::<AccessRecord>(name, &content).err(),
                Some(("session", _)) if !name.ends_with(CLOSED) => {
                    unseal::<SessionRecord>(name, &content).err()
                }
                Some(("request", _)) => unseal::<String>(name, &content).err(),
                _ => None,
            };
            verified.faults.extend(fault);
        }
        Ok(verified)
    }
}

/// Objects below `kind`, grouped by all but the last part of their names; each group sorted.
fn rows<'o>(objects: &'o [Listed], kind: &str) -> BTreeMap<String, Vec<&'o Listed>> {
    let mut rows: BTreeMap<String, Vec<&Listed>> = BTreeMap::new();
    for object in objects.iter().filter(|object| object.name.starts_with(kind)) {
        if let Some((row, _)) = object.name.rsplit_once('/') {
            rows.entry(row.to_owned()).or_default().push(object);
        }
    }
    rows
}

/// Whether any object has a name with that prefix.
fn has_row(objects: &[Listed], row: &str) -> bool {
    let first = objects.partition_point(|object| object.name.as_str() < row);
    objects.get(first).is_some_and(|object| object.name.starts_with(row))
}

/// Files that were being written when a process ended; they are never visible to readers.
fn leftovers(root: &Path, folder: &Path, grace: Duration, dry_run: bool, collected: &mut Collected) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let (path, Ok(about)) = (entry.path(), entry.metadata()) else { continue };
        if about.is_dir() {
            leftovers(root, &path, grace, dry_run, collected);
            continue;
        }
        let name = path.strip_prefix(root).unwrap_or(&path).to_string_lossy().into_owned();
        let staged = name.rsplit_once('#').is_some_and(|(_, n)| n.bytes().all(|byte| byte.is_ascii_digit()));
        let old = about.modified().is_ok_and(|modified| older(modified, grace));
        if staged && old && (dry_run || std::fs::remove_file(&path).is_ok()) {
            collected.bytes += about.len();
            collected.objects.push(name);
        }
    }
}
