//! Durable storage of set-ups and sessions: in a local folder, on an S3-compatible object store, or in memory for tests.
//!
//! ```text
//! blob/<hash>                          a file of a set-up
//! setup/<set-up>                       its manifest: paths and hashes; their hash is its name
//! derived/<set-up>/<build>             data that a build of the engine derived from it
//! access/<tenant>/<set-up>/<number>    a tenant's upload of it, and who else may use it: generations
//! grant/<tenant>/<set-up>/<owner>      an owner whose access record may let a tenant use the set-up
//! session/<tenant>/<id>/<number>       a session: generations
//! closed/<tenant>/<id>                 the mark of a closed session, and the hash of the request that opened it
//! request/<tenant>/<hash>              the request id of an upload, and the hash of its request
//! index/<tenant>/<kind>/<id>@<bytes>   what a tenant holds: see `index.rs`
//! lease/<task>/<number>                which server does a task of which one is enough: generations
//! format, identity                     what tells this store from others
//! ```
//!
//! - One primitive: create if absent, atomic and durable before it is acknowledged (on a local disk, file and folder are
//!   synced). Of two writers of the same object one loses, and is told so.
//! - Objects never change. Mutable state is a row of generations, of which the last one counts and the last eight stay.
//! - What a tenant holds, and what remains of what it held, is bounded by its quota and by constants.
//! - Every read verifies a hash; an error names the object.
//! - A set-up is written from its leaves up, and visible only once it is complete. Leftovers of a crash are unreachable, and
//!   [`collect`](Store::collect)ed when they are old enough.
//!
//! Absent on purpose: what a set-up or a design means, who may do what, caches.

mod access;
mod backend;
mod collect;
mod content;
mod error;
mod health;
mod index;
mod lease;
mod records;
mod requests;
mod rows;
mod sessions;
mod store;
mod verify;

pub use collect::{Collected, Schedule};
pub use error::{StoreError, unless_damaged};
pub use health::Health;
pub use index::{Excess, Held, Kind, Quota, Reservation, Survey, Usage};
pub use records::{AccessRecord, Manifest, ManifestEntry, Numbers, SessionRecord, Shared, Update};
pub use requests::Claim;
pub use rows::Generation;
pub use store::Store;
pub use verify::Verified;
