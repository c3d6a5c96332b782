//! Visibility of set-ups, and summaries of set-ups and sessions in lists.

use std::{collections::BTreeSet, time::SystemTime};

use moldline_host::Tenant;

use crate::linearisation::Design;

/// The tenants that may use a set-up besides its owner.
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

/// A caller's access to a set-up.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Access {
    /// Whether the caller has uploaded it.
    pub owned: bool,
    /// For the owner: as set. For others: the part that lets them use it, without the names of other tenants.
    pub visibility: Visibility,
}

/// A set-up in a list.
#[derive(Clone, Debug, PartialEq)]
pub struct SetupSummary {
    /// Its id.
    pub id: String,
    /// The user's title.
    pub name: String,
    /// Vertices of its mesh.
    pub vertices: usize,
    /// Cells of its mesh.
    pub cells: usize,
    /// Design variables.
    pub variables: usize,
    /// First upload by the caller, or by the tenant that shares it.
    pub created: SystemTime,
    /// The caller's access to it.
    pub access: Access,
}

/// The latest stored state of a session.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    /// Its id.
    pub id: String,
    /// Id of its set-up.
    pub setup_id: String,
    /// Increases by one with each update.
    pub generation: u64,
    /// All variables in order, and the given control points. `None` in lists.
    pub design: Option<Design>,
    /// The user's label.
    pub label: String,
    /// Time of its opening.
    pub created: SystemTime,
    /// Time of its last update.
    pub updated: SystemTime,
}

/// Changes to a session.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SessionUpdate {
    /// The generation on which the update is based.
    pub expected_generation: u64,
    /// Unchanged if `None`.
    pub design: Option<Design>,
    /// Unchanged if `None`.
    pub label: Option<String>,
    /// Chosen by the client to identify retries; may be empty.
    pub request_id: String,
}

/// The part of a list to return.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Page {
    /// Most entries; 0, and anything beyond the service's limit, stands for the limit.
    pub size: usize,
    /// `next` of the page before; empty for the first page.
    pub token: String,
}

/// A page of a list.
#[derive(Clone, Debug, PartialEq)]
pub struct Listed<T> {
    /// In the order of their ids.
    pub entries: Vec<T>,
    /// Token of the next page, if there is one.
    pub next: Option<String>,
}
