//! The engine on real set-ups, from their folders alone: the E175, a boom with a fairing, a half model.

// Helpers of tests fail by panicking, like the tests themselves.
#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};

use moldline_deform::{
    Constraint, DeformError, Deformation, Kernel, NoMonitor, OuterMoldLine, Propagation, Setup, SetupError,
    ownership::Freedom,
};
use moldline_geometry::{Body, Vector3};
use moldline_mesh::Group;
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

const CORNER: [(&str, f64); 3] =
    [("wing.translation", 5.0), ("wing.rotation", 10.0), ("htail.rotation", 10.0)];

#[test]
fn the_e175_is_found_by_projection() {
    let setup = build(content("examples/e175/setup-motions.toml")).unwrap();
    let report = setup.report();
    assert!(report.watertight && report.euler == 2 && report.pieces == 1);
    assert_eq!(report.against_normal, 0);
    assert_eq!(report.seams.len(), 4, "wing and tail, port and starboard");
    assert!(report.components.iter().all(|c| c.largest_distance < 1e-12));
    assert!(report.seam_residual < 1e-10 * report.length);
    let baseline = deform(&setup, &[]).unwrap();
    let moved = baseline.vertices.iter().zip(&setup.mesh().vertices);
    let moved = moved.map(|(a, b)| (Vector3::from(*a) - Vector3::from(*b)).norm()).fold(0.0, f64::max);
    assert!(moved < 1e-11, "the baseline design gives the reference mesh, {moved}");
}

#[test]
fn the_hard_corners_keep_their_quality_on_both_outer_mold_lines() {
    for outer_mold_line in [OuterMoldLine::Sharp, OuterMoldLine::Smooth] {
        let mut content = content("examples/e175/setup-motions.toml");
        content.input.options.outer_mold_line = outer_mold_line;
        let setup = build(content).unwrap();
        let length = setup.report().length;
        for (translation, rotation) in [(5.0, 10.0), (5.0, -10.0), (-5.0, 10.0), (-5.0, -10.0)] {
            let values = [
                ("wing.translation", translation),
                ("wing.rotation", rotation),
                ("htail.rotation", rotation),
            ];
            let result = deform(&setup, &values).unwrap();
            let total = &result.quality.total;
            assert!(total.aspect_ratio.p95 <= 1.9, "{values:?}: {}", total.aspect_ratio.p95);
            assert!(total.aspect_ratio.above_5_percent <= 0.02, "{values:?}");
            assert_eq!(total.folded, 0, "{values:?}");
            assert!(result.seam_residual <= 1e-10 * length);
            assert!(result.projection_residual <= 1e-10 * length);
        }
        for (translation, diameter) in [(5.0, 1.5), (5.0, 0.7), (-5.0, 1.5), (-5.0, 0.7)] {
            let values = [("wing.translation", translation), ("fuselage.diameter_ratio", diameter)];
            let total = deform(&setup, &values).unwrap().quality.total;
            assert!(total.aspect_ratio.p95 <= 1.9 && total.folded == 0, "{values:?}: {total:?}");
            assert!(total.aspect_ratio.above_5_percent <= 0.02, "{values:?}");
        }
    }
}

/// Values of every scalar of some variables.
fn all(setup: &Setup, values: &[(&str, f64)]) -> Vec<(String, f64)> {
    let names = setup.parameterisation().variables().iter().map(|v| v.name.clone());
    let of_group = |name: &str| values.iter().find(|(group, _)| name.split('[').next() == Some(*group));
    names.filter_map(|name| of_group(&name).map(|(_, value)| (name.clone(), *value))).collect()
}

#[test]
fn corners_of_table_2_where_wing_and_tail_nearly_leave_the_fuselage() {
    let setup = build(content("examples/e175/setup.toml")).unwrap();
    // The largest root chord at its largest twist and droop in the thinnest fuselage; the same forward; the tail's
    // trailing edge as low and as far aft as it goes.
    let tail = [("htail.area", 310.0), ("htail.aspect_ratio", 3.2), ("htail.rotation", 8.0)];
    let wing = [("wing.twist", 5.0), ("wing.camber", -5.0), ("wing.area", 940.0), ("wing.aspect_ratio", 6.3)];
    let aft = [&tail[..], &wing, &[("wing.translation", 16.4), ("fuselage.diameter", 7.4)]].concat();
    let fore = [&tail[..], &wing, &[("wing.translation", -16.4), ("fuselage.diameter", 7.4)]].concat();
    for values in [&tail[..], &aft, &fore] {
        let values = all(&setup, values);
        let values: Vec<(&str, f64)> = values.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        let result = deform(&setup, &values).unwrap();
        let total = &result.quality.total;
        assert_eq!((total.folded, total.inverted), (0, 0), "{values:?}");
        assert!(total.aspect_ratio.above_5_percent <= 0.02, "{values:?}");
        assert!(result.held_residual <= 1e-12 * setup.report().length, "{:e}", result.held_residual);
    }
}

#[test]
fn every_vertex_stays_on_its_components() {
    let setup = build(content("examples/e175/setup-motions.toml")).unwrap();
    let result = deform(&setup, &CORNER).unwrap();
    let worst = largest_distance(&setup, &result, &bodies(&setup, &CORNER));
    assert!(worst <= 1e-12, "{worst:e} of the length");
    for (v, x) in (0u32..).zip(&result.vertices) {
        let in_plane = setup.mesh().vertices[v as usize][1] == 0.0;
        assert!(!in_plane || x[1] == 0.0, "vertex {v} left the symmetry plane");
    }
}

#[test]
fn the_smooth_outer_mold_line_is_the_zero_set_of_the_union() {
    let mut content = content("examples/e175/setup-motions.toml");
    content.input.options.outer_mold_line = OuterMoldLine::Smooth;
    let setup = build(content).unwrap();
    let result = deform(&setup, &CORNER).unwrap();
    let bodies = bodies(&setup, &CORNER);
    let (length, rho) = (setup.report().length, setup.report().rho);
    for (v, x) in (0u32..).zip(&result.vertices) {
        let x = Vector3::from(*x);
        if setup.is_active(v) {
            // Eq. 8 as it stands, over all components and by the global search.
            let distances: Vec<f64> = bodies.iter().map(|b| b.signed_distance(&x)).collect();
            let least = distances.iter().copied().fold(f64::INFINITY, f64::min);
            let sum: f64 = distances.iter().map(|d| (-rho * (d - least)).exp()).sum();
            let value = least - sum.ln() / rho;
            assert!(value.abs() <= 1e-10 * length, "vertex {v}: Phi = {value:e}");
        } else {
            let own = &setup.ownership().of(v)[0];
            assert!(own.freedom != Freedom::Surface || setup.ownership().is_seam(v));
            let distance = bodies[own.component as usize].closest_point(&x).distance.abs();
            assert!(distance <= 1e-12 * length, "protected vertex {v}: {distance:e}");
        }
    }
}

#[test]
fn bits_do_not_depend_on_threads_or_repetition() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut content = content("examples/e175/setup-motions.toml");
            content.input.options.outer_mold_line = OuterMoldLine::Smooth;
            let setup = build(content).unwrap();
            let first = deform(&setup, &CORNER).unwrap().vertices;
            assert_eq!(first, deform(&setup, &CORNER).unwrap().vertices);
            first
        })
    };
    assert_eq!(run(1), run(2));
}

#[test]
fn other_propagations_and_kernels_end_on_the_components_too() {
    for (propagation, kernel) in [
        (Propagation::Absolute, Kernel::Cubic),
        (Propagation::Departure, Kernel::Cubic),
        (Propagation::Departure, Kernel::Multiquadric),
        (Propagation::Surface, Kernel::Cubic),
    ] {
        let mut content = content("examples/e175/setup-motions.toml");
        content.input.options.propagation = propagation;
        content.input.options.kernel = Some(kernel);
        let setup = build(content).unwrap();
        let values = [("wing.translation", 1.0), ("wing.rotation", -2.0)];
        let result = deform(&setup, &values).unwrap();
        let worst = largest_distance(&setup, &result, &bodies(&setup, &values));
        assert!(worst <= 1e-11, "{propagation:?} {kernel:?}: {worst:e} of the length");
        assert_eq!(result.quality.total.folded, 0, "{propagation:?} {kernel:?}");
    }
}

#[test]
fn smoothing_keeps_vertices_on_their_components() {
    let mut content = content("examples/e175/setup-motions.toml");
    content.input.options.smoothing.rounds = 3;
    let setup = build(content).unwrap();
    let values = [("wing.translation", 2.0)];
    let result = deform(&setup, &values).unwrap();
    let worst = largest_distance(&setup, &result, &bodies(&setup, &values));
    assert!(worst <= 1e-11 && result.quality.total.folded == 0, "{worst:e}");
}

#[test]
fn a_boom_with_a_fairing_moves_along_the_wing() {
    let setup = build(content("tests/configurations/boom")).unwrap();
    let report = setup.report();
    assert!(report.triangles == 5436 && report.quadrilaterals == 0);
    assert!(report.seams.iter().any(|s| s.components.len() == 3 && s.vertices == 2), "two triple points");
    for values in [[("boom.translation", -0.3)], [("fairing.translation", 0.02)]] {
        let result = deform(&setup, &values).unwrap();
        let worst = largest_distance(&setup, &result, &bodies(&setup, &values));
        assert!(worst <= 1e-12, "{values:?}: {worst:e} of the length");
        assert_eq!(result.quality.total.folded, 0, "{values:?}");
    }
}

#[test]
fn a_half_model_keeps_its_border_in_the_plane() {
    let setup = build(content("tests/configurations/half")).unwrap();
    assert!(setup.report().watertight, "the border lies in the symmetry plane");
    let values = [("wing.translation", -1.0), ("wing.rotation", 5.0)];
    let result = deform(&setup, &values).unwrap();
    let worst = largest_distance(&setup, &result, &bodies(&setup, &values));
    assert!(worst <= 1e-12 && result.quality.total.folded == 0, "{worst:e}");
    for (before, after) in setup.mesh().vertices.iter().zip(&result.vertices) {
        assert!(before[1].abs() > 1e-9 || after[1] == 0.0);
    }
}

#[test]
fn a_mesh_off_its_components_is_refused_by_vertex() {
    let mut content = content("tests/configurations/boom");
    content.input.mesh.vertices[77][2] += 0.01;
    let Err(SetupError::OffSurface { count, worst, .. }) = build(content) else { panic!("accepted") };
    assert_eq!((count, worst[0].vertex), (1, 77));
    assert!(worst[0].distance > 1e-3 && worst[0].distance <= 0.0101);
}

#[test]
fn a_mesh_with_a_hole_is_refused_unless_the_options_accept_it() {
    let mut open = content("tests/configurations/boom");
    open.input.mesh.cells.remove(1000);
    assert!(matches!(build(open.clone()), Err(SetupError::OpenMesh { count: 3, .. })));
    open.input.options.open_mesh = true;
    assert!(!build(open).unwrap().report().watertight);
}

#[test]
fn options_out_of_range_are_named() {
    let mut content = content("tests/configurations/boom");
    content.input.options.blend_radius = 2.0;
    let error = build(content).unwrap_err();
    assert_eq!(error.to_string(), "options.blend_radius = 2 is outside 0.001..=1");
}

#[test]
fn a_seam_without_a_root_is_an_error_with_vertices() {
    let setup = build(content("tests/configurations/boom")).unwrap();
    let mut points = setup.parameterisation().control_points(&setup.parameterisation().baseline()).unwrap();
    // The boom, lifted off the wing.
    points[1].iter_mut().for_each(|p| p[2] += 3.0);
    let error = setup.deform_control_points(&points, &NoMonitor).unwrap_err();
    let DeformError::SeamLost { count, worst, .. } = &error else { panic!("{error}") };
    assert!(*count > 0 && worst[0].distance > 1.0, "{error}");
    deform(&setup, &[]).unwrap();
}

#[test]
fn control_points_that_do_not_fit_are_refused() {
    let setup = build(content("tests/configurations/boom")).unwrap();
    let good = setup.parameterisation().control_points(&setup.parameterisation().baseline()).unwrap();
    let mut short = good.clone();
    short[2].pop();
    assert!(matches!(setup.deform_control_points(&short, &NoMonitor), Err(DeformError::ControlPoints(_))));
    let mut nan = good;
    nan[0][5][1] = f64::NAN;
    let error = setup.deform_control_points(&nan, &NoMonitor).unwrap_err().to_string();
    assert!(error.contains("control_points[0][5][1] = NaN"), "{error}");
}

/// A group of the vertices that `contains` names, by their index and position.
fn group(content: &mut SetupContent, name: &str, contains: impl Fn(usize, &[f64; 3]) -> bool) -> Vec<u32> {
    let vertices = content.input.mesh.vertices.iter().enumerate();
    let indices: Vec<u32> = vertices.filter(|&(i, x)| contains(i, x)).map(|(i, _)| i as u32).collect();
    content.input.mesh.vertex_groups.push(Group { name: name.into(), indices: indices.clone() });
    indices
}

#[test]
fn stationary_vertices_that_their_component_leaves_are_named() {
    let mut content = content("examples/e175/setup-motions.toml");
    let tips = group(&mut content, "tips", |_, x| x[1].abs() > 11.9);
    content.input.options.stationary_groups = vec!["tips".into()];
    let setup = build(content).unwrap();
    // The fuselage may change under wings that stay.
    let result = deform(&setup, &[("fuselage.diameter_ratio", 1.2)]).unwrap();
    for &v in &tips {
        let [after, before] =
            [&result.vertices, &setup.mesh().vertices].map(|x| Vector3::from(x[v as usize]));
        assert!((after - before).norm() < 1e-11);
    }
    let error = deform(&setup, &[("wing.rotation", 1.0)]).unwrap_err();
    let DeformError::Held { constraint, count, worst, .. } = &error else { panic!("{error}") };
    // The flat caps slide in their own plane: vertices inside them remain on the wing.
    assert!(
        *constraint == Constraint::Stationary && *count > tips.len() / 2 && *count < tips.len(),
        "{error}"
    );
    assert!(tips.contains(&worst[0].vertex) && worst[0].distance > 1e-3, "{error}");
}

#[test]
fn a_protected_vertex_on_a_seam_is_named() {
    let mut content = content("examples/e175/setup-motions.toml");
    let seam = build(content.clone()).unwrap().seam_vertices().nth(5).unwrap();
    group(&mut content, "pin", |i, _| i == seam as usize);
    content.input.options.protected_groups = vec!["pin".into()];
    let error = build(content).unwrap_err();
    let SetupError::HeldSeam { vertex, .. } = &error else { panic!("{error}") };
    assert_eq!(*vertex, seam);
}

/// Two unit balls, 3 m apart, of which the first can be moved along x.
fn balls(on_event: &str) -> Setup {
    let ball = moldline_testing::sphere(6);
    let count = ball.vertices.len() as u32;
    let shifted = ball.vertices.iter().map(|x| [x[0] + 3.0, x[1], x[2]]);
    let vertices: Vec<[f64; 3]> = ball.vertices.iter().copied().chain(shifted).collect();
    let own = ball.cells.iter().map(|cell| cell.vertices().to_vec());
    let others = ball.cells.iter().map(|cell| cell.vertices().iter().map(|v| v + count).collect());
    let cells: Vec<Vec<u32>> = own.chain(others).collect();
    let document = format!(
        r#"{{
            "format": 1,
            "mesh": {{ "vertices": {vertices:?}, "cells": {cells:?} }},
            "components": [
                {{ "name": "one", "primitive": {{ "type": "sphere", "center": [0, 0, 0], "radius": 1 }} }},
                {{ "name": "two", "primitive": {{ "type": "sphere", "center": [3, 0, 0], "radius": 1 }} }}
            ],
            "parameterisation": {{
                "variables": [{{ "name": "x", "unit": "m", "lower": -1, "upper": 4 }}],
                "operations": [
                    {{ "type": "translation", "components": ["one"], "direction": [1, 0, 0], "variable": "x" }}
                ]
            }},
            "options": {{ "on_event": "{on_event}" }}
        }}"#
    );
    let folder = std::env::temp_dir().join(format!("moldline-balls-{on_event}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("setup.json"), document).unwrap();
    let (files, setup_file) = read_folder(&folder, &Limits::default()).unwrap();
    std::fs::remove_dir_all(&folder).unwrap();
    build(read_setup(&files, Some(&setup_file), &Limits::default()).unwrap()).unwrap()
}

/// A body is moved into another, and until both coincide.
#[test]
fn collisions_are_refused_reported_or_ignored() {
    let [refusing, reporting, ignoring] = ["refuse", "report", "ignore"].map(balls);
    for (x, meets) in [(-1.0, false), (0.9, false), (1.1, true), (2.0, true), (3.0, true)] {
        match deform(&refusing, &[("x", x)]) {
            Ok(_) => assert!(!meets, "{x}"),
            Err(DeformError::Collision { components, vertices, position, count, .. }) => {
                assert!(meets && count > 0 && vertices.len() >= 6, "{x}");
                assert_eq!(components, ["one", "two"]);
                assert!((1.0..=4.0).contains(&position[0]), "{position:?}");
            }
            Err(other) => panic!("{x}: {other}"),
        }
        let crossings = |setup: &Setup| deform(setup, &[("x", x)]).unwrap().crossings.len();
        assert_eq!(crossings(&reporting) > 0, meets, "{x}");
        assert_eq!(crossings(&ignoring), 0);
    }
}
