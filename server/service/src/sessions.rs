//! Open sessions, each with the linearisations that it used last. A session pins its set-up; Deform itself is a pure
//! function, so sessions cannot disturb each other.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use uuid::Uuid;

use crate::{
    error::{Code, ServiceError},
    limits::Limits,
    requests::Answers,
    setups::StoredSetup,
};

/// Sessions by id, with what they keep: values of type `T`, at most so many a session, and so many bytes in all.
#[derive(Debug)]
pub struct Sessions<T> {
    state: Mutex<State<T>>,
    sessions: usize,
    kept: usize,
    bytes: usize,
}

#[derive(Debug)]
struct State<T> {
    open: HashMap<String, Session<T>>,
    answers: Answers,
    /// Of all that is kept.
    bytes: usize,
    /// Grows with every use.
    clock: u64,
}

#[derive(Debug)]
struct Session<T> {
    setup: Arc<StoredSetup>,
    kept: Vec<Kept<T>>,
}

#[derive(Debug)]
struct Kept<T> {
    id: String,
    value: Arc<T>,
    bytes: usize,
    used: u64,
}

impl<T> Sessions<T> {
    /// No sessions.
    pub fn new(limits: &Limits) -> Self {
        let answers = Answers::new(4 * limits.sessions);
        let state = State { open: HashMap::new(), answers, bytes: 0, clock: 0 };
        Self {
            state: Mutex::new(state),
            sessions: limits.sessions,
            kept: limits.linearisations,
            bytes: limits.linearisation_bytes,
        }
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
        if state.open.len() >= self.sessions {
            return Err(ServiceError::new(
                Code::ResourceExhausted,
                format!("{} sessions are open, which is the limit; close some", state.open.len()),
            ));
        }
        // Not to be guessed, since whoever knows it may use the session.
        let id = Uuid::new_v4().simple().to_string();
        state.answers.remember(request_id, setup.id.as_str(), &id);
        state.open.insert(id.clone(), Session { setup, kept: Vec::new() });
        Ok(id)
    }

    /// The session's set-up.
    ///
    /// # Errors
    /// `NotFound`.
    pub fn setup(&self, id: &str) -> Result<Arc<StoredSetup>, ServiceError> {
        let state = self.lock();
        let session = state.open.get(id).ok_or_else(|| ServiceError::not_found("session", id))?;
        Ok(Arc::clone(&session.setup))
    }

    /// Closes a session and lets go of what it keeps. What it computes ends undisturbed.
    ///
    /// # Errors
    /// `NotFound`.
    pub fn close(&self, id: &str) -> Result<(), ServiceError> {
        let mut state = self.lock();
        let closed = state.open.remove(id).ok_or_else(|| ServiceError::not_found("session", id))?;
        state.bytes -= closed.kept.iter().map(|kept| kept.bytes).sum::<usize>();
        drop(state);
        // Large, and so not freed under the lock.
        drop(closed);
        Ok(())
    }

    /// What a session keeps by that name.
    pub fn find(&self, session: &str, id: &str) -> Option<Arc<T>> {
        let mut state = self.lock();
        let used = state.tick();
        let kept = state.open.get_mut(session)?.kept.iter_mut().find(|kept| kept.id == id)?;
        kept.used = used;
        Some(Arc::clone(&kept.value))
    }

    /// Keeps `value`, in place of one of the same name, and lets go of those used least recently: of the session's where
    /// it has too many, of all where there are too many bytes. Nothing is kept for a session that is closed.
    pub fn keep(&self, session: &str, id: &str, value: Arc<T>, bytes: usize) {
        let mut state = self.lock();
        let used = state.tick();
        let Some(owner) = state.open.get_mut(session) else { return };
        let mut dropped: Vec<Kept<T>> = owner.kept.extract_if(.., |kept| kept.id == id).collect();
        owner.kept.push(Kept { id: id.to_owned(), value, bytes, used });
        if owner.kept.len() > self.kept {
            dropped.extend(oldest(&owner.kept).map(|index| owner.kept.remove(index)));
        }
        state.bytes += bytes;
        state.bytes -= dropped.iter().map(|kept| kept.bytes).sum::<usize>();
        while state.bytes > self.bytes {
            let sessions = state.open.values_mut().filter(|session| !session.kept.is_empty());
            let least = sessions.min_by_key(|session| session.kept.iter().map(|kept| kept.used).min());
            let Some(kept) = least.map(|session| &mut session.kept) else { break };
            let Some(index) = oldest(kept) else { break };
            let kept = kept.remove(index);
            state.bytes -= kept.bytes;
            dropped.push(kept);
        }
        drop(state);
        // Large, and so not freed under the lock.
        drop(dropped);
    }

    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T> State<T> {
    fn tick(&mut self) -> u64 {
        self.clock += 1;
        self.clock
    }
}

/// Index of the one used least recently.
fn oldest<T>(kept: &[Kept<T>]) -> Option<usize> {
    (0..kept.len()).min_by_key(|&index| kept[index].used)
}
