//! The mesh service without a transport: set-ups, sessions, deformations and products with their derivatives.
//!
//! ```text
//! upload -> read -> (hash) -> build once -> set-up -> session -> deform -> linearisation -> products
//!           pool               pool                              pool                       pool
//! ```
//!
//! - A set-up is immutable and named by the hash of its content. Uploading the same content again gives the same set-up,
//!   built once for all concurrent uploads ([`Service::create_setup`]).
//! - Deform and the products with its derivative are pure functions of (set-up, design, vectors): sessions cannot
//!   disturb each other, and a retry is safe.
//! - Deform always linearises, since that costs a fraction of the deformation. The linearisations used last stay in memory, so
//!   that products do not deform again; one that was evicted is recomputed from the design, to the same bits.
//! - What is acknowledged is in the store. Memory holds set-ups and linearisations within their budgets, each loaded or made
//!   once for all concurrent requests. Any service on the same store can continue any session.
//! - A caller is a [`moldline_host::Principal`]. Objects that it may not see look to it as if they did not exist.
//!
//! Pool, caches, single flight, errors and callers are those of `moldline-host`.
//!
//! Absent on purpose: wire formats, ports, and who holds which credential.

mod access;
mod checks;
mod derivatives;
mod limits;
mod linearisation;
mod progress;
mod quotas;
mod read;
mod service;
mod session_index;
mod sessions;
mod setup_cache;
mod setup_id;
mod setups;
mod status;
mod upload;

pub use moldline_check::Report as CheckReport;
pub use moldline_setup_files::ArchiveKind;
pub use moldline_store::{Health, Quota, Schedule, Store, StoreError};

pub use access::{Access, Listed, Page, Session, SessionUpdate, SetupSummary, Visibility};
pub use checks::{CheckAt, CheckRequest};
pub use derivatives::At;
pub use limits::Limits;
pub use linearisation::{
    ControlPointVectors, Design, Directions, Gradients, Linearised, Seeds, Values, Wanted,
};
pub use progress::reporter;
pub use read::explained;
pub use service::Service;
pub use setup_cache::StoredSetup;
pub use setup_id::SetupId;
pub use setups::{Created, Receiving, SetupView};
pub use status::Status;
pub use upload::{FileEntry, Upload, UploadHeader, UploadSource, Uploaded};
