//! Errors with the path of the field: `components[1].patches[0].knots_u[7] = NaN is not finite`.

use moldline_foundation::Failure;
use moldline_geometry::{ComponentError, PrimitiveError};
use moldline_mesh::{MeshError, io::ReadError};
use moldline_parameterisation::ParameterisationError;
use moldline_spline::KnotError;

/// Why a set-up cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum SetupFileError {
    /// There is no set-up file, or more than one.
    #[error("{found}; expected one of setup.toml and setup.json in the top folder. Files: {known}")]
    SetupFile {
        /// The set-up files found.
        found: &'static str,
        /// Names of the files.
        known: String,
    },
    /// A file named by the set-up is missing.
    #[error("{field} = '{path}' is not among the files of the set-up: {known}")]
    MissingFile {
        /// Path of the field.
        field: String,
        /// The file named.
        path: String,
        /// Names of the files.
        known: String,
    },
    /// A path that leaves the folder, or that could.
    #[error("{field}: path '{path}' {reason}; use a relative path with '/' inside the set-up's folder")]
    Path {
        /// Path of the field, or the archive.
        field: String,
        /// The path as given.
        path: String,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// More than the limit.
    #[error("{field}: {count} {what} exceed the limit of {limit}")]
    TooMany {
        /// Path of the field, file or archive.
        field: String,
        /// What is counted.
        what: &'static str,
        /// Their number, or a lower bound.
        count: u64,
        /// Largest number accepted.
        limit: u64,
    },
    /// The document is not well-formed, lacks a field, has an unknown one or one of the wrong type.
    #[error("{file}: {}{message}", if field.is_empty() { String::new() } else { format!("{field}: ") })]
    Syntax {
        /// Name of the file.
        file: String,
        /// Path of the field, as far as it is known.
        field: String,
        /// What is wrong.
        message: String,
    },
    /// An unknown version of the format.
    #[error("format = {found} is not supported; this program reads format = 1")]
    Format {
        /// The version found.
        found: u32,
    },
    /// NaN or infinity.
    #[error("{field} = {value} is not finite")]
    NotFinite {
        /// Path of the number.
        field: String,
        /// The number.
        value: f64,
    },
    /// A number outside its range.
    #[error("{field} = {value} {requirement}")]
    Value {
        /// Path of the field.
        field: String,
        /// Its value, as text.
        value: String,
        /// The requirement.
        requirement: String,
    },
    /// The lengths of two lists, or of a list and a degree, do not match.
    #[error("{field} has {found} {what}, expected {expected}")]
    Size {
        /// Path of the list.
        field: String,
        /// Its length.
        found: usize,
        /// Kind of its entries.
        what: &'static str,
        /// The required length, and why.
        expected: String,
    },
    /// An invalid knot vector.
    #[error("{field}: {source}")]
    Knots {
        /// Path of the knot vector.
        field: String,
        /// What is wrong.
        source: KnotError,
    },
    /// Not exactly one of several fields.
    #[error("{field} needs exactly one of {choices}; found {found}")]
    Choice {
        /// Path of the struct.
        field: String,
        /// The fields to choose from.
        choices: &'static str,
        /// Those present.
        found: String,
    },
    /// Two components, files or groups of the same name.
    #[error("{field}: '{name}' occurs twice")]
    Duplicate {
        /// Path of the second.
        field: String,
        /// The name.
        name: String,
    },
    /// Patches that do not form a component.
    #[error("components[{index}] ('{name}'): {source}")]
    Component {
        /// Index of the component.
        index: usize,
        /// Its name.
        name: String,
        /// What is wrong.
        source: ComponentError,
    },
    /// An invalid primitive.
    #[error("components[{index}].primitive ('{name}'): {source}")]
    Primitive {
        /// Index of the component.
        index: usize,
        /// Its name.
        name: String,
        /// What is wrong.
        source: PrimitiveError,
    },
    /// A mesh file that cannot be read, or whose mesh is not valid.
    #[error("mesh ({file}): {source}")]
    MeshFile {
        /// Name of the file.
        file: String,
        /// What is wrong.
        source: ReadError,
    },
    /// An invalid inline mesh.
    #[error("mesh: {0}")]
    Mesh(#[from] MeshError),
    /// An invalid parameterisation.
    #[error("parameterisation.{0}")]
    Parameterisation(#[from] ParameterisationError),
    /// An archive that cannot be read.
    #[error("the archive cannot be read: {message}")]
    Archive {
        /// What is wrong.
        message: String,
    },
    /// A file or folder that cannot be read.
    #[error("cannot read '{path}': {source}")]
    Io {
        /// The path.
        path: String,
        /// The system's reason.
        source: std::io::Error,
    },
}

impl Failure for SetupFileError {
    fn field(&self) -> Option<String> {
        Some(match self {
            Self::SetupFile { .. } => "setup_file".to_owned(),
            Self::MissingFile { field, .. }
            | Self::Path { field, .. }
            | Self::TooMany { field, .. }
            | Self::NotFinite { field, .. }
            | Self::Value { field, .. }
            | Self::Size { field, .. }
            | Self::Knots { field, .. }
            | Self::Choice { field, .. }
            | Self::Duplicate { field, .. } => field.clone(),
            Self::Syntax { file, field, .. } if field.is_empty() => file.clone(),
            Self::Syntax { field, .. } => field.clone(),
            Self::Format { .. } => "format".to_owned(),
            Self::Component { index, .. } => format!("components[{index}]"),
            Self::Primitive { index, .. } => format!("components[{index}].primitive"),
            Self::MeshFile { source: ReadError::Mesh { error, .. }, .. } | Self::Mesh(error) => {
                return error.field().map(|field| format!("mesh.{field}"));
            }
            Self::MeshFile { source: ReadError::MergeTolerance { .. }, .. } => {
                "mesh.merge_tolerance".to_owned()
            }
            Self::MeshFile { .. } => "mesh.file".to_owned(),
            Self::Parameterisation(error) => return error.field(),
            Self::Archive { .. } => "archive".to_owned(),
            Self::Io { path, .. } => path.clone(),
        })
    }
}
