//! Set-ups as users write them: a folder or an archive with `setup.toml` (or `setup.json`), geometry and mesh files.
//!
//! The steps: [`read_folder`] or [`unpack`] gives [`Files`] (names to bytes); [`read_setup`] parses the document,
//! checks every number and converts it to the engine's [`SetupInput`](moldline_deform::SetupInput). Errors name the
//! field: `components[1].patches[0].knots_u[7] = NaN is not finite`. The [`document`] module is the format itself;
//! its JSON Schema is published as `docs/setup.schema.json`.
//!
//! [`encode_derived`] and [`decode_derived`] convert the engine's derived data to bytes and back.
//!
//! Only [`read_folder`] touches the disk. Every count, path and size is checked before it is used.

mod convert;
mod derived;
pub mod document;
mod error;
mod files;
mod options;
mod outputs;
mod parse;
mod report;
mod schema;

pub use convert::{GeometryContent, SetupContent, check_parameterisation, read_geometry, read_setup};
pub use derived::{BUILD, decode_derived, encode_derived};
pub use error::SetupFileError;
pub use files::{ArchiveKind, Files, Limits, read_folder, read_geometry_folder, unpack};
pub use options::{OptionsDocument, SeamDocument, SmoothingDocument};
pub use report::{quality_json, report_json};
pub use schema::{geometry_schema, setup_schema};
