//! Durable storage of set-ups and sessions: in a local folder, on an S3-compatible object store, or in memory for tests.
//!
//! ```text
//! blob/<hash>                          a file of a set-up
//! setup/<set-up>                       its manifest: paths and hashes; their hash is its name
//! derived/<set-up>/<build>             data that a build of the engine derived from it
//! access/<tenant>/<set-up>/<number>    a tenant's upload of it, and who else may use it: generations
//! grant/<tenant>/<set-up>/<owner>      an owner whose access record may let a tenant use the set-up
//! session/<tenant>/<id>/<number>       a session: generations
//! session/<tenant>/<id>/closed         the mark of a closed session
//! request/<tenant>/<hash>              a request id, and the hash of its request
//! format, identity                     what tells this store from others
//! ```
//!
//! - One primitive: create if absent, atomic and durable before it is acknowledged (on a local disk, file and folder are
//!   synced). Of two writers of the same object one loses, and is told so.
//! - Objects never change. Mutable state is a row of generations, of which the last one counts.
//! - Every read verifies a hash; an error names the object.
//! - A set-up is written from its leaves up, and visible only once it is complete. Leftovers of a crash are unreachable, and
//!   [`collect`](Store::collect)ed when they are old enough.
//!
//! Absent on purpose: what a set-up or a design means, who may do what, caches.

mod backend;
mod collect;
mod error;
mod health;
mod records;
mod store;

pub use collect::{Collected, Verified};
pub use error::{StoreError, unless_damaged};
pub use health::Health;
pub use records::{AccessRecord, Manifest, ManifestEntry, Numbers, SessionRecord, Shared};
pub use store::{Claim, Generation, Store};
