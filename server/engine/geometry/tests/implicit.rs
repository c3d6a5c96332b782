//! The smooth union against its closed forms and a bisector computed by root finding; gradients against differences.

mod common;

use common::*;
use moldline_geometry::*;

fn primitive(p: &Primitive) -> Body {
    let (component, points) = Component::primitive("p".into(), p).expect("valid");
    Body::new(component.into(), points)
}

/// Two overlapping spheres and one far from both.
const SPHERES: [([f64; 3], f64); 3] =
    [([0.0, 0.0, 0.0], 1.0), ([1.2, 0.3, -0.1], 0.8), ([9.0, 0.0, 0.0], 0.5)];

/// Distance to a sphere and its gradient, from their definitions.
fn sphere_at((center, radius): ([f64; 3], f64), x: &Vector3) -> (f64, Vector3) {
    let d = x - Vector3::from(center);
    (d.norm() - radius, d / d.norm())
}

fn union_at(union: &SmoothUnion, x: &Vector3) -> SmoothUnionPoint {
    union.eval(&SPHERES.map(|s| sphere_at(s, x)), &mut [0.0; 3])
}

#[test]
fn union_of_spheres_has_the_value_and_the_weights_of_its_formula() {
    let mut random = Random::new(1);
    for rho in [0.5, 5.0, 20.0] {
        let union = SmoothUnion { rho };
        for _ in 0..500 {
            let x = random.vector(2.0);
            let distances = SPHERES.map(|s| sphere_at(s, &x));
            let mut weights = [0.0; 3];
            let point = union.eval(&distances, &mut weights);
            // The formula as it stands; these exponents neither overflow nor vanish.
            let sum: f64 = distances.iter().map(|d| (-rho * d.0).exp()).sum();
            assert!((point.phi + sum.ln() / rho).abs() <= 1e-14 * (1.0 + 1.0 / rho));
            for (w, d) in weights.iter().zip(&distances) {
                assert!((w - (-rho * d.0).exp() / sum).abs() < 1e-13);
            }
        }
    }
}

#[test]
fn what_is_out_of_reach_counts_for_nothing() {
    let union = SmoothUnion { rho: 1e6 };
    let components = [(2e3, Vector3::x()), (2e3 + 1.01 * union.reach(), Vector3::y())];
    let mut weights = [f64::NAN; 2];
    let point = union.eval(&components, &mut weights);
    assert_eq!(weights, [1.0, 0.0]);
    assert_eq!((point.phi, point.gradient), (2e3, Vector3::x()));
}

#[test]
fn where_components_are_equally_far_the_union_is_lower_by_its_bias() {
    for rho in [1.0, 1e3] {
        let union = SmoothUnion { rho };
        for (m, log) in [(1, 0.0), (2, std::f64::consts::LN_2), (3, 1.098_612_288_668_109_8)] {
            let components = vec![(0.25, Vector3::x()); m];
            let point = union.eval(&components, &mut vec![0.0; m]);
            assert!((0.25 - point.phi - log / rho).abs() < 1e-15);
            assert!((union.bias(m) - log / rho).abs() < 1e-15);
            assert!((point.gradient - Vector3::x()).norm() < 1e-15);
        }
    }
}

#[test]
fn the_fillet_is_the_distance_from_a_right_angled_seam_along_the_bisector() {
    for fillet in [1e-3, 0.1, 40.0] {
        let union = SmoothUnion::from_fillet(fillet);
        // The half spaces x < 0 and y < 0 meet at the origin; where does the union vanish along the bisector?
        let at = |s: f64| {
            let p = Vector3::new(1.0, 1.0, 0.0).normalize() * s;
            union.eval(&[(p.x, Vector3::x()), (p.y, Vector3::y())], &mut [0.0; 2]).phi
        };
        let (mut low, mut high) = (0.0, 10.0 * fillet);
        assert!(at(low) < 0.0 && at(high) > 0.0);
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if at(middle) < 0.0 { low = middle } else { high = middle }
        }
        assert!((low - fillet).abs() < 1e-12 * fillet, "{low} instead of {fillet}");
        assert!((union.fillet() - fillet).abs() < 1e-12 * fillet);
    }
}

#[test]
fn gradients_of_unions_agree_with_central_differences() {
    let mut random = Random::new(2);
    let union = SmoothUnion { rho: 4.0 };
    let h = 1e-5;
    for _ in 0..500 {
        let x = Vector3::new(0.7, 0.2, 0.0) + random.vector(1.5);
        if SPHERES.iter().any(|s| (x - Vector3::from(s.0)).norm() < 0.1) {
            // The curvature of the distance to a sphere, and with it the error of a difference, grows to its centre.
            continue;
        }
        let point = union_at(&union, &x);
        for k in 0..3 {
            let mut e = Vector3::zeros();
            e[k] = h;
            let difference = (union_at(&union, &(x + e)).phi - union_at(&union, &(x - e)).phi) / (2.0 * h);
            assert!((point.gradient[k] - difference).abs() < 2e-8, "{x:?} {k}");
        }
    }
}

#[test]
fn gradients_of_distances_are_the_outward_normals_of_spheres_and_capsules() {
    let (start, end, radius) = (Vector3::new(1.0, -2.0, 3.0), Vector3::new(2.5, -1.0, 5.0), 0.7);
    let sphere = primitive(&Primitive::Sphere { center: start, radius });
    let capsule = primitive(&Primitive::Capsule { start, end, radius });
    let axis = end - start;
    let mut random = Random::new(3);
    for _ in 0..1000 {
        let x = (start + end) * 0.5 + random.vector(3.0);
        let fraction = ((x - start).dot(&axis) / axis.norm_squared()).clamp(0.0, 1.0);
        for (b, center) in [(&sphere, start), (&capsule, start + axis * fraction)] {
            let out = x - center;
            if out.norm() < 0.05 {
                continue;
            }
            let point = SignedDistance::new(b).eval(&x);
            assert!((point.phi - (out.norm() - radius)).abs() < 1e-12 * b.size());
            // An error of a foot point turns the normal by its ratio to the radius.
            assert!((point.normal - out.normalize()).norm() < 1e-8, "{x:?} {point:?}");
            let near = SignedDistance::new(b).eval_near(&x, &point.foot.location);
            assert!((near.normal - out.normalize()).norm() < 1e-8);
        }
    }
}

#[test]
fn gradients_of_distances_agree_with_central_differences_off_faces_and_edges() {
    let b = body("wing", wing_patches(Trailing::Wedge));
    let mut random = Random::new(4);
    let (h, mut off_face, mut on_face) = (1e-5, 0, 0);
    while off_face < 100 || on_face < 300 {
        let l =
            Location { patch: u32::from(random.unit() < 0.5), u: random.unit().powi(3), v: random.unit() };
        let x = b.position(&l) + random.vector(0.6);
        let point = SignedDistance::new(&b).eval(&x);
        if point.phi < 0.05 {
            // Inside the medial surface is near, where there is no gradient.
            continue;
        }
        *if point.foot.feature == Feature::Face { &mut on_face } else { &mut off_face } += 1;
        for k in 0..3 {
            let mut e = Vector3::zeros();
            e[k] = h;
            let difference = (b.signed_distance(&(x + e)) - b.signed_distance(&(x - e))) / (2.0 * h);
            // Second derivatives jump where foot points pass from a face to an edge: first order there.
            assert!((point.normal[k] - difference).abs() < 1e-4, "{x:?} {k} {point:?}");
        }
    }
}
