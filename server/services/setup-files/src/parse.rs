//! Parsing of TOML and JSON to documents, with the path of the field in every error.

use serde::de::DeserializeOwned;

use crate::SetupFileError;
use crate::document::{GeometryDocument, ParameterisationDocument, SetupDocument};

/// Parses a set-up file; the ending of its name decides between TOML and JSON.
pub(crate) fn parse_setup(file: &str, bytes: &[u8]) -> Result<SetupDocument, SetupFileError> {
    let document: SetupDocument =
        if file.ends_with(".toml") { parse_toml(file, bytes)? } else { parse_json(file, "", bytes)? };
    if document.format != 1 {
        return Err(SetupFileError::Format { found: document.format });
    }
    Ok(document)
}

/// Parses a geometry file of the component at `field`.
pub(crate) fn parse_geometry(
    file: &str,
    field: &str,
    bytes: &[u8],
) -> Result<GeometryDocument, SetupFileError> {
    parse_json(file, field, bytes)
}

/// Parses a set-up file that has a parameterisation only.
pub(crate) fn parse_parameterisation(text: &str) -> Result<ParameterisationDocument, SetupFileError> {
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Part {
        #[serde(default)]
        parameterisation: ParameterisationDocument,
    }
    parse_toml::<Part>("parameterisation", text.as_bytes()).map(|part| part.parameterisation)
}

/// Files that a document names, with the paths of the fields.
pub(crate) fn references(document: &SetupDocument) -> Vec<(String, String)> {
    let mesh = document.mesh.file.iter().map(|file| ("mesh.file".to_owned(), file.clone()));
    let components = document.components.iter().enumerate().filter_map(|(i, component)| {
        component.file.as_ref().map(|file| (format!("components[{i}].file"), file.clone()))
    });
    mesh.chain(components).collect()
}

fn text<'a>(file: &str, bytes: &'a [u8]) -> Result<&'a str, SetupFileError> {
    std::str::from_utf8(bytes).map_err(|error| SetupFileError::Syntax {
        file: file.into(),
        field: String::new(),
        message: format!("is not UTF-8 from byte {}", error.valid_up_to()),
    })
}

fn parse_toml<T: DeserializeOwned>(file: &str, bytes: &[u8]) -> Result<T, SetupFileError> {
    /// The tree of a TOML document takes many times its bytes; JSON is read without one.
    const LARGEST: usize = 16 << 20;
    if bytes.len() > LARGEST {
        let (field, count, limit) = (file.to_owned(), bytes.len() as u64, LARGEST as u64);
        let what = "bytes of TOML (write JSON, or put the numbers into files of their own)";
        return Err(SetupFileError::TooMany { field, what, count, limit });
    }
    let syntax =
        |field: String, message: String| SetupFileError::Syntax { file: file.into(), field, message };
    let deserializer = toml::Deserializer::parse(text(file, bytes)?)
        .map_err(|error| syntax(String::new(), error.to_string().trim_end().to_owned()))?;
    serde_path_to_error::deserialize(deserializer).map_err(|error| {
        let field = field_path("", &error.path().to_string());
        syntax(field, error.inner().message().to_owned())
    })
}

fn parse_json<T: DeserializeOwned>(file: &str, prefix: &str, bytes: &[u8]) -> Result<T, SetupFileError> {
    let text = text(file, bytes)?;
    let mut deserializer = serde_json::Deserializer::from_str(text);
    let result = serde_path_to_error::deserialize(&mut deserializer);
    let value = result.map_err(|error| {
        let field = field_path(prefix, &error.path().to_string());
        let inner = error.inner();
        match not_a_number(text, inner) {
            Some(value) => SetupFileError::NotFinite { field, value },
            None => SetupFileError::Syntax { file: file.into(), field, message: inner.to_string() },
        }
    })?;
    deserializer.end().map_err(|error| SetupFileError::Syntax {
        file: file.into(),
        field: String::new(),
        message: error.to_string(),
    })?;
    Ok(value)
}

/// `prefix.path`, where either may be missing (the path is `.` at the root of a document, `?` if unknown).
fn field_path(prefix: &str, path: &str) -> String {
    let path = path.trim_end_matches('?').trim_end_matches('.');
    match (prefix.is_empty(), path.is_empty()) {
        (true, _) => path.into(),
        (false, true) => prefix.into(),
        (false, false) => format!("{prefix}.{path}"),
    }
}

/// JSON has no NaN and no infinity, but some programs write them nevertheless (`NaN`, `-Infinity`, `1e999`).
fn not_a_number(text: &str, error: &serde_json::Error) -> Option<f64> {
    const WORDS: [(&str, f64); 5] = [
        ("NaN", f64::NAN),
        ("nan", f64::NAN),
        ("Infinity", f64::INFINITY),
        ("-Infinity", f64::NEG_INFINITY),
        ("inf", f64::INFINITY),
    ];
    let line = text.lines().nth(error.line().checked_sub(1)?)?.as_bytes();
    // The column is that of the last byte read: the first that cannot begin a number, or the last digit.
    let column = error.column().min(line.len());
    let start = line[..column].iter().rposition(|b| b",[: \t".contains(b)).map_or(0, |i| i + 1);
    let rest = &line[start..];
    let word = WORDS.into_iter().find(|(word, _)| rest.starts_with(word.as_bytes()));
    if let Some((_, value)) = word {
        return Some(value);
    }
    let end = rest.iter().position(|b| !b"+-.eE0123456789".contains(b)).unwrap_or(rest.len());
    let number: f64 = std::str::from_utf8(&rest[..end]).ok()?.parse().ok()?;
    number.is_infinite().then_some(number)
}
