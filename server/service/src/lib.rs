//! The service without a transport: set-ups, sessions, one bounded compute pool, and one kind of error.
//!
//! ```text
//! upload -> read -> (hash) -> build once -> set-up -> session -> deform
//!           pool               pool                              pool
//! ```
//!
//! - A set-up is immutable and named by the hash of its content. Who uploads the same content gets the same set-up,
//!   built once however many ask at the same time ([`Service::create_setup`]).
//! - Deform is a pure function of (set-up, design): sessions cannot disturb each other, and a retry is safe.
//! - The engine runs on the pool only, never on the async runtime's threads; a panic in it is an error of one request.
//! - Whoever drops a future has lost interest: queued work is forgotten, running work is told through
//!   [`moldline_deform::Monitor::cancelled`].
//!
//! Absent on purpose: wire formats, ports, and anything that survives the process.

mod cancel;
mod error;
mod flight;
mod limits;
mod pool;
mod progress;
mod read;
mod refusal;
mod requests;
mod service;
mod sessions;
mod setups;
mod upload;

pub use moldline_setup::ArchiveKind;

pub use cancel::Cancellation;
pub use error::{Code, ServiceError, Violation};
pub use limits::Limits;
pub use pool::PoolLimits;
pub use progress::{Progress, Reporter};
pub use service::{Created, Deformed, Design, Receiving, Service, Values};
pub use setups::{SetupId, StoredSetup};
pub use upload::{FileEntry, Upload, UploadHeader, UploadSource, Uploaded};
