//! The panel method's service and its commands. `api` is the service in messages of the protocol, `convert` has their meaning;
//! `grpc` and `http` wrap it.

pub mod analyze;
mod api;
mod choices;
mod convert;
mod grpc;
mod http;
mod query;
mod replies;
pub mod serve;
