//! An index of sessions. A session is a row of small records in the store, each an immutable generation; memory holds only
//! which set-up a session uses, so that requests in quick succession do not read the store again.

use std::{
    collections::HashMap,
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use moldline_host::{Code, ServiceError, Tenant};
use moldline_store::{Generation, Numbers, SessionRecord, Store, StoreError};

use crate::{
    access::Session,
    linearisation::{Design, Values},
};

/// How long a session that was found open counts as open: one closed through another server is rejected after this time.
const FRESH: Duration = Duration::from_secs(1);
/// Sessions in memory.
const KNOWN: usize = 4096;

/// Sessions of a store, and those found recently.
#[derive(Debug)]
pub struct SessionIndex {
    store: Store,
    known: Mutex<HashMap<(Tenant, String), Known>>,
}

#[derive(Clone, Debug)]
struct Known {
    setup: String,
    found: Instant,
}

impl SessionIndex {
    /// The sessions of a store.
    pub fn new(store: Store) -> Self {
        Self { store, known: Mutex::default() }
    }

    /// Id of the set-up of an open session, which its tenant may use.
    ///
    /// # Errors
    /// `NotFound`, `PermissionDenied` if the set-up is not shared any more; if the store does not answer, for sessions that
    /// were not found before.
    pub async fn setup_of(&self, tenant: &Tenant, id: &str) -> Result<String, ServiceError> {
        let key = (tenant.clone(), id.to_owned());
        let known = self.lock().get(&key).cloned();
        if let Some(known) = &known
            && known.found.elapsed() < FRESH
        {
            return Ok(known.setup.clone());
        }
        let latest = match self.latest(tenant, id).await {
            Ok(Some(latest)) => self.may_use(tenant, &latest.record).await.map(|may| Some((latest, may))),
            Ok(None) => Ok(None),
            Err(error) => Err(error),
        };
        match (latest, known) {
            (Ok(Some((latest, true))), _) => {
                self.remember(key, &latest.record.setup);
                Ok(latest.record.setup)
            }
            (Ok(Some((latest, false))), _) => {
                self.lock().remove(&key);
                Err(no_longer_shared(&latest.record.setup))
            }
            (Ok(None), _) => {
                self.lock().remove(&key);
                Err(ServiceError::not_found("session", id))
            }
            (Err(StoreError::Unavailable { reason, .. }), Some(known)) => {
                tracing::warn!(
                    session = id,
                    reason,
                    "the store does not answer; using the session as it was last read"
                );
                Ok(known.setup)
            }
            (Err(error), _) => Err(error.into()),
        }
    }

    /// Whether a tenant may still use the set-up of its session: it has uploaded the same content itself, before or after it
    /// opened the session, or the set-up is shared with it. Sessions of older versions do not say, and go on.
    async fn may_use(&self, tenant: &Tenant, record: &SessionRecord) -> Result<bool, StoreError> {
        let (tenant, setup) = (tenant.as_str(), record.setup.as_str());
        Ok(record.own
            || record.opened.is_empty()
            || self.store.access_or_damage(tenant, setup).await?.is_some()
            || self.store.granted(tenant, setup).await?.is_some())
    }

    /// The last generation of an open session whose set-up its tenant may use.
    ///
    /// # Errors
    /// `NotFound`, `PermissionDenied` if the set-up is not shared any more, or if the store does not answer.
    pub async fn usable(&self, tenant: &Tenant, id: &str) -> Result<Generation<SessionRecord>, ServiceError> {
        let latest = self.get(tenant, id).await?;
        match self.may_use(tenant, &latest.record).await? {
            true => Ok(latest),
            false => Err(no_longer_shared(&latest.record.setup)),
        }
    }

    /// The last generation of an open session.
    ///
    /// # Errors
    /// `NotFound`, or if the store does not answer.
    pub async fn get(&self, tenant: &Tenant, id: &str) -> Result<Generation<SessionRecord>, ServiceError> {
        self.latest(tenant, id).await?.ok_or_else(|| ServiceError::not_found("session", id))
    }

    /// The hash of the request that opened a session, which may have a damaged record.
    ///
    /// # Errors
    /// `NotFound`, or if the store does not answer.
    pub async fn opened_by(&self, tenant: &Tenant, id: &str) -> Result<String, ServiceError> {
        match self.latest(tenant, id).await {
            Ok(Some(latest)) => Ok(latest.record.opened),
            Err(StoreError::Corrupt { .. }) => Ok(String::new()),
            Ok(None) => Err(ServiceError::not_found("session", id)),
            Err(error) => Err(error.into()),
        }
    }

    async fn latest(
        &self,
        tenant: &Tenant,
        id: &str,
    ) -> Result<Option<Generation<SessionRecord>>, StoreError> {
        match is_id(id) {
            true => self.store.session(tenant.as_str(), id).await,
            false => Ok(None),
        }
    }

    /// Records a session that was just stored as open.
    pub fn opened(&self, tenant: &Tenant, id: &str, setup: &str) {
        self.remember((tenant.clone(), id.to_owned()), setup);
    }

    /// Forgets a session that was just closed.
    pub fn closed(&self, tenant: &Tenant, id: &str) {
        self.lock().remove(&(tenant.clone(), id.to_owned()));
    }

    fn remember(&self, key: (Tenant, String), setup: &str) {
        let mut known = self.lock();
        known.insert(key, Known { setup: setup.to_owned(), found: Instant::now() });
        if known.len() > KNOWN {
            known.retain(|_, known| known.found.elapsed() < FRESH);
        }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<(Tenant, String), Known>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn no_longer_shared(setup: &str) -> ServiceError {
    let text =
        format!("set-up {setup} is not shared with you any more; ask its owner, or upload it yourself");
    ServiceError::new(Code::PermissionDenied, text)
}

/// The id of the session that a request opens: the same for the same request id, a new one for an empty one.
pub fn id_for(tenant: &Tenant, request_id: &str) -> String {
    if request_id.is_empty() {
        return uuid::Uuid::new_v4().simple().to_string();
    }
    let mut hasher = blake3::Hasher::new_derive_key("moldline session of a request");
    hasher.update(tenant.as_str().as_bytes());
    hasher.update(b"/");
    hasher.update(request_id.as_bytes());
    hasher.finalize().to_hex()[..ID_DIGITS].to_owned()
}

const ID_DIGITS: usize = 32;

fn is_id(text: &str) -> bool {
    text.len() == ID_DIGITS && text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
}

/// A stored session as callers see it.
pub fn view(id: &str, Generation { number, record }: Generation<SessionRecord>) -> Session {
    let points = |numbers: Numbers| numbers.0.as_chunks::<3>().0.to_vec();
    let control_points = record.control_points.into_iter().map(|(name, of)| (name, points(of))).collect();
    Session {
        id: id.to_owned(),
        setup_id: record.setup,
        generation: number,
        design: Some(Design { values: Values::Vector(record.design.0), control_points }),
        label: record.label,
        created: record.created,
        updated: record.updated,
    }
}
