//! Foot points against exhaustive search, signs against winding numbers, primitives against their analytic distances.

mod common;

use common::*;
use moldline_geometry::*;

/// Points spread around a body: anywhere in a box twice its size, and off its surface by lengths of all orders.
fn scattered(b: &Body, count: usize, random: &mut Random) -> Vec<Vector3> {
    let bounds = b.bounds();
    let patches = b.component().patches();
    (0..count)
        .map(|k| {
            if k % 3 == 0 {
                let e = (bounds.high - bounds.low).add_scalar(0.3 * bounds.diagonal());
                return bounds.center() + random.vector(0.5).component_mul(&e);
            }
            let patch = ((random.unit() * patches.len() as f64) as usize).min(patches.len() - 1);
            let [u, v] = patches[patch].surface.domain();
            let mut l =
                Location { patch: patch as u32, u: random.between(u.0, u.1), v: random.between(v.0, v.1) };
            if k % 3 == 1 {
                // Close to a side of the patch: edges, tips, poles.
                let e = random.logarithmic(1e-9, 1e-1);
                match k % 4 {
                    0 => l.u = u.0 + e * (u.1 - u.0),
                    1 => l.u = u.1 - e * (u.1 - u.0),
                    2 => l.v = v.0 + e * (v.1 - v.0),
                    _ => l.v = v.1 - e * (v.1 - v.0),
                }
            }
            let scale = random.logarithmic(1e-9, 1e-1) * b.size();
            b.position(&l) + random.vector(scale)
        })
        .collect()
}

fn check_against_exhaustive(b: &Body, count: usize, seed: u64) {
    let reference = Exhaustive::new(b, 8, 40);
    let mut random = Random::new(seed);
    let mut wrong = Vec::new();
    for x in scattered(b, count, &mut random) {
        let foot = b.closest_point(&x);
        assert!(((foot.position - x).norm() - foot.distance.abs()).abs() < 1e-12 * b.size());
        assert_eq!(b.position(&foot.location), foot.position);
        let expected = reference.distance(b, &x);
        // The reference can only be too far; ours must not be further.
        if foot.distance.abs() > expected + 1e-12 * b.size() {
            wrong.push((x, foot.distance, expected));
        }
        // And ours is attained, so that it cannot be too near; the reference must find it unless its seeds missed.
        assert!(foot.distance.abs() > expected - 0.2 * b.size());
    }
    assert!(wrong.is_empty(), "{} of {count} wrong, first {:?}", wrong.len(), wrong[0]);
}

#[test]
fn wing_is_never_beaten_by_exhaustive_search() {
    check_against_exhaustive(&body("wing", wing_patches(Trailing::Wedge)), 3000, 1);
    check_against_exhaustive(&body("wing", wing_patches(Trailing::Cusp)), 1500, 2);
}

#[test]
fn wrapped_wing_is_never_beaten_by_exhaustive_search() {
    check_against_exhaustive(&body("wing", wrapped_wing_patches()), 1500, 3);
}

#[test]
fn fuselage_is_never_beaten_by_exhaustive_search() {
    check_against_exhaustive(&body("fuselage", fuselage_patches()), 3000, 4);
}

#[test]
fn bar_is_never_beaten_by_exhaustive_search() {
    check_against_exhaustive(&body("bar", bar_patches()), 1500, 5);
}

/// The sign of the distance against the winding number of a triangulation, wherever the triangulation's own error (its
/// distance from the surface) cannot change the answer.
fn check_signs(b: &Body, per_interval: [usize; 2], count: usize, seed: u64, error: f64) {
    let triangulation = Triangulation::new(b, per_interval);
    let mut random = Random::new(seed);
    let (mut checked, mut off_face) = (0, 0);
    for x in scattered(b, count, &mut random) {
        let foot = b.closest_point(&x);
        if foot.distance.abs() <= error * b.size() {
            continue;
        }
        let winding = triangulation.winding_number(&x);
        assert!((winding - winding.round()).abs() < 1e-6, "the triangulation is not closed: {winding}");
        assert_eq!(foot.distance < 0.0, winding > 0.5, "{x:?}: {foot:?}, winding {winding}");
        checked += 1;
        off_face += usize::from(foot.feature != Feature::Face);
    }
    assert!(checked > count / 3, "{checked}");
    assert!(off_face > 0);
}

#[test]
fn signs_agree_with_winding_numbers() {
    check_signs(&body("wing", wing_patches(Trailing::Wedge)), [12, 10], 4000, 11, 1e-4);
    check_signs(&body("wing", wing_patches(Trailing::Cusp)), [12, 10], 4000, 12, 1e-4);
    check_signs(&body("wing", wrapped_wing_patches()), [12, 10], 2000, 13, 1e-4);
    check_signs(&body("fuselage", fuselage_patches()), [8, 8], 4000, 14, 1e-3);
}

#[test]
fn signs_at_convex_and_concave_edges_and_corners() {
    // Flat faces: the triangulation is exact.
    check_signs(&body("bar", bar_patches()), [1, 1], 20_000, 15, 1e-12);
}

#[test]
fn primitives_have_their_analytic_distances() {
    let c = Vector3::new(1.0, -2.0, 3.0);
    let d = Vector3::new(2.5, -1.0, 5.0);
    let primitives = [
        Primitive::Sphere { center: c, radius: 1.3 },
        Primitive::Box { low: c, high: d },
        Primitive::Cylinder { start: c, end: d, radius: 0.7 },
        Primitive::Capsule { start: c, end: d, radius: 0.7 },
    ];
    for scale in [1.0, 1e-4, 1e5] {
        for p in &primitives {
            let p = match *p {
                Primitive::Sphere { center, radius } => {
                    Primitive::Sphere { center: center * scale, radius: radius * scale }
                }
                Primitive::Box { low, high } => Primitive::Box { low: low * scale, high: high * scale },
                Primitive::Cylinder { start, end, radius } => {
                    Primitive::Cylinder { start: start * scale, end: end * scale, radius: radius * scale }
                }
                Primitive::Capsule { start, end, radius } => {
                    Primitive::Capsule { start: start * scale, end: end * scale, radius: radius * scale }
                }
            };
            let (component, points) = Component::primitive("p".into(), &p).expect("valid");
            let b = Body::new(component.into(), points);
            let mut random = Random::new(21);
            for x in scattered(&b, 2000, &mut random) {
                let (ours, exact) = (b.signed_distance(&x), p.signed_distance(&x));
                assert!(
                    (ours - exact).abs() <= 1e-12 * b.size(),
                    "{p:?} at {x:?}: {ours} instead of {exact}"
                );
            }
        }
    }
}

#[test]
fn points_with_a_continuum_of_nearest_points_get_one_of_them() {
    let c = Vector3::new(1.0, -2.0, 3.0);
    let (component, points) =
        Component::primitive("s".into(), &Primitive::Sphere { center: c, radius: 2.0 }).expect("valid");
    let b = Body::new(component.into(), points);
    assert!((b.signed_distance(&c) + 2.0).abs() < 1e-12);
    let d = c + Vector3::new(0.0, 3.0, 1.0);
    let (component, points) =
        Component::primitive("c".into(), &Primitive::Cylinder { start: c, end: d, radius: 0.5 })
            .expect("valid");
    let b = Body::new(component.into(), points);
    assert!((b.signed_distance(&((c + d) * 0.5)) + 0.5).abs() < 1e-12);
}

#[test]
fn distances_within_a_bound() {
    let b = body("wing", wing_patches(Trailing::Wedge));
    let mut random = Random::new(31);
    for x in scattered(&b, 2000, &mut random) {
        let foot = b.closest_point(&x);
        let d = foot.distance.abs();
        let within = b.closest_point_within(&x, d * 1.001 + 1e-9).expect("within");
        assert!((within.distance - foot.distance).abs() < 1e-12 * b.size());
        assert!(b.closest_point_within(&x, d * 0.999 - 1e-9 * b.size()).is_none());
    }
}

#[test]
fn near_a_good_hint_the_local_foot_point_is_the_global_one() {
    for b in [body("wing", wing_patches(Trailing::Wedge)), body("fuselage", fuselage_patches())] {
        let mut random = Random::new(41);
        let (mut tried, mut found) = (0, 0);
        for x in scattered(&b, 3000, &mut random) {
            let foot = b.closest_point(&x);
            // From the global foot point itself the descent stays.
            let again = b.closest_point_near(&x, &foot.location);
            assert!(
                again.is_some_and(|a| (a.distance - foot.distance).abs() < 1e-11 * b.size()),
                "{x:?} {foot:?} {again:?}"
            );
            // A point a little outside its foot point on a face, hinted from close by. Within thin edges and at poles
            // the local minimum near the hint may rightly be another one.
            if foot.feature != Feature::Face {
                continue;
            }
            tried += 1;
            let y = foot.position + foot.normal * (1e-4 * b.size() * random.unit());
            let global = b.closest_point(&y);
            let hint = b.walk(&foot.location, ParameterDirection::V, 0.02 * (random.unit() - 0.5));
            let near = b.closest_point_near(&y, &hint);
            found += usize::from(
                near.is_some_and(|near| (near.distance - global.distance).abs() < 1e-11 * b.size()),
            );
        }
        assert!(tried > 1000 && 100 * found >= 99 * tried, "{found} of {tried}");
    }
}

#[test]
fn a_hint_keeps_to_its_sheet() {
    // A little above the upper sheet of the thin trailing edge, hinted from the lower one.
    let b = body("wing", wing_patches(Trailing::Wedge));
    let hint = Location { patch: 0, u: 0.08, v: 0.3 };
    let upper = Location { patch: 1, ..hint };
    let x = b.position(&upper) + b.normal(&upper) * 1e-4;
    let global = b.closest_point(&x);
    assert_eq!(global.location.patch, 1);
    let near = b.closest_point_near(&x, &hint).expect("converges");
    assert_eq!(near.location.patch, 0);
    assert!(near.normal.dot(&b.normal(&hint)) > 0.9);
}

#[test]
fn foot_points_along_an_edge() {
    let b = body("wing", wing_patches(Trailing::Wedge));
    let (edge, e) = b
        .component()
        .edges()
        .iter()
        .enumerate()
        .find(|(_, e)| e.sharp && e.sides.iter().all(|s| s.side == Side::UMin))
        .expect("a trailing edge");
    assert_eq!(e.sides.len(), 2);
    let mut random = Random::new(51);
    for _ in 0..500 {
        let on = Location { patch: 0, u: 0.0, v: random.between(0.02, 0.98) };
        let x = b.position(&on) + random.vector(0.2);
        let hint = Location { v: (on.v + random.between(-0.02, 0.02)).clamp(0.0, 1.0), ..on };
        let foot = b.closest_point_on_edge(&x, edge as u32, &hint);
        assert_eq!(foot.feature, Feature::Edge { edge: edge as u32 });
        let tangent = b.point(&foot.location).d_v;
        assert!((x - foot.position).dot(&tangent).abs() < 1e-12 * tangent.norm() * b.size());
        let other = b.closest_point_on_edge(&x, edge as u32, &Location { patch: 1, u: 0.5, v: 0.5 });
        assert!((other.distance.abs() - foot.distance.abs()).abs() < 1e-12);
    }
}

/// Runs a search on a stack that unbounded recursion would exhaust at once.
fn on_a_small_stack(search: impl FnOnce() + Send + 'static) {
    let thread = std::thread::Builder::new().stack_size(512 << 10).spawn(search).expect("a thread");
    thread.join().expect("the search ends");
}

#[test]
fn far_from_the_origin_searches_end_and_are_as_exact_as_the_coordinates() {
    // From 100 m on, halved pieces of a body of a few metres no longer become smaller than 1e-14 of it.
    on_a_small_stack(|| {
        let mut random = Random::new(61);
        let d = Vector3::new(2.5, 0.5, 1.0);
        for far in [1e2, 1e4, 1e6, 1e9, 1e12] {
            let c = Vector3::new(far, -0.3 * far, 0.1 * far);
            for here in [
                Primitive::Sphere { center: Vector3::zeros(), radius: 1.3 },
                Primitive::Cylinder { start: Vector3::zeros(), end: d, radius: 0.4 },
                Primitive::Capsule { start: Vector3::zeros(), end: d, radius: 0.4 },
            ] {
                // Moved as a design moves them: the patches fit at the origin, and far away no longer to the last bit.
                let (component, points) = Component::primitive("p".into(), &here).expect("valid");
                let moved = |p: &[f64; 4]| [p[0] + p[3] * c.x, p[1] + p[3] * c.y, p[2] + p[3] * c.z, p[3]];
                let b = Body::new(component.into(), points.iter().map(moved).collect());
                let near = scattered(&b, 60, &mut random);
                let from_afar = (0..20).map(|_| random.vector(3.0));
                for x in near.into_iter().chain(from_afar).chain([c, c + d * 0.5]) {
                    let (ours, exact) = (b.signed_distance(&x), here.signed_distance(&(x - c)));
                    let rounding = 1e-12 * b.size() + 64.0 * f64::EPSILON * far;
                    assert!(
                        (ours.abs() - exact.abs()).abs() <= rounding,
                        "{here:?} at {x:?}: {ours}, {exact}"
                    );
                }
            }
        }
    });
}

#[test]
fn searches_end_whatever_the_control_points() {
    on_a_small_stack(|| {
        let patches = wing_patches(Trailing::Wedge);
        let wing = body("wing", patches);
        let mut random = Random::new(62);
        let extremes = [0.0, 1e-300, 1e-160, 1e150, 1e200, 1e308, f64::INFINITY, f64::NAN];
        for extreme in extremes {
            let mut points = wing.control_points().to_vec();
            for point in points.iter_mut().step_by(7) {
                point[0] = extreme;
            }
            let spoilt = Body::new(wing.component().clone(), points);
            let all = Body::new(
                wing.component().clone(),
                wing.control_points().iter().map(|p| [p[0] * extreme, p[1] * extreme, p[2], p[3]]).collect(),
            );
            for b in [spoilt, all] {
                for x in [random.vector(1.0), random.vector(20.0), Vector3::repeat(extreme)] {
                    let foot = b.closest_point(&x);
                    assert!((foot.location.patch as usize) < b.component().patches().len());
                    b.closest_point_near(&x, &foot.location);
                }
            }
        }
    });
}

#[test]
fn patches_of_absurd_size_or_weights_are_refused() {
    let scaled = |scale: f64| {
        let mut patches = wing_patches(Trailing::Wedge);
        patches.iter_mut().for_each(|p| p.control_points.iter_mut().for_each(|c| *c = c.map(|x| x * scale)));
        Component::new("wing".into(), patches, &ComponentOptions::default())
    };
    assert!(scaled(1e-20).is_ok() && scaled(1e20).is_ok());
    for scale in [1e-40, 1e40, 1e300] {
        let error = scaled(scale).expect_err("too small or too large");
        assert!(matches!(error, ComponentError::Size { .. }), "{error}");
    }
    for weight in [0.0, -1.0, 1e-10, 1e10, f64::NAN] {
        let mut patches = wing_patches(Trailing::Wedge);
        let count = patches[0].control_points.len();
        patches[0].weights = Some((0..count).map(|i| if i == 5 { weight } else { 1.0 }).collect());
        let error = Component::new("wing".into(), patches, &ComponentOptions::default()).expect_err("weight");
        assert!(matches!(error, ComponentError::Weight { index: 5, .. }), "{error}");
    }
}
