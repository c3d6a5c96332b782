//! An index of what each tenant holds, so that quotas, lists and figures look at nothing else.
//!
//! An entry is an empty object whose name says all: `index/<tenant>/<kind>/<id>@<bytes>`. The records decide what exists;
//! entries follow them. One is made before its record, as a reservation: a quota holds whoever writes, since each writer
//! counts after it has reserved, and takes its reservation back if there are too many. What a crash leaves is settled by the
//! next [collection](Store::collect).

use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use bytes::Bytes;

use crate::{
    error::{StoreError, unless_damaged},
    rows::CLOSED,
    store::Store,
};

/// What an entry stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// A set-up that the tenant owns.
    Setup,
    /// A set-up that the tenant has deleted, and that is not collected yet.
    Deleted,
    /// An open session.
    Session,
}

impl Kind {
    const ALL: [Self; 3] = [Self::Setup, Self::Deleted, Self::Session];

    fn name(self) -> &'static str {
        match self {
            Self::Setup => "setup",
            Self::Deleted => "deleted",
            Self::Session => "session",
        }
    }

    pub(crate) fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Whether its record is one of a session, or one of access to a set-up.
    pub(crate) fn is_of_session(self) -> bool {
        self == Self::Session
    }
}

/// Number of entries and their bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Held {
    /// Entries.
    pub count: usize,
    /// Bytes of all.
    pub bytes: u64,
}

impl Held {
    fn of(entries: &BTreeMap<String, u64>) -> Self {
        let bytes = entries.values().fold(0_u64, |sum, &bytes| sum.saturating_add(bytes));
        Self { count: entries.len(), bytes }
    }

    /// Both together.
    pub fn and(self, other: Self) -> Self {
        Self { count: self.count + other.count, bytes: self.bytes.saturating_add(other.bytes) }
    }
}

/// What a tenant holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// Its set-ups.
    pub setups: Held,
    /// Set-ups that it deleted, until they are collected.
    pub deleted: Held,
    /// Its open sessions; bytes beyond [`FREE`](crate::SessionRecord::FREE) of each.
    pub sessions: Held,
}

/// What a tenant may hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quota {
    /// Set-ups; as many deleted ones that are not collected yet.
    pub setups: usize,
    /// Open sessions.
    pub sessions: usize,
    /// Bytes of set-ups and sessions; as many of deleted set-ups.
    pub bytes: u64,
}

/// The part of a quota that does not suffice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Excess {
    /// Too many set-ups.
    Setups(usize),
    /// Too many open sessions.
    Sessions(usize),
    /// Too many bytes.
    Bytes(u64),
    /// Too many set-ups, or bytes of them, that are deleted but not collected yet.
    Deleted(Held),
}

impl Usage {
    /// The part of a quota that `more` of a kind would exceed.
    fn excess(&self, quota: &Quota, kind: Kind, more: Held) -> Option<Excess> {
        let (mut setups, mut sessions) = (self.setups, self.sessions);
        match kind {
            Kind::Session => sessions = sessions.and(more),
            Kind::Setup | Kind::Deleted => setups = setups.and(more),
        }
        let all = setups.and(self.deleted);
        let bytes = setups.bytes.saturating_add(sessions.bytes);
        match kind {
            Kind::Session if sessions.count > quota.sessions => Some(Excess::Sessions(self.sessions.count)),
            Kind::Setup if setups.count > quota.setups => Some(Excess::Setups(self.setups.count)),
            _ if bytes > quota.bytes => Some(Excess::Bytes(self.setups.and(self.sessions).bytes)),
            Kind::Setup
                if all.count > quota.setups.saturating_mul(2)
                    || all.bytes > quota.bytes.saturating_mul(2) =>
            {
                Some(Excess::Deleted(self.deleted))
            }
            _ => None,
        }
    }
}

/// What all tenants hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Survey {
    /// Different set-ups.
    pub setups: usize,
    /// Open sessions.
    pub sessions: usize,
    /// Bytes, as they count for the tenants.
    pub bytes: u64,
}

/// One turn for each tenant that reserves in this process: they do not push each other out.
#[derive(Debug, Default)]
pub(crate) struct Turns(Mutex<HashMap<String, Arc<tokio::sync::Mutex<()>>>>);

impl Turns {
    fn of(&self, tenant: &str) -> Arc<tokio::sync::Mutex<()>> {
        let mut turns = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        turns.retain(|name, turn| name == tenant || Arc::strong_count(turn) > 1);
        Arc::clone(turns.entry(tenant.to_owned()).or_default())
    }
}

/// A reservation, which is taken back unless its record has been written when it is dropped.
#[derive(Debug)]
pub struct Reservation {
    store: Store,
    tenant: String,
    kind: Kind,
    id: String,
    kept: bool,
}

impl Reservation {
    /// Its record has been written.
    pub fn keep(mut self) {
        self.kept = true;
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        if self.kept {
            return;
        }
        // Outside of a runtime nothing waits for it: the next collection settles it.
        let Ok(runtime) = tokio::runtime::Handle::try_current() else { return };
        let (store, tenant, kind, id) = (self.store.clone(), self.tenant.clone(), self.kind, self.id.clone());
        runtime.spawn(async move {
            if let Err(error) = store.settle(&tenant, kind, &id).await {
                tracing::warn!(%error, "a reservation stays for the next collection");
            }
        });
    }
}

/// Tries of a reservation while other servers reserve the last places at the same moment.
const TRIES: u32 = 5;
/// Upper bound of the first pause between tries.
const PAUSE: Duration = Duration::from_millis(20);

impl Store {
    fn folder(tenant: &str, kind: Kind) -> String {
        format!("index/{tenant}/{}", kind.name())
    }

    /// A tenant's entries of a kind, and their bytes.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn entries(&self, tenant: &str, kind: Kind) -> Result<BTreeMap<String, u64>, StoreError> {
        let mut entries = BTreeMap::new();
        for name in self.backend.children(&Self::folder(tenant, kind)).await? {
            let Some((id, bytes)) = name.split_once('@') else { continue };
            let Ok(bytes) = bytes.parse::<u64>() else { continue };
            // While an entry grows there are two of them.
            let entry = entries.entry(id.to_owned()).or_insert(bytes);
            *entry = bytes.max(*entry);
        }
        Ok(entries)
    }

    /// What a tenant holds.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn usage(&self, tenant: &str) -> Result<Usage, StoreError> {
        self.usage_besides(tenant, "").await
    }

    /// What a tenant holds, where one set-up does not count as deleted, since it is uploaded again.
    async fn usage_besides(&self, tenant: &str, id: &str) -> Result<Usage, StoreError> {
        let (setups, mut deleted, sessions) = tokio::try_join!(
            self.entries(tenant, Kind::Setup),
            self.entries(tenant, Kind::Deleted),
            self.entries(tenant, Kind::Session)
        )?;
        deleted.remove(id);
        let (setups, deleted, sessions) = (Held::of(&setups), Held::of(&deleted), Held::of(&sessions));
        Ok(Usage { setups, deleted, sessions })
    }

    /// What all tenants hold. It takes as long as they have set-ups and open sessions.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn survey(&self) -> Result<Survey, StoreError> {
        let (mut setups, mut survey) = (BTreeSet::new(), Survey::default());
        for tenant in self.backend.children("index").await? {
            let owned = self.entries(&tenant, Kind::Setup).await?;
            let sessions = Held::of(&self.entries(&tenant, Kind::Session).await?);
            survey.bytes = survey.bytes.saturating_add(Held::of(&owned).and(sessions).bytes);
            survey.sessions += sessions.count;
            setups.extend(owned.into_keys());
        }
        Ok(Survey { setups: setups.len(), ..survey })
    }

    /// Reserves a place within a tenant's quota, for a set-up or session that is about to be written, or for more bytes of it.
    ///
    /// # Errors
    /// If the store does not answer.
    pub async fn reserve(
        &self,
        tenant: &str,
        kind: Kind,
        id: &str,
        bytes: u64,
        quota: &Quota,
    ) -> Result<Result<Reservation, Excess>, StoreError> {
        let reservation = || Reservation {
            store: self.clone(),
            tenant: tenant.to_owned(),
            kind,
            id: id.to_owned(),
            kept: false,
        };
        // What stays within what is free needs no sum.
        let held = async || match (kind, bytes) {
            (Kind::Session, 0) => {
                let sessions = Held::of(&self.entries(tenant, kind).await?);
                Ok(Usage { sessions, ..Usage::default() })
            }
            _ => self.usage_besides(tenant, id).await,
        };
        let turn = self.turns.of(tenant);
        let _turn = turn.lock().await;
        let mut tries = 0;
        loop {
            let known = self.entries(tenant, kind).await?.get(id).copied();
            if known.is_some_and(|known| known >= bytes) {
                return Ok(Ok(reservation()));
            }
            let (count, more) = (usize::from(known.is_none()), bytes - known.unwrap_or(0));
            if let Some(excess) = held().await?.excess(quota, kind, Held { count, bytes: more }) {
                return Ok(Err(excess));
            }
            if !self.enter(tenant, kind, id, bytes).await? {
                return Ok(Ok(reservation()));
            }
            let Some(excess) = held().await?.excess(quota, kind, Held::default()) else {
                return Ok(Ok(reservation()));
            };
            self.backend.delete(&entry(tenant, kind, id, bytes)).await?;
            tries += 1;
            if tries == TRIES {
                return Ok(Err(excess));
            }
            let share = f64::from(uuid::Uuid::new_v4().as_bytes()[0]) / 256.0;
            tokio::time::sleep((PAUSE * 2_u32.pow(tries)).mul_f64(share)).await;
        }
    }

    /// Makes an entry; `false` if it was there.
    pub(crate) async fn enter(
        &self,
        tenant: &str,
        kind: Kind,
        id: &str,
        bytes: u64,
    ) -> Result<bool, StoreError> {
        self.backend.create(&entry(tenant, kind, id, bytes), Bytes::new()).await
    }

    /// Removes all entries of an id.
    pub(crate) async fn forget(&self, tenant: &str, kind: Kind, id: &str) -> Result<(), StoreError> {
        let folder = Self::folder(tenant, kind);
        let of_id = |name: &String| name.split_once('@').is_some_and(|(of, _)| of == id);
        for name in self.backend.children(&folder).await?.into_iter().filter(of_id) {
            self.backend.delete(&format!("{folder}/{name}")).await?;
        }
        Ok(())
    }

    /// Makes the index say of an id what its record says.
    pub(crate) async fn settle(&self, tenant: &str, kind: Kind, id: &str) -> Result<(), StoreError> {
        match kind {
            Kind::Setup | Kind::Deleted => self.settle_setup(tenant, id, BTreeSet::new()).await,
            Kind::Session => match self.session(tenant, id).await {
                Ok(Some(latest)) => self.enter(tenant, kind, id, latest.record.charged).await.map(drop),
                Ok(None) => self.forget(tenant, kind, id).await,
                // It can be closed still.
                Err(StoreError::Corrupt { .. }) => Ok(()),
                Err(error) => Err(error),
            },
        }
    }

    /// Makes the index of a store that has none.
    pub(crate) async fn make_index(&self) -> Result<(), StoreError> {
        for tenant in self.backend.children("access").await? {
            for setup in self.backend.children(&format!("access/{tenant}")).await? {
                self.settle_setup(&tenant, &setup, BTreeSet::new()).await?;
            }
        }
        for tenant in self.backend.children("session").await? {
            for id in self.backend.children(&format!("session/{tenant}")).await? {
                let names = self.backend.children(&format!("session/{tenant}/{id}")).await?;
                if !names.iter().any(|name| name == CLOSED) {
                    let latest = unless_damaged(self.session(&tenant, &id).await)?;
                    let charged = latest.map_or(0, |latest| latest.record.charged);
                    self.enter(&tenant, Kind::Session, &id, charged).await?;
                }
            }
        }
        Ok(())
    }
}

fn entry(tenant: &str, kind: Kind, id: &str, bytes: u64) -> String {
    format!("{}/{id}@{bytes}", Store::folder(tenant, kind))
}
