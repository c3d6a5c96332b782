//! The evaluation in dual numbers against the engine's own deformations: values, and derivatives by central differences.

mod common;

use common::{design, setup, unit};
use moldline_check::{Chain, Derivative, central_difference, norm, relative_error};
use moldline_deform::{NoMonitor, Options, OuterMoldLine, Propagation, Setup};
use nalgebra::Vector3;

/// Values to 1e-10 of the length; derivatives to `bound`, as near as differences extrapolated from two steps come.
fn agrees(setup: &Setup, design: &[f64], some: &[usize], name: &str, bound: f64) {
    let variables = setup.parameterisation().variables();
    let directions: Vec<Vec<f64>> = some.iter().map(|&k| unit(variables.len(), k)).collect();
    let dual = Chain::new(setup).eval(design, &directions, &NoMonitor).expect("evaluates");
    let engine = setup.deform(design, &NoMonitor).expect("deforms");
    let both = engine.vertices.iter().zip(&dual.values.vertices);
    let off = both.map(|(a, b)| (Vector3::from(*a) - b).norm()).fold(0.0, f64::max) / setup.length();
    assert!(off <= 1e-10, "{name}: values differ by {off:.1e} of the length");
    for ((&k, direction), tangent) in some.iter().zip(&directions).zip(&dual.tangents) {
        let tangent: Derivative = tangent.vertices.iter().map(|&x| x.into()).collect();
        assert!(norm(&tangent) > 0.0, "{name}: {} does something", variables[k].name);
        let range = variables[k].upper - variables[k].lower;
        let difference =
            |h: f64| central_difference(setup, design, direction, h * range, &NoMonitor).expect("deforms");
        let extrapolated = |h: f64| {
            let (wide, narrow) = (difference(h), difference(0.5 * h));
            let both = wide.iter().zip(&narrow);
            both.map(|(w, n)| [0, 1, 2].map(|axis| (4.0 * n[axis] - w[axis]) / 3.0)).collect::<Derivative>()
        };
        let errors = [3e-3, 1e-3, 1e-4].map(|h| relative_error(&extrapolated(h), &tangent));
        let best = errors.iter().copied().fold(f64::INFINITY, f64::min);
        assert!(best <= bound, "{name}: {} is off by {best:.1e} ({errors:?})", variables[k].name);
    }
}

/// All ways of propagation, sharp and with a fillet wide enough to reach many vertices.
fn everywhere(folder: &str, fraction: f64) {
    let change = |outer_mold_line, propagation| {
        move |options: &mut Options| {
            options.outer_mold_line = outer_mold_line;
            options.propagation = propagation;
            options.fillet = Some(0.02);
        }
    };
    for outer_mold_line in [OuterMoldLine::Sharp, OuterMoldLine::Smooth] {
        for propagation in [Propagation::Surface, Propagation::Departure, Propagation::Absolute] {
            let setup = setup(folder, change(outer_mold_line, propagation));
            let name = format!("{folder}, {outer_mold_line:?}, {propagation:?}");
            agrees(&setup, &design(&setup, fraction), &[0, 1], &name, 1e-9);
        }
    }
}

#[test]
fn three_components_that_meet_in_a_point() {
    everywhere("tests/configurations/boom", 0.5);
}

#[test]
fn half_model_of_rational_patches() {
    everywhere("tests/configurations/half", 0.4);
}

#[test]
fn smoothing() {
    for outer_mold_line in [OuterMoldLine::Sharp, OuterMoldLine::Smooth] {
        let setup = setup("tests/configurations/half", |options| {
            options.outer_mold_line = outer_mold_line;
            options.fillet = Some(0.02);
            options.smoothing.rounds = 2;
        });
        agrees(&setup, &design(&setup, 0.3), &[0, 1], &format!("smoothed, {outer_mold_line:?}"), 1e-9);
    }
}

#[test]
fn e175() {
    let setup = setup("examples/e175", |_| {});
    // Twist and camber amid the span, wing area, translation, tail rotation, diameter.
    agrees(&setup, &design(&setup, 0.25), &[2, 20, 38, 42, 43, 44], "e175", 1e-8);
}
