//! Messages in JSON: arrays as nested lists, enumerations as words.

mod answers;
pub mod read;
pub mod requests;

pub use answers::word;
