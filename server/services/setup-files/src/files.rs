//! Folders and archives as maps of names to bytes.

use std::collections::BTreeMap;
use std::io::{Cursor, Read};
use std::path::Path;

use flate2::read::MultiGzDecoder;

use crate::SetupFileError;
use crate::parse::{parse_setup, references};

/// Files of a set-up: path relative to its folder, with `/`, and bytes.
pub type Files = BTreeMap<String, Vec<u8>>;

/// Usual names of the set-up file.
const SETUP_FILES: [&str; 2] = ["setup.toml", "setup.json"];
/// Longest path accepted, bytes.
const PATH_LIMIT: usize = 512;

/// Limits on a set-up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Files of a set-up.
    pub files: usize,
    /// Bytes of all files together, decompressed.
    pub bytes: u64,
    /// Components.
    pub components: usize,
    /// Control points of all components together.
    pub control_points: usize,
    /// The mesh.
    pub mesh: moldline_mesh::Limits,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            files: 10_000,
            bytes: 4 << 30,
            components: 1000,
            control_points: 5_000_000,
            mesh: moldline_mesh::Limits::default(),
        }
    }
}

/// Formats of archives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArchiveKind {
    /// tar
    Tar,
    /// tar compressed by gzip
    TarGz,
    /// zip
    Zip,
}

impl ArchiveKind {
    /// By the ending of a file name: `.tar`, `.tar.gz`, `.tgz`, `.zip`.
    pub fn of_name(name: &str) -> Option<Self> {
        let name = name.to_ascii_lowercase();
        let ends = |ending: &str| name.ends_with(ending);
        if ends(".tar") {
            Some(Self::Tar)
        } else if ends(".tar.gz") || ends(".tgz") {
            Some(Self::TarGz)
        } else if ends(".zip") {
            Some(Self::Zip)
        } else {
            None
        }
    }
}

/// Checks a path given by a user and returns it without `.` parts.
///
/// # Errors
/// [`SetupFileError::Path`] for absolute paths, `..`, backslashes, drive letters, empty parts and control characters.
pub(crate) fn clean_path(field: &str, path: &str) -> Result<String, SetupFileError> {
    let refuse = |reason| {
        let shown: String = path.chars().take(80).flat_map(char::escape_default).collect();
        Err(SetupFileError::Path { field: field.into(), path: shown, reason })
    };
    if path.len() > PATH_LIMIT {
        return refuse("is too long");
    }
    if path.starts_with('/') {
        return refuse("is absolute");
    }
    if path.contains(['\\', ':']) || path.chars().any(char::is_control) {
        return refuse("contains a backslash, a colon or a control character");
    }
    let mut parts = Vec::new();
    for part in path.split('/') {
        match part {
            "." => {}
            ".." => return refuse("leaves the folder"),
            "" => return refuse("has an empty part"),
            part => parts.push(part),
        }
    }
    if parts.is_empty() {
        return refuse("names no file");
    }
    Ok(parts.join("/"))
}

/// Unpacks an archive. A single top folder is left out, so that `set-up/setup.toml` becomes `setup.toml`.
///
/// # Errors
/// For damaged archives, more files or bytes than the limits allow, links, and paths that leave the folder.
pub fn unpack(kind: ArchiveKind, bytes: &[u8], limits: &Limits) -> Result<Files, SetupFileError> {
    let files = match kind {
        ArchiveKind::Tar => unpack_tar(bytes, limits)?,
        ArchiveKind::TarGz => unpack_tar(MultiGzDecoder::new(bytes), limits)?,
        ArchiveKind::Zip => unpack_zip(bytes, limits)?,
    };
    Ok(without_top_folder(files))
}

fn damaged(error: impl std::fmt::Display) -> SetupFileError {
    SetupFileError::Archive { message: error.to_string() }
}

/// Collects files under the limits.
struct Collector<'a> {
    limits: &'a Limits,
    files: Files,
    bytes: u64,
}

impl<'a> Collector<'a> {
    fn new(limits: &'a Limits) -> Self {
        Self { limits, files: Files::new(), bytes: 0 }
    }

    /// Reads a file, no further than the limit whatever its header says.
    fn add(&mut self, path: &str, content: impl Read) -> Result<(), SetupFileError> {
        let path = clean_path("archive", path)?;
        if self.files.len() >= self.limits.files {
            return Err(self.too_many("files", self.files.len() as u64 + 1, self.limits.files as u64));
        }
        let left = self.limits.bytes - self.bytes;
        let mut content = content.take(left.saturating_add(1));
        let mut bytes = Vec::new();
        content.read_to_end(&mut bytes).map_err(damaged)?;
        self.bytes += bytes.len() as u64;
        if self.bytes > self.limits.bytes {
            return Err(self.too_many("bytes", self.bytes, self.limits.bytes));
        }
        if self.files.contains_key(&path) {
            return Err(SetupFileError::Duplicate { field: "archive".into(), name: path });
        }
        self.files.insert(path, bytes);
        Ok(())
    }

    fn too_many(&self, what: &'static str, count: u64, limit: u64) -> SetupFileError {
        SetupFileError::TooMany { field: "archive".into(), what, count, limit }
    }
}

fn unpack_tar(reader: impl Read, limits: &Limits) -> Result<Files, SetupFileError> {
    let mut collector = Collector::new(limits);
    // Headers and padding cost bytes too, and broken links none: so all bytes read are bounded as well.
    let overhead = 4096 * (limits.files as u64 + 2);
    let mut archive = tar::Archive::new(reader.take(limits.bytes.saturating_add(overhead)));
    for entry in archive.entries().map_err(damaged)? {
        let entry = entry.map_err(damaged)?;
        let path = String::from_utf8(entry.path_bytes().into_owned());
        let path = path.map_err(|_| damaged("a file name is not UTF-8"))?;
        let kind = entry.header().entry_type();
        if kind.is_dir() || kind.is_pax_global_extensions() {
            continue;
        }
        if !kind.is_file() {
            return Err(SetupFileError::Path {
                field: "archive".into(),
                path: path.chars().take(80).flat_map(char::escape_default).collect(),
                reason: "is a link or a device",
            });
        }
        collector.add(&path, entry)?;
    }
    Ok(collector.files)
}

fn unpack_zip(bytes: &[u8], limits: &Limits) -> Result<Files, SetupFileError> {
    let mut collector = Collector::new(limits);
    // Before the directory is read, whose entries take several times their bytes.
    let entries = bytes.windows(4).filter(|bytes| bytes == b"PK\x01\x02").count();
    if entries > limits.files.saturating_mul(8) {
        return Err(collector.too_many("entries", entries as u64, limits.files as u64));
    }
    let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).map_err(damaged)?;
    if archive.len() > limits.files.saturating_mul(4) {
        return Err(collector.too_many("entries", archive.len() as u64, limits.files as u64));
    }
    for i in 0..archive.len() {
        let entry = archive.by_index(i).map_err(damaged)?;
        if entry.is_dir() {
            continue;
        }
        let path = entry.name().map_err(damaged)?.into_owned();
        if entry.is_symlink() {
            return Err(SetupFileError::Path {
                field: "archive".into(),
                path,
                reason: "is a link or a device",
            });
        }
        collector.add(&path, entry)?;
    }
    Ok(collector.files)
}

fn without_top_folder(files: Files) -> Files {
    let top = |path: &String| path.split_once('/').map(|(top, _)| top.to_owned());
    let Some(first) = files.keys().next().and_then(top) else { return files };
    if files.keys().any(|path| top(path).as_ref() != Some(&first)) {
        return files;
    }
    files.into_iter().map(|(path, bytes)| (path[first.len() + 1..].to_owned(), bytes)).collect()
}

/// The name of the set-up file: the one given, or the one of the usual names that is present.
pub(crate) fn find_setup_file(files: &Files, given: Option<&str>) -> Result<String, SetupFileError> {
    if let Some(given) = given {
        let path = clean_path("setup_file", given)?;
        return if files.contains_key(&path) {
            Ok(path)
        } else {
            Err(SetupFileError::MissingFile { field: "setup_file".into(), path, known: names(files) })
        };
    }
    let mut there = SETUP_FILES.into_iter().filter(|name| files.contains_key(*name));
    let missing = |found| SetupFileError::SetupFile { found, known: names(files) };
    let first = there.next().ok_or_else(|| missing("there is no set-up file"))?;
    if there.next().is_some() {
        return Err(missing("there are two set-up files"));
    }
    Ok(first.into())
}

/// The names, shortened to fit a message.
pub(crate) fn names(files: &Files) -> String {
    const SHOWN: usize = 12;
    let shown: Vec<&str> = files.keys().take(SHOWN).map(String::as_str).collect();
    match files.len() {
        0 => "none".into(),
        n if n <= SHOWN => shown.join(", "),
        n => format!("{}, and {} more", shown.join(", "), n - SHOWN),
    }
}

/// Reads a set-up from disk: a folder (with `setup.toml` or `setup.json`), a set-up file in its folder, or an archive.
/// In a folder only the set-up file and the files that it names are read. Returns the files and the name of the set-up file.
///
/// # Errors
/// If a file cannot be read, or the set-up file cannot be parsed far enough to know the files that it names.
pub fn read_folder(path: &Path, limits: &Limits) -> Result<(Files, String), SetupFileError> {
    read_named(path, limits, |_| true)
}

/// As [`read_folder`], without the mesh: for a folder that waits for one.
///
/// # Errors
/// As `read_folder`.
pub fn read_geometry_folder(path: &Path, limits: &Limits) -> Result<(Files, String), SetupFileError> {
    read_named(path, limits, |field| field != "mesh.file")
}

/// Reads the set-up file and the files that it names in fields for which `wanted` holds.
fn read_named(
    path: &Path,
    limits: &Limits,
    wanted: impl Fn(&str) -> bool,
) -> Result<(Files, String), SetupFileError> {
    let io = |path: &Path| {
        let path = path.display().to_string();
        move |source| SetupFileError::Io { path, source }
    };
    let mut collector = Collector::new(limits);
    let metadata = std::fs::metadata(path).map_err(io(path))?;
    if metadata.is_file()
        && let Some(kind) = path.file_name().and_then(|name| name.to_str()).and_then(ArchiveKind::of_name)
    {
        let files = unpack(kind, &std::fs::read(path).map_err(io(path))?, limits)?;
        let setup_file = find_setup_file(&files, None)?;
        return Ok((files, setup_file));
    }
    let read = |collector: &mut Collector<'_>, folder: &Path, name: &str| {
        let path = folder.join(name);
        let file = std::fs::File::open(&path).map_err(io(&path))?;
        collector.add(name, file).map_err(|error| match error {
            SetupFileError::Archive { message } => SetupFileError::Io {
                path: path.display().to_string(),
                source: std::io::Error::other(message),
            },
            other => other,
        })
    };
    let folder = if metadata.is_dir() { path } else { path.parent().unwrap_or(Path::new(".")) };
    if metadata.is_dir() {
        for name in SETUP_FILES.into_iter().filter(|name| folder.join(name).is_file()) {
            read(&mut collector, folder, name)?;
        }
    } else {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default().to_owned();
        read(&mut collector, folder, &name)?;
    }
    let given = collector.files.keys().next().filter(|_| !metadata.is_dir()).cloned();
    let setup_file = find_setup_file(&collector.files, given.as_deref())?;
    let document = parse_setup(&setup_file, &collector.files[&setup_file])?;
    for (field, name) in references(&document).into_iter().filter(|(field, _)| wanted(field)) {
        let name = clean_path(&field, &name)?;
        if !collector.files.contains_key(&name) {
            read(&mut collector, folder, &name)?;
        }
    }
    Ok((collector.files, setup_file))
}
