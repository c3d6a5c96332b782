//! Moldline's wire messages, client and server traits, compiled from `proto/moldline`.
//!
//! Transports, the binary and the clients use this crate; the services do not know it.

mod codec;
mod weight;

/// Version 1 of the interface.
pub mod v1 {
    #![allow(missing_docs, reason = "the comments are in the .proto files, and not every message has one")]
    #![allow(clippy::all, unused_qualifications, reason = "generated")]
    tonic::include_proto!("moldline.v1");
}

/// The compiled `FileDescriptorSet`, for server reflection.
pub const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));

/// Largest size in memory of a decoded request, bytes, where `length` bytes came: several times as much, and more for small ones,
/// whose parts are small. What would take more is refused.
pub fn decoded(length: u64) -> u64 {
    (64 << 10) + 4 * length + (32 * length).min(1 << 20)
}

#[cfg(feature = "json")]
pub mod json;
