//! Who may use a set-up, and what callers learn of set-ups and sessions without opening them.

use std::{collections::BTreeSet, time::SystemTime};

use crate::{linearisation::Design, principal::Tenant};

/// Who may use a set-up besides its owner.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Visibility {
    /// Nobody.
    #[default]
    Private,
    /// These tenants.
    Tenants(BTreeSet<Tenant>),
    /// Every tenant of the server.
    Public,
}

/// What a set-up is to the caller.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Access {
    /// Whether the caller has uploaded it.
    pub owned: bool,
    /// To the owner: what was chosen. To others: what lets them use it, without the names of yet others.
    pub visibility: Visibility,
}

/// A set-up in a list.
#[derive(Clone, Debug, PartialEq)]
pub struct SetupSummary {
    /// Its name on the server.
    pub id: String,
    /// The user's title of it.
    pub name: String,
    /// Vertices of its mesh.
    pub vertices: usize,
    /// Cells of its mesh.
    pub cells: usize,
    /// Design variables.
    pub variables: usize,
    /// When the caller, or the one who shares it, first uploaded it.
    pub created: SystemTime,
    /// What it is to the caller.
    pub access: Access,
}

/// A session as it was stored last.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    /// Its name on the server.
    pub id: String,
    /// Its set-up.
    pub setup_id: String,
    /// Grows by one with each update.
    pub generation: u64,
    /// All variables in order, and the control points that were given. `None` in lists.
    pub design: Option<Design>,
    /// For people.
    pub label: String,
    /// When it was opened.
    pub created: SystemTime,
    /// When it was stored last.
    pub updated: SystemTime,
}

/// What to change of a session.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SessionUpdate {
    /// The generation that it is based on.
    pub expected_generation: u64,
    /// As it was if `None`.
    pub design: Option<Design>,
    /// As it was if `None`.
    pub label: Option<String>,
    /// Chosen by the client so that a retry is recognised; may be empty.
    pub request_id: String,
}

/// Which part of a list.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Page {
    /// Most entries; 0 and more than the service's limit are its limit.
    pub size: usize,
    /// As the page before gave it; empty for the first one.
    pub token: String,
}

/// A page of a list.
#[derive(Clone, Debug, PartialEq)]
pub struct Listed<T> {
    /// In the order of their ids.
    pub entries: Vec<T>,
    /// For the next page, if there is more.
    pub next: Option<String>,
}
