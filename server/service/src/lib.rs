//! The service without a transport: set-ups, sessions, one bounded compute pool, and one kind of error.
//!
//! ```text
//! upload -> read -> (hash) -> build once -> set-up -> session -> deform -> linearisation -> products
//!           pool               pool                              pool                       pool
//! ```
//!
//! - A set-up is immutable and named by the hash of its content. Who uploads the same content gets the same set-up,
//!   built once however many ask at the same time ([`Service::create_setup`]).
//! - Deform and the products with its derivative are pure functions of (set-up, design, vectors): sessions cannot
//!   disturb each other, and a retry is safe.
//! - Deform always linearises, since that costs a fraction of it, and the session keeps the linearisations used last:
//!   products then deform nothing again. Asked for by design, one that is not kept any more is made again, bit by bit.
//! - The engine runs on the pool only, never on the async runtime's threads; a panic in it is an error of one request.
//! - Whoever drops a future has lost interest: queued work is forgotten, running work is told through
//!   [`moldline_deform::Monitor::cancelled`].
//!
//! - What is acknowledged is in the store. Memory holds what is used: set-ups and linearisations within their budgets, each
//!   loaded or made once however many ask. Any service on the same store can go on with any session.
//! - Who calls is a [`Principal`]. Of what it may not see it learns nothing, not even that it exists.
//!
//! Absent on purpose: wire formats, ports, and who holds which credential.

mod access;
mod cache;
mod cancel;
mod checks;
mod error;
mod flight;
mod limits;
mod linearisation;
mod pool;
mod principal;
mod progress;
mod read;
mod refusal;
mod service;
mod sessions;
mod setups;
mod status;
mod upload;

pub use moldline_check::Report as CheckReport;
pub use moldline_setup::ArchiveKind;
pub use moldline_store::{Store, StoreError};

pub use access::{Access, Listed, Page, Session, SessionUpdate, SetupSummary, Visibility};
pub use cancel::Cancellation;
pub use checks::{CheckAt, CheckRequest};
pub use error::{Code, ServiceError, Violation};
pub use flight::{Flights, Follower, Joined, Reports};
pub use limits::Limits;
pub use linearisation::{
    ControlPointVectors, Design, Directions, Gradients, Linearised, Seeds, Values, Wanted,
};
pub use pool::{Completed, ComputePool, PoolLimits, Task, Ticket};
pub use principal::{Principal, Role, Tenant, TenantError};
pub use progress::{Progress, Reporter};
pub use refusal::mesh_field;
pub use service::{At, Created, Product, Receiving, Service, SetupView, Timing};
pub use setups::{SetupId, StoredSetup};
pub use status::{CacheStatus, Status, Work};
pub use upload::{FileEntry, Upload, UploadHeader, UploadSource, Uploaded};
