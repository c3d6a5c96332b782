//! Set-ups as users write them: a folder or an archive with `setup.toml` (or `setup.json`), geometry and mesh files.
//!
//! The way through: [`read_folder`] or [`unpack`] gives [`Files`] (names to bytes); [`read_setup`] parses the document,
//! checks every number and converts it to the engine's [`SetupInput`](moldline_deform::SetupInput). Errors name the
//! field: `components[1].patches[0].knots_u[7] = NaN is not finite`. The [`document`] module is the format itself;
//! its JSON Schema is published as `docs/setup.schema.json`.
//!
//! What the engine derived from a set-up goes to bytes and back by [`encode_derived`] and [`decode_derived`].
//!
//! Only [`read_folder`] touches the disk. Nothing here trusts a count, a path or a size before it is checked.

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

pub use convert::{SetupContent, read_setup};
pub use derived::{BUILD, decode_derived, encode_derived};
pub use error::SetupFileError;
pub use files::{ArchiveKind, Files, Limits, read_folder, unpack};
pub use options::{OptionsDocument, SeamDocument, SmoothingDocument};
pub use report::{quality_json, report_json};
pub use schema::{geometry_schema, setup_schema};
