//! An archive of a set-up; the first byte chooses the kind. Unpacking never exceeds the limits, whatever the archive claims. The
//! files are then read as a set-up.
#![no_main]

use libfuzzer_sys::fuzz_target;
use moldline_setup_files::{ArchiveKind, Limits, read_setup, unpack};

fuzz_target!(|input: &[u8]| {
    let Some((kind, content)) = input.split_first() else { return };
    let kind = match kind % 3 {
        0 => ArchiveKind::Tar,
        1 => ArchiveKind::TarGz,
        _ => ArchiveKind::Zip,
    };
    let limits = Limits { bytes: 1 << 20, files: 16, ..Limits::default() };
    if let Ok(files) = unpack(kind, content, &limits) {
        assert!(files.len() <= 16);
        assert!(files.values().map(Vec::len).sum::<usize>() <= 1 << 20);
        let _ = read_setup(&files, None, &limits);
    }
});
