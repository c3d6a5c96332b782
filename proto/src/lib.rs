//! Moldline's wire messages, client and server traits, compiled from `proto/moldline`.
//!
//! Only the binary and clients see this crate; the service behind it knows no transport.

/// Version 1 of the interface.
pub mod v1 {
    #![allow(missing_docs, reason = "the comments are in the .proto files, and not every message has one")]
    #![allow(clippy::all, unused_qualifications, reason = "generated")]
    tonic::include_proto!("moldline.v1");
}

/// The compiled `FileDescriptorSet`, for server reflection.
pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));

#[cfg(feature = "json")]
pub mod json;
