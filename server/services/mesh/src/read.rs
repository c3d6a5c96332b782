//! Conversion of uploaded or stored bytes to the engine's input and the hash of the content.

use bytes::Bytes;
use moldline_deform::SetupInput;
use moldline_host::{ServiceError, Share};
use moldline_mesh::{Origin, io::vtu};
use moldline_setup_files::{Files, SetupContent, read_setup, unpack};
use moldline_store::Manifest;

use crate::{
    limits::Limits,
    setup_id::SetupId,
    upload::{UploadSource, Uploaded},
};

/// A set-up that has been read but not built.
pub struct Read {
    /// The user's title.
    pub name: String,
    /// The engine's input.
    pub input: SetupInput,
}

/// A set-up with the files that it was read from.
pub struct Content {
    /// Hash of the files.
    pub id: SetupId,
    /// The engine's input.
    pub read: Read,
    /// The set-up file, followed by the files to which it refers by path.
    pub files: Vec<(String, Vec<u8>)>,
}

/// An error of the engine for the user of a mesh file: behind the indices of vertices and cells come their numbers in the file.
pub fn explained(origin: &Origin, error: impl Into<ServiceError>) -> ServiceError {
    error.into().reworded(|text| origin.explain(text))
}

/// An estimate of the memory that reading files takes besides their bytes: syntax trees, documents, arrays.
pub fn memory<'a>(files: impl IntoIterator<Item = (&'a str, &'a [u8])>, limits: &Limits) -> u64 {
    let of_file = |(path, content): (&str, &[u8])| {
        let (times, inflated) = match path.rsplit('.').next().unwrap_or_default() {
            // The tree of a document of short lists, as measured.
            "toml" => (36, 0),
            "json" => (12, 0),
            "vtu" => (8, vtu::inflated(content, &limits.setup_file.mesh)),
            _ => (8, 0),
        };
        inflated.saturating_add(times * content.len() as u64)
    };
    files.into_iter().map(of_file).fold(0, u64::saturating_add)
}

/// Reads an upload. `memory` is what has been taken for its bytes, and grows by what it is unpacked and read to.
///
/// # Errors
/// `InvalidArgument` naming the invalid field of the set-up, `ResourceExhausted` if there is no memory for it.
pub fn uploaded(uploaded: Uploaded, limits: &Limits, memory: &mut Share) -> Result<Content, ServiceError> {
    /// What deflate makes of a byte at most, and a little.
    const INFLATED: u64 = 1100;
    let received = uploaded.bytes();
    let Uploaded { header, mut contents, .. } = uploaded;
    let files: Files = match header.source {
        UploadSource::Files(files) => files.into_iter().map(|file| file.path).zip(contents).collect(),
        // An archive is received as one file.
        UploadSource::Archive { kind, .. } => {
            memory.grow("the archive", limits.unpacked_bytes.min(received.saturating_mul(INFLATED)))?;
            let files = unpack(kind, &contents.pop().unwrap_or_default(), &file_limits(limits))?;
            memory.shrink(files.values().map(|content| content.len() as u64).sum());
            files
        }
    };
    let held = memory.amount();
    let contents = files.iter().map(|(path, content)| (path.as_str(), &content[..]));
    memory.grow("reading the files", self::memory(contents, limits))?;
    let content = read(files, header.setup_file.as_deref(), limits)?;
    // The engine's input is about as large.
    memory.shrink(2 * held);
    Ok(content)
}

/// Reads the stored files of a set-up, which have been verified against its id.
///
/// # Errors
/// `InvalidArgument` if this version rejects what an earlier one accepted.
pub fn stored(files: Vec<(String, Bytes)>, limits: &Limits) -> Result<Read, ServiceError> {
    let setup_file = files.first().map(|(path, _)| path.clone());
    let files = files.into_iter().map(|(path, content)| (path, content.into())).collect();
    let SetupContent { name, input, .. } = read_setup(&files, setup_file.as_deref(), &file_limits(limits))?;
    Ok(Read { name, input })
}

fn read(mut files: Files, setup_file: Option<&str>, limits: &Limits) -> Result<Content, ServiceError> {
    let SetupContent { name, input, files: used, .. } = read_setup(&files, setup_file, &file_limits(limits))?;
    // A file to which the set-up refers twice is kept once.
    let used: Vec<(String, Vec<u8>)> =
        used.into_iter().filter_map(|path| files.remove_entry(&path)).collect();
    let manifest = Manifest::of(used.iter().map(|(path, content)| (path.as_str(), content.as_slice())));
    Ok(Content { id: SetupId::new(manifest.id()), read: Read { name, input }, files: used })
}

fn file_limits(limits: &Limits) -> moldline_setup_files::Limits {
    moldline_setup_files::Limits {
        bytes: limits.unpacked_bytes,
        files: limits.upload_files,
        ..limits.setup_file
    }
}
