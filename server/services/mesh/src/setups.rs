//! Methods of set-ups: upload, build, list, share, delete.

use std::{
    sync::Arc,
    time::{Instant, SystemTime},
};

use futures::StreamExt;
use moldline_host::{Principal, Progress, Role, ServiceError, Share, Task, Tenant, Ticket};
use moldline_store::{AccessRecord, Claim, Kind, Reservation, Shared, StoreError, unless_damaged};

use crate::{
    access::{Access, Listed, Page, SetupSummary, Visibility},
    limits::Limits,
    read,
    service::{AT_ONCE, Service, after, request_hash, taken},
    setup_cache::StoredSetup,
    setup_id::SetupId,
    upload::{Upload, UploadHeader, Uploaded, check_visibility},
};

/// The answer to an upload.
#[derive(Clone, Debug)]
pub struct Created {
    /// The set-up.
    pub setup: Arc<StoredSetup>,
    /// The caller's access to it.
    pub access: Access,
    /// Whether it is new to the caller.
    pub built: bool,
}

/// A set-up, and the caller's access to it.
#[derive(Clone, Debug)]
pub struct SetupView {
    /// The set-up.
    pub setup: Arc<StoredSetup>,
    /// The caller's access to it.
    pub access: Access,
}

/// An upload in progress; its place is free when this is dropped.
#[derive(Debug)]
pub struct Receiving<'a> {
    upload: Upload,
    limits: &'a Limits,
    memory: Share,
    _place: Share,
}

impl Service {
    /// Begins to receive a set-up.
    ///
    /// # Errors
    /// `InvalidArgument` for an invalid header, `ResourceExhausted` if too many uploads are in progress,
    /// `PermissionDenied` to readers.
    pub fn receive(&self, caller: &Principal, header: UploadHeader) -> Result<Receiving<'_>, ServiceError> {
        caller.need(Role::User)?;
        let place = self.uploads.take(&caller.tenant, "the upload", 1)?;
        let memory = self.memory().take(&caller.tenant, "the upload", 0)?;
        let upload = Upload::begin(header, &self.limits)?;
        Ok(Receiving { upload, limits: &self.limits, memory, _place: place })
    }

    /// Builds an uploaded set-up, or finds the one with the same content, and stores it. Dropping the future abandons it; the
    /// build ends when nobody waits for it.
    ///
    /// # Errors
    /// `InvalidArgument` for invalid files, `AlreadyExists` for a request id that was used with other content,
    /// `ResourceExhausted` beyond a quota, `Unavailable` if it cannot be stored, `PermissionDenied` to readers.
    pub async fn create_setup(
        &self,
        caller: &Principal,
        mut uploaded: Uploaded,
        mut tell: impl FnMut(Progress),
    ) -> Result<Created, ServiceError> {
        caller.need(Role::User)?;
        let tenant = &caller.tenant;
        tell(Progress { stage: "read", fraction: 0.0, message: "reading the files".to_owned() });
        let request_id = uploaded.header.request_id.clone();
        let visibility = uploaded.header.visibility.clone();
        let limits = self.limits.clone();
        let mut memory = match uploaded.memory.take() {
            Some(memory) => memory,
            None => self.memory().take(tenant, "the upload", uploaded.bytes())?,
        };
        let task = Task { kind: "read", tenant: tenant.clone(), setup: None, session: None, memory: 0 };
        let read = move |_: &Ticket| Ok((read::uploaded(uploaded, &limits, &mut memory)?, memory));
        // Held until the set-up is stored.
        let (mut content, _memory) = self.pool.run(task, read).await?.value;
        let id = content.id.to_string();
        tell(Progress { stage: "read", fraction: 1.0, message: format!("set-up {id}") });

        let request = request_hash(&["setup", &id, &format!("{visibility:?}")]);
        if self.store.claim(tenant.as_str(), &request_id, &request).await? == Claim::Taken {
            return Err(taken(&request_id));
        }
        let began = Instant::now();
        let bytes: u64 = content.files.iter().map(|(_, file)| file.len() as u64).sum();
        let known = self.store.access_or_damage(tenant.as_str(), &id).await?.map(|known| known.record);
        let new = !matches!(known, Some(Ok(record)) if record.owned);
        let place = if new { Some(self.reserve(caller, Kind::Setup, &id, bytes).await?) } else { None };
        let files = std::mem::take(&mut content.files);
        let hide = new && self.limits.hide_known;
        let setup = self.setups.of_content(tenant, content, hide, tell).await?;
        self.store.put_setup(&files).await?;
        // A concurrent upload of the same content that failed may have taken the reservation back.
        let place = match place {
            Some(_) => Some(self.reserve(caller, Kind::Setup, &id, bytes).await?),
            None => None,
        };
        let (access, built) = self.own(caller, &setup, bytes, visibility).await?;
        place.into_iter().for_each(Reservation::keep);
        if hide {
            tokio::time::sleep_until((began + setup.answer_time()).into()).await;
        }
        Ok(Created { setup, access, built })
    }

    /// Makes the caller an owner of a set-up; whether it was none before.
    async fn own(
        &self,
        caller: &Principal,
        setup: &StoredSetup,
        bytes: u64,
        visibility: Option<Visibility>,
    ) -> Result<(Access, bool), ServiceError> {
        let (tenant, id) = (caller.tenant.as_str(), setup.id.as_str());
        loop {
            let known = self.store.access_or_damage(tenant, id).await?;
            let number = known.as_ref().map_or(1, |known| known.number + 1);
            let known = unless_damaged(known.map(|known| known.record).transpose())?;
            let (record, new) = match known.filter(|record| record.owned) {
                Some(record) => match &visibility {
                    Some(visibility) => (AccessRecord { shared: shared(visibility), ..record }, false),
                    None => return Ok((owner_access(&record), false)),
                },
                None => {
                    let shared = shared(visibility.as_ref().unwrap_or(&Visibility::Private));
                    (access_record(setup, bytes, shared), true)
                }
            };
            if self.store.put_access(tenant, id, number, &record).await? {
                return Ok((owner_access(&record), new));
            }
        }
    }

    /// The set-up of that id.
    ///
    /// # Errors
    /// `NotFound`, `Unavailable` if the store does not answer.
    pub async fn get_setup(&self, caller: &Principal, id: &str) -> Result<SetupView, ServiceError> {
        let not_found = || ServiceError::not_found("setup", id);
        let (_, access) = self.access(&caller.tenant, id).await?.ok_or_else(not_found)?;
        let setup = self.setups.named(&caller.tenant, id).await?.ok_or_else(not_found)?;
        Ok(SetupView { setup, access })
    }

    /// A tenant's access to a set-up; `None` if it may not use it.
    async fn access(&self, tenant: &Tenant, id: &str) -> Result<Option<(AccessRecord, Access)>, StoreError> {
        if !SetupId::is_valid(id) {
            return Ok(None);
        }
        let own = self.store.access(tenant.as_str(), id).await?.map(|known| known.record);
        if let Some(record) = own.filter(|record| record.owned) {
            let access = owner_access(&record);
            return Ok(Some((record, access)));
        }
        let granted = self.store.granted(tenant.as_str(), id).await?;
        Ok(granted.map(|record| {
            let visibility = match record.shared {
                Shared::Public => Visibility::Public,
                _ => Visibility::Tenants([tenant.clone()].into()),
            };
            (record, Access { owned: false, visibility })
        }))
    }

    /// The set-ups that the caller may use.
    ///
    /// # Errors
    /// `Unavailable` if the store does not answer.
    pub async fn list_setups(
        &self,
        caller: &Principal,
        page: &Page,
    ) -> Result<Listed<SetupSummary>, ServiceError> {
        let names = self.store.setups_of(caller.tenant.as_str()).await?;
        let summaries = after(names, page).map(|id| async move {
            let found = unless_damaged(self.access(&caller.tenant, &id).await)?;
            Ok(found.map(|(record, access)| SetupSummary {
                id,
                name: record.name,
                vertices: record.vertices as usize,
                cells: record.cells as usize,
                variables: record.variables as usize,
                created: record.created,
                access,
            }))
        });
        self.listed(page, summaries.buffered(AT_ONCE), |summary: &SetupSummary| summary.id.clone()).await
    }

    /// Sets which other tenants may use a set-up that the caller owns. Those that may not use it any more are refused from
    /// their next call on, in sessions too; calls that run are finished.
    ///
    /// # Errors
    /// `NotFound`, `InvalidArgument` for too many tenants, `PermissionDenied` to readers, `Unavailable` if it cannot be stored.
    pub async fn share_setup(
        &self,
        caller: &Principal,
        id: &str,
        visibility: Visibility,
    ) -> Result<Access, ServiceError> {
        caller.need(Role::User)?;
        check_visibility("", Some(&visibility), &self.limits)?;
        self.change_access(caller, id, |record| record.shared = shared(&visibility)).await
    }

    /// Gives up a set-up that the caller owns. Its own sessions on it go on; those of tenants with which it was shared are
    /// refused from their next call on.
    ///
    /// # Errors
    /// `NotFound`, `PermissionDenied` to readers, `Unavailable` if it cannot be stored.
    pub async fn delete_setup(&self, caller: &Principal, id: &str) -> Result<(), ServiceError> {
        caller.need(Role::User)?;
        self.change_access(caller, id, |record| record.owned = false).await.map(drop)
    }

    async fn change_access(
        &self,
        caller: &Principal,
        id: &str,
        change: impl Fn(&mut AccessRecord),
    ) -> Result<Access, ServiceError> {
        let tenant = caller.tenant.as_str();
        let not_found = || ServiceError::not_found("setup", id);
        if !SetupId::is_valid(id) {
            return Err(not_found());
        }
        loop {
            let known = self.store.access(tenant, id).await?.filter(|known| known.record.owned);
            let mut known = known.ok_or_else(not_found)?;
            change(&mut known.record);
            if self.store.put_access(tenant, id, known.number + 1, &known.record).await? {
                return Ok(owner_access(&known.record));
            }
        }
    }
}

impl Receiving<'_> {
    /// Appends bytes to a file.
    ///
    /// # Errors
    /// `InvalidArgument` if they do not fit the header, `ResourceExhausted` if there is no memory for them.
    pub fn append(&mut self, file: usize, data: &[u8]) -> Result<(), ServiceError> {
        self.memory.grow("the upload", data.len() as u64)?;
        self.upload.append(file, data, self.limits)
    }

    /// Progress of the upload.
    pub fn progress(&self) -> Progress {
        let message = "receiving the files".to_owned();
        Progress { stage: "receive", fraction: self.upload.fraction(), message }
    }

    /// Ends the upload.
    ///
    /// # Errors
    /// `InvalidArgument` naming the first incomplete file.
    pub fn finish(self) -> Result<Uploaded, ServiceError> {
        Ok(Uploaded { memory: Some(self.memory), ..self.upload.finish()? })
    }
}

fn owner_access(record: &AccessRecord) -> Access {
    let visibility = match &record.shared {
        Shared::Private => Visibility::Private,
        Shared::Public => Visibility::Public,
        Shared::Tenants(tenants) => {
            Visibility::Tenants(tenants.iter().filter_map(|tenant| Tenant::new(tenant).ok()).collect())
        }
    };
    Access { owned: true, visibility }
}

fn shared(visibility: &Visibility) -> Shared {
    match visibility {
        Visibility::Private => Shared::Private,
        Visibility::Public => Shared::Public,
        Visibility::Tenants(tenants) => Shared::Tenants(tenants.iter().map(Tenant::to_string).collect()),
    }
}

fn access_record(setup: &StoredSetup, bytes: u64, shared: Shared) -> AccessRecord {
    let mesh = setup.engine.mesh();
    AccessRecord {
        owned: true,
        shared,
        name: setup.name.clone(),
        vertices: mesh.vertices.len() as u64,
        cells: mesh.cells.len() as u64,
        variables: setup.engine.parameterisation().variables().len() as u64,
        bytes,
        created: SystemTime::now(),
    }
}
