//! The seam search against closed forms: a line on a plane through one and two balls.

// Helpers of tests fail by panicking, like the tests themselves.
#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use moldline_deform::{
    DeformError, NoMonitor, SeamOptions,
    chain::seams::{SeamLine, SeamSearch, SeamSolver, SeamVertex},
};
use moldline_geometry::{Body, Component, Primitive, Vector3};

fn body(primitive: &Primitive) -> Body {
    let (component, points) = Component::primitive("part".into(), primitive).unwrap();
    Body::new(Arc::new(component), points)
}

/// A block whose upper face is the plane z = 0, and unit balls.
fn bodies(centres: [[f64; 3]; 2]) -> Vec<Body> {
    let block = Primitive::Box { low: Vector3::new(-8.0, -8.0, -1.0), high: Vector3::new(8.0, 8.0, 0.0) };
    let ball = |center: [f64; 3]| Primitive::Sphere { center: center.into(), radius: 1.0 };
    [block, ball(centres[0]), ball(centres[1])].iter().map(body).collect()
}

/// Searches the line y = z = 0 of the block, in the direction of x, from (-2, 0, 0) for the union of both balls.
fn solver(bodies: &[Body], fillet: f64, bracket: [f64; 2]) -> SeamSolver {
    let start = bodies[0].closest_point(&Vector3::new(-2.0, 0.0, 0.0)).location;
    let point = bodies[0].point(&start);
    // A unit of lambda is a metre.
    let along = |derivative: &Vector3| if derivative.x.abs() > 1.0 { 1.0 / derivative.x } else { 0.0 };
    let direction = [along(&point.d_u), along(&point.d_v)];
    let line = SeamLine {
        reference: 0,
        start,
        direction,
        bracket,
        limits: [-6.0, 10.0],
        from_inside: false,
        targets: vec![1, 2],
        carried: Vec::new(),
    };
    let vertex =
        SeamVertex { vertex: 0, owners: vec![0], locations: vec![start], search: SeamSearch::Line(line) };
    let options = SeamOptions { fillet, ..SeamOptions::default() };
    SeamSolver { vertices: vec![vertex], options, length: 1.0 }
}

fn found(solver: &SeamSolver, bodies: &[Body]) -> Vector3 {
    solver.eval(bodies, bodies, &NoMonitor).unwrap()[0].position
}

#[test]
fn between_two_targets_the_seam_keeps_to_their_smooth_union() {
    // Balls at +-0.6 beside the line are equally far from it, so that phi = ln(2)/rho = fillet / sqrt(2) on the seam.
    for fillet in [1e-1, 1e-3, 1e-9] {
        let bodies = bodies([[0.0, 0.6, 0.0], [0.0, -0.6, 0.0]]);
        let position = found(&solver(&bodies, fillet, [-1.0, 2.0]), &bodies);
        let radius: f64 = 1.0 + fillet / f64::sqrt(2.0);
        let expected = Vector3::new(-(radius * radius - 0.36).sqrt(), 0.0, 0.0);
        assert!((position - expected).norm() < 1e-12, "fillet {fillet}: {position} {expected}");
    }
}

#[test]
fn the_seam_goes_over_from_one_target_to_the_other() {
    // On the line, left of the centres, phi_i = c_i - 1 - x: the root is the smooth minimum of the left ends c_i - 1.
    for fillet in [1e-1, 1e-2, 1e-9] {
        let rho = f64::sqrt(2.0) * f64::ln(2.0) / fillet;
        let reference = bodies([[0.0; 3], [0.5, 0.0, 0.0]]);
        let solver = solver(&reference, fillet, [0.0, 1.5]);
        for step in 0..=20 {
            let moved = 0.06 * f64::from(step);
            let bodies = bodies([[moved, 0.0, 0.0], [0.5, 0.0, 0.0]]);
            let (first, second) = (moved - 1.0, -0.5_f64);
            let least = first.min(second);
            let sum = (-rho * (first - least)).exp() + (-rho * (second - least)).exp();
            let expected = least - sum.ln() / rho;
            let x = found(&solver, &bodies).x;
            assert!((x - expected).abs() < 1e-12, "fillet {fillet}, moved by {moved}: {x} {expected}");
        }
    }
}

#[test]
fn a_union_out_of_reach_is_lost_by_vertex() {
    let reference = bodies([[0.0; 3], [0.5, 0.0, 0.0]]);
    let solver = solver(&reference, 1e-3, [0.0, 1.5]);
    let bodies = bodies([[0.0, 0.0, 3.0], [0.5, 0.0, 4.0]]);
    let Err(DeformError::SeamLost { count, worst, .. }) = solver.eval(&bodies, &bodies, &NoMonitor) else {
        panic!("nothing is met")
    };
    assert_eq!((count, worst[0].vertex), (1, 0));
    assert!((worst[0].distance - 2.0).abs() < 0.01, "{}", worst[0].distance);
}
