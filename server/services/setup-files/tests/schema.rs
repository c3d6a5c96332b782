//! The published schemas are those of the structs.

use std::path::Path;

use moldline_setup_files::{geometry_schema, setup_schema};
use serde_json::Value;

fn check(name: &str, schema: &Value) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../docs").join(name);
    let text = format!("{}\n", serde_json::to_string_pretty(schema).expect("is JSON"));
    if std::env::var_os("UPDATE_SCHEMA").is_some() {
        std::fs::write(&path, &text).expect("docs can be written");
    }
    let published = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        published == text,
        "docs/{name} is out of date: run UPDATE_SCHEMA=1 cargo test -p moldline-setup-files --test schema"
    );
}

#[test]
fn published_schemas_are_current() {
    check("setup.schema.json", &setup_schema());
    check("geometry.schema.json", &geometry_schema());
}
