//! A mesh file; the first byte chooses the kind. A mesh that is read can be written and read again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use moldline_mesh::{
    Limits,
    io::{msh, stl, vtu},
};

fuzz_target!(|input: &[u8]| {
    let Some((kind, content)) = input.split_first() else { return };
    let limits = Limits { vertices: 10_000, cells: 10_000, ..Limits::default() };
    let read = match kind % 3 {
        0 => msh::read(content, &limits),
        1 => vtu::read(content, &limits),
        _ => stl::read(content, 1e-9, &limits),
    };
    let Ok(imported) = read else { return };
    let again = vtu::read(&vtu::write(&imported.mesh, &[], &[]), &limits).expect("what was written is read");
    assert_eq!(again.mesh.cells.len(), imported.mesh.cells.len());
});
