//! Meshes that cannot be right are refused as what they are, with the place and the way out that helps.

// Helpers of tests fail by panicking, like the tests themselves.
#![allow(clippy::unwrap_used)]

use moldline_deform::{Misfit, NoMonitor, Setup, SetupError};
use moldline_mesh::{Cell, SurfaceMesh};
use moldline_setup_files::{Files, Limits, SetupContent, SetupFileError, read_setup};
use moldline_testing::sphere;
use serde_json::{Value, json};

/// A set-up of a mesh and primitives.
fn document(mesh: &SurfaceMesh, primitives: &[Value]) -> Value {
    let cells: Vec<&[u32]> = mesh.cells.iter().map(Cell::vertices).collect();
    let component = |(index, primitive)| json!({ "name": format!("c{index}"), "primitive": primitive });
    json!({
        "format": 1,
        "mesh": { "vertices": mesh.vertices, "cells": cells },
        "components": primitives.iter().enumerate().map(component).collect::<Vec<_>>(),
    })
}

fn ball(x: f64) -> Value {
    json!({ "type": "sphere", "center": [x, 0.0, 0.0], "radius": 1.0 })
}

fn read(document: &Value) -> Result<SetupContent, SetupFileError> {
    let files = Files::from([("setup.json".to_owned(), document.to_string().into_bytes())]);
    read_setup(&files, None, &Limits::default())
}

fn build(document: &Value) -> Result<Setup, SetupError> {
    Setup::build(read(document).unwrap().input, &NoMonitor)
}

fn refused(mesh: &SurfaceMesh) -> SetupError {
    build(&document(mesh, &[ball(0.0)])).err().unwrap()
}

/// Another mesh behind the first, moved by `by`.
fn joined(first: &SurfaceMesh, second: &SurfaceMesh, by: [f64; 3]) -> SurfaceMesh {
    let offset = first.vertices.len() as u32;
    let mut mesh = first.clone();
    mesh.vertices.extend(second.vertices.iter().map(|x| [0, 1, 2].map(|axis| x[axis] + by[axis])));
    mesh.cells.extend(second.cells.iter().map(|cell| cell.map(|vertex| vertex + offset)));
    mesh
}

#[test]
fn pieces_that_point_inwards_are_turned() {
    let mesh = sphere(4);
    let right = build(&document(&mesh, &[ball(0.0)])).unwrap();
    assert_eq!(right.report().turned_cells, 0);
    let mut inwards = mesh.clone();
    inwards.cells.iter_mut().for_each(|cell| *cell = cell.flipped());
    let turned = build(&document(&inwards, &[ball(0.0)])).unwrap();
    assert_eq!(turned.report().turned_cells, mesh.cells.len());
    assert_eq!((turned.report().volume > 0.0, turned.report().against_normal), (true, 0));
    assert!((turned.report().volume - right.report().volume).abs() < 1e-12);
    // One of two pieces.
    let both = build(&document(&joined(&mesh, &inwards, [3.0, 0.0, 0.0]), &[ball(0.0), ball(3.0)])).unwrap();
    assert_eq!(both.report().turned_cells, mesh.cells.len());
}

#[test]
fn neighbours_that_point_to_opposite_sides_are_named() {
    let mut mesh = sphere(4);
    mesh.cells[7] = mesh.cells[7].flipped();
    let error = refused(&mesh);
    let SetupError::MixedOrientation { count: 4, cells, .. } = error else { panic!("{error}") };
    assert!(cells.contains(&7));
}

#[test]
fn cells_and_shells_that_are_there_twice_are_named() {
    let mut mesh = sphere(4);
    mesh.cells.push(mesh.cells[5].flipped());
    let last = mesh.cells.len() as u32 - 1;
    assert!(
        matches!(refused(&mesh), SetupError::RepeatedCells { count: 1, first, .. } if first == [5, last])
    );
    let (one, n) = (sphere(4), sphere(4).cells.len());
    let twice = joined(&one, &one, [0.0, 1e-12, 0.0]);
    assert!(matches!(refused(&twice), SetupError::RepeatedCells { count, .. } if count == n));
}

#[test]
fn inner_walls_are_located() {
    let mut mesh = sphere(4);
    let [a, b] = mesh.cells[0].edges().next().unwrap();
    let far = mesh.cells.last().unwrap().vertices()[0];
    mesh.cells.push(Cell::triangle(a, b, far));
    let error = refused(&mesh);
    assert!(matches!(error, SetupError::NonManifold { count: 1, .. }), "{error}");
    assert!(error.to_string().contains("fuse the bodies"), "{error}");
    let (at, at_other) = (mesh.vertices[a as usize], mesh.vertices[b as usize]);
    let text = error.to_string();
    assert!(text.contains(&format!("{at:?}")) || text.contains(&format!("{at_other:?}")), "{text}");
}

/// A sphere whose northern half has its own vertices, `gap` apart.
fn cracked(gap: f64) -> SurfaceMesh {
    let mut mesh = sphere(4);
    let (mut copies, vertices) = (std::collections::HashMap::new(), &mut mesh.vertices);
    for cell in &mut mesh.cells {
        let north = cell.vertices().iter().all(|&v| vertices[v as usize][2] >= -1e-9);
        if north {
            *cell = cell.map(|v| {
                let [x, y, z] = vertices[v as usize];
                if z.abs() > 1e-9 {
                    return v;
                }
                *copies.entry(v).or_insert_with(|| {
                    vertices.push([x, y, z + gap]);
                    vertices.len() as u32 - 1
                })
            });
        }
    }
    mesh
}

#[test]
fn cracks_are_measured_and_healed() {
    for gap in [0.0, 1e-9, 1e-7] {
        let mesh = cracked(gap);
        let SetupError::DoubleVertices { edges, distance, tolerance, .. } = refused(&mesh) else {
            panic!("{}", refused(&mesh))
        };
        assert_eq!((edges, distance), (32, gap));
        // The advice helps.
        let mut healed = document(&mesh, &[ball(0.0)]);
        healed["mesh"]["merge_tolerance"] = json!(tolerance);
        let setup = build(&healed).unwrap();
        assert_eq!(setup.report().left_out.merged_nodes, 16);
        assert!(setup.report().watertight);
    }
    let mut coarse = document(&cracked(0.0), &[ball(0.0)]);
    coarse["mesh"]["merge_tolerance"] = json!(0.6);
    let error = read(&coarse).unwrap_err();
    assert!(error.to_string().contains("of the area"), "{error}");
}

#[test]
fn a_hole_is_still_a_hole() {
    let mut mesh = sphere(4);
    mesh.cells.pop();
    assert!(matches!(refused(&mesh), SetupError::OpenMesh { count: 4, .. }));
}

#[test]
fn a_border_beside_the_plane_of_symmetry_is_measured() {
    let mesh = sphere(4);
    let starboard = |cell: &&Cell| cell.vertices().iter().all(|&v| mesh.vertices[v as usize][1] > -1e-9);
    let cells: Vec<Cell> = mesh.cells.iter().filter(starboard).copied().collect();
    let mut number = vec![u32::MAX; mesh.vertices.len()];
    let mut vertices = Vec::new();
    for &v in cells.iter().flat_map(|cell| cell.vertices()) {
        if number[v as usize] == u32::MAX {
            number[v as usize] = vertices.len() as u32;
            vertices.push(mesh.vertices[v as usize]);
        }
    }
    let cells: Vec<Cell> = cells.iter().map(|cell| cell.map(|v| number[v as usize])).collect();
    let mut half = SurfaceMesh::new(vertices, cells, vec![], vec![]).unwrap();
    assert!(build(&document(&half, &[ball(0.0)])).is_ok());
    half.vertices.iter_mut().for_each(|x| x[1] += 1e-4);
    let error = refused(&half);
    let SetupError::BorderOffPlane { count: 16, distance, .. } = error else { panic!("{error}") };
    assert!((distance - 1e-4).abs() < 1e-12, "{distance}");
}

#[test]
fn bodies_that_pass_through_each_other_untrimmed_are_named() {
    let two = joined(&sphere(6), &sphere(6), [1.0, 0.0, 0.0]);
    let error = build(&document(&two, &[ball(0.0), ball(1.0)])).err().unwrap();
    let SetupError::Inside { component, position, worst, .. } = &error else { panic!("{error}") };
    assert_eq!(component, "c0");
    let depth = 1.0 - position.iter().map(|x| x * x).sum::<f64>().sqrt();
    assert!((worst[0].distance - depth).abs() < 1e-12 && depth > 0.5);
    assert!(error.to_string().contains("fuse them"), "{error}");
}

/// A box in quadrilaterals.
fn block(low: [f64; 3], high: [f64; 3]) -> SurfaceMesh {
    let vertices =
        (0..8).map(|k| [0, 1, 2].map(|axis| if k >> axis & 1 == 0 { low[axis] } else { high[axis] }));
    let cells = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let cells = cells.map(|[a, b, c, d]| Cell::quad(a, b, c, d)).to_vec();
    SurfaceMesh::new(vertices.collect(), cells, vec![], vec![]).unwrap()
}

#[test]
fn units_axes_mirror_images_and_origins_are_recognised() {
    let component = || json!({ "type": "box", "low": [1.0, 2.0, 3.0], "high": [4.0, 4.0, 4.0] });
    let [low, high] = [[1.0, 2.0, 3.0], [4.0, 4.0, 4.0]];
    let misfit = |mesh: &SurfaceMesh| match build(&document(mesh, &[component()])) {
        Err(SetupError::OffSurface { misfit, .. }) => misfit,
        Err(SetupError::Misfit { misfit, .. }) => Some(misfit),
        Err(error) => panic!("{error}"),
        Ok(_) => panic!("it fits"),
    };
    for (ratio, mesh_unit, component_unit) in [
        (1000.0, "mm", "m"),
        (304.8, "mm", "ft"),
        (25.4, "mm", "in"),
        (12.0, "in", "ft"),
        (1.0 / 0.3048, "ft", "m"),
        (0.001, "m", "mm"),
        (1.0 / 304.8, "ft", "mm"),
        (1.0 / 12.0, "ft", "in"),
        (0.3048, "m", "ft"),
    ] {
        let scaled = |x: [f64; 3]| x.map(|x| ratio * x);
        let found = misfit(&block(scaled(low), scaled(high)));
        let Some(Misfit::Scale { ratio: measured, units }) = found else { panic!("{ratio}: {found:?}") };
        assert!((measured / ratio - 1.0).abs() < 1e-9);
        assert_eq!(units, [mesh_unit, component_unit]);
    }
    let order = |x: [f64; 3]| [x[0], x[2], x[1]];
    assert_eq!(misfit(&block(order(low), order(high))), Some(Misfit::Axes { axes: [0, 2, 1] }));
    let mirrored = block([1.0, -4.0, 3.0], [4.0, -2.0, 4.0]);
    assert_eq!(misfit(&mirrored), Some(Misfit::Mirrored { axis: 1 }));
    let moved = misfit(&block([11.0, 2.0, 3.0], [14.0, 4.0, 4.0]));
    assert!(matches!(moved, Some(Misfit::Moved { by: [x, _, _] }) if (x - 10.0).abs() < 1e-9), "{moved:?}");
    // Another body altogether.
    assert_eq!(misfit(&block([0.0; 3], [1.0, 5.0, 2.0])), None);
    // The advice helps.
    let mut mesh = document(&block(low.map(|x| 1000.0 * x), high.map(|x| 1000.0 * x)), &[component()]);
    mesh["mesh"]["unit"] = json!("mm");
    assert!(build(&mesh).is_ok());
}

#[test]
fn errors_and_the_report_speak_of_the_files_nodes() {
    let mesh = sphere(4);
    let file = |bad: Option<usize>| {
        let n = mesh.vertices.len();
        let mut text = format!("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{}\n", n + 5);
        for k in 1..=5 {
            text += &format!("{k} 9 9 9\n");
        }
        for (k, [x, y, z]) in mesh.vertices.iter().enumerate() {
            let factor = if bad == Some(k) { 1.01 } else { 1.0 };
            text += &format!("{} {:?} {:?} {:?}\n", k + 6, factor * x, factor * y, factor * z);
        }
        text += &format!("$EndNodes\n$Elements\n{}\n", mesh.cells.len());
        for (k, cell) in mesh.cells.iter().enumerate() {
            let nodes: Vec<String> = cell.vertices().iter().map(|v| (v + 6).to_string()).collect();
            text += &format!("{} {} 2 0 1 {}\n", k + 1, cell.vertices().len() - 1, nodes.join(" "));
        }
        text + "$EndElements\n"
    };
    let input = |bad| {
        let mut setup = document(&mesh, &[ball(0.0)]);
        setup["mesh"] = json!({ "file": "m.msh" });
        let files = Files::from([
            ("setup.json".to_owned(), setup.to_string().into_bytes()),
            ("m.msh".to_owned(), file(bad).into_bytes()),
        ]);
        read_setup(&files, None, &Limits::default()).unwrap().input
    };
    let setup = Setup::build(input(None), &NoMonitor).unwrap();
    assert_eq!(setup.report().left_out.nodes, 5);
    assert!(setup.report().to_string().contains("5 nodes without cells"), "{}", setup.report());
    let input = input(Some(10));
    let origin = input.origin.clone();
    let error = Setup::build(input, &NoMonitor).err().unwrap().to_string();
    assert!(origin.explain(&error).contains("vertices[10] (node 16)"), "{}", origin.explain(&error));
}
