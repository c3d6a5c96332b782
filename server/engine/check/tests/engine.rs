//! The engine's linearisation passes the check.

mod common;

use std::sync::Arc;

use common::{design, setup};
use moldline_check::{Chain, CheckOptions, Phase, Watch, check_design};
use moldline_deform::{NoMonitor, OuterMoldLine, Propagation, Setup};

struct Nobody;

impl Watch for Nobody {
    fn progress(&self, _: Phase, _: f64) {}
}

/// Dot products to 1e-12, dual numbers to 1e-10, central differences to `bound`.
fn passes(setup: Setup, fraction: f64, variables: &[usize], name: &str, bound: f64) {
    let setup = Arc::new(setup);
    let design = design(&setup, fraction);
    let linear = setup.linearise(&design, &NoMonitor).expect("deforms");
    let options = CheckOptions {
        variables: variables.to_vec(),
        steps: vec![1e-3, 1e-4, 1e-5],
        ..CheckOptions::all(design.len())
    };
    let check = check_design(&setup, &Chain::new(&setup), &linear, &*setup, &design, &options, &Nobody)
        .expect("is checked");
    let (dot, dual, central) = (check.dot_product_max(), check.dual_max(), check.central_difference_max());
    println!("{name}: dot products {dot:.1e}, dual numbers {dual:.1e}, central differences {central:.1e}");
    for row in &check.variables {
        println!("    {:?} {:.1e} vertex {}", row.first_off, row.dual, row.worst_vertex);
    }
    assert!(dot <= 1e-12, "{name}: dot products are off by {dot:.1e}");
    assert!(dual <= 1e-10, "{name}: {:?}", check.variables);
    assert!(central <= bound, "{name}: central differences are off by {central:.1e}");
}

fn everywhere(folder: &str, fraction: f64) {
    for outer_mold_line in [OuterMoldLine::Sharp, OuterMoldLine::Smooth] {
        for propagation in [Propagation::Surface, Propagation::Departure, Propagation::Absolute] {
            let setup = setup(folder, |options| {
                options.outer_mold_line = outer_mold_line;
                options.propagation = propagation;
                options.fillet = Some(0.02);
            });
            let name = format!("{folder}, {outer_mold_line:?}, {propagation:?}");
            passes(setup, fraction, &[0, 1], &name, 1e-6);
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
    let setup = setup("tests/configurations/half", |options| options.smoothing.rounds = 2);
    passes(setup, 0.3, &[0, 1], "smoothed", 1e-6);
}

#[test]
fn e175() {
    // With the multiquadric kernel, and with the cubic one.
    for propagation in [Propagation::Surface, Propagation::Departure] {
        let setup = setup("examples/e175", |options| options.propagation = propagation);
        passes(setup, 0.25, &[2, 20, 38, 42, 43, 44], &format!("e175, {propagation:?}"), 1e-6);
    }
}
