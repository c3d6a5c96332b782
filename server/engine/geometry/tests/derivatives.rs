//! First and second-order terms of signed distances, unions and walks, against closed forms and differences of
//! evaluations.

mod common;

use common::*;
use moldline_geometry::*;

/// Fourth-order central difference.
fn difference<const N: usize>(h: f64, f: impl Fn(f64) -> [f64; N]) -> [f64; N] {
    let [a, b, c, d] = [f(-2.0 * h), f(-h), f(h), f(2.0 * h)];
    std::array::from_fn(|k| (a[k] - d[k] + 8.0 * (c[k] - b[k])) / (12.0 * h))
}

fn assert_near(found: &[f64], expected: &[f64], tolerance: f64, what: &str) {
    let scale = expected.iter().fold(1.0_f64, |m, x| m.max(x.abs()));
    let error = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(error <= tolerance * scale, "{what}: {found:?} instead of {expected:?}");
}

/// The body with control points moved by `t` along `direction` (internal, homogeneous).
fn moved(body: &Body, direction: &Block, t: f64) -> Body {
    let mut points = body.control_points().to_vec();
    for (i, p) in points.iter_mut().enumerate() {
        (0..3).for_each(|k| p[k] += t * direction.row(i)[k]);
    }
    Body::new(body.component().clone(), points)
}

fn random_motion(body: &Body, random: &mut Random) -> Block {
    let mut user = Block::zeros(body.component().user_control_point_count(), 3);
    user.data_mut().iter_mut().for_each(|x| *x = random.between(-1.0, 1.0));
    body.component().internal_jvp(&user)
}

fn change(body: &Body, at: &Location, direction: &Block, dx: Vector3) -> FootChange {
    let mut rows = Block::zeros(3, 3);
    body.basis(at).point_jvp(direction, &mut rows);
    FootChange { x: dx, s: rows.vector(0, 0), s_uv: [rows.vector(1, 0), rows.vector(2, 0)] }
}

fn bodies() -> Vec<(Body, f64)> {
    let sphere = Primitive::Sphere { center: Vector3::new(0.3, 0.0, -0.2), radius: 1.3 };
    let (component, points) = Component::primitive("sphere".into(), &sphere).expect("valid");
    vec![
        (body("wing", wing_patches(Trailing::Wedge)), 0.6),
        (body("fuselage", fuselage_patches()), 0.8),
        (Body::new(component.into(), points), 0.5),
        (body("bar", bar_patches()), 0.8),
    ]
}

#[test]
fn surface_points_are_linear_in_the_control_points() {
    let mut random = Random::new(3);
    for (b, _) in bodies() {
        let direction = random_motion(&b, &mut random);
        let next = moved(&b, &direction, 1.0);
        for (i, p) in b.component().patches().iter().enumerate() {
            let [u, v] = p.surface.domain();
            let at = Location { patch: i as u32, u: random.between(u.0, u.1), v: random.between(v.0, v.1) };
            let mut rows = Block::zeros(3, 3);
            b.basis(&at).point_jvp(&direction, &mut rows);
            let (before, after) = (b.point(&at), next.point(&at));
            let differences =
                [after.position - before.position, after.d_u - before.d_u, after.d_v - before.d_v];
            for (k, expected) in differences.iter().enumerate() {
                assert_near(rows.row(k), expected.as_slice(), 1e-12, "linear");
            }
        }
    }
}

#[test]
fn distance_normal_and_parameters_change_as_differences_do() {
    let mut random = Random::new(11);
    let mut on_edges = 0;
    for (b, spread) in bodies() {
        let mut checked = 0;
        while checked < 60 {
            let patch = (random.unit() * b.component().patches().len() as f64) as u32;
            let [u, v] = b.component().patches()[patch as usize].surface.domain();
            let at = Location { patch, u: random.between(u.0, u.1), v: random.between(v.0, v.1) };
            let x = b.position(&at) + random.vector(spread);
            let distance = SignedDistance::new(&b);
            let value = distance.eval(&x);
            if value.foot.feature == Feature::Face
                && b.component().edge_of(&value.foot.location, 1e-3).is_some()
            {
                continue;
            }
            let direction = random_motion(&b, &mut random);
            let dx = random.vector(1.0);
            let h = 1e-5;
            let steps = [-2.0 * h, -h, h, 2.0 * h].map(|t| {
                SignedDistance::new(&moved(&b, &direction, t)).eval_near(&(x + dx * t), &value.foot.location)
            });
            // At a collapsed side control points that coincide move apart, and the foot point may jump between them.
            let same = |p: &SignedDistancePoint| {
                let (here, there) = (p.foot.location, value.foot.location);
                let jump = (here.u - there.u).abs().max((here.v - there.v).abs());
                p.foot.feature == value.foot.feature && here.patch == there.patch && jump < 0.1
            };
            if !steps.iter().all(same) || value.phi.abs() < 1e-3 {
                continue;
            }
            let expected = difference(h, |t| {
                let p =
                    steps[[-2.0, -1.0, 1.0, 2.0].iter().position(|s| *s == (t / h).round()).expect("a step")];
                [p.phi, p.normal.x, p.normal.y, p.normal.z, p.foot.location.u, p.foot.location.v]
            });
            let derivative = distance.derivative(&x, &value.foot);
            let change = change(&b, &value.foot.location, &direction, dx);
            let (phi, n) = derivative.jvp(&change);
            let mu = derivative.parameters_jvp(&change);
            let found = [phi, n.x, n.y, n.z, mu[0], mu[1]];
            assert_near(&found, &expected, 1e-6, &format!("{} at {:?}", b.component().name(), value.foot));
            on_edges += usize::from(value.foot.feature != Feature::Face);
            checked += 1;
        }
    }
    assert!(on_edges > 10, "edges and corners are among the foot points: {on_edges}");
}

#[test]
fn products_with_the_transpose_agree() {
    let mut random = Random::new(12);
    let dot = |a: &FootChange, b: &FootChange| {
        a.x.dot(&b.x) + a.s.dot(&b.s) + a.s_uv[0].dot(&b.s_uv[0]) + a.s_uv[1].dot(&b.s_uv[1])
    };
    for (b, spread) in bodies() {
        for _ in 0..50 {
            let l = Location { patch: 0, u: random.unit(), v: random.unit() };
            let x = b.position(&l) + random.vector(spread);
            let foot = b.closest_point(&x);
            let d = SignedDistance::new(&b).derivative(&x, &foot);
            let change = FootChange {
                x: random.vector(1.0),
                s: random.vector(1.0),
                s_uv: [random.vector(1.0), random.vector(1.0)],
            };
            let (a, n, m) = (random.unit(), random.vector(1.0), [random.unit(), random.unit()]);
            let (phi, dn) = d.jvp(&change);
            let mu = d.parameters_jvp(&change);
            let close = |forward: f64, backward: f64, what: &str| {
                let scale = 1.0 + forward.abs().max(dn.norm()).max(mu[0].abs()).max(mu[1].abs());
                assert!((forward - backward).abs() <= 1e-11 * scale, "{what}: {forward} {backward}");
            };
            close(a * phi + n.dot(&dn), dot(&d.vjp(a, &n), &change), "distance");
            close(m[0] * mu[0] + m[1] * mu[1], dot(&d.parameters_vjp(m), &change), "parameters");
            close(n.dot(&d.foot_jvp(&change)), dot(&d.foot_vjp(&n), &change), "foot");
        }
    }
}

#[test]
fn a_sphere_has_the_hessian_of_its_distance() {
    let sphere = Primitive::Sphere { center: Vector3::zeros(), radius: 2.0 };
    let (component, points) = Component::primitive("sphere".into(), &sphere).expect("valid");
    let b = Body::new(component.into(), points);
    let mut random = Random::new(13);
    for _ in 0..50 {
        let n = random.vector(1.0).normalize();
        let x = n * random.between(1.0, 3.0);
        let foot = b.closest_point(&x);
        let dx = random.vector(1.0);
        let (phi, dn) =
            SignedDistance::new(&b).derivative(&x, &foot).jvp(&FootChange { x: dx, ..FootChange::default() });
        // grad = x / |x|, Hessian = (I - n n^T) / |x|.
        assert!((phi - n.dot(&dx)).abs() < 1e-12);
        assert!((dn - (dx - n * n.dot(&dx)) / x.norm()).norm() < 1e-10);
    }
}

#[test]
fn the_union_changes_as_differences_do() {
    let mut random = Random::new(14);
    for rho in [0.7, 4.0] {
        let union = SmoothUnion { rho };
        let parts: Vec<(f64, Vector3)> =
            (0..3).map(|_| (random.between(-0.5, 0.5), random.vector(1.0))).collect();
        let changes: Vec<(f64, Vector3)> =
            (0..3).map(|_| (random.between(-1.0, 1.0), random.vector(1.0))).collect();
        let expected = difference(1e-4, |t| {
            let at: Vec<_> =
                parts.iter().zip(&changes).map(|(p, c)| (p.0 + t * c.0, p.1 + c.1 * t)).collect();
            let point = union.eval(&at, &mut [0.0; 3]);
            [point.phi, point.gradient.x, point.gradient.y, point.gradient.z]
        });
        let mut weights = [0.0; 3];
        let point = union.eval(&parts, &mut weights);
        let (phi, g) = union.jvp(&weights, parts.iter().map(|p| p.1), &changes);
        assert_near(&[phi, g.x, g.y, g.z], &expected, 1e-10, "union");

        let (a, b) = (random.unit(), random.vector(1.0));
        let forward = a * phi + b.dot(&g);
        let backward: f64 = (0..3)
            .map(|c| {
                let (phi, n) = union.vjp(weights[c], &parts[c].1, &point.gradient, a, &b);
                phi * changes[c].0 + n.dot(&changes[c].1)
            })
            .sum();
        assert!((forward - backward).abs() < 1e-13);
    }
}

#[test]
fn walks_change_as_differences_do() {
    // Over leading edges (the neighbour runs the other way), around the fuselage, to the ends of surfaces.
    let cases = [
        (
            body("wing", wing_patches(Trailing::Wedge)),
            Location { patch: 0, u: 0.95, v: 0.4 },
            [0.12, -0.3, 3.0],
        ),
        (body("wing", wrapped_wing_patches()), Location { patch: 0, u: 0.8, v: 0.4 }, [0.3, -0.2, 0.9]),
        (body("fuselage", fuselage_patches()), Location { patch: 0, u: 0.6, v: 0.3 }, [0.9, -0.7, 0.1]),
        (body("bar", bar_patches()), Location { patch: 6, u: 0.6, v: 0.3 }, [0.2, 0.8, -0.9]),
    ];
    let mut crossed = 0;
    for (b, from, lengths) in cases {
        for along in [ParameterDirection::U, ParameterDirection::V] {
            for length in lengths {
                let walk = b.walk_derivative(&from, along, length);
                assert_eq!(walk.end, b.walk(&from, along, length));
                crossed += usize::from(walk.end.patch != from.patch);
                let uv = |l: Location| {
                    assert_eq!(l.patch, walk.end.patch);
                    [l.u, l.v]
                };
                let start = |du: f64, dv: f64| Location { patch: from.patch, u: from.u + du, v: from.v + dv };
                let by_u = difference(1e-5, |t| uv(b.walk(&start(t, 0.0), along, length)));
                let by_v = difference(1e-5, |t| uv(b.walk(&start(0.0, t), along, length)));
                let by_length = difference(1e-5, |t| uv(b.walk(&from, along, length + t)));
                let found = [0, 1].map(|k| [walk.by_start[k][0], walk.by_start[k][1], walk.by_length[k]]);
                for k in 0..2 {
                    assert_near(&found[k], &[by_u[k], by_v[k], by_length[k]], 1e-7, "walk");
                }
            }
        }
    }
    assert!(crossed > 3, "some walks cross into another patch: {crossed}");
}
