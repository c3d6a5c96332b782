//! The example aircraft: its variables, and what they do to its control points.

use std::path::Path;

use moldline_parameterisation::{ControlPoints, Parameterisation};
use moldline_setup_files::{Limits, SetupContent, read_folder, read_setup};
use moldline_testing::Random;

fn example(file: &str) -> SetupContent {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../examples/e175").join(file);
    let (files, setup_file) = read_folder(&path, &Limits::default()).expect("the example can be read");
    read_setup(&files, Some(&setup_file), &Limits::default()).expect("the example is valid")
}

fn at(p: &Parameterisation, values: &[(&str, f64)]) -> ControlPoints {
    let design = p.design(values.iter().copied()).expect("known names");
    p.control_points(&design).expect("acceptable")
}

#[test]
fn table_2() {
    let content = example("setup.toml");
    let p = &content.input.parameterisation;
    assert_eq!(p.variables().len(), 45);
    let groups: Vec<(&str, usize)> = p.groups().iter().map(|g| (g.name.as_str(), g.range.len())).collect();
    let expected = [
        ("wing.twist", 8),
        ("wing.camber", 30),
        ("wing.area", 1),
        ("wing.aspect_ratio", 1),
        ("htail.area", 1),
        ("htail.aspect_ratio", 1),
        ("wing.translation", 1),
        ("htail.rotation", 1),
        ("fuselage.diameter", 1),
    ];
    assert_eq!(groups, expected);
    let baseline = p.baseline();
    assert!(p.validate(&baseline).is_ok());
    let value = |name: &str| baseline[p.index(name).expect("exists")];
    // Published: S_W 68.2 m^2, 8.33; S_T 23.25 m^2, 4.30.
    let square_metres = 0.3048 * 0.3048;
    assert!(
        (value("wing.area") * square_metres - 68.2).abs() < 0.5,
        "{}",
        value("wing.area") * square_metres
    );
    assert!((value("wing.aspect_ratio") - 8.33).abs() < 0.05, "{}", value("wing.aspect_ratio"));
    assert!((value("htail.area") * square_metres - 23.25).abs() < 0.1);
    assert!((value("htail.aspect_ratio") - 4.30).abs() < 0.02);
}

#[test]
fn the_baseline_is_the_geometry_bit_by_bit() {
    for file in ["setup.toml", "setup-motions.toml"] {
        let content = example(file);
        let p = &content.input.parameterisation;
        let points = p.control_points(&p.baseline()).expect("acceptable");
        for (component, points) in ["fuselage", "wing", "htail"].into_iter().zip(points) {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../examples/e175/geometry");
            let text = std::fs::read_to_string(path.join(format!("{component}.json"))).expect("is there");
            let document: serde_json::Value = serde_json::from_str(&text).expect("is JSON");
            let reference: Vec<u64> = document["patches"]
                .as_array()
                .expect("is a list")
                .iter()
                .flat_map(|patch| patch["control_points"].as_array().expect("is a list"))
                .flat_map(|row| row.as_array().expect("is a list"))
                .flat_map(|point| point.as_array().expect("is a list"))
                .map(|x| x.as_f64().expect("is a number").to_bits())
                .collect();
            let found: Vec<u64> = points.iter().flatten().map(|x| x.to_bits()).collect();
            assert_eq!(found, reference, "{file} {component}");
        }
    }
}

/// Pairs of control points that coincide in the reference.
fn coincident(points: &[[f64; 3]]) -> Vec<(usize, usize)> {
    let mut pairs = Vec::new();
    for i in 0..points.len() {
        for j in 0..i {
            if (0..3).all(|a| (points[i][a] - points[j][a]).abs() < 1e-12) {
                pairs.push((j, i));
            }
        }
    }
    pairs
}

#[test]
fn what_coincides_stays_coincident_in_every_corner_of_the_box() {
    let content = example("setup.toml");
    let p = &content.input.parameterisation;
    let reference = p.control_points(&p.baseline()).expect("acceptable");
    let pairs: Vec<Vec<(usize, usize)>> = reference.iter().map(|points| coincident(points)).collect();
    assert!(pairs.iter().all(|pairs| pairs.len() > 20), "edges and poles are shared");
    let mut random = Random::new(1);
    for _ in 0..50 {
        let design: Vec<f64> =
            p.variables().iter().map(|v| if random.coin() { v.lower } else { v.upper }).collect();
        let points = p.control_points(&design).expect("acceptable");
        for (points, pairs) in points.iter().zip(&pairs) {
            for &(i, j) in pairs {
                let gap = (0..3).map(|a| (points[i][a] - points[j][a]).abs()).fold(0.0, f64::max);
                assert!(gap < 1e-12, "{gap} between {i} and {j}");
            }
        }
    }
}

#[test]
fn motions_of_figs_6_and_7() {
    let content = example("setup-motions.toml");
    let p = &content.input.parameterisation;
    let names: Vec<&str> = p.variables().iter().map(|v| v.name.as_str()).collect();
    assert_eq!(names, ["wing.translation", "wing.rotation", "htail.rotation", "fuselage.diameter_ratio"]);
    let reference = at(p, &[]);

    let [fuselage, wing, htail] = &at(p, &[("wing.translation", 5.0), ("wing.rotation", 10.0)])[..] else {
        panic!("three components")
    };
    assert_eq!((fuselage, htail), (&reference[0], &reference[2]));
    let (sin, cos) = 10.0_f64.to_radians().sin_cos();
    for (moved, [x, y, z]) in wing.iter().zip(&reference[1]) {
        // Nose up about the root quarter chord, then aft.
        let (dx, dz) = (x - 12.81775, z - 0.25);
        let expected = [12.81775 + cos * dx + sin * dz + 5.0, *y, 0.25 + cos * dz - sin * dx];
        assert!((0..3).all(|a| (moved[a] - expected[a]).abs() < 1e-13), "{moved:?} {expected:?}");
    }

    let [fuselage, wing, htail] = &at(p, &[("fuselage.diameter_ratio", 1.5)])[..] else {
        panic!("three components")
    };
    assert_eq!((wing, htail), (&reference[1], &reference[2]));
    let half_width = |points: &[[f64; 3]]| points.iter().map(|p| p[1]).fold(0.0, f64::max);
    assert!((half_width(fuselage) / half_width(&reference[0]) - 1.5).abs() < 1e-12);
    for (moved, rest) in fuselage.iter().zip(&reference[0]) {
        assert_eq!(moved[0], rest[0], "no motion along the body");
        if rest[0] >= 31.0 || rest[0] <= 0.0 {
            assert_eq!(moved, rest, "nose and tail stay");
        }
    }
}

#[test]
fn one_side_mirrors_the_other() {
    let content = example("setup.toml");
    let p = &content.input.parameterisation;
    let reference = p.control_points(&p.baseline()).expect("acceptable").remove(1);
    let design: Vec<f64> =
        p.variables().iter().enumerate().map(|(i, v)| if i % 3 == 0 { v.lower } else { v.upper }).collect();
    let wing = p.control_points(&design).expect("acceptable").remove(1);
    for (i, [x, y, z]) in reference.iter().enumerate() {
        let image = reference
            .iter()
            .position(|q| (q[0] - x).abs() < 1e-12 && (q[1] + y).abs() < 1e-12 && (q[2] - z).abs() < 1e-12);
        let image = image.expect("the wing is symmetric");
        let gap = [wing[i][0] - wing[image][0], wing[i][1] + wing[image][1], wing[i][2] - wing[image][2]];
        assert!(gap.iter().all(|g| g.abs() < 1e-12), "{gap:?}");
    }
}
