//! Where set-ups and sessions last: on a local folder, an S3-compatible object store, or in memory for tests.
//!
//! ```text
//! blob/<hash>                          a file of a set-up
//! setup/<set-up>                       its manifest: paths and hashes; their hash is its name
//! derived/<set-up>/<build>             what a build of the engine found for it
//! access/<tenant>/<set-up>/<number>    that a tenant has uploaded it, and who else may use it: generations
//! grant/<tenant>/<set-up>/<owner>      where to look whether a tenant may use another's set-up
//! session/<tenant>/<id>/<number>       a session: generations
//! session/<tenant>/<id>/closed         that it is closed
//! request/<tenant>/<hash>              a request id, and the hash of the request that it named
//! ```
//!
//! - One primitive: an object is created if it is absent, whole or not at all, and durable before it is said to exist (on
//!   a local disk file and folder are synced). Of two who create the same object one loses, and is told.
//! - Nothing that exists changes. What changes is a row of generations; the last one counts.
//! - Every read verifies a hash, and names the object where it does not fit.
//! - A set-up is written from its leaves up, and seen only once it is whole. What a crash leaves behind is unreachable and
//!   [`collect`](Store::collect)ed when it is old enough.
//!
//! Absent on purpose: what a set-up or a design means, who may do what, caches.

mod backend;
mod collect;
mod error;
mod records;
mod store;

pub use collect::{Collected, Verified};
pub use error::{StoreError, unless_damaged};
pub use records::{AccessRecord, Manifest, ManifestEntry, Numbers, SessionRecord, Shared};
pub use store::{Claim, Generation, Store};
