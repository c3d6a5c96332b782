//! Garbage collection, by hand and by itself.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
    time::{Duration, Instant},
};

use crate::{
    access::grants,
    backend::{Listed, is_staged},
    error::StoreError,
    index::Kind,
    lease::Lease,
    records::{AccessRecord, SessionRecord, older},
    requests::REMEMBERED,
    rows::{CLOSED, KEPT},
    store::Store,
};

/// Objects that a collection removed or, in a dry run, would remove.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Collected {
    /// Their names.
    pub objects: Vec<String>,
    /// Their size.
    pub bytes: u64,
}

/// When a store is collected by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schedule {
    /// Time between collections, of all servers on the store together.
    pub every: Duration,
    /// Objects that were written after this time stay; longer than any upload takes, and than an hour.
    pub grace: Duration,
}

/// Share of the time that a collection by itself takes of the store.
const SHARE: f64 = 0.1;
/// Longest rest after one step.
const REST: Duration = Duration::from_secs(5);
/// Term of the lease under which a store is collected.
const TERM: Duration = Duration::from_secs(300);

/// The pace of a collection.
enum Pace {
    /// As fast as the store.
    Full,
    /// With rests, and for as long as the lease holds.
    Leased(Lease),
}

impl Pace {
    /// Rests after a step; whether the collection may go on.
    async fn next(&mut self, began: Instant) -> Result<bool, StoreError> {
        let Self::Leased(lease) = self else { return Ok(true) };
        tokio::time::sleep(began.elapsed().mul_f64(1.0 / SHARE - 1.0).min(REST)).await;
        lease.holds().await
    }
}

/// What a collection has found.
#[derive(Default)]
struct Found {
    garbage: Vec<Listed>,
    /// Ids of set-ups with an owner or a session.
    needed: BTreeSet<String>,
    /// Names of grants that a record stands for.
    granted: BTreeSet<String>,
}

impl Store {
    /// Collects the store on a schedule: under a lease, so that one of many servers does it, and at a tenth of its speed. It
    /// goes on until it is dropped.
    pub async fn collect_by_itself(self, schedule: Schedule) {
        let pause = (schedule.every / 8).clamp(Duration::from_secs(1), Duration::from_secs(600));
        loop {
            tokio::time::sleep(pause).await;
            match self.collect_if_due(schedule).await {
                Ok(Some(collected)) => {
                    let (objects, bytes) = (collected.objects.len(), collected.bytes);
                    tracing::info!(objects, bytes, "collected the store");
                }
                Ok(None) => {}
                Err(error) => tracing::warn!(%error, "the store is not collected"),
            }
        }
    }

    /// A collection, if it is due and no other server is at it.
    ///
    /// # Errors
    /// Those of [`collect`](Self::collect).
    pub async fn collect_if_due(&self, schedule: Schedule) -> Result<Option<Collected>, StoreError> {
        let Some(lease) = self.lease("collect", TERM, schedule.every).await? else { return Ok(None) };
        let mut pace = Pace::Leased(lease);
        let collected = self.collect_at(schedule.grace, false, &mut pace).await?;
        if let Pace::Leased(lease) = pace {
            lease.finish().await?;
        }
        Ok(Some(collected))
    }

    /// Removes unreachable objects that have not been written for `grace`; with `dry_run` only lists them. Under a running
    /// service `grace` must be longer than any upload takes, and than an hour.
    ///
    /// # Errors
    /// If the store does not answer, or a record that decides is damaged; nothing is removed then.
    pub async fn collect(&self, grace: Duration, dry_run: bool) -> Result<Collected, StoreError> {
        self.collect_at(grace, dry_run, &mut Pace::Full).await
    }

    async fn collect_at(
        &self,
        grace: Duration,
        dry_run: bool,
        pace: &mut Pace,
    ) -> Result<Collected, StoreError> {
        let mut found = Found::default();
        let mut collected = Collected::default();
        let tenants = self.tenants().await?;
        // Content is listed last: what is uploaded meanwhile is young.
        for tenant in &tenants {
            let began = Instant::now();
            let used = self.look_at_sessions(tenant, &mut found).await?;
            self.look_at_access(tenant, &used, grace, &mut found).await?;
            found.needed.extend(used);
            for below in ["closed", "request"] {
                let objects = self.backend.list(&format!("{below}/{tenant}")).await?;
                found.garbage.extend(objects.into_iter().filter(|object| older(object.modified, REMEMBERED)));
            }
            if !pace.next(began).await? {
                return Ok(collected);
            }
        }
        let began = Instant::now();
        self.look_at_content(grace, &mut found).await?;
        if !pace.next(began).await? {
            return Ok(collected);
        }
        for object in found.garbage.into_iter().filter(|object| older(object.modified, grace)) {
            let began = Instant::now();
            if !dry_run {
                // It may have been rewritten since it was listed.
                match self.backend.modified(&object.name).await? {
                    Some(modified) if older(modified, grace) => self.backend.delete(&object.name).await?,
                    _ => continue,
                }
                if let Some(("session", rest)) = object.name.split_once('/')
                    && let Some((id, _)) = rest.rsplit_once('/')
                {
                    self.backend.remove_folder(&format!("session/{id}")).await;
                }
            }
            collected.bytes += object.size;
            collected.objects.push(object.name);
            if !pace.next(began).await? {
                return Ok(collected);
            }
        }
        if !dry_run {
            for tenant in &tenants {
                let began = Instant::now();
                self.settle_index(tenant, grace).await?;
                if !pace.next(began).await? {
                    return Ok(collected);
                }
            }
        }
        if let Some(folder) = self.backend.local_folder() {
            leftovers(folder, folder, grace, dry_run, &mut collected);
        }
        Ok(collected)
    }

    async fn look_at_access(
        &self,
        tenant: &str,
        used: &BTreeSet<String>,
        grace: Duration,
        found: &mut Found,
    ) -> Result<(), StoreError> {
        for (row, mut generations) in rows(self.backend.list(&format!("access/{tenant}")).await?) {
            let setup = row.rsplit('/').next().unwrap_or_default().to_owned();
            let Some(last) = generations.last() else { continue };
            let record: Option<AccessRecord> = self.record(&last.name).await?;
            match record {
                // What was deleted just now may be in use by a session that is being opened; and that the tenant had uploaded it
                // is what its sessions rely upon.
                Some(record) if !record.owned && older(last.modified, grace) && !used.contains(&setup) => {}
                record => {
                    if let Some(record) = record {
                        found.granted.extend(grants(tenant, &setup, &record));
                    }
                    found.needed.insert(setup);
                    generations.truncate(generations.len().saturating_sub(KEPT as usize));
                }
            }
            found.garbage.extend(generations);
        }
        Ok(())
    }

    /// Set-ups that open sessions of a tenant use.
    async fn look_at_sessions(
        &self,
        tenant: &str,
        found: &mut Found,
    ) -> Result<BTreeSet<String>, StoreError> {
        let mut used = BTreeSet::new();
        let below = format!("session/{tenant}");
        let sessions = rows(self.backend.list(&below).await?);
        // Listed after the sessions: what is closed meanwhile counts as open.
        for (row, mut generations) in sessions {
            let id = &row[below.len() + 1..];
            let marked = generations.iter().any(|object| object.name.ends_with(CLOSED));
            if !marked && !self.backend.exists(&format!("closed/{tenant}/{id}")).await? {
                let Some(last) = generations.last() else { continue };
                if let Some(record) = self.record::<SessionRecord>(&last.name).await? {
                    used.insert(record.setup);
                }
                generations.truncate(generations.len().saturating_sub(KEPT as usize));
            }
            // A mark that it is closed is removed last.
            found.garbage.extend(generations);
        }
        Ok(used)
    }

    async fn look_at_content(&self, grace: Duration, found: &mut Found) -> Result<(), StoreError> {
        let Found { garbage, needed, granted } = found;
        let mut blobs = BTreeSet::new();
        for object in self.backend.list("setup").await? {
            let id = &object.name["setup/".len()..];
            // A young set-up may be about to get an owner: its blobs stay with it.
            if needed.contains(id) || !older(object.modified, grace) {
                let files = self.manifest(id).await?.map(|manifest| manifest.files).unwrap_or_default();
                blobs.extend(files.into_iter().map(|file| file.hash));
            } else {
                garbage.push(object);
            }
        }
        let blob = |object: &Listed| !blobs.contains(&object.name["blob/".len()..]);
        garbage.extend(self.backend.list("blob").await?.into_iter().filter(blob));
        let derived = |object: &Listed| {
            let setup = object.name.split('/').nth(1).unwrap_or_default();
            !needed.contains(setup)
        };
        garbage.extend(self.backend.list("derived").await?.into_iter().filter(derived));
        let grant = |object: &Listed| !granted.contains(&object.name);
        garbage.extend(self.backend.list("grant").await?.into_iter().filter(grant));
        garbage.extend(self.backend.list("probe").await?);
        Ok(())
    }

    /// Settles what crashes left in the index of a tenant.
    async fn settle_index(&self, tenant: &str, grace: Duration) -> Result<(), StoreError> {
        let mut known = BTreeSet::new();
        let below = format!("index/{tenant}/");
        for object in self.backend.list(&below).await? {
            let Some((kind, entry)) = object.name[below.len()..].split_once('/') else { continue };
            let (Some(kind), Some((id, _))) = (Kind::named(kind), entry.split_once('@')) else { continue };
            known.insert((kind.is_of_session(), id.to_owned()));
            if older(object.modified, grace) {
                self.settle(tenant, kind, id).await?;
            }
        }
        for setup in self.backend.children(&format!("access/{tenant}")).await? {
            if !known.contains(&(false, setup.clone())) {
                self.settle(tenant, Kind::Setup, &setup).await?;
            }
        }
        for id in self.backend.children(&format!("session/{tenant}")).await? {
            if !known.contains(&(true, id.clone())) {
                self.settle(tenant, Kind::Session, &id).await?;
            }
        }
        Ok(())
    }
}

/// Objects grouped by all but the last part of their names; each group sorted.
fn rows(objects: Vec<Listed>) -> BTreeMap<String, Vec<Listed>> {
    let mut rows: BTreeMap<String, Vec<Listed>> = BTreeMap::new();
    for object in objects {
        if let Some((row, _)) = object.name.rsplit_once('/') {
            rows.entry(row.to_owned()).or_default().push(object);
        }
    }
    rows
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
        let old = about.modified().is_ok_and(|modified| older(modified, grace));
        if is_staged(&name) && old && (dry_run || std::fs::remove_file(&path).is_ok()) {
            collected.bytes += about.len();
            collected.objects.push(name);
        }
    }
}
