//! How components are put together: counts of edges and vertices, orientation, refused input.

mod common;

use common::*;
use moldline_geometry::*;
use moldline_spline::KnotVector;

fn counts(component: &Component) -> (usize, usize, usize) {
    let count = |f: &dyn Fn(&Edge) -> bool| component.edges().iter().filter(|e| f(e)).count();
    (count(&|e| !e.collapsed && !e.sharp), count(&|e| e.sharp), count(&|e| e.collapsed))
}

/// Gauss' theorem: the flux of the position through the surface is three times the volume, which must be positive.
fn volume(body: &Body) -> f64 {
    let mut sum = 0.0;
    for (i, p) in body.component().patches().iter().enumerate() {
        for u in p.surface.knots_u().breaks().windows(2) {
            for v in p.surface.knots_v().breaks().windows(2) {
                let n = 12;
                for a in 0..n {
                    for b in 0..n {
                        let f = |k: usize, w: &[f64]| w[0] + (w[1] - w[0]) * (k as f64 + 0.5) / n as f64;
                        let point = body.point(&Location { patch: i as u32, u: f(a, u), v: f(b, v) });
                        let area = (u[1] - u[0]) * (v[1] - v[0]) / (n * n) as f64;
                        let sign = if p.flipped { -1.0 } else { 1.0 };
                        sum += sign * area * point.position.dot(&point.d_u.cross(&point.d_v)) / 3.0;
                    }
                }
            }
        }
    }
    sum
}

#[test]
fn wing_has_a_sharp_trailing_edge_rims_and_a_smooth_leading_edge() {
    let b = body("wing", wing_patches(Trailing::Wedge));
    // Leading edge; trailing edge and two rims of two curves; two ends of two caps.
    assert_eq!(counts(b.component()), (1, 5, 4));
    assert_eq!(b.component().vertices().len(), 4);
    assert!(volume(&b) > 0.0);
}

#[test]
fn wrapped_wing_is_cut_at_its_c0_knot_and_has_the_same_edges() {
    let b = body("wing", wrapped_wing_patches());
    assert_eq!(b.component().patches().len(), 4);
    assert_eq!(counts(b.component()), (1, 5, 4));
    let plain = body("wing", wing_patches(Trailing::Wedge));
    assert!((volume(&b) - volume(&plain)).abs() < 1e-12 * volume(&plain));
}

#[test]
fn caps_may_meet_a_part_of_a_side() {
    // Raising the smoothness at the leading edge, by averaging, leaves one patch whose sides two caps share.
    let mut patches = wing_patches(Trailing::Wedge);
    let (lower, upper) = (patches[0].clone(), patches[1].clone());
    let n_v = lower.knots_v.control_point_count();
    let rows = |p: &PatchInput| p.control_points.chunks(n_v).map(<[_]>::to_vec).collect::<Vec<_>>();
    let (l, mut u) = (rows(&lower), rows(&upper));
    u.reverse();
    // Degree 3 with a double knot: the leading-edge row is the mean of its neighbours and not a control point.
    let control_points: Vec<[f64; 3]> = l[..7].iter().chain(&u[1..]).flatten().copied().collect();
    let k = lower.knots_u.knots();
    let mut knots: Vec<f64> = k[..k.len() - 2].to_vec();
    knots.extend(k.iter().rev().map(|t| 2.0 - t).skip(4));
    let knots_u = KnotVector::new(3, knots).expect("valid");
    let skin = PatchInput {
        name: "skin".into(),
        knots_u,
        knots_v: lower.knots_v.clone(),
        control_points,
        weights: None,
    };
    // Caps between the two halves of the skin's end curves.
    let split = |a: f64, b: f64, end: usize| -> Vec<[f64; 3]> {
        let piece = skin.knots_u.clamped_piece(a, b);
        let column: Vec<[f64; 3]> = skin.control_points.chunks(n_v).map(|r| r[end]).collect();
        let combine = |row: &moldline_spline::LinearRow| {
            let mut p = [0.0; 3];
            for i in 0..row.count {
                for d in 0..3 {
                    p[d] += row.weights[i] * column[row.first + i][d];
                }
            }
            p
        };
        skin.knots_u.refinement(&piece).iter().map(combine).collect()
    };
    for (cap, end) in [(2, 0), (3, n_v - 1)] {
        let (low, mut high) = (split(0.0, 1.0, end), split(1.0, 2.0, end));
        high.reverse();
        patches[cap].control_points = low.iter().zip(&high).flat_map(|(a, b)| [*a, *b]).collect();
    }
    patches.splice(0..2, [skin]);
    let b = body("wing", patches);
    assert_eq!(b.component().patches().len(), 3);
    // No edge along the leading edge now.
    assert_eq!(counts(b.component()), (0, 5, 4));
    assert!(volume(&b) > 0.0);
}

#[test]
fn fuselage_closes_on_itself_and_has_two_poles() {
    let b = body("fuselage", fuselage_patches());
    assert_eq!(counts(b.component()), (1, 0, 2));
    assert!(volume(&b) > 0.0);
    // Normals at the poles: the smooth nose looks forward, along the limit from all sides.
    let domain = b.component().patches()[0].surface.domain();
    let forward = Vector3::new(-1.0, 0.0, 0.0);
    for k in 0..=8 {
        let l = Location { patch: 0, u: domain[0].0, v: k as f64 / 8.0 };
        let near = Location { u: domain[0].0 + 1e-7, ..l };
        assert!((b.normal(&l) - b.normal(&near)).norm() < 1e-5, "limit at v = {}", l.v);
        assert!((b.normal(&l) - forward).norm() < 0.2);
        let tail = Location { u: domain[0].1, ..l };
        let near = Location { u: domain[0].1 - 1e-7, ..l };
        assert!((b.normal(&tail) - b.normal(&near)).norm() < 1e-5);
        assert!(b.normal(&tail).norm() > 0.999);
    }
}

#[test]
fn orientation_does_not_depend_on_the_input() {
    for flip in 0..16u32 {
        let mut patches = wing_patches(Trailing::Wedge);
        for (k, p) in patches.iter_mut().enumerate() {
            if flip & (1 << k) != 0 {
                // Transposed: u and v exchange roles, and the normal turns round.
                let (n_u, n_v) = (p.knots_u.control_point_count(), p.knots_v.control_point_count());
                let old = p.control_points.clone();
                p.control_points = (0..n_u * n_v).map(|i| old[(i % n_u) * n_v + i / n_u]).collect();
                std::mem::swap(&mut p.knots_u, &mut p.knots_v);
            }
        }
        let b = body("wing", patches);
        assert!(volume(&b) > 0.0);
        assert_eq!(counts(b.component()), (1, 5, 4));
        // Far above the upper sheet is outside, between the sheets inside.
        assert!(b.signed_distance(&Vector3::new(11.5, 0.5, 2.0)) > 0.0);
        assert!(b.signed_distance(&Vector3::new(11.5, 0.5, 0.1)) < 0.0);
    }
}

#[test]
fn open_shells_are_refused_unless_allowed() {
    let mut patches = wing_patches(Trailing::Wedge);
    patches.pop();
    match Component::new("wing".into(), patches.clone(), &ComponentOptions::default()) {
        Err(ComponentError::Open { count: 2, .. }) => {}
        other => panic!("expected an open shell, got {:?}", other.map(|c| c.0.edges().len())),
    }
    let options = ComponentOptions { allow_open: true, ..Default::default() };
    let (component, points) = Component::new("wing".into(), patches, &options).expect("allowed");
    assert!(component.is_open());
    assert!(volume(&Body::new(component.into(), points)) > 0.0);
}

#[test]
fn bad_input_is_named() {
    let good = wing_patches(Trailing::Wedge);
    let make = |change: &dyn Fn(&mut PatchInput)| {
        let mut patches = good.clone();
        change(&mut patches[1]);
        Component::new("wing".into(), patches, &ComponentOptions::default()).map(|_| ()).expect_err("refused")
    };
    let e = make(&|p| p.control_points[5][1] = f64::NAN);
    assert!(
        matches!(&e, ComponentError::NotFinite { patch, index: 5, value } if patch == "upper" && value.is_nan())
    );
    let e = make(&|p| p.control_points.truncate(135));
    assert!(matches!(e, ComponentError::ControlPointCount { count: 135, n_u: 8, n_v: 17, .. }));
    let e = make(&|p| p.weights = Some(vec![1.0; 3]));
    assert!(matches!(e, ComponentError::WeightCount { weights: 3, count: 136, .. }));
    let e = make(&|p| {
        let mut w = vec![1.0; 136];
        w[7] = -2.0;
        p.weights = Some(w);
    });
    assert!(matches!(e, ComponentError::Weight { index: 7, value: -2.0, .. }));
    let e = Component::new("nothing".into(), vec![], &ComponentOptions::default())
        .map(|_| ())
        .expect_err("empty");
    assert!(matches!(e, ComponentError::Empty { .. }));
    let mut twice = good.clone();
    twice.push(good[0].clone());
    let e =
        Component::new("wing".into(), twice, &ComponentOptions::default()).map(|_| ()).expect_err("twice");
    assert!(matches!(e, ComponentError::NonManifold { .. }));
}

#[test]
fn user_control_points_map_linearly_and_exactly() {
    // A patch that is unclamped along v: its clamped control points are real combinations.
    let patches = wrapped_wing_patches();
    let user: Vec<[f64; 3]> = patches.iter().flat_map(|p| p.control_points.clone()).collect();
    let (component, points) =
        Component::new("wing".into(), patches, &ComponentOptions::default()).expect("valid");
    assert_eq!(component.internal_control_points(&user), points);
    // Cutting at a full knot only copies: every internal point is one of the user's, bit for bit.
    for p in &points {
        assert!(user.iter().any(|q| q[..] == p[..3]) && p[3] == 1.0);
    }
    // The transpose.
    let mut random = Random::new(5);
    let mut block = |count: usize| {
        let mut block = Block::zeros(count, 6);
        block.data_mut().iter_mut().for_each(|x| *x = random.between(-1.0, 1.0));
        block
    };
    let (direction, seeds) = (block(user.len()), block(points.len()));
    let dot = |a: &Block, b: &Block| -> f64 { a.data().iter().zip(b.data()).map(|(a, b)| a * b).sum() };
    let forward = dot(&seeds, &component.internal_jvp(&direction));
    let backward = dot(&component.internal_vjp(&seeds), &direction);
    assert!((forward - backward).abs() < 1e-12 * forward.abs());
}

#[test]
fn walking_continues_over_smooth_edges_and_stops_at_sharp_ones() {
    let b = body("fuselage", fuselage_patches());
    // Once around the fuselage: back to where the walk started.
    let from = Location { patch: 0, u: 0.6, v: 0.3 };
    let around = b.walk(&from, ParameterDirection::V, 1.0);
    assert!((b.position(&around) - b.position(&from)).norm() < 1e-9 * b.size());
    let back = b.walk(&from, ParameterDirection::V, -0.7);
    assert!((back.v - 0.6).abs() < 1e-9);
    // Into a pole: it ends there.
    assert_eq!(b.walk(&from, ParameterDirection::U, 5.0).u, 1.0);

    // Over the leading edge, where the neighbour runs the other way, and on to the trailing edge.
    let b = body("wing", wing_patches(Trailing::Wedge));
    let from = Location { patch: 0, u: 0.95, v: 0.4 };
    let over = b.walk(&from, ParameterDirection::U, 0.1);
    assert_eq!(over.patch, 1);
    assert!((over.u - 0.95).abs() < 1e-3 && (over.v - 0.4).abs() < 1e-12);
    let end = b.walk(&from, ParameterDirection::U, 3.0);
    assert_eq!((end.patch, end.u), (1, 0.0));
    // The line's speed in space is continuous.
    let step = |d: f64| b.position(&b.walk(&from, ParameterDirection::U, d));
    let before = (step(0.05 - 1e-7) - step(0.05 - 2e-7)).norm();
    let after = (step(0.05 + 2e-7) - step(0.05 + 1e-7)).norm();
    assert!((before - after).abs() < 1e-4 * before);
}
