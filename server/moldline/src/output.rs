//! Results of commands on standard output and in files.

use std::{
    fmt, fs,
    io::{self, Write},
    path::Path,
};

use crate::failure::Failure;

/// Prints a line of results. A reader that closes its end, as `head` does, is no failure.
pub fn say(line: &dyn fmt::Display) -> Result<(), Failure> {
    match writeln!(io::stdout().lock(), "{line}") {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(Failure::Output(error)),
        _ => Ok(()),
    }
}

/// Writes a file.
pub fn write(path: &Path, content: &[u8]) -> Result<(), Failure> {
    fs::write(path, content).map_err(|error| Failure::File { path: path.to_owned(), error })
}

/// Writes a file, and its folder first if it is missing.
pub fn write_with_folder(path: &Path, content: &[u8]) -> Result<(), Failure> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(|error| Failure::File { path: folder.to_owned(), error })?;
    }
    write(path, content)
}
