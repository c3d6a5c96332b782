//! Methods of sessions: open, read, list, update, close.

use std::{sync::Arc, time::SystemTime};

use futures::StreamExt;
use moldline_host::{Code, Principal, Role, ServiceError};
use moldline_store::{Generation, Kind, Reservation, SessionRecord, Update, unless_damaged};

use crate::{
    access::{Listed, Page, Session, SessionUpdate},
    linearisation::{Design, Resolved},
    service::{AT_ONCE, Service, after, request_hash, taken},
    session_index::{id_for, view},
    setup_cache::StoredSetup,
    setups::SetupView,
};

impl Service {
    /// Opens a session on a set-up, at its baseline. The same request id again gives the same session.
    ///
    /// # Errors
    /// `NotFound`, `ResourceExhausted`, `AlreadyExists`, `PermissionDenied` to readers, `Unavailable` if it cannot be
    /// stored.
    pub async fn open_session(
        &self,
        caller: &Principal,
        setup_id: &str,
        label: &str,
        request_id: &str,
    ) -> Result<Session, ServiceError> {
        caller.need(Role::User)?;
        self.check_label(label)?;
        self.check_request_id(request_id)?;
        let tenant = &caller.tenant;
        let SetupView { setup, access } = self.get_setup(caller, setup_id).await?;
        let (id, opened) = (id_for(tenant, request_id), request_hash(&["session", setup_id, label]));
        if !request_id.is_empty()
            && let Some(session) = self.opened_before(caller, &id, request_id, &opened).await?
        {
            return Ok(session);
        }
        let parameterisation = setup.engine.parameterisation();
        let (design, control_points) =
            Resolved::new(parameterisation, Design::default())?.numbers(parameterisation);
        let now = SystemTime::now();
        let mut record = SessionRecord {
            setup: setup_id.to_owned(),
            design,
            control_points,
            label: label.to_owned(),
            created: now,
            updated: now,
            request: request_id.to_owned(),
            opened,
            updates: Vec::new(),
            own: access.owned,
            charged: 0,
        };
        record.charged = record.charge();
        let place = self.reserve(caller, Kind::Session, &id, record.charged).await?;
        if !self.store.put_session(tenant.as_str(), &id, 1, &record).await? {
            // A concurrent copy of the same request was faster.
            let found = self.opened_before(caller, &id, request_id, &record.opened).await?;
            return found.ok_or_else(|| ServiceError::not_found("session", &id));
        }
        place.keep();
        self.sessions.opened(tenant, &id, setup_id);
        Ok(view(&id, Generation { number: 1, record }))
    }

    /// The session that the same request opened before, if it did.
    async fn opened_before(
        &self,
        caller: &Principal,
        id: &str,
        request_id: &str,
        opened: &str,
    ) -> Result<Option<Session>, ServiceError> {
        let tenant = caller.tenant.as_str();
        // Records of older versions do not say by which request.
        let same = |known: &str| known.is_empty() || known == opened;
        if let Some(latest) = self.store.session(tenant, id).await? {
            return match same(&latest.record.opened) {
                true => Ok(Some(view(id, latest))),
                false => Err(taken(request_id)),
            };
        }
        match self.store.closed_session(tenant, id).await? {
            Some(known) if same(&known) => Err(ServiceError::not_found("session", id)),
            Some(_) => Err(taken(request_id)),
            None => Ok(None),
        }
    }

    /// Reserves a place, or more bytes, for a set-up or a session.
    pub(crate) async fn reserve(
        &self,
        caller: &Principal,
        kind: Kind,
        id: &str,
        bytes: u64,
    ) -> Result<Reservation, ServiceError> {
        let quota = self.quotas.of(&caller.tenant);
        let place = self.store.reserve(caller.tenant.as_str(), kind, id, bytes, &quota).await?;
        place.map_err(|excess| Self::exceeds(quota, excess, bytes))
    }

    fn check_label(&self, label: &str) -> Result<(), ServiceError> {
        let (length, limit) = (label.len(), self.limits.label_bytes);
        if length <= limit {
            return Ok(());
        }
        Err(ServiceError::invalid("label", format!("{length} bytes are more than the limit of {limit}")))
    }

    /// The latest stored state of a session.
    ///
    /// # Errors
    /// `NotFound`, `Unavailable` if the store does not answer.
    pub async fn get_session(&self, caller: &Principal, id: &str) -> Result<Session, ServiceError> {
        Ok(view(id, self.sessions.get(&caller.tenant, id).await?))
    }

    /// The caller's open sessions.
    ///
    /// # Errors
    /// `Unavailable` if the store does not answer.
    pub async fn list_sessions(
        &self,
        caller: &Principal,
        page: &Page,
    ) -> Result<Listed<Session>, ServiceError> {
        let tenant = caller.tenant.as_str();
        let open = self.store.entries(tenant, Kind::Session).await?.into_keys();
        let found = after(open, page).map(|id| async move {
            let latest = unless_damaged(self.store.session(tenant, &id).await)?;
            Ok(latest.map(|latest| Session { design: None, ..view(&id, latest) }))
        });
        self.listed(page, found.buffered(AT_ONCE), |session: &Session| session.id.clone()).await
    }

    /// Stores a session's design. Of two updates of one generation one wins; a retry of the winner gets the same answer.
    ///
    /// # Errors
    /// `NotFound`, `InvalidArgument` naming the entry of the design, `Aborted` if the session is at another generation,
    /// `AlreadyExists` for a request id that was used with another update, `PermissionDenied` to readers, `Unavailable` if it
    /// cannot be stored.
    pub async fn update_session(
        &self,
        caller: &Principal,
        id: &str,
        update: SessionUpdate,
    ) -> Result<Session, ServiceError> {
        caller.need(Role::User)?;
        let (tenant, expected) = (&caller.tenant, update.expected_generation);
        if let Some(label) = &update.label {
            self.check_label(label)?;
        }
        self.check_request_id(&update.request_id)?;
        let Generation { number, mut record } = self.sessions.usable(tenant, id).await?;
        let setup = self.resident(caller, id, &record.setup).await?;
        let parameterisation = setup.engine.parameterisation();
        let design = update.design.map(|design| Resolved::new(parameterisation, design)).transpose()?;
        let design = design.map(|design| design.numbers(parameterisation));
        let label = update.label;
        let next = expected.saturating_add(1);
        let this = Update {
            id: request_hash(&[&update.request_id]),
            content: request_hash(&[&expected.to_string(), &format!("{design:?}"), &format!("{label:?}")]),
            generation: next,
        };
        let recognised = !update.request_id.is_empty();
        let known = record.updates.iter().find(|known| recognised && known.id == this.id);
        if known.is_some_and(|known| *known != this) {
            return Err(taken(&update.request_id));
        }
        if number == expected {
            if let Some((design, control_points)) = design {
                (record.design, record.control_points) = (design, control_points);
            }
            if let Some(label) = label {
                record.label = label;
            }
            record.updated = SystemTime::now();
            record.request = update.request_id.clone();
            if recognised {
                record.note(this.clone());
            }
            let charge = record.charge();
            let more = match charge > record.charged {
                true => Some(self.reserve(caller, Kind::Session, id, charge).await?),
                false => None,
            };
            record.charged = charge;
            if self.store.put_session(tenant.as_str(), id, next, &record).await? {
                more.into_iter().for_each(Reservation::keep);
                return Ok(view(id, Generation { number: next, record }));
            }
        }
        // This request may have been carried out before, or a concurrent copy of it.
        if recognised
            && let Some(record) = self.store.session_at(tenant.as_str(), id, next).await?
            && record.updates.contains(&this)
        {
            return Ok(view(id, Generation { number: next, record }));
        }
        let found = self.sessions.get(tenant, id).await?.number;
        Err(ServiceError::new(Code::Aborted, "").at(
            "expected_generation",
            format!("{expected} is not the session's generation {found}; read the session again"),
        ))
    }

    /// Closes a session for good, even if its record is damaged.
    ///
    /// # Errors
    /// `NotFound`, `PermissionDenied` to readers, `Unavailable` if it cannot be stored.
    pub async fn close_session(&self, caller: &Principal, id: &str) -> Result<(), ServiceError> {
        caller.need(Role::User)?;
        let opened = self.sessions.opened_by(&caller.tenant, id).await?;
        self.store.close_session(caller.tenant.as_str(), id, &opened).await?;
        self.sessions.closed(&caller.tenant, id);
        Ok(())
    }

    /// The set-up of an open session.
    pub(crate) async fn session_setup(
        &self,
        caller: &Principal,
        id: &str,
    ) -> Result<Arc<StoredSetup>, ServiceError> {
        let setup = self.sessions.setup_of(&caller.tenant, id).await?;
        self.resident(caller, id, &setup).await
    }

    /// The set-up of a session, loaded if it is not in memory.
    async fn resident(
        &self,
        caller: &Principal,
        session_id: &str,
        setup: &str,
    ) -> Result<Arc<StoredSetup>, ServiceError> {
        self.setups.named(&caller.tenant, setup).await?.ok_or_else(|| {
            let text = format!("set-up {setup} of session {session_id} is missing in the store");
            ServiceError::new(Code::Internal, text)
        })
    }
}
