//! Open sessions, each with the linearisations that it used last. A session pins its set-up; Deform itself is a pure
//! function, so sessions cannot disturb each other.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::SystemTime,
};

use uuid::Uuid;

use crate::{
    access::{self, Listed, Page},
    error::{Code, ServiceError},
    limits::Limits,
    linearisation::Design,
    principal::Tenant,
    requests::Answers,
    setups::StoredSetup,
    status::CacheStatus,
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
    /// How often what was looked for was kept, was not, and was dropped to make room.
    hits: u64,
    misses: u64,
    evictions: u64,
}

#[derive(Debug)]
struct Session<T> {
    owner: Tenant,
    record: access::Session,
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
        let state =
            State { open: HashMap::new(), answers, bytes: 0, clock: 0, hits: 0, misses: 0, evictions: 0 };
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
    pub fn open(
        &self,
        owner: &Tenant,
        setup: Arc<StoredSetup>,
        design: Design,
        label: &str,
        request_id: &str,
    ) -> Result<access::Session, ServiceError> {
        let mut state = self.lock();
        let key = if request_id.is_empty() { String::new() } else { format!("{owner}/{request_id}") };
        if let Some(id) = state.answers.find(&key, setup.id.as_str())? {
            let id = id.to_owned();
            let open = state.open.get(&id).ok_or_else(|| ServiceError::not_found("session", &id))?;
            return Ok(open.record.clone());
        }
        if state.open.len() >= self.sessions {
            return Err(ServiceError::new(
                Code::ResourceExhausted,
                format!("{} sessions are open, which is the limit; close some", state.open.len()),
            ));
        }
        // Not to be guessed, since whoever knows it may use the session.
        let id = Uuid::new_v4().simple().to_string();
        state.answers.remember(&key, setup.id.as_str(), &id);
        let now = SystemTime::now();
        let record = access::Session {
            id: id.clone(),
            setup_id: setup.id.to_string(),
            generation: 1,
            design: Some(design),
            label: label.to_owned(),
            created: now,
            updated: now,
        };
        state
            .open
            .insert(id, Session { owner: owner.clone(), record: record.clone(), setup, kept: Vec::new() });
        Ok(record)
    }

    /// The session as it was stored last.
    ///
    /// # Errors
    /// `NotFound`.
    pub fn get(&self, owner: &Tenant, id: &str) -> Result<access::Session, ServiceError> {
        Ok(self.lock().of(owner, id)?.record.clone())
    }

    /// The owner's sessions.
    pub fn list(&self, owner: &Tenant, page: &Page, limit: usize) -> Listed<access::Session> {
        let size = if page.size == 0 { limit } else { page.size.min(limit) };
        let state = self.lock();
        let mut entries: Vec<access::Session> = state
            .open
            .values()
            .filter(|open| open.owner == *owner && open.record.id > page.token)
            .map(|open| access::Session { design: None, ..open.record.clone() })
            .collect();
        entries.sort_by(|a, b| a.id.cmp(&b.id));
        let more = entries.len() > size;
        entries.truncate(size);
        let next = entries.last().filter(|_| more).map(|last| last.id.clone());
        Listed { entries, next }
    }

    /// Stores what `change` makes of the session.
    ///
    /// # Errors
    /// `NotFound`, `Aborted` if it is not at the generation `expected`.
    pub fn update(
        &self,
        owner: &Tenant,
        id: &str,
        expected: u64,
        change: impl FnOnce(&mut access::Session),
    ) -> Result<access::Session, ServiceError> {
        let mut state = self.lock();
        let record = &mut state.of_mut(owner, id)?.record;
        if record.generation != expected {
            let found = record.generation;
            return Err(ServiceError::new(Code::Aborted, "").at(
                "expected_generation",
                format!("{expected} is not the session's generation {found}; read the session again"),
            ));
        }
        change(record);
        record.generation += 1;
        record.updated = SystemTime::now();
        Ok(record.clone())
    }

    /// The session's set-up.
    ///
    /// # Errors
    /// `NotFound`.
    pub fn setup(&self, owner: &Tenant, id: &str) -> Result<Arc<StoredSetup>, ServiceError> {
        Ok(Arc::clone(&self.lock().of(owner, id)?.setup))
    }

    /// Open sessions of `owner`, or of all.
    pub fn count(&self, owner: Option<&Tenant>) -> usize {
        self.lock().open.values().filter(|open| owner.is_none_or(|owner| open.owner == *owner)).count()
    }

    /// What the sessions of `owner`, or of all, keep.
    pub fn cache(&self, owner: Option<&Tenant>) -> CacheStatus {
        let state = self.lock();
        let kept = || {
            let open = state.open.values().filter(|open| owner.is_none_or(|owner| open.owner == *owner));
            open.flat_map(|open| &open.kept)
        };
        let told = |count| if owner.is_none() { count } else { 0 };
        CacheStatus {
            entries: kept().count(),
            bytes: kept().map(|kept| kept.bytes).sum(),
            budget: self.bytes,
            hits: told(state.hits),
            misses: told(state.misses),
            evictions: told(state.evictions),
        }
    }

    /// Closes a session and lets go of what it keeps. What it computes ends undisturbed.
    ///
    /// # Errors
    /// `NotFound`.
    pub fn close(&self, owner: &Tenant, id: &str) -> Result<(), ServiceError> {
        let mut state = self.lock();
        state.of(owner, id)?;
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
        let kept = state.open.get_mut(session)?.kept.iter_mut().find(|kept| kept.id == id);
        let found = kept.map(|kept| {
            kept.used = used;
            Arc::clone(&kept.value)
        });
        *if found.is_some() { &mut state.hits } else { &mut state.misses } += 1;
        found
    }

    /// Keeps `value`, in place of one of the same name, and lets go of those used least recently: of the session's where
    /// it has too many, of all where there are too many bytes. Nothing is kept for a session that is closed.
    pub fn keep(&self, session: &str, id: &str, value: Arc<T>, bytes: usize) {
        let mut state = self.lock();
        let used = state.tick();
        let Some(owner) = state.open.get_mut(session) else { return };
        let mut dropped: Vec<Kept<T>> = owner.kept.extract_if(.., |kept| kept.id == id).collect();
        owner.kept.push(Kept { id: id.to_owned(), value, bytes, used });
        let replaced = dropped.len();
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
        state.evictions += (dropped.len() - replaced) as u64;
        drop(state);
        // Large, and so not freed under the lock.
        drop(dropped);
    }

    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T> State<T> {
    fn of(&self, owner: &Tenant, id: &str) -> Result<&Session<T>, ServiceError> {
        let open = self.open.get(id).filter(|open| open.owner == *owner);
        open.ok_or_else(|| ServiceError::not_found("session", id))
    }

    fn of_mut(&mut self, owner: &Tenant, id: &str) -> Result<&mut Session<T>, ServiceError> {
        let open = self.open.get_mut(id).filter(|open| open.owner == *owner);
        open.ok_or_else(|| ServiceError::not_found("session", id))
    }

    fn tick(&mut self) -> u64 {
        self.clock += 1;
        self.clock
    }
}

/// Index of the one used least recently.
fn oldest<T>(kept: &[Kept<T>]) -> Option<usize> {
    (0..kept.len()).min_by_key(|&index| kept[index].used)
}
