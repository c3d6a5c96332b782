//! Verification: all objects are read, and what records need is there.

use std::collections::BTreeMap;

use crate::{
    error::StoreError,
    records::{AccessRecord, SessionRecord, check_hash, unseal, unseal_bytes},
    rows::CLOSED,
    store::Store,
};

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
    /// Reads all objects, and reports damaged and missing ones.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn verify(&self) -> Result<Verified, StoreError> {
        let objects = self.backend.list("").await?;
        let is_there = |name: &str| objects.binary_search_by(|object| object.name.as_str().cmp(name)).is_ok();
        let mut verified = Verified::default();
        // By row: the set-up that its last generation needs. Names sort by number.
        let mut needs: BTreeMap<&str, Option<String>> = BTreeMap::new();
        for object in &objects {
            let Some((content, _)) = self.backend.read(&object.name).await? else { continue };
            verified.objects += 1;
            verified.bytes += content.len() as u64;
            let name = object.name.as_str();
            let row = name.rsplit_once('/').map_or("", |(row, _)| row);
            let fault = match name.split_once('/') {
                Some(("blob", hash)) => check_hash(name, hash, &content).err(),
                Some(("setup", id)) => match self.manifest(id).await {
                    Ok(manifest) => {
                        let files = manifest.map(|manifest| manifest.files).unwrap_or_default();
                        let mut blobs = files.iter().map(|file| format!("blob/{}", file.hash));
                        blobs.find(|blob| !is_there(blob)).map(|blob| missing(blob, &format!("set-up {id}")))
                    }
                    Err(error) => Some(error),
                },
                Some(("derived", _)) => unseal_bytes(name, content).err(),
                Some(("access", _)) => match unseal::<AccessRecord>(name, &content) {
                    Ok(record) => {
                        let setup = row.rsplit('/').next().unwrap_or_default();
                        needs.insert(row, record.owned.then(|| setup.to_owned()));
                        None
                    }
                    Err(error) => Some(error),
                },
                Some(("session", _)) if name.ends_with(CLOSED) => {
                    needs.insert(row, None);
                    None
                }
                Some(("session", rest)) => match unseal::<SessionRecord>(name, &content) {
                    Ok(record) => {
                        let id = rest.rsplit_once('/').map_or(rest, |(id, _)| id);
                        let open = !is_there(&format!("closed/{id}"));
                        needs.insert(row, open.then_some(record.setup));
                        None
                    }
                    Err(error) => Some(error),
                },
                Some(("closed" | "request", _)) => unseal::<String>(name, &content).err(),
                _ => None,
            };
            verified.faults.extend(fault);
        }
        let needed = needs.into_iter().filter_map(|(row, setup)| Some((row, setup?)));
        for (row, setup) in needed.filter(|(_, setup)| !is_there(&format!("setup/{setup}"))) {
            verified.faults.push(missing(format!("setup/{setup}"), row));
        }
        Ok(verified)
    }
}

fn missing(object: String, needed_by: &str) -> StoreError {
    StoreError::corrupt(object, format!("it is missing, and {needed_by} needs it"))
}
