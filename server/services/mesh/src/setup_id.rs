//! Ids of set-ups.

use std::fmt;

/// Id of a set-up: the BLAKE3 hash of its content, in hexadecimal digits.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SetupId(String);

impl SetupId {
    pub(crate) fn new(digits: String) -> Self {
        Self(digits)
    }

    /// Whether a text from a caller has the form of an id.
    pub(crate) fn is_valid(text: &str) -> bool {
        text.len() == 2 * blake3::OUT_LEN
            && text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
    }

    /// The digits.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for SetupId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}
