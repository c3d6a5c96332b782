//! From uploaded bytes to the engine's input and the name of its content.

use moldline_deform::SetupInput;
use moldline_setup::{Files, SetupContent, read_setup, unpack};

use crate::{
    error::ServiceError,
    limits::Limits,
    setups::SetupId,
    upload::{UploadSource, Uploaded},
};

/// A set-up that has been read but not built.
pub struct Content {
    /// Hash of all files that it consists of.
    pub id: SetupId,
    /// The user's title of it.
    pub name: String,
    /// For the engine.
    pub input: SetupInput,
}

/// Reads an upload.
///
/// # Errors
/// `InvalidArgument` naming the field of the set-up that is wrong.
pub fn read(uploaded: Uploaded, limits: &Limits) -> Result<Content, ServiceError> {
    let limits = moldline_setup::Limits {
        bytes: limits.unpacked_bytes,
        files: limits.upload_files,
        ..limits.setup_file
    };
    let Uploaded { header, mut contents } = uploaded;
    let files: Files = match header.source {
        UploadSource::Files(files) => files.into_iter().map(|file| file.path).zip(contents).collect(),
        // An archive is received as one file.
        UploadSource::Archive { kind, .. } => unpack(kind, &contents.pop().unwrap_or_default(), &limits)?,
    };
    let SetupContent { name, input, files: used } =
        read_setup(&files, header.setup_file.as_deref(), &limits)?;
    Ok(Content { id: manifest(&files, used), name, input })
}

/// The name of what a set-up consists of: its set-up file first, then what that refers to by path. Whatever else was
/// uploaded, and whether it came in an archive, does not matter.
fn manifest(files: &Files, mut used: Vec<String>) -> SetupId {
    // Grows with every change of meaning of the format.
    let mut manifest = blake3::Hasher::new_derive_key("moldline set-up, format 1");
    if let Some((_setup_file, others)) = used.split_first_mut() {
        others.sort();
    }
    for path in used {
        let content = files.get(&path).map_or(&[][..], Vec::as_slice);
        manifest.update(&(path.len() as u64).to_le_bytes());
        manifest.update(path.as_bytes());
        manifest.update(blake3::hash(content).as_bytes());
    }
    SetupId::new(manifest.finalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn id(files: &[(&str, &str)], used: &[&str]) -> SetupId {
        let files = files.iter().map(|(path, text)| (path.to_string(), text.as_bytes().to_vec())).collect();
        manifest(&files, used.iter().map(|path| path.to_string()).collect())
    }

    #[test]
    fn the_name_depends_on_what_is_used_and_on_nothing_else() {
        let base = [("setup.toml", "s"), ("mesh.msh", "m"), ("wing.json", "w")];
        let reference = id(&base, &["setup.toml", "mesh.msh", "wing.json"]);
        assert_eq!(id(&base, &["setup.toml", "wing.json", "mesh.msh"]), reference);
        let more = [("setup.toml", "s"), ("mesh.msh", "m"), ("wing.json", "w"), ("notes", "n")];
        assert_eq!(id(&more, &["setup.toml", "mesh.msh", "wing.json"]), reference);
        assert_ne!(id(&base, &["setup.toml", "mesh.msh"]), reference);
        assert_ne!(id(&base, &["mesh.msh", "setup.toml", "wing.json"]), reference);
        let other = [("setup.toml", "s"), ("mesh.msh", "M"), ("wing.json", "w")];
        assert_ne!(id(&other, &["setup.toml", "mesh.msh", "wing.json"]), reference);
        // Bytes cannot wander from one file to the next.
        assert_ne!(id(&[("a", "xy"), ("b", "")], &["a", "b"]), id(&[("a", "x"), ("b", "y")], &["a", "b"]));
    }
}
