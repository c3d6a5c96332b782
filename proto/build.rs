//! Compiles `moldline/v1/*.proto` in Rust, so that nobody needs protoc.

use std::{env, error::Error, fs, path::PathBuf};

use prost::Message;
use prost_types::{FileDescriptorSet, field_descriptor_proto::Type};
use tonic_prost_build::Builder;

const FILES: [&str; 4] = [
    "moldline/v1/array.proto",
    "moldline/v1/quality.proto",
    "moldline/v1/mesh_service.proto",
    "moldline/v1/panel_service.proto",
];

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=moldline");
    let descriptors = protox::compile(FILES, ["."])?;
    let out = PathBuf::from(env::var("OUT_DIR")?);
    fs::write(out.join("descriptors.bin"), descriptors.encode_to_vec())?;
    let builder = tonic_prost_build::configure().bytes(".moldline.v1");
    let builder =
        if env::var_os("CARGO_FEATURE_JSON").is_some() { json(builder, &descriptors) } else { builder };
    builder.compile_fds(descriptors)?;
    Ok(())
}

/// Messages of answers are written as JSON as well, and described for OpenAPI. `src/json.rs` has what needs a hand: arrays are nested
/// lists, enumerations words.
fn json(mut builder: Builder, descriptors: &FileDescriptorSet) -> Builder {
    const DERIVE: &str = "#[derive(serde::Serialize, utoipa::ToSchema)]";
    const WORDS: &str = "#[serde(rename_all = \"snake_case\")]";
    // These may be infinite, which JSON writes as null.
    const INFINITE: [&str; 11] = [
        "Variable",
        "QualitySummary",
        "Distribution",
        "CheckReport",
        "CheckedDesign",
        "CheckedVariable",
        "DotProductError",
        "StepError",
        "DifferenceError",
        "Kink",
        "FlowCoefficients",
    ];
    for file in descriptors.file.iter().filter(|file| file.package() == "moldline.v1") {
        for named in &file.enum_type {
            let path = format!(".moldline.v1.{}", named.name());
            builder = builder.enum_attribute(&path, DERIVE).enum_attribute(&path, WORDS);
        }
        let answered = |name: &str| name != "Array" && name != "SetupChunk" && !name.ends_with("Request");
        for message in file.message_type.iter().filter(|message| answered(message.name())) {
            let path = format!(".moldline.v1.{}", message.name());
            builder = builder.message_attribute(&path, DERIVE);
            for (index, oneof) in message.oneof_decl.iter().enumerate() {
                // A field that is `optional` has one of its own, which leaves no trace.
                let real = |field: &&prost_types::FieldDescriptorProto| {
                    field.oneof_index == Some(index as i32) && !field.proto3_optional()
                };
                if message.field.iter().find(real).is_some() {
                    let full = format!("{path}.{}", oneof.name());
                    // The end of a path, since what begins with the whole one are its variants too.
                    let field = format!("{}.{}", message.name(), oneof.name());
                    builder =
                        builder.enum_attribute(&full, DERIVE).enum_attribute(&full, WORDS).field_attribute(
                            &field,
                            "#[serde(flatten, skip_serializing_if = \"Option::is_none\")]",
                        );
                }
            }
            for field in &message.field {
                let path = format!("{path}.{}", field.name());
                let alone = field.label() == prost_types::field_descriptor_proto::Label::Optional;
                match field.r#type() {
                    Type::Enum => {
                        let name = field.type_name().rsplit('.').next().unwrap_or_default();
                        let attributes = format!(
                            "#[serde(serialize_with = \"crate::json::word::<{name}, _>\")] #[schema(value_type = {name})]"
                        );
                        builder = builder.field_attribute(&path, attributes);
                    }
                    Type::Message if alone && field.oneof_index.is_none() => {
                        builder = builder
                            .field_attribute(&path, "#[serde(skip_serializing_if = \"Option::is_none\")]");
                    }
                    Type::Double if INFINITE.contains(&message.name()) => {
                        builder = builder.field_attribute(&path, "#[schema(value_type = Option<f64>)]");
                    }
                    _ => {}
                }
            }
        }
    }
    builder
}
