//! The machinery of a service on a port, whatever the service does: one port for gRPC, gRPC-Web and HTTP, TLS, who calls,
//! deadlines, errors, arrays, what is seen of requests, health, and an orderly end.
//!
//! A service gives its gRPC services and its HTTP routes as [`Served`] and gets one [`axum::Router`] back ([`router`]),
//! to be served on a [`Port`]. Its handlers find the caller as [`moldline_service::Principal`] and the [`Deadline`] in the
//! extensions of a request, and answer errors with [`status`] or [`Refusal`].
//!
//! Absent on purpose: what any service does, the command line.

mod access;
mod code;
mod deadline;
mod extract;
mod health;
mod listen;
pub mod media;
mod metrics;
pub mod npy;
mod observe;
mod refusal;
mod shell;
mod tls;
pub mod tokens;

pub use access::{Access, Certified, role};
pub use code::codes;
pub use deadline::{Deadline, REQUEST_TIMEOUT};
pub use extract::{Caller, Id, Query};
pub use health::Health;
pub use listen::Port;
pub use metrics::{start as start_metrics, upkeep as metrics_upkeep};
pub use observe::{REQUEST_ID, Trace, names};
pub use refusal::{Answer, FieldViolation, Problem, Refusal, status};
pub use shell::{Gauges, Served, Surroundings, router};
pub use tls::{TlsError, TlsFiles, acceptor};
