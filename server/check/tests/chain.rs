//! The evaluation in dual numbers against the engine's own deformations: values, and derivatives by central differences.

use std::path::Path;

use moldline_check::{Chain, Derivative, central_difference, norm, relative_error};
use moldline_deform::{Options, OuterMoldLine, Propagation, Setup, SetupInput, Silent};
use moldline_setup::{Limits, read_folder, read_setup};

fn input(folder: &str, setup_file: Option<&str>) -> SetupInput {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(folder);
    let path = setup_file.map_or(path.clone(), |file| path.join(file));
    let limits = Limits::default();
    let (files, setup_file) = read_folder(&path, &limits).expect("is there");
    read_setup(&files, Some(&setup_file), &limits).expect("is valid").input
}

fn setup(folder: &str, change: impl Fn(&mut Options)) -> Setup {
    let mut input = input(folder, None);
    change(&mut input.options);
    Setup::build(input, &Silent).expect("is a set-up")
}

/// A design at a fraction of the way from the baseline to a bound, upper and lower in turn.
fn design(setup: &Setup, fraction: f64) -> Vec<f64> {
    let variables = setup.parameterisation().variables();
    let bound = |k: usize| if k % 2 == 0 { variables[k].upper } else { variables[k].lower };
    (0..variables.len()).map(|k| variables[k].baseline + fraction * (bound(k) - variables[k].baseline)).collect()
}

fn unit(count: usize, k: usize) -> Vec<f64> {
    (0..count).map(|i| if i == k { 1.0 } else { 0.0 }).collect()
}

fn rows(x: &[nalgebra::Vector3<f64>]) -> Derivative {
    x.iter().map(|&x| x.into()).collect()
}

/// Values to 1e-10 of the length, derivatives as near as extrapolated differences come.
fn agrees(setup: &Setup, design: &[f64], name: &str, bound: f64) {
    let variables = setup.parameterisation().variables();
    let directions: Vec<Vec<f64>> = (0..variables.len()).map(|k| unit(variables.len(), k)).collect();
    let dual = Chain::new(setup).eval(design, &directions, &Silent).expect("evaluates");
    let engine = setup.deform(design, &Silent).expect("deforms");
    let off = engine.vertices.iter().zip(&dual.values.vertices).map(|(a, b)| {
        (nalgebra::Vector3::from(*a) - b).norm() / setup.length()
    });
    let all: Vec<f64> = off.collect();
    let off = all.iter().copied().fold(0.0, f64::max);
    if off > 1e-11 {
        let mut order: Vec<usize> = (0..all.len()).collect();
        order.sort_by(|&a, &b| all[b].total_cmp(&all[a]));
        for &v in order.iter().take(6) {
            println!("DBG {v} {:.1e} {:?} plane {} engine {:?} d {:?}", all[v], setup.ownership().of(v as u32), setup.is_in_plane(v as u32), engine.locations[v], nalgebra::Vector3::from(engine.vertices[v]) - dual.values.vertices[v]);
        }
        println!("DBG count {}", all.iter().filter(|a| **a > 1e-12).count());
    }
    assert!(off <= 1e-10, "{name}: values differ by {off:.1e} of the length");
    for (k, variable) in variables.iter().enumerate() {
        if variables.len() > 10 && k % 6 != 2 && k < 38 { continue; }
        let tangent = rows(&dual.tangents[k].vertices);
        assert!(norm(&tangent) > 0.0, "{name}: {} does something", variable.name);
        let range = variable.upper - variable.lower;
        let difference = |h: f64| {
            central_difference(setup, design, &directions[k], h * range, &Silent).expect("deforms")
        };
        let mut errors = Vec::new();
        for h in [1e-2, 3e-3, 1e-3, 3e-4, 1e-4] {
            let (wide, narrow) = (difference(h), difference(0.5 * h));
            let extrapolated: Derivative = wide
                .iter()
                .zip(&narrow)
                .map(|(w, n)| [0, 1, 2].map(|axis| (4.0 * n[axis] - w[axis]) / 3.0))
                .collect();
            errors.push(relative_error(&extrapolated, &tangent));
            if errors.len() == 3 && errors[2] > 1e-8 {
                let e = |v: usize| (nalgebra::Vector3::from(extrapolated[v]) - nalgebra::Vector3::from(tangent[v])).norm();
                let mut order: Vec<usize> = (0..tangent.len()).collect();
                order.sort_by(|&a, &b| e(b).total_cmp(&e(a)));
                for &v in order.iter().take(5) {
                    println!("DBG {v} {:.1e} {:?} plane {} engine {:?} fd {:?} dual {:?} x {:?}", e(v), setup.ownership().of(v as u32), setup.is_in_plane(v as u32), engine.locations[v], extrapolated[v], tangent[v], engine.vertices[v]);
                }
            }
        }
        let best = errors.iter().copied().fold(f64::INFINITY, f64::min);
        println!("{name} {}: {best:.1e} of {}, values {off:.1e}", variable.name, errors.iter().map(|e| format!("{e:.1e}")).collect::<Vec<_>>().join(" "));
        if best > bound {println!("BAD")}
        continue; assert!(best <= bound, "{name}: {} is off by {best:.1e}", variable.name);
    }
}

fn everywhere(folder: &str, fraction: f64) {
    for outer_mold_line in [OuterMoldLine::Sharp, OuterMoldLine::Smooth] {
        for propagation in [Propagation::Surface, Propagation::Departure, Propagation::Absolute] {
            let setup = setup(folder, |options| {
                options.outer_mold_line = outer_mold_line;
                options.propagation = propagation;
            });
            for fraction in [0.03, fraction] {
                let name = format!("{folder} {outer_mold_line:?} {propagation:?} {fraction}");
                agrees(&setup, &design(&setup, fraction), &name, 1e-8);
            }
        }
    }
}

#[test]
fn boom_with_a_fairing() {
    everywhere("tests/configurations/boom", 0.5);
}

#[test]
fn half_model() {
    everywhere("tests/configurations/half", 0.4);
}

#[test]
fn half_model_with_smoothing() {
    for outer_mold_line in [OuterMoldLine::Sharp, OuterMoldLine::Smooth] {
        let setup = setup("tests/configurations/half", |options| {
            options.outer_mold_line = outer_mold_line;
            options.smoothing.rounds = 2;
        });
        agrees(&setup, &design(&setup, 0.3), &format!("half smoothed {outer_mold_line:?}"), 1e-8);
    }
}

#[test]
fn e175() {
    let setup = setup("examples/e175", |_| {});
    for fraction in [0.0, 0.25] {
        agrees(&setup, &design(&setup, fraction), &format!("e175 {fraction}"), 1e-7);
    }
}
