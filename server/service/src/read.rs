//! From uploaded or stored bytes to the engine's input and the name of its content.

use bytes::Bytes;
use moldline_deform::SetupInput;
use moldline_setup::{Files, SetupContent, read_setup, unpack};
use moldline_store::Manifest;

use crate::{
    error::ServiceError,
    limits::Limits,
    setups::SetupId,
    upload::{UploadSource, Uploaded},
};

/// A set-up that has been read but not built.
pub struct Read {
    /// The user's title of it.
    pub name: String,
    /// For the engine.
    pub input: SetupInput,
}

/// The same with what it was read from.
pub struct Content {
    /// Hash of all files that it consists of.
    pub id: SetupId,
    /// For the engine.
    pub read: Read,
    /// What it consists of: its set-up file first, then what that refers to by path.
    pub files: Vec<(String, Vec<u8>)>,
}

/// Reads an upload.
///
/// # Errors
/// `InvalidArgument` naming the field of the set-up that is wrong.
pub fn uploaded(uploaded: Uploaded, limits: &Limits) -> Result<Content, ServiceError> {
    let Uploaded { header, mut contents } = uploaded;
    let files: Files = match header.source {
        UploadSource::Files(files) => files.into_iter().map(|file| file.path).zip(contents).collect(),
        // An archive is received as one file.
        UploadSource::Archive { kind, .. } => {
            unpack(kind, &contents.pop().unwrap_or_default(), &file_limits(limits))?
        }
    };
    read(files, header.setup_file.as_deref(), limits)
}

/// Reads what the store keeps of a set-up: its files, verified against its name.
///
/// # Errors
/// `InvalidArgument` if this version reads less than the one that stored it.
pub fn stored(files: Vec<(String, Bytes)>, limits: &Limits) -> Result<Read, ServiceError> {
    let setup_file = files.first().map(|(path, _)| path.clone());
    let files = files.into_iter().map(|(path, content)| (path, content.into())).collect();
    let SetupContent { name, input, .. } = read_setup(&files, setup_file.as_deref(), &file_limits(limits))?;
    Ok(Read { name, input })
}

fn read(mut files: Files, setup_file: Option<&str>, limits: &Limits) -> Result<Content, ServiceError> {
    let SetupContent { name, input, files: used } = read_setup(&files, setup_file, &file_limits(limits))?;
    // One that is referred to twice is one file.
    let used: Vec<(String, Vec<u8>)> =
        used.into_iter().filter_map(|path| files.remove_entry(&path)).collect();
    let manifest = Manifest::of(used.iter().map(|(path, content)| (path.as_str(), content.as_slice())));
    Ok(Content { id: SetupId::new(manifest.id()), read: Read { name, input }, files: used })
}

fn file_limits(limits: &Limits) -> moldline_setup::Limits {
    moldline_setup::Limits { bytes: limits.unpacked_bytes, files: limits.upload_files, ..limits.setup_file }
}
