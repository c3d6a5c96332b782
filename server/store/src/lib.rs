//! Durable storage of set-ups and sessions: on a local folder, an S3-compatible object store, or in memory for tests.
//!
//! ```text
//! blob/<hash>                          a file of a set-up
//! setup/<set-up>                       its manifest: paths and hashes; their hash is its name
//! derived/<set-up>/<build>             its derived data, by build of the engine
//! access/<tenant>/<set-up>/<number>    an upload by a tenant, and who else may use it: generations
//! grant/<tenant>/<set-up>/<owner>      a pointer to the owner's record that may let a tenant use the set-up
//! session/<tenant>/<id>/<number>       a session: generations
//! session/<tenant>/<id>/closed         the mark that it is closed
//! request/<tenant>/<hash>              a request id, and the hash of the request that it named
//! ```
//!
//! - One primitive, create if absent: an object is written whole or not at all, and is durable before the write is acknowledged
//!   (on a local disk file and folder are synced). If two callers create the same object, one of them is told that it lost.
//! - Objects never change. A record that changes is a row of generations, of which the last one counts.
//! - Every read verifies a hash; an error names the object.
//! - A set-up is written from its leaves up, and is visible only once it is whole. Leftovers of a crash are unreachable, and
//!   [`collect`](Store::collect)ed when they are old enough.
//!
//! Absent on purpose: the meaning of set-ups and designs, permissions, caches.

mod backend;
mod collect;
mod error;
mod records;
mod store;

pub use collect::{Collected, Verified};
pub use error::{StoreError, unless_damaged};
pub use records::{AccessRecord, Manifest, ManifestEntry, Numbers, SessionRecord, Shared};
pub use store::{Claim, Generation, Store};
