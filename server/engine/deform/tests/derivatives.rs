//! Jacobian-vector and vector-Jacobian products of whole deformations: against differences of deformations, and against each
//! other.

// Helpers of tests fail by panicking, like the tests themselves.
#![allow(clippy::unwrap_used)]

use std::{path::Path, sync::Arc};

use moldline_deform::{
    DeformError, Direction, Inputs, Kernel, Linearisation, NoMonitor, Options, OuterMoldLine, Propagation,
    Setup, Tangent,
};
use moldline_parameterisation::Override;
use moldline_setup_files::{Limits, read_folder, read_setup};
use moldline_testing::Random;

fn setup(folder: &str, change: impl Fn(&mut Options)) -> Arc<Setup> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..").join(folder);
    let (files, setup_file) = read_folder(&folder, &Limits::default()).unwrap();
    let mut content = read_setup(&files, Some(&setup_file), &Limits::default()).unwrap();
    change(&mut content.input.options);
    Arc::new(Setup::build(content.input, &NoMonitor).unwrap())
}

fn seed(setup: &Setup, random: &mut Random) -> Tangent {
    Tangent {
        vertices: random.vectors(setup.mesh().vertices.len()),
        functions: setup.functions().iter().map(|_| random.signed()).collect(),
    }
}

fn design(setup: &Setup, share: f64, random: &mut Random) -> Vec<f64> {
    let variables = setup.parameterisation().variables().iter();
    variables
        .map(|v| {
            let end = if random.between(-1.0, 1.0) < 0.0 { v.lower } else { v.upper };
            v.baseline + share * (end - v.baseline)
        })
        .collect()
}

fn dot(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| a * b).sum()
}

fn dot_all(a: &Tangent, b: &Tangent) -> f64 {
    dot(&a.vertices, &b.vertices) + a.functions.iter().zip(&b.functions).map(|(a, b)| a * b).sum::<f64>()
}

/// Relative error of `J v` against the best of a few fourth-order central differences.
fn against_differences(linearisation: &Linearisation, direction: &[f64], range: f64) -> f64 {
    let setup = linearisation.setup();
    let design = linearisation.design();
    let tangent = linearisation.jvp(&[direction]).unwrap().remove(0);
    let at = |t: f64| {
        let design: Vec<f64> = design.iter().zip(direction).map(|(x, d)| x + t * d).collect();
        let control_points = setup.parameterisation().control_points(&design).unwrap();
        let deformation = setup.deform_control_points(&control_points, &NoMonitor).unwrap();
        (deformation.vertices, deformation.functions)
    };
    let size = dot(&tangent.vertices, &tangent.vertices).sqrt();
    // A soft bracket changes over shorter distances, and is free of convergence noise.
    let steps = if setup.options().seam.polish { [1e-3, 1e-4] } else { [1e-5, 1e-6] };
    steps
        .map(|step| {
            let h = step * range;
            let [a, b, c, d] = [-2.0, -1.0, 1.0, 2.0].map(|k| at(k * h));
            let slope = |x: [f64; 4]| (x[0] - x[3] + 8.0 * (x[2] - x[1])) / (12.0 * h);
            let error = (0..a.0.len()).map(|v| {
                (0..3)
                    .map(|k| (slope([&a, &b, &c, &d].map(|x| x.0[v][k])) - tangent.vertices[v][k]).powi(2))
                    .sum::<f64>()
            });
            let of_functions = (0..a.1.len()).map(|f| {
                let scale = tangent.functions[f].abs().max(1e-3 * a.1[f].abs() / range).max(1e-6);
                (slope([&a, &b, &c, &d].map(|x| x.1[f])) - tangent.functions[f]).abs() / scale
            });
            of_functions.fold(0.0, f64::max).max(error.sum::<f64>().sqrt() / size)
        })
        .into_iter()
        .fold(f64::INFINITY, f64::min)
}

/// Largest relative gap between `w . J v` and `J^T w . v`, in blocks of `k`.
fn dot_product_gap(linearisation: &Linearisation, k: usize, random: &mut Random) -> f64 {
    let variables = linearisation.design().len();
    let setup = linearisation.setup();
    let directions: Vec<Vec<f64>> =
        (0..k).map(|_| (0..variables).map(|_| random.between(-1.0, 1.0)).collect()).collect();
    let seeds: Vec<Tangent> = (0..k).map(|_| seed(setup, random)).collect();
    let tangents = linearisation.jvp(&directions).unwrap();
    let gradients = linearisation.vjp(&seeds).unwrap();
    let mut worst: f64 = 0.0;
    for (direction, tangent) in directions.iter().zip(&tangents) {
        for (seed, gradient) in seeds.iter().zip(&gradients) {
            let forward = dot_all(seed, tangent);
            let backward: f64 = gradient.design.iter().zip(direction).map(|(a, b)| a * b).sum();
            let scale = (dot_all(seed, seed) * dot_all(tangent, tangent)).sqrt();
            worst = worst.max((forward - backward).abs() / scale);
        }
    }
    worst
}

/// A name, and a change of the options.
type Variant = (&'static str, fn(&mut Options));

/// All options that change the chain of operations.
fn variants() -> Vec<Variant> {
    vec![
        ("sharp", |_| {}),
        ("smooth", |o| o.outer_mold_line = OuterMoldLine::Smooth),
        ("smoothing", |o| {
            // Gentle, or vertices of a leading edge are drawn to points equally near to both sheets.
            o.smoothing.rounds = 2;
            o.smoothing.relaxation = 0.1;
            o.outer_mold_line = OuterMoldLine::Smooth;
        }),
        ("departure", |o| o.propagation = Propagation::Departure),
        ("absolute", |o| {
            o.propagation = Propagation::Absolute;
            o.outer_mold_line = OuterMoldLine::Smooth;
        }),
        ("soft bracket", |o| {
            // Soft enough to be smooth over the steps of the differences.
            o.seam.polish = false;
            o.seam.soft_steps = 16;
            o.seam.eta = 1e6;
        }),
        ("cubic", |o| {
            o.kernel = Some(Kernel::Cubic);
            o.regularisation = 1e-6;
        }),
    ]
}

#[test]
fn products_agree_with_differences_and_with_their_transposes() {
    for folder in ["tests/configurations/boom", "tests/configurations/half"] {
        for (name, change) in variants() {
            let setup = setup(folder, change);
            // At other designs differences with a soft bracket come to 2e-6 only: between truncation and rounding no step is better.
            let mut random = Random::new(5);
            let design = design(&setup, 0.35, &mut random);
            let linearisation = setup.linearise(&design, &NoMonitor).unwrap();
            let gap = dot_product_gap(&linearisation, 3, &mut random);
            assert!(gap <= 1e-12, "{folder}, {name}: dot products differ by {gap:e}");
            for (i, variable) in setup.parameterisation().variables().iter().enumerate() {
                let mut direction = vec![0.0; design.len()];
                direction[i] = 1.0;
                let error = against_differences(&linearisation, &direction, variable.upper - variable.lower);
                assert!(error <= 1e-6, "{folder}, {name}, {}: {error:e}", variable.name);
            }
        }
    }
}

#[test]
fn the_e175_has_exact_products_far_from_its_baseline() {
    for outer_mold_line in [OuterMoldLine::Sharp, OuterMoldLine::Smooth] {
        let setup = setup("examples/e175", |o| o.outer_mold_line = outer_mold_line);
        let mut random = Random::new(3);
        for share in [0.0, 0.5] {
            let design = design(&setup, share, &mut random);
            let linearisation = setup.linearise(&design, &NoMonitor).unwrap();
            let plain = setup.deform(&design, &NoMonitor).unwrap();
            assert_eq!(plain.vertices, linearisation.deformation().vertices);
            for k in [1, design.len()] {
                let gap = dot_product_gap(&linearisation, k, &mut random);
                assert!(gap <= 1e-12, "k = {k}: dot products differ by {gap:e}");
            }
            let direction: Vec<f64> = setup
                .parameterisation()
                .variables()
                .iter()
                .map(|v| random.between(-0.05, 0.05) * (v.upper - v.lower))
                .collect();
            let error = against_differences(&linearisation, &direction, 1.0);
            assert!(error <= 1e-6, "{error:e}");
        }
    }
}

#[test]
fn scalar_outputs_are_those_of_the_aircraft() {
    let setup = setup("examples/e175", |_| {});
    let design = setup.parameterisation().baseline();
    let deformation = setup.deform(&design, &NoMonitor).unwrap();
    let value = |name: &str| {
        let index = setup.functions().iter().position(|f| f.name == name);
        deformation.functions[index.unwrap_or_else(|| panic!("{name}"))]
    };
    let near = |name: &str, expected: f64, tolerance: f64| {
        let found = value(name);
        assert!(
            (found - expected).abs() <= tolerance * expected.abs(),
            "{name} = {found}, expected {expected}"
        );
    };
    let variable = |name: &str| design[setup.parameterisation().index(name).unwrap()];
    // What the planform operations call area and aspect ratio (areas in square feet).
    const SQUARE_FOOT: f64 = 0.3048 * 0.3048;
    for component in ["wing", "htail"] {
        let area = value(&format!("{component}.planform_area"));
        let span = value(&format!("{component}.span"));
        near(
            &format!("{component}.planform_area"),
            variable(&format!("{component}.area")) * SQUARE_FOOT,
            1e-2,
        );
        let ratio = variable(&format!("{component}.aspect_ratio"));
        assert!((span * span / area - ratio).abs() <= 1e-2 * ratio, "{component}: {span}, {area}");
    }
    near("enclosed_volume", setup.report().volume, 1e-12);
    // The mesh's cells, measured without gradients.
    let area: f64 = setup
        .mesh()
        .cells
        .iter()
        .zip(setup.cell_owner())
        .filter(|(_, owner)| **owner == 1)
        .map(|(cell, _)| moldline_mesh::area_vector(&deformation.vertices, cell).norm())
        .sum();
    near("wing.wetted_area", area, 1e-12);
}

#[test]
fn control_points_are_inputs_too() {
    let setup = setup("tests/configurations/half", |o| o.outer_mold_line = OuterMoldLine::Smooth);
    let mut random = Random::new(5);
    let design = design(&setup, 0.3, &mut random);
    let control_points = setup.parameterisation().control_points(&design).unwrap();
    let by_design = setup.linearise(&design, &NoMonitor).unwrap();
    let given = control_points.into_iter().enumerate();
    let given = given.map(|(component, control_points)| Override { component, control_points }).collect();
    let by_points = setup.linearise(Inputs { design: design.clone(), given }, &NoMonitor).unwrap();
    assert_eq!(by_points.deformation().vertices, by_design.deformation().vertices);

    // A direction in design space is one of control points.
    let direction: Vec<f64> = design.iter().map(|_| random.between(-1.0, 1.0)).collect();
    let parameterisation = setup.parameterisation().linearise(&design).unwrap();
    let of_points = parameterisation.jvp(&[&direction]).unwrap();
    let a = by_design.jvp(&[&direction]).unwrap();
    let b = by_points.jvp_inputs(&[of_points[0].clone().into()]).unwrap();
    assert_eq!(a, b);
    let stages = by_design.stages(&direction[..].into()).unwrap();
    assert_eq!(stages.control_points, of_points[0]);
    for (x, y) in stages.vertices.iter().zip(&a[0].vertices) {
        assert!((0..3).all(|k| (x[k] - y[k]).abs() <= 1e-12));
    }
    assert!(by_points.jvp(&[&direction]).unwrap()[0].vertices.iter().flatten().all(|x| *x == 0.0));

    // The gradient with respect to control points, contracted, is the gradient with respect to the design.
    let seed = seed(&setup, &mut random);
    let gradient = by_points.vjp(std::slice::from_ref(&seed)).unwrap().remove(0);
    assert!(gradient.design.iter().all(|x| *x == 0.0));
    let contracted: f64 = gradient.control_points.iter().zip(&of_points[0]).map(|(g, t)| dot(g, t)).sum();
    let forward = dot_all(&seed, &a[0]);
    assert!((contracted - forward).abs() <= 1e-11 * forward.abs().max(1.0));

    let short = Tangent { vertices: seed.vertices[1..].to_vec(), ..seed.clone() };
    assert!(matches!(by_points.vjp(&[seed, short]), Err(DeformError::SeedSize { index: 1, .. })));
}

#[test]
fn products_do_not_depend_on_threads() {
    let setup = setup("tests/configurations/boom", |o| o.outer_mold_line = OuterMoldLine::Smooth);
    let design = design(&setup, 0.35, &mut Random::new(7));
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let linearisation = setup.linearise(&design, &NoMonitor).unwrap();
            let mut random = Random::new(1);
            let seeds: Vec<Tangent> = (0..3).map(|_| seed(&setup, &mut random)).collect();
            let directions: Vec<Vec<f64>> =
                (0..5).map(|k| design.iter().map(|x| (x + k as f64).sin()).collect()).collect();
            (linearisation.jvp(&directions).unwrap(), linearisation.vjp(&seeds).unwrap())
        })
    };
    assert_eq!(run(1), run(2));
}

#[test]
fn given_control_points_cut_the_way_from_the_design() {
    let setup = setup("tests/configurations/boom", |o| o.outer_mold_line = OuterMoldLine::Smooth);
    let mut random = Random::new(11);
    let design = design(&setup, 0.3, &mut random);
    let control_points = setup.parameterisation().control_points(&design).unwrap();
    let boom = setup.components().iter().position(|c| c.name() == "boom").unwrap();
    let given = Override { component: boom, control_points: control_points[boom].clone() };
    let inputs = Inputs { design: design.clone(), given: vec![given] };
    let at = setup.linearise(inputs, &NoMonitor).unwrap();

    // Part of the way through the design, part through the control points of the component that is given and of another one.
    let mut vectors = |component: usize| -> (usize, Vec<[f64; 3]>) {
        let vector = |_: &[f64; 3]| std::array::from_fn(|_| random.between(-0.1, 0.1));
        (component, control_points[component].iter().map(vector).collect())
    };
    let other = (boom + 1) % setup.components().len();
    let direction = Direction {
        design: Some(design.iter().enumerate().map(|(i, _)| 0.1 + 0.01 * i as f64).collect()),
        control_points: vec![vectors(boom), vectors(other)],
    };
    let tangent = at.jvp_inputs(std::slice::from_ref(&direction)).unwrap().remove(0);

    let mut expected = setup
        .parameterisation()
        .linearise(&design)
        .unwrap()
        .jvp(&[direction.design.as_ref().unwrap()])
        .unwrap();
    expected[0][boom].fill([0.0; 3]);
    for (component, vectors) in &direction.control_points {
        let sums = expected[0][*component].iter_mut().zip(vectors);
        sums.for_each(|(sum, x)| (0..3).for_each(|axis| sum[axis] += x[axis]));
    }
    let by_design = setup.linearise(&design, &NoMonitor).unwrap();
    assert_eq!(by_design.jvp_inputs(&[expected.remove(0).into()]).unwrap()[0], tangent);

    let seed = seed(&setup, &mut random);
    let gradient = at.vjp(std::slice::from_ref(&seed)).unwrap().remove(0);
    assert_eq!(at.vjp_control_points(std::slice::from_ref(&seed)).unwrap()[0], gradient.control_points);
    let of_design = gradient.design.iter().zip(direction.design.as_ref().unwrap()).map(|(g, d)| g * d);
    let of_points = direction.control_points.iter().map(|(c, v)| dot(&gradient.control_points[*c], v));
    let backward = of_design.sum::<f64>() + of_points.sum::<f64>();
    let forward = dot_all(&seed, &tangent);
    let scale = (dot_all(&seed, &seed) * dot_all(&tangent, &tangent)).sqrt();
    assert!((forward - backward).abs() <= 1e-12 * scale, "{forward} {backward}");

    let short = Direction { control_points: vec![(boom, vec![[0.0; 3]])], ..Direction::default() };
    assert!(matches!(at.jvp_inputs(&[short]), Err(DeformError::ControlPoints(_))));
}
