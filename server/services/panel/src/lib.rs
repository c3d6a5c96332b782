//! The panel service without a transport: configurations, analyses, and products with their derivative.
//!
//! ```text
//! mesh, options -> (hash) -> configuration        vertices, Mach -> (hash) -> solution        flow -> analysis, products
//!                            pool, kept                          pool, once, kept                     pool
//! ```
//!
//! - A configuration and a solution are named by the hash of their input. They are kept in memory within budgets of bytes, and
//!   recomputed to the same bits when their input is sent again. Nothing is durable.
//! - A tenant sees only its own configurations and solutions.
//! - Memory is claimed before it is allocated ([`Claim`](moldline_host::Claim)); an error names the claim and the budget.
//! - Concurrent requests for the same solution share one computation; dropping a future abandons it.
//!
//! Pool, caches, single flight, errors and callers are those of `moldline-host`.
//!
//! Absent on purpose: wire formats, ports, numerics.

mod configuration;
mod merging;
mod progress;
mod service;
mod solved;

pub use configuration::{Configuration, Definition};
pub use merging::Merging;
pub use progress::reporter;
pub use service::{Analysed, AnalysisPoint, Created, Geometry, Limits, PanelService, Status};
pub use solved::Solved;
