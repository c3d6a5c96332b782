//! Methods of sessions: open, read, list, update, close.

use std::{sync::Arc, time::SystemTime};

use futures::StreamExt;
use moldline_host::{Code, Principal, Role, ServiceError};
use moldline_store::{Generation, SessionRecord, unless_damaged};

use crate::{
    access::{Listed, Page, Session, SessionUpdate},
    linearisation::{Design, Resolved},
    service::{AT_ONCE, Service, after},
    session_index::{id_for, view},
    setup_cache::StoredSetup,
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
        let tenant = &caller.tenant;
        let setup = self.get_setup(caller, setup_id).await?.setup;
        let repeated = self.claim(caller, request_id, &["session", setup_id, label]).await?;
        let id = id_for(tenant, request_id);
        if repeated {
            if let Some(session) = self.store.session(tenant.as_str(), &id).await? {
                return Ok(view(&id, session));
            }
            if self.store.session_at(tenant.as_str(), &id, 1).await?.is_some() {
                // It has been opened: by a copy of the same request in between, or it is closed by now.
                return match self.store.session(tenant.as_str(), &id).await? {
                    Some(session) => Ok(view(&id, session)),
                    None => Err(ServiceError::not_found("session", &id)),
                };
            }
        }
        let (open, limit) = (self.store.sessions(tenant.as_str()).await?.len(), self.limits.sessions);
        if open >= limit {
            let message = format!("{open} of your sessions are open, which is the limit; close some");
            return Err(ServiceError::new(Code::ResourceExhausted, message));
        }
        let parameterisation = setup.engine.parameterisation();
        let (design, control_points) =
            Resolved::new(parameterisation, Design::default())?.numbers(parameterisation);
        let now = SystemTime::now();
        let record = SessionRecord {
            setup: setup_id.to_owned(),
            design,
            control_points,
            label: label.to_owned(),
            created: now,
            updated: now,
            request: request_id.to_owned(),
        };
        let latest = match self.store.put_session(tenant.as_str(), &id, 1, &record).await? {
            true => Generation { number: 1, record },
            // A concurrent copy of the same request.
            false => self.sessions.get(tenant, &id).await?,
        };
        self.sessions.opened(tenant, &id, setup_id);
        Ok(view(&id, latest))
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
        let found = after(self.store.sessions(tenant).await?, page).map(|id| async move {
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
        let Generation { number, mut record } = self.sessions.get(tenant, id).await?;
        let setup = self.resident(caller, id, &record.setup).await?;
        let parameterisation = setup.engine.parameterisation();
        let design = update.design.map(|design| Resolved::new(parameterisation, design)).transpose()?;
        let design = design.map(|design| design.numbers(parameterisation));
        let label = update.label;
        let request = [id, &expected.to_string(), &format!("{design:?}"), &format!("{label:?}")];
        self.claim(caller, &update.request_id, &request).await?;

        let next = expected.saturating_add(1);
        if number == expected {
            if let Some((design, control_points)) = design {
                (record.design, record.control_points) = (design, control_points);
            }
            if let Some(label) = label {
                record.label = label;
            }
            record.updated = SystemTime::now();
            record.request = update.request_id.clone();
            if self.store.put_session(tenant.as_str(), id, next, &record).await? {
                return Ok(view(id, Generation { number: next, record }));
            }
        }
        // This request may have been carried out before.
        if !update.request_id.is_empty()
            && let Some(record) = self.store.session_at(tenant.as_str(), id, next).await?
            && record.request == update.request_id
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
        self.sessions.find(&caller.tenant, id).await?;
        self.store.close_session(caller.tenant.as_str(), id).await?;
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
