//! Uploads of a set-up's files in chunks. Every count is checked before memory is allocated.

use std::collections::HashSet;

use moldline_host::{ServiceError, Share, shorten};
use moldline_setup_files::ArchiveKind;

use crate::{access::Visibility, limits::Limits};

/// Header of an upload: its description, sent before its bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UploadHeader {
    /// Chosen by the client to identify retries; may be empty.
    pub request_id: String,
    /// The file that describes the set-up; found by its usual names if `None`.
    pub setup_file: Option<String>,
    /// Who else may use it. `None`: unchanged, or nobody if the set-up is new to the caller.
    pub visibility: Option<Visibility>,
    /// The files to follow.
    pub source: UploadSource,
}

/// Contents of an upload.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum UploadSource {
    /// The files of a folder.
    Files(Vec<FileEntry>),
    /// One archive of the folder.
    Archive {
        /// Its format.
        kind: ArchiveKind,
        /// Bytes.
        size: u64,
    },
}

/// A file of an upload.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileEntry {
    /// Relative to the folder, with `/` between parts.
    pub path: String,
    /// Bytes.
    pub size: u64,
}

/// An upload in progress.
#[derive(Debug)]
pub struct Upload {
    header: UploadHeader,
    /// Announced bytes of each file; one entry for an archive.
    sizes: Vec<u64>,
    /// Received bytes of each file.
    contents: Vec<Vec<u8>>,
    received: u64,
}

/// A complete upload.
#[derive(Debug)]
pub struct Uploaded {
    /// Its header.
    pub header: UploadHeader,
    /// The bytes of each file in the header's order; one entry for an archive.
    pub contents: Vec<Vec<u8>>,
    /// The memory taken for them.
    pub(crate) memory: Option<Share>,
}

impl Uploaded {
    /// Bytes of all files.
    pub fn bytes(&self) -> u64 {
        self.contents.iter().map(|content| content.len() as u64).sum()
    }
}

impl Upload {
    /// Starts an upload.
    ///
    /// # Errors
    /// `InvalidArgument` naming the entry of the header: no files, too many, too large; paths that are repeated, absolute or
    /// outside the folder.
    pub fn begin(header: UploadHeader, limits: &Limits) -> Result<Self, ServiceError> {
        if header.request_id.len() > limits.request_id_bytes {
            return Err(ServiceError::invalid(
                "header.request_id",
                format!(
                    "{} bytes are more than the limit of {}",
                    header.request_id.len(),
                    limits.request_id_bytes
                ),
            ));
        }
        check_visibility("header.", header.visibility.as_ref(), limits)?;
        let sizes = match &header.source {
            UploadSource::Files(files) => {
                check_files(files, limits)?;
                files.iter().map(|file| file.size).collect()
            }
            UploadSource::Archive { size, .. } => vec![*size],
        };
        let total = sizes.iter().fold(0_u64, |total, &size| total.saturating_add(size));
        if total == 0 {
            return Err(ServiceError::invalid("header", "announces no bytes at all"));
        }
        if total > limits.upload_bytes {
            return Err(ServiceError::invalid(
                "header",
                format!("announces {total} bytes, more than the limit of {}", limits.upload_bytes),
            ));
        }
        // Grows with the bytes received: a header alone allocates no memory.
        let contents = vec![Vec::new(); sizes.len()];
        Ok(Self { header, sizes, contents, received: 0 })
    }

    /// Appends bytes to a file.
    ///
    /// # Errors
    /// `InvalidArgument` if the chunk is too large, belongs to no file of the header, or exceeds its file.
    pub fn append(&mut self, file: usize, data: &[u8], limits: &Limits) -> Result<(), ServiceError> {
        let files = self.sizes.len();
        let (Some(&size), Some(content)) = (self.sizes.get(file), self.contents.get_mut(file)) else {
            return Err(ServiceError::invalid("chunk.file", format!("{file} is outside 0..{files}")));
        };
        if data.len() > limits.chunk_bytes {
            return Err(ServiceError::invalid(
                "chunk.data",
                format!("{} bytes are more than the limit of {}", data.len(), limits.chunk_bytes),
            ));
        }
        if (content.len() + data.len()) as u64 > size {
            return Err(ServiceError::invalid(
                "chunk.data",
                format!("file {file} has more bytes than the {size} that the header announces"),
            ));
        }
        content.extend_from_slice(data);
        self.received += data.len() as u64;
        Ok(())
    }

    /// Share of the bytes that have been received, 0 to 1.
    pub fn fraction(&self) -> f64 {
        self.received as f64 / self.sizes.iter().sum::<u64>() as f64
    }

    /// Ends the upload.
    ///
    /// # Errors
    /// `InvalidArgument` naming the first incomplete file.
    pub fn finish(self) -> Result<Uploaded, ServiceError> {
        for (file, (content, size)) in self.contents.iter().zip(&self.sizes).enumerate() {
            if content.len() as u64 != *size {
                let field = match self.header.source {
                    UploadSource::Files(_) => format!("header.files[{file}].size"),
                    UploadSource::Archive { .. } => "header.archive.size".to_owned(),
                };
                let received = content.len();
                return Err(ServiceError::invalid(
                    field,
                    format!("{size} bytes were announced, {received} came"),
                ));
            }
        }
        Ok(Uploaded { header: self.header, contents: self.contents, memory: None })
    }
}

fn check_files(files: &[FileEntry], limits: &Limits) -> Result<(), ServiceError> {
    if files.is_empty() || files.len() > limits.upload_files {
        return Err(ServiceError::invalid(
            "header.files",
            format!("{} files are outside 1..={}", files.len(), limits.upload_files),
        ));
    }
    let mut paths = HashSet::with_capacity(files.len());
    for (index, FileEntry { path, .. }) in files.iter().enumerate() {
        let field = || format!("header.files[{index}].path");
        let inside = path.split('/').all(|part| !matches!(part, "" | "." | ".."));
        if !inside || path.len() > limits.path_bytes || path.contains(['\\', '\0']) {
            return Err(ServiceError::invalid(
                field(),
                format!("`{}` is not a relative path with `/` between its parts", shorten(path)),
            ));
        }
        if !paths.insert(path.as_str()) {
            return Err(ServiceError::invalid(field(), format!("`{path}` occurs twice")));
        }
    }
    Ok(())
}

/// Rejects a list of tenants that is too long. `prefix`: of the field.
///
/// # Errors
/// `InvalidArgument` naming the field.
pub fn check_visibility(
    prefix: &str,
    visibility: Option<&Visibility>,
    limits: &Limits,
) -> Result<(), ServiceError> {
    let Some(Visibility::Tenants(tenants)) = visibility else { return Ok(()) };
    let (count, limit) = (tenants.len(), limits.shared_with);
    if count <= limit {
        return Ok(());
    }
    let text =
        format!("{count} tenants are more than the limit of {limit}; share it with all, or with fewer");
    Err(ServiceError::invalid(format!("{prefix}shared_with"), text))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(files: &[(&str, u64)]) -> UploadHeader {
        let files = files.iter().map(|&(path, size)| FileEntry { path: path.to_owned(), size }).collect();
        let source = UploadSource::Files(files);
        UploadHeader { request_id: String::new(), setup_file: None, visibility: None, source }
    }

    fn field(result: Result<impl std::fmt::Debug, ServiceError>) -> String {
        result.unwrap_err().violations[0].field.clone()
    }

    #[test]
    fn files_are_put_together_from_chunks() {
        let limits = Limits::default();
        let mut upload = Upload::begin(header(&[("a", 3), ("b/c", 2), ("empty", 0)]), &limits).unwrap();
        upload.append(0, b"12", &limits).unwrap();
        assert_eq!(upload.fraction(), 0.4);
        upload.append(0, b"3", &limits).unwrap();
        upload.append(1, b"45", &limits).unwrap();
        assert_eq!(upload.finish().unwrap().contents, [b"123".to_vec(), b"45".to_vec(), Vec::new()]);
    }

    #[test]
    fn headers_out_of_limits_are_refused_by_field() {
        let limits = Limits { upload_files: 2, upload_bytes: 10, ..Limits::default() };
        let begin = |files: &[(&str, u64)]| field(Upload::begin(header(files), &limits));
        assert_eq!(begin(&[]), "header.files");
        assert_eq!(begin(&[("a", 1), ("b", 1), ("c", 1)]), "header.files");
        assert_eq!(begin(&[("a", 0)]), "header");
        assert_eq!(begin(&[("a", u64::MAX), ("b", u64::MAX)]), "header");
        assert_eq!(begin(&[("a", 1), ("a", 1)]), "header.files[1].path");
        for path in ["", "/etc/passwd", "../a", "a/../../b", "a//b", "./a", "a\\b", "a\0"] {
            assert_eq!(begin(&[(path, 1)]), "header.files[0].path", "{path:?}");
        }
    }

    #[test]
    fn chunks_that_do_not_fit_are_refused() {
        let limits = Limits { chunk_bytes: 4, ..Limits::default() };
        let mut upload = Upload::begin(header(&[("a", 6)]), &limits).unwrap();
        assert_eq!(field(upload.append(1, b"1", &limits)), "chunk.file");
        assert_eq!(field(upload.append(0, b"12345", &limits)), "chunk.data");
        upload.append(0, b"1234", &limits).unwrap();
        assert_eq!(field(upload.append(0, b"567", &limits)), "chunk.data");
        let error = upload.finish().unwrap_err();
        assert_eq!(error.violations[0].field, "header.files[0].size");
        assert_eq!(error.message, "header.files[0].size: 6 bytes were announced, 4 came");
    }
}
