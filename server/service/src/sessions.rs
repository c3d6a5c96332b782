//! Open sessions. A session pins its set-up; Deform itself is a pure function, so sessions cannot disturb each other.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use uuid::Uuid;

use crate::{
    error::{Code, ServiceError},
    requests::Answers,
    setups::StoredSetup,
};

/// Sessions by id, at most a given number.
#[derive(Debug)]
pub struct Sessions {
    state: Mutex<State>,
    capacity: usize,
}

#[derive(Debug)]
struct State {
    open: HashMap<String, Arc<StoredSetup>>,
    answers: Answers,
}

impl Sessions {
    /// Up to `capacity` sessions.
    pub fn new(capacity: usize) -> Self {
        let state = State { open: HashMap::new(), answers: Answers::new(4 * capacity) };
        Self { state: Mutex::new(state), capacity }
    }

    /// Opens a session; the same request id again gives the same session.
    ///
    /// # Errors
    /// `ResourceExhausted` if too many are open, `AlreadyExists` if the request id named another set-up.
    pub fn open(&self, setup: Arc<StoredSetup>, request_id: &str) -> Result<String, ServiceError> {
        let mut state = self.lock();
        if let Some(session) = state.answers.find(request_id, setup.id.as_str())? {
            // It may be closed by now; a retry that comes so late gets the same answer, and NotFound when it is used.
            return Ok(session.to_owned());
        }
        if state.open.len() >= self.capacity {
            return Err(ServiceError::new(
                Code::ResourceExhausted,
                format!("{} sessions are open, which is the limit; close some", state.open.len()),
            ));
        }
        // Not to be guessed, since whoever knows it may use the session.
        let id = Uuid::new_v4().simple().to_string();
        state.answers.remember(request_id, setup.id.as_str(), &id);
        state.open.insert(id.clone(), setup);
        Ok(id)
    }

    /// The session's set-up.
    ///
    /// # Errors
    /// `NotFound`.
    pub fn setup(&self, id: &str) -> Result<Arc<StoredSetup>, ServiceError> {
        self.lock().open.get(id).cloned().ok_or_else(|| ServiceError::not_found("session", id))
    }

    /// Closes a session. What it computes ends undisturbed.
    ///
    /// # Errors
    /// `NotFound`.
    pub fn close(&self, id: &str) -> Result<(), ServiceError> {
        let closed = self.lock().open.remove(id);
        closed.map(drop).ok_or_else(|| ServiceError::not_found("session", id))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
