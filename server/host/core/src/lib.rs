//! What every service needs, whatever it computes: errors with codes, callers, a compute pool, single flight, caches,
//! cancellation and progress.
//!
//! - A service runs its engine on the [`ComputePool`], never on the async runtime's threads. Tenants take turns, the queue is
//!   bounded, and a panic in the engine is an error of one request.
//! - Dropping a future cancels its work: queued work is removed, running work sees it through its [`Cancellation`].
//! - Concurrent requests for the same result share one computation ([`Flights`]), and results are kept within a budget of bytes
//!   ([`Cache`]).
//! - All errors are [`ServiceError`]s. Every [`Failure`](moldline_foundation::Failure) of an engine becomes one by `?`.
//!
//! Absent on purpose: wire formats and ports (`transport`), meshes, panels, anything that one service alone needs.

mod cache;
mod cancel;
mod error;
mod flight;
mod pool;
mod principal;
mod progress;
mod supply;
mod timing;

pub use cache::{Cache, CacheStatus, Claim};
pub use cancel::{Cancellation, Interest};
pub use error::{Code, ServiceError, Violation, shorten};
pub use flight::{Flights, Follower, Joined, Reports};
pub use pool::{Completed, ComputePool, PoolLimits, Task, Ticket, Work};
pub use principal::{Principal, Role, Tenant, TenantError};
pub use progress::{Progress, Reporter};
pub use supply::{Share, Sharing, Supply};
pub use timing::{Product, Timing};
