//! Moldline's wire messages, client and server traits, compiled from `proto/moldline`.
//!
//! Transports, the binary and the clients use this crate; the services do not know it.

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
