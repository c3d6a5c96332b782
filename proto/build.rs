//! Compiles `moldline/v1/*.proto` in Rust, without protoc.

use std::{env, error::Error, fs, path::PathBuf};

use prost::Message;
use prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorSet,
    field_descriptor_proto::{Label, Type},
};
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
    let builder = tonic_prost_build::configure().bytes(".moldline.v1").codec_path("crate::codec::Codec");
    let builder =
        if env::var_os("CARGO_FEATURE_JSON").is_some() { json(builder, &descriptors) } else { builder };
    let mut config = tonic_prost_build::Config::new();
    config.enable_type_names();
    builder.compile_fds_with_config(descriptors, config)?;
    Ok(())
}

/// Messages that HTTP reads as JSON documents, and that no answer contains.
const READ: [&str; 17] = [
    "OpenSessionRequest",
    "UpdateSessionRequest",
    "ShareSetupRequest",
    "DeformRequest",
    "ApplyJacobianVectorRequest",
    "ApplyAdjointRequest",
    "JacobianRequest",
    "LinearisationPoint",
    "CreateConfigurationRequest",
    "PanelOptions",
    "AnalyzeRequest",
    "FlowAngles",
    "FlowReference",
    "AnalysisPoint",
    "AnalysisGeometry",
    "PanelServiceApplyJacobianVectorRequest",
    "PanelServiceApplyAdjointRequest",
];

/// Messages whose JSON in requests is that of a type of the same name in `src/json/requests.rs`: answers contain them too, and
/// describe them otherwise, or their JSON is not that of their fields.
const MIRRORED: [&str; 6] =
    ["DesignPoint", "ControlPoints", "ControlPointVectors", "FlowInputs", "FlowOutputs", "TrailingEdges"];

/// Messages of requests only, without a JSON of their own.
const UNWRITTEN: [&str; 6] =
    ["Array", "SetupChunk", "TrailingEdges", "NoTrailingEdges", "NameList", "IndexGroup"];

/// Fields of requests that an address or a header carries.
const ELSEWHERE: [&str; 4] = ["setup_id", "session_id", "configuration_id", "request_id"];

/// Parts of requests that may be absent but not null.
const NOT_NULL: [&str; 4] = ["at", "directions", "seeds", "options"];

/// Fields of `READ` that the rules of [`read_field`] do not describe.
const EXCEPTIONS: [(&str, &str); 19] = [
    ("UpdateSessionRequest.expected_generation", ""),
    (
        "UpdateSessionRequest.design",
        "#[schema(value_type = Option<crate::json::requests::DesignPoint>, nullable = false)]",
    ),
    ("UpdateSessionRequest.label", "#[schema(nullable = false)]"),
    (
        "ShareSetupRequest.visibility",
        "#[serde(deserialize_with = \"crate::json::read::word::<Visibility, _>\")] #[schema(value_type = Visibility, inline)]",
    ),
    (
        "DeformRequest.input",
        "#[serde(rename = \"design\", default, deserialize_with = \"crate::json::read::design\")] \
         #[schema(value_type = Option<crate::json::read::Design>, nullable = false)]",
    ),
    ("ApplyJacobianVectorRequest.design", POINTS),
    ("ApplyAdjointRequest.vertices", VECTORS),
    ("ApplyAdjointRequest.functions", POINTS),
    (
        "CreateConfigurationRequest.cells",
        "#[serde(default = \"crate::json::read::no_cells\", deserialize_with = \"crate::json::read::cells\")] \
         #[schema(value_type = Vec<Vec<u32>>)]",
    ),
    ("CreateConfigurationRequest.vertices", POINTS),
    ("CreateConfigurationRequest.cell_groups", GROUPS),
    ("CreateConfigurationRequest.vertex_groups", GROUPS),
    (
        "PanelOptions.symmetry",
        "#[serde(default, deserialize_with = \"crate::json::read::optional_word::<PanelSymmetry, _>\")] \
         #[schema(value_type = Option<PanelSymmetry>, nullable = false)]",
    ),
    (
        "PanelOptions.solver",
        "#[serde(default, deserialize_with = \"crate::json::read::optional_word::<PanelSolver, _>\")] \
         #[schema(value_type = Option<PanelSolver>, nullable = false)]",
    ),
    (
        "PanelOptions.on_doubt",
        "#[serde(default, deserialize_with = \"crate::json::read::optional_word::<PanelOnDoubt, _>\")] \
         #[schema(value_type = Option<PanelOnDoubt>, nullable = false)]",
    ),
    (
        "PanelOptions.components",
        "#[serde(default, deserialize_with = \"crate::json::read::names\")] \
         #[schema(value_type = Option<Vec<String>>, nullable = false)]",
    ),
    ("AnalyzeRequest.vertices", POINTS),
    ("AnalysisGeometry.vertices", POINTS),
    ("FlowReference.point", "#[serde(default, deserialize_with = \"crate::json::read::point\")]"),
];

/// Lists of points or of numbers.
const POINTS: &str = "#[serde(default)] #[schema(value_type = Option<Vec<Vec<f64>>>, nullable = false)]";

/// Lists of lists of points.
const VECTORS: &str =
    "#[serde(default)] #[schema(value_type = Option<Vec<Vec<Vec<f64>>>>, nullable = false)]";

/// Names of groups with their indices.
const GROUPS: &str = "#[serde(default, deserialize_with = \"crate::json::read::groups\")] \
                      #[schema(value_type = std::collections::BTreeMap<String, Vec<u32>>)]";

/// Fields of `READ` that must be given.
const REQUIRED: [&str; 3] = ["FlowReference.area", "FlowReference.chord", "FlowReference.span"];

/// Messages of answers are written as JSON, and those of requests read; both are described for OpenAPI.
fn json(mut builder: Builder, descriptors: &FileDescriptorSet) -> Builder {
    for file in descriptors.file.iter().filter(|file| file.package() == "moldline.v1") {
        for named in &file.enum_type {
            let path = format!(".moldline.v1.{}", named.name());
            builder = builder.enum_attribute(
                &path,
                "#[derive(serde::Serialize, serde::Deserialize, utoipa::ToSchema)] #[serde(rename_all = \"snake_case\")]",
            );
            if let Some(unspecified) = named.value.first() {
                // Requests leave the field out.
                let path = format!("{path}.{}", unspecified.name());
                builder = builder.field_attribute(&path, "#[serde(skip_deserializing)]");
            }
        }
        for message in &file.message_type {
            let name = message.name();
            if READ.contains(&name) {
                builder = read(builder, message);
            } else if !name.ends_with("Request") && !UNWRITTEN.contains(&name) {
                builder = write(builder, message);
            }
            if MIRRORED.contains(&name) {
                let path = format!(".moldline.v1.{name}");
                let from = format!("#[serde(from = \"crate::json::requests::{name}\")]");
                builder = builder.message_attribute(&path, "#[derive(serde::Deserialize)]");
                builder = builder.message_attribute(&path, from);
            }
        }
    }
    builder
}

/// Reads a message of requests. Unknown fields are refused, and fields that are not required may be absent.
fn read(mut builder: Builder, message: &DescriptorProto) -> Builder {
    let path = format!(".moldline.v1.{}", message.name());
    builder = builder
        .message_attribute(&path, "#[derive(serde::Deserialize, utoipa::ToSchema)]")
        .message_attribute(&path, "#[serde(deny_unknown_fields)]");
    if !message.name().ends_with("Request") {
        builder = builder.message_attribute(&path, format!("#[schema(as = Request{})]", message.name()));
    }
    if message.name() == "DeformRequest" {
        let example = "#[schema(example = json!({ \"design\": { \"wing.translation\": 0.5 } }))]";
        builder = builder.message_attribute(&path, example);
    }
    let oneofs = message.oneof_decl.iter().map(|oneof| oneof.name());
    let exception = |field: &str| {
        let field = format!("{}.{field}", message.name());
        EXCEPTIONS.iter().find(|(name, _)| *name == field).map(|(_, attributes)| (*attributes).to_owned())
    };
    for oneof in oneofs {
        if let Some(attributes) = exception(oneof) {
            // The end of a path, since the full path is also the beginning of the paths of its variants.
            builder = builder.field_attribute(format!("{}.{oneof}", message.name()), attributes);
        }
    }
    for field in &message.field {
        let attributes = exception(field.name()).unwrap_or_else(|| read_field(message.name(), field));
        if field.oneof_index.is_none() || field.proto3_optional() {
            builder = builder.field_attribute(format!("{path}.{}", field.name()), attributes);
        }
    }
    builder
}

fn read_field(message: &str, field: &FieldDescriptorProto) -> String {
    if REQUIRED.contains(&format!("{message}.{}", field.name()).as_str()) {
        return String::new();
    }
    if ELSEWHERE.contains(&field.name()) && message.ends_with("Request") {
        return "#[serde(skip)]".to_owned();
    }
    let mut attributes = "#[serde(default)]".to_owned();
    let repeated = field.label() == Label::Repeated;
    if field.r#type() == Type::Message {
        let name = field.type_name().rsplit('.').next().unwrap_or_default();
        let container = if repeated { "Vec" } else { "Option" };
        if MIRRORED.contains(&name) {
            attributes += &format!("#[schema(value_type = {container}<crate::json::requests::{name}>)]");
        }
    }
    if NOT_NULL.contains(&field.name()) {
        attributes += "#[serde(deserialize_with = \"crate::json::read::given\")]";
    }
    if !repeated && (field.r#type() == Type::Message || field.proto3_optional()) {
        attributes += "#[schema(nullable = false)]";
    }
    attributes
}

/// Writes a message of answers. `src/json/answers.rs` has what needs a hand: arrays are nested lists, enumerations words.
fn write(mut builder: Builder, message: &DescriptorProto) -> Builder {
    const DERIVE: &str = "#[derive(serde::Serialize, utoipa::ToSchema)]";
    // JSON has no infinity: it is null.
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
    let path = format!(".moldline.v1.{}", message.name());
    builder = builder.message_attribute(&path, DERIVE);
    for (index, oneof) in message.oneof_decl.iter().enumerate() {
        // A field that is `optional` has a oneof of its own, which leaves no trace.
        let real = |field: &&FieldDescriptorProto| {
            field.oneof_index == Some(index as i32) && !field.proto3_optional()
        };
        if message.field.iter().find(real).is_some() {
            let full = format!("{path}.{}", oneof.name());
            // The end of a path, since the full path is also the beginning of the paths of its variants.
            let field = format!("{}.{}", message.name(), oneof.name());
            builder = builder
                .enum_attribute(&full, DERIVE)
                .enum_attribute(&full, "#[serde(rename_all = \"snake_case\")]")
                .field_attribute(&field, "#[serde(flatten, skip_serializing_if = \"Option::is_none\")]");
        }
    }
    for field in &message.field {
        let path = format!("{path}.{}", field.name());
        let alone = field.label() == Label::Optional;
        match field.r#type() {
            Type::Enum => {
                let name = field.type_name().rsplit('.').next().unwrap_or_default();
                let attributes = format!(
                    "#[serde(serialize_with = \"crate::json::word::<{name}, _>\")] #[schema(value_type = {name})]"
                );
                builder = builder.field_attribute(&path, attributes);
            }
            Type::Message if alone && field.oneof_index.is_none() => {
                builder =
                    builder.field_attribute(&path, "#[serde(skip_serializing_if = \"Option::is_none\")]");
            }
            Type::Double if INFINITE.contains(&message.name()) => {
                builder = builder.field_attribute(&path, "#[schema(value_type = Option<f64>)]");
            }
            _ => {}
        }
    }
    builder
}
