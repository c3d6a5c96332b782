//! Folders and archives: the same files from either, and hostile archives rejected.

mod common;

use std::io::{Cursor, Write};

use common::{document, files};
use flate2::{Compression, write::GzEncoder};
use moldline_setup_files::{ArchiveKind, Files, Limits, SetupFileError, read_folder, read_setup, unpack};
use zip::write::SimpleFileOptions;

fn tar_of(entries: &[(&str, &[u8])]) -> Vec<u8> {
    let mut builder = tar::Builder::new(Vec::new());
    for (path, bytes) in entries {
        let mut header = tar::Header::new_ustar();
        // Written by hand, since the builder itself rejects bad paths.
        header.as_old_mut().name[..path.len()].copy_from_slice(path.as_bytes());
        header.set_size(bytes.len() as u64);
        header.set_mode(0o644);
        header.set_cksum();
        builder.append(&header, *bytes).expect("in memory");
    }
    builder.into_inner().expect("in memory")
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).expect("in memory");
    encoder.finish().expect("in memory")
}

fn zip_of(entries: &[(&str, &[u8])]) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (path, bytes) in entries {
        writer.start_file(*path, SimpleFileOptions::default()).expect("in memory");
        writer.write_all(bytes).expect("in memory");
    }
    writer.finish().expect("in memory").into_inner()
}

fn refused(kind: ArchiveKind, bytes: &[u8], limits: &Limits) -> String {
    unpack(kind, bytes, limits).expect_err("must be refused").to_string()
}

fn entries(files: &Files) -> Vec<(&str, &[u8])> {
    files.iter().map(|(path, bytes)| (path.as_str(), bytes.as_slice())).collect()
}

#[test]
fn all_kinds_give_the_same_files() {
    let mut expected = files(&document());
    expected.insert("geometry/wing.json".into(), b"{}".to_vec());
    let entries = entries(&expected);
    let limits = Limits::default();
    let tar = tar_of(&entries);
    assert_eq!(unpack(ArchiveKind::Tar, &tar, &limits).expect("is valid"), expected);
    assert_eq!(unpack(ArchiveKind::TarGz, &gzip(&tar), &limits).expect("is valid"), expected);
    assert_eq!(unpack(ArchiveKind::Zip, &zip_of(&entries), &limits).expect("is valid"), expected);
    // Packed as one folder.
    let inside: Vec<(String, &[u8])> = entries.iter().map(|(p, b)| (format!("./e175/{p}"), *b)).collect();
    let inside: Vec<(&str, &[u8])> = inside.iter().map(|(p, b)| (p.as_str(), *b)).collect();
    assert_eq!(unpack(ArchiveKind::Tar, &tar_of(&inside), &limits).expect("is valid"), expected);
    assert!(read_setup(&expected, None, &limits).is_ok());
}

#[test]
fn kinds_by_name() {
    let kinds = ["a.tar", "a.tar.gz", "a.TGZ", "a.zip", "a.toml"].map(ArchiveKind::of_name);
    use ArchiveKind::{Tar, TarGz, Zip};
    assert_eq!(kinds, [Some(Tar), Some(TarGz), Some(TarGz), Some(Zip), None]);
}

#[test]
fn paths_that_leave_the_folder() {
    let limits = Limits::default();
    for path in ["../evil", "/etc/passwd", "a/../../evil", "a\\..\\evil", "C:evil"] {
        let tar = refused(ArchiveKind::Tar, &tar_of(&[(path, b"x")]), &limits);
        assert!(tar.starts_with("archive: path '"), "{tar}");
        let zip = refused(ArchiveKind::Zip, &zip_of(&[(path, b"x")]), &limits);
        assert!(zip.starts_with("archive: path '"), "{zip}");
    }
}

#[test]
fn links_and_devices() {
    for kind in [tar::EntryType::Symlink, tar::EntryType::Link, tar::EntryType::Fifo] {
        let mut builder = tar::Builder::new(Vec::new());
        let mut header = tar::Header::new_gnu();
        header.set_path("setup.toml").expect("short");
        header.set_entry_type(kind);
        header.set_size(0);
        header.set_cksum();
        builder.append(&header, std::io::empty()).expect("in memory");
        let bytes = builder.into_inner().expect("in memory");
        let text = refused(ArchiveKind::Tar, &bytes, &Limits::default());
        assert!(text.starts_with("archive: path 'setup.toml' is a link or a device"), "{text}");
    }
    let mut writer = zip::ZipWriter::new(Cursor::new(Vec::new()));
    writer.add_symlink("setup.toml", "/etc/passwd", SimpleFileOptions::default()).expect("in memory");
    let bytes = writer.finish().expect("in memory").into_inner();
    let text = refused(ArchiveKind::Zip, &bytes, &Limits::default());
    assert!(text.starts_with("archive: path 'setup.toml' is a link or a device"), "{text}");
}

#[test]
fn more_than_the_limits() {
    let limits = Limits { bytes: 100_000, files: 3, ..Limits::default() };
    // Compresses to almost nothing.
    let zeros = vec![0; 10_000_000];
    for (kind, bytes) in [
        (ArchiveKind::Tar, tar_of(&[("zeros", &zeros)])),
        (ArchiveKind::TarGz, gzip(&tar_of(&[("zeros", &zeros)]))),
        (ArchiveKind::Zip, zip_of(&[("zeros", &zeros)])),
    ] {
        let text = refused(kind, &bytes, &limits);
        assert!(
            text.contains("bytes exceed the limit of 100000") || text.contains("cannot be read"),
            "{kind:?} {text}"
        );
    }
    let many: Vec<(String, &[u8])> = (0..5).map(|i| (format!("f{i}"), b"".as_slice())).collect();
    let many: Vec<(&str, &[u8])> = many.iter().map(|(p, b)| (p.as_str(), *b)).collect();
    for (kind, bytes) in [(ArchiveKind::Tar, tar_of(&many)), (ArchiveKind::Zip, zip_of(&many))] {
        assert_eq!(refused(kind, &bytes, &limits), "archive: 4 files exceed the limit of 3");
    }
    // A header that states more than the archive holds allocates nothing.
    let mut header = tar::Header::new_gnu();
    header.set_path("huge").expect("short");
    header.set_size(1 << 60);
    header.set_cksum();
    let text = refused(ArchiveKind::Tar, header.as_bytes(), &Limits::default());
    assert!(text.starts_with("the archive cannot be read") || text.contains("exceed"), "{text}");
}

#[test]
fn damaged_and_ambiguous_archives() {
    let limits = Limits::default();
    let good = gzip(&tar_of(&entries(&files(&document()))));
    let text = refused(ArchiveKind::TarGz, &good[..good.len() / 2], &limits);
    assert!(text.starts_with("the archive cannot be read"), "{text}");
    assert!(refused(ArchiveKind::Zip, b"PK", &limits).starts_with("the archive cannot be read"));
    assert!(
        refused(ArchiveKind::TarGz, b"no gzip at all", &limits).starts_with("the archive cannot be read")
    );
    assert!(refused(ArchiveKind::Tar, &[7; 1024], &limits).starts_with("the archive cannot be read"));
    let twice = tar_of(&[("a/b", b"1"), ("./a/b", b"2")]);
    assert_eq!(refused(ArchiveKind::Tar, &twice, &limits), "archive: 'a/b' occurs twice");
}

#[test]
fn folders_on_disk() {
    let folder = tempfile::tempdir().expect("a place for files");
    let limits = Limits::default();
    let error = read_folder(folder.path(), &limits).expect_err("is empty");
    assert!(matches!(error, SetupFileError::SetupFile { .. }), "{error}");
    let mut document = document();
    document["components"][1] = serde_json::json!({ "name": "box", "file": "geometry/box.json" });
    std::fs::write(folder.path().join("setup.json"), document.to_string()).expect("can write");
    std::fs::write(folder.path().join("unrelated"), "x").expect("can write");
    let error = read_folder(folder.path(), &limits).expect_err("the geometry is missing");
    assert!(
        matches!(&error, SetupFileError::Io { path, .. } if path.ends_with("geometry/box.json")),
        "{error}"
    );
    std::fs::create_dir(folder.path().join("geometry")).expect("can write");
    let geometry = serde_json::json!({ "patches": common::cube() }).to_string();
    std::fs::write(folder.path().join("geometry/box.json"), geometry).expect("can write");
    let (found, setup_file) = read_folder(folder.path(), &limits).expect("is complete");
    assert_eq!(setup_file, "setup.json");
    assert_eq!(found.keys().collect::<Vec<_>>(), ["geometry/box.json", "setup.json"]);
    assert!(read_setup(&found, Some(&setup_file), &limits).is_ok());
    // A set-up file by its own name, and an archive.
    std::fs::rename(folder.path().join("setup.json"), folder.path().join("other.json")).expect("can write");
    let (again, name) = read_folder(&folder.path().join("other.json"), &limits).expect("is complete");
    assert_eq!((again.len(), name.as_str()), (2, "other.json"));
    let archive = folder.path().join("box.tar.gz");
    std::fs::write(&archive, gzip(&tar_of(&entries(&found)))).expect("can write");
    assert_eq!(read_folder(&archive, &limits).expect("is complete"), (found, "setup.json".to_owned()));
    let tight = Limits { bytes: 500, ..limits };
    let error = read_folder(&folder.path().join("other.json"), &tight).expect_err("too large");
    assert!(matches!(error, SetupFileError::TooMany { what: "bytes", .. }), "{error}");
}

#[test]
fn entries_are_counted_before_the_directory_is_read() {
    let limits = Limits { files: 10, ..Limits::default() };
    let names: Vec<String> = (0..81).map(|i| i.to_string()).collect();
    let zip = zip_of(&names.iter().map(|name| (name.as_str(), &b""[..])).collect::<Vec<_>>());
    // Cut off behind its entries, it has no directory that could be read.
    let end = zip.len() - 22;
    assert!(refused(ArchiveKind::Zip, &zip[..end], &limits).contains("81 entries exceed the limit of 10"));
}
