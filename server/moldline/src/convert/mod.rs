//! Conversions between the messages of the protocol and the types of the services.

pub mod arrays;
pub mod check;
pub mod derivatives;
pub mod sessions;
pub mod setups;
pub mod status;
