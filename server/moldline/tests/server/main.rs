//! The services on real ports, with plain clients over loopback.

mod access;
mod grpc;
mod harness;
mod http;
mod panel;
