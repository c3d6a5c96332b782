//! Small components with closed-form planforms.

use moldline_spline::{KnotVector, Surface};

use crate::{ComponentReference, PatchReference};

fn patch(
    degrees: (usize, usize),
    shape: (usize, usize),
    point: impl Fn(usize, usize) -> [f64; 3],
) -> PatchReference {
    let knots = |p, n| KnotVector::clamped_uniform(p, n).expect("valid");
    PatchReference {
        surface: Surface::new(knots(degrees.0, shape.0), knots(degrees.1, shape.1)),
        control_points: (0..shape.0)
            .flat_map(|i| (0..shape.1).map(move |j| (i, j)))
            .map(|(i, j)| point(i, j))
            .collect(),
        weights: Vec::new(),
    }
}

/// Leading edge 1 + |y|/2, chord 4 - 0.4 |y|, half span 5, z = 0.1 |y| + thickness; upper and lower patch share their
/// edges.
pub(crate) fn tapered_wing() -> ComponentReference {
    let side = |sign: f64| {
        patch((2, 1), (5, 5), move |i, j| {
            let y: f64 = [-5.0, -2.5, 0.0, 2.5, 5.0][j];
            let (chord, s) = (4.0 - 0.4 * y.abs(), [0.0, 0.0, 0.4, 0.8, 1.0][i]);
            let t = sign * [0.0, 0.06, 0.08, 0.03, 0.0][i];
            [1.0 + 0.5 * y.abs() + s * chord, y, 0.1 * y.abs() + t * chord]
        })
    };
    ComponentReference { name: "wing".into(), patches: vec![side(-1.0), side(1.0)] }
}

/// A duct of unit square cross-section, x = 0..10, centred on (y, z) = (0, 0.3 x).
pub(crate) fn box_body() -> ComponentReference {
    let ring = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5]];
    let body = patch((3, 1), (7, 5), |i, j| {
        let x = [0.0, 1.0, 3.0, 5.0, 7.0, 9.0, 10.0][i];
        [x, ring[j][0], 0.3 * x + ring[j][1]]
    });
    ComponentReference { name: "body".into(), patches: vec![body] }
}
