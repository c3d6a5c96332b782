//! Set-ups in memory, by the hash of their content.

use std::{
    collections::BTreeMap,
    fmt,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, SystemTime},
};

use moldline_deform::Setup;

use crate::{
    access::{Access, Visibility},
    error::{Code, ServiceError},
    principal::Tenant,
};

/// Name of a set-up: the hash of its content in hexadecimal digits.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SetupId(String);

impl SetupId {
    /// The name of what `hash` is the digest of.
    pub fn new(hash: blake3::Hash) -> Self {
        Self(hash.to_hex().to_string())
    }

    /// The digits.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for SetupId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// A set-up that is built.
#[derive(Debug)]
pub struct StoredSetup {
    /// Its name.
    pub id: SetupId,
    /// The user's title of it.
    pub name: String,
    /// What the engine made of it.
    pub engine: Arc<Setup>,
    /// Values of the scalar outputs for the reference mesh.
    pub functions: Vec<f64>,
    /// How long the engine took.
    pub build_time: Duration,
}

impl StoredSetup {
    /// What the set-up found, as a JSON document.
    pub fn report_json(&self) -> String {
        moldline_setup::report_json(self.engine.report()).to_string()
    }
}

/// Who owns which set-up, and who else may use it.
#[derive(Debug, Default)]
pub struct Owners(Mutex<BTreeMap<(String, Tenant), (SystemTime, Visibility)>>);

impl Owners {
    /// Makes `owner` an owner; whether it is new to it. `visibility` replaces what was chosen before.
    pub fn add(&self, id: &str, owner: &Tenant, visibility: Option<Visibility>) -> (Access, bool) {
        let mut owners = self.lock();
        let key = (id.to_owned(), owner.clone());
        let new = !owners.contains_key(&key);
        let entry = owners.entry(key).or_insert((SystemTime::now(), Visibility::Private));
        if let Some(visibility) = visibility {
            entry.1 = visibility;
        }
        (Access { owned: true, visibility: entry.1.clone() }, new)
    }

    /// No longer an owner; whether it was one.
    pub fn remove(&self, id: &str, owner: &Tenant) -> bool {
        self.lock().remove(&(id.to_owned(), owner.clone())).is_some()
    }

    /// What the set-up is to `tenant`, and since when; `None` if it may not use it.
    pub fn access(&self, id: &str, tenant: &Tenant) -> Option<(SystemTime, Access)> {
        let owners = self.lock();
        if let Some((since, visibility)) = owners.get(&(id.to_owned(), tenant.clone())) {
            return Some((*since, Access { owned: true, visibility: visibility.clone() }));
        }
        owners.iter().filter(|((of, _), _)| of == id).find_map(|(_, (since, visibility))| {
            let visibility = match visibility {
                Visibility::Private => return None,
                Visibility::Tenants(tenants) if !tenants.contains(tenant) => return None,
                Visibility::Tenants(_) => Visibility::Tenants([tenant.clone()].into()),
                Visibility::Public => Visibility::Public,
            };
            Some((*since, Access { owned: false, visibility }))
        })
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<(String, Tenant), (SystemTime, Visibility)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// All set-ups in memory, at most a given number.
#[derive(Debug)]
pub struct Setups {
    /// Least recently used first.
    known: Mutex<Vec<Arc<StoredSetup>>>,
    capacity: usize,
}

impl Setups {
    /// Keeps up to `capacity` set-ups.
    pub fn new(capacity: usize) -> Self {
        Self { known: Mutex::default(), capacity }
    }

    /// The set-up of that name.
    pub fn get(&self, id: &str) -> Option<Arc<StoredSetup>> {
        let mut known = self.lock();
        let position = known.iter().position(|setup| setup.id.as_str() == id)?;
        let setup = known.remove(position);
        known.push(Arc::clone(&setup));
        Some(setup)
    }

    /// Makes room for one more by dropping the least recently used one that no session uses.
    ///
    /// # Errors
    /// `ResourceExhausted` if all are in use.
    pub fn make_room(&self) -> Result<(), ServiceError> {
        let mut known = self.lock();
        while known.len() >= self.capacity {
            // A use can only begin through `get`, which waits for the lock.
            let Some(idle) = known.iter().position(|setup| Arc::strong_count(setup) == 1) else {
                return Err(ServiceError::new(
                    Code::ResourceExhausted,
                    format!("{} set-ups are in use, which is the limit; close sessions", known.len()),
                ));
            };
            let dropped = known.remove(idle);
            tracing::info!(setup = %dropped.id, "dropped a set-up that no session uses");
        }
        Ok(())
    }

    /// All that are in memory.
    pub fn all(&self) -> Vec<Arc<StoredSetup>> {
        self.lock().clone()
    }

    /// Adds a set-up.
    pub fn insert(&self, setup: Arc<StoredSetup>) {
        self.lock().push(setup);
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Arc<StoredSetup>>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
