//! The services on real ports, with plain clients over loopback.

#![allow(clippy::unwrap_used, reason = "helpers of tests may panic")]

mod access;
mod grpc;
mod harness;
mod http;
mod panel;
