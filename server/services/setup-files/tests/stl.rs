//! A set-up whose mesh is an STL file.

// Helpers of tests fail by panicking, like the tests themselves.
#![allow(clippy::unwrap_used)]

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use moldline_deform::{DeformError, Deformation, NoMonitor, Setup, SetupError};
use moldline_geometry::{Body, Vector3};
use moldline_setup_files::{Limits, SetupContent, read_folder, read_setup};

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..")
}

fn content(folder: &str) -> SetupContent {
    let (files, setup_file) = read_folder(&repository().join(folder), &Limits::default()).unwrap();
    read_setup(&files, Some(&setup_file), &Limits::default()).unwrap()
}

fn build(content: SetupContent) -> Result<Setup, SetupError> {
    Setup::build(content.input, &NoMonitor)
}

fn deform(setup: &Setup, values: &[(&str, f64)]) -> Result<Deformation, DeformError> {
    setup.deform(setup.parameterisation().design(values.iter().copied()).unwrap(), &NoMonitor)
}

fn bodies(setup: &Setup, values: &[(&str, f64)]) -> Vec<Body> {
    let design = setup.parameterisation().design(values.iter().copied()).unwrap();
    setup.bodies(&setup.parameterisation().control_points(&design).unwrap()).unwrap()
}

/// Largest distance of any vertex from one of its components, by the global search, relative to the reference length.
fn largest_distance(setup: &Setup, deformation: &Deformation, bodies: &[Body]) -> f64 {
    let vertices = 0..deformation.vertices.len() as u32;
    let worst = vertices.map(|v| {
        let x = Vector3::from(deformation.vertices[v as usize]);
        let owners = setup.ownership().of(v).iter();
        owners.map(|a| bodies[a.component as usize].closest_point(&x).distance.abs()).fold(0.0, f64::max)
    });
    worst.fold(0.0, f64::max) / setup.report().length
}

#[test]
fn a_set_up_folder_may_hold_its_mesh_as_stl() {
    let original = content("tests/configurations/boom");
    let mesh = &original.input.mesh;
    // ASCII with 17 digits, each triangle with its own corners, as triangulation programs write it.
    let mut stl = String::from("solid boom\n");
    for cell in &mesh.cells {
        stl += "facet normal 0 0 0\nouter loop\n";
        for &v in cell.vertices() {
            let [x, y, z] = mesh.vertices[v as usize];
            writeln!(stl, "vertex {x:e} {y:e} {z:e}").unwrap();
        }
        stl += "endloop\nendfacet\n";
    }
    stl += "endsolid boom\n";
    let source = repository().join("tests/configurations/boom");
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("geometry")).unwrap();
    for name in ["wing", "boom", "fairing"] {
        let file = format!("geometry/{name}.json");
        std::fs::copy(source.join(&file), folder.path().join(&file)).unwrap();
    }
    std::fs::write(folder.path().join("mesh.stl"), stl).unwrap();
    let text = std::fs::read_to_string(source.join("setup.toml")).unwrap();
    assert!(text.contains("mesh.vtu"), "the folder itself holds a VTU file of triangles");
    std::fs::write(folder.path().join("setup.toml"), text.replace("mesh.vtu", "mesh.stl")).unwrap();

    let (files, setup_file) = read_folder(folder.path(), &Limits::default()).unwrap();
    let read = read_setup(&files, Some(&setup_file), &Limits::default()).unwrap();
    let (from_stl, from_vtu) = (build(read).unwrap(), build(original).unwrap());
    let counts = |s: &Setup| (s.mesh().vertices.len(), s.report().triangles, s.report().euler);
    assert_eq!(counts(&from_stl), counts(&from_vtu));
    // The same mesh with its vertices in another order, so the same quality.
    let values = [("boom.translation", -0.2)];
    let [a, b] = [&from_stl, &from_vtu].map(|setup| deform(setup, &values).unwrap());
    assert_eq!(a.quality.total.folded, 0);
    let worst = largest_distance(&from_stl, &a, &bodies(&from_stl, &values));
    assert!(worst <= 1e-12, "{worst:e} of the length");
    let [p, q] = [a, b].map(|result| result.quality.total.aspect_ratio.p95);
    assert!((p - q).abs() < 0.05, "{p} {q}");
}
