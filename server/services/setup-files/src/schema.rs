//! JSON Schemas of the documents, generated from the structs.

use crate::document::{GeometryDocument, SetupDocument};

/// Schema of `setup.toml` and `setup.json`.
pub fn setup_schema() -> serde_json::Value {
    schemars::schema_for!(SetupDocument).to_value()
}

/// Schema of geometry files.
pub fn geometry_schema() -> serde_json::Value {
    schemars::schema_for!(GeometryDocument).to_value()
}
