//! A set-up file, TOML or JSON by the first byte: it is read or rejected.
#![no_main]

use libfuzzer_sys::fuzz_target;
use moldline_setup_files::{Files, Limits, read_setup};

fuzz_target!(|input: &[u8]| {
    let Some((kind, content)) = input.split_first() else { return };
    let name = if kind % 2 == 0 { "setup.toml" } else { "setup.json" };
    let files = Files::from([(name.to_owned(), content.to_vec())]);
    let _ = read_setup(&files, None, &Limits::default());
});
