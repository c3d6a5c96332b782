//! The panel method as a service without a transport: configurations, analyses, products with their derivative, over the mesh
//! service's compute pool and with its errors.
//!
//! ```text
//! mesh, options -> (hash) -> configuration        vertices, Mach -> (hash) -> solution        flow -> analysis, products
//!                            pool, kept                          pool, once, kept                     pool
//! ```
//!
//! - A configuration and a solution are named by the hash of what they are made from. They are kept in memory within budgets
//!   of bytes, and made again to the same bits when somebody sends what they are made from again. Nothing is durable.
//! - A tenant sees what it has made itself.
//! - Memory is claimed before it is taken ([`Claim`]); beyond the budget there is an error that names both.
//! - Who asks for a solution that is being made follows it; whoever drops a future has lost interest.
//!
//! Absent on purpose: wire formats, ports, numerics.

mod configuration;
mod memory;
mod refusal;
mod reporter;
mod service;
mod solved;

pub use configuration::{Configuration, Definition};
pub use memory::{Claim, Memory};
pub use refusal::refused;
pub use reporter::Reporter;
pub use service::{Analysed, AnalysisPoint, Created, Geometry, Limits, PanelService, Status};
pub use solved::Solved;
