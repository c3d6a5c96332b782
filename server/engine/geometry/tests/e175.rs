//! Foot points on the components of `examples/e175`, globally and from hints.

mod common;

use common::*;
use moldline_geometry::*;
use moldline_spline::KnotVector;

fn e175(name: &str) -> Body {
    let path = format!("{}/../../../examples/e175/geometry/{name}.json", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(&path).expect("the example is part of the repository");
    let json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let array = |v: &serde_json::Value| v.as_array().expect("an array").clone();
    let number = |v: &serde_json::Value| v.as_f64().expect("a number");
    let knots = |p: &serde_json::Value, along: &str| {
        let degree = p[format!("degree_{along}")].as_u64().expect("a degree") as usize;
        let knots = array(&p[format!("knots_{along}")]).iter().map(number).collect();
        KnotVector::new(degree, knots).expect("valid knots")
    };
    let patches = array(&json["patches"])
        .iter()
        .map(|p| PatchInput {
            name: p["name"].as_str().expect("a name").into(),
            knots_u: knots(p, "u"),
            knots_v: knots(p, "v"),
            control_points: array(&p["control_points"])
                .iter()
                .flat_map(array)
                .map(|point| [0, 1, 2].map(|k| number(&point[k])))
                .collect(),
            weights: None,
        })
        .collect();
    body(name, patches)
}

fn anywhere(b: &Body, random: &mut Random) -> Location {
    let patches = b.component().patches();
    let patch = ((random.unit() * patches.len() as f64) as usize).min(patches.len() - 1);
    let [u, v] = patches[patch].surface.domain();
    Location { patch: patch as u32, u: random.between(u.0, u.1), v: random.between(v.0, v.1) }
}

/// 15,000 points, half around the wing and half off its surface by lengths of all orders.
#[test]
fn foot_points_on_the_wing_are_never_beaten_by_exhaustive_search() {
    let b = e175("wing");
    let bounds = b.bounds();
    let extent = (bounds.high - bounds.low).add_scalar(0.2 * b.size());
    let reference = Exhaustive::new(&b, 6, 40);
    let mut random = Random::new(7);
    let mut wrong = Vec::new();
    for k in 0..15_000 {
        let x = if k % 2 == 0 {
            bounds.center() + random.vector(0.5).component_mul(&extent)
        } else {
            let l = anywhere(&b, &mut random);
            let scale = random.logarithmic(1e-8, 1e-1) * b.size();
            b.position(&l) + random.vector(scale)
        };
        let foot = b.closest_point(&x);
        assert!(((b.position(&foot.location) - x).norm() - foot.distance.abs()).abs() < 1e-12 * b.size());
        let expected = reference.distance(&b, &x);
        if foot.distance.abs() > expected + 1e-12 * b.size() {
            wrong.push((x, foot.distance, expected));
        }
    }
    assert!(wrong.is_empty(), "{} wrong, first {:?}", wrong.len(), wrong[0]);
}

/// Points on and off the fuselage from hints up to 5 m away, as when a wing slides along it, and from both poles.
#[test]
fn descent_slides_along_the_fuselage_from_far_hints() {
    let b = e175("fuselage");
    let [u, _] = b.component().patches()[0].surface.domain();
    let mut random = Random::new(5);
    let mut tried = 0;
    while tried < 2000 {
        let target = anywhere(&b, &mut random);
        let x = b.position(&target) + b.normal(&target) * [0.0, 0.01, 0.3][tried % 3];
        let mut hint = anywhere(&b, &mut random);
        match tried % 10 {
            8 => hint.u = u.0,
            9 => hint.u = u.1,
            _ => {}
        }
        // From around a corner of the section the nearest point need not be downhill: the tail cone is tall and narrow.
        let same_side = b.normal(&hint).dot(&b.normal(&target)) > 0.7;
        let pole = hint.u == u.0 || hint.u == u.1;
        if (b.position(&hint) - x).norm() > 5.0 || !(same_side || pole) {
            continue;
        }
        tried += 1;
        let near = b.closest_point_near(&x, &hint).expect("converges");
        let global = b.closest_point(&x);
        assert!(
            (near.distance - global.distance).abs() < 1e-10 * b.size(),
            "{x:?} from {hint:?}: {near:?} instead of {global:?}"
        );
    }
}

/// From any good hint beside the foot point, also where caps narrow to nothing and feet lie on edges.
#[test]
fn descent_from_a_good_hint_finds_the_foot_point_on_the_wing() {
    let b = e175("wing");
    let bounds = b.bounds();
    let extent = (bounds.high - bounds.low).add_scalar(0.2 * b.size());
    let mut random = Random::new(9);
    for _ in 0..5000 {
        let x = bounds.center() + random.vector(0.5).component_mul(&extent);
        let foot = b.closest_point(&x);
        // On the way to its foot point a point keeps it.
        let y = foot.position + (x - foot.position) * 0.1;
        let hint = Location { u: foot.location.u + 1e-3, v: foot.location.v + 1e-3, ..foot.location };
        let near = b.closest_point_near(&y, &hint).expect("converges");
        assert!((near.distance.abs() - 0.1 * foot.distance.abs()).abs() < 1e-11 * b.size(), "{x:?} {near:?}");
    }
}
