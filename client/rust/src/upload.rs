//! Upload of a set-up's files.

use std::{
    fs::{self, File},
    io::Read,
    path::{Path, PathBuf},
};

use moldline_proto::v1::{
    Archive, ArchiveKind, CreateSetupRequest, FileEntry, FileList, SetupChunk, SetupHeader,
    create_setup_request::Part, setup_header::Source,
};
use tokio::sync::mpsc::Sender;

use crate::Error;

/// Bytes of one message, within the server's limit of 1 MiB.
const CHUNK: u64 = 1 << 20;

const ARCHIVES: [(&str, ArchiveKind); 4] = [
    (".tar", ArchiveKind::Tar),
    (".tar.gz", ArchiveKind::TarGz),
    (".tgz", ArchiveKind::TarGz),
    (".zip", ArchiveKind::Zip),
];

/// The files to send, and their entry in the header: an archive, or all files of a folder except hidden ones and Python's
/// caches.
pub fn files(path: &Path) -> Result<(Vec<PathBuf>, Source), Error> {
    let size =
        |path: &Path| fs::metadata(path).map(|file| file.len()).map_err(|error| Error::file(path, &error));
    if !path.is_dir() {
        let name = path.to_string_lossy();
        let Some((_, kind)) = ARCHIVES.iter().find(|(suffix, _)| name.ends_with(suffix)) else {
            let known = ARCHIVES.map(|(suffix, _)| suffix).join(", ");
            return Err(Error::client(format!(
                "{} is neither a folder nor an archive ({known})",
                path.display()
            )));
        };
        let archive = Archive { kind: (*kind).into(), size: size(path)? };
        return Ok((vec![path.to_owned()], Source::Archive(archive)));
    }
    let mut found = Vec::new();
    collect(path, &mut found)?;
    found.sort();
    let entry = |file: &PathBuf| {
        let parts = file.strip_prefix(path).unwrap_or(file).iter();
        let parts: Vec<_> = parts.map(|part| part.to_string_lossy()).collect();
        Ok(FileEntry { path: parts.join("/"), size: size(file)? })
    };
    let files = found.iter().map(entry).collect::<Result<_, Error>>()?;
    Ok((found, Source::Files(FileList { files })))
}

fn collect(folder: &Path, found: &mut Vec<PathBuf>) -> Result<(), Error> {
    let not_readable = |error| Error::file(folder, &error);
    for entry in fs::read_dir(folder).map_err(not_readable)? {
        let path = entry.map_err(not_readable)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with('.') || name == "__pycache__" {
            continue;
        }
        if path.is_dir() {
            collect(&path, found)?;
        } else if path.is_file() {
            found.push(path);
        }
    }
    Ok(())
}

/// Sends the header, then the files' bytes, until the receiver is dropped. Blocks.
pub fn upload(
    header: SetupHeader,
    files: &[PathBuf],
    messages: &Sender<CreateSetupRequest>,
) -> Result<(), Error> {
    let send = |part| messages.blocking_send(CreateSetupRequest { part: Some(part) }).is_ok();
    if !send(Part::Header(header)) {
        return Ok(());
    }
    for (index, path) in (0..).zip(files) {
        let not_readable = |error| Error::file(path, &error);
        let mut file = File::open(path).map_err(not_readable)?;
        loop {
            let mut data = Vec::new();
            file.by_ref().take(CHUNK).read_to_end(&mut data).map_err(not_readable)?;
            if data.is_empty() {
                break;
            }
            if !send(Part::Chunk(SetupChunk { file: index, data: data.into() })) {
                return Ok(());
            }
        }
    }
    Ok(())
}
