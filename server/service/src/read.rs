//! From uploaded bytes to the engine's input and the name of its content.

use moldline_deform::SetupInput;

use crate::{error::ServiceError, limits::Limits, setups::SetupId, upload::Uploaded};

/// A set-up that has been read but not built.
pub struct Content {
    /// Hash of all files that it consists of.
    pub id: SetupId,
    /// The user's title of it.
    pub name: String,
    /// For the engine.
    pub input: SetupInput,
}

pub fn read(_uploaded: Uploaded, _limits: &Limits) -> Result<Content, ServiceError> {
    todo!()
}
