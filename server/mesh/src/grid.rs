//! Points hashed by the cube they lie in, to find neighbours within a small radius.

#[derive(Default)]
pub(crate) struct HashGrid;
