//! The transport of any service: one port for gRPC, gRPC-Web and HTTP, TLS, authentication, deadlines, errors, arrays,
//! request ids, logs and metrics, health, and graceful shutdown.
//!
//! A service gives its gRPC services and its HTTP routes as [`Served`] and gets one [`axum::Router`] back ([`router`]),
//! to be served on a [`Port`]. Its handlers find the caller as [`moldline_host::Principal`] and the [`Deadline`] in the
//! extensions of a request, and answer errors with [`status`] or [`ErrorResponse`].
//!
//! Absent on purpose: anything that depends on the service, the command line.

mod access;
mod admit;
mod answer;
mod code;
mod connections;
mod deadline;
mod error_response;
mod extract;
mod files;
mod health;
mod listen;
mod local;
pub mod media;
mod methods;
mod metrics;
pub mod npy;
mod observe;
mod received;
mod shell;
mod tls;
pub mod tokens;

pub use access::{Access, Certified};
pub use admit::{Admission, AnswerBytes, Method};
pub use code::codes;
pub use connections::{ConnectionLimits, Connections};
pub use deadline::{Deadline, REQUEST_TIMEOUT};
pub use error_response::{Answer, ErrorResponse, FieldViolation, Problem, status};
pub use extract::{Caller, Id, Query};
pub use files::raise_file_limit;
pub use health::Health;
pub use listen::{Port, Tls};
pub use metrics::{start as start_metrics, upkeep as metrics_upkeep};
pub use observe::{REQUEST_ID, Trace, names};
pub use shell::{Gauges, Served, Surroundings, administration, router};
pub use tls::{TlsError, TlsFiles, acceptor};
