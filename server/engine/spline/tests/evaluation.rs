//! Values and derivatives against scipy's BSpline (literal tables), closed forms and differences.
#![allow(missing_docs)]

use moldline_spline::*;
use std::f64::consts::FRAC_1_SQRT_2;

const KNOTS: [f64; 13] = [0.0, 0.0, 0.0, 0.0, 0.3, 0.5, 0.5, 0.9, 1.4, 2.0, 2.0, 2.0, 2.0];

fn close(a: &Vector3, b: [f64; 3], tolerance: f64) -> bool {
    (a - Vector3::from(b)).norm() <= tolerance * (1.0 + Vector3::from(b).norm())
}

#[test]
fn cubic_curve_agrees_with_scipy() {
    let points: Vec<[f64; 4]> = (0..9)
        .map(|i| i as f64)
        .map(|i| [(1.7 * i).sin() + 0.1 * i, (2.3 * i).cos(), 0.5 * i - 0.03 * i * i, 1.0])
        .collect();
    let curve = Curve::new(KnotVector::new(3, KNOTS.to_vec()).expect("valid"));
    let table = [
        (
            0.2,
            [0.39895521699206427, -0.21990703503934267, 0.7013037037037038],
            [-3.9823789012347524, 1.7019141140951055, 2.6128888888888886],
            [-30.324379528257804, 50.396735409821076, -5.937777777777775],
        ),
        (
            0.5,
            [-0.11917200450561888, 0.218868859615517, 1.3266666666666667],
            [7.599640167331701, -8.952843607647603, 1.4500000000000002],
            [-31.258638145243808, 69.0666910408575, -3.4166666666666607],
        ),
        (
            1.99,
            [1.5815234957229276, 0.8114794070376259, 2.0774916927609426],
            [7.641687247513003, 8.709607370209008, 0.25165883838383785],
            [24.32532191533751, 41.030000287051735, -0.16510101010101863],
        ),
        (
            2.0,
            [1.6591618148564957, 0.9006401723847685, 2.08],
            [7.886494635467644, 9.123864862289494, 0.25],
            [24.636155675590548, 41.82149812904541, -0.1666666666666714],
        ),
    ];
    for (u, s, d, dd) in table {
        let jet = curve.jet(&points, u);
        assert!(close(&jet.position, s, 1e-13), "{u}");
        assert!(close(&jet.d, d, 1e-13), "{u}");
        assert!(close(&jet.dd, dd, 1e-13), "{u}");
        assert_eq!(jet.position, curve.position(&points, u));
    }
}

#[test]
fn unclamped_quadratic_agrees_with_scipy() {
    let knots = KnotVector::new(2, vec![-0.4, 0.0, 0.3, 0.7, 1.1, 1.2, 2.0, 2.5]).expect("valid");
    assert_eq!(knots.domain(), (0.3, 1.2));
    assert!(!knots.is_clamped());
    let points: Vec<[f64; 4]> =
        (0..5).map(|i| i as f64).map(|i| [(1.1 * i).sin(), (0.9 * i).cos(), 0.2 * i * i, 1.0]).collect();
    let curve = Curve::new(knots.clone());
    let jet = curve.jet(&points, 0.9);
    assert!(close(&jet.position, [0.6255868537572531, -0.25647459628741304, 0.9250000000000003], 1e-14));
    assert!(close(&jet.d, [-2.035872891227984, -2.4147551733526376, 2.7500000000000004], 1e-14));
    assert!(close(&jet.dd, [-9.145477503116851, -1.4636250797162944, 6.250000000000002], 1e-13));
    let end = curve.jet(&points, 7.0);
    assert!(close(&end.position, [-0.24595195855950044, -0.9032595058300708, 1.9555555555555555], 1e-14));

    // Clamping does not change the curve.
    let clamped = knots.clamped_piece(0.3, 1.2);
    assert!(clamped.is_clamped());
    let moved: Vec<[f64; 4]> = combine(&knots.refinement(&clamped), &points);
    let same = Curve::new(clamped);
    for k in 0..=40 {
        let u = 0.3 + 0.9 * k as f64 / 40.0;
        assert!((curve.position(&points, u) - same.position(&moved, u)).norm() < 1e-14);
    }
}

fn combine(rows: &[LinearRow], points: &[[f64; 4]]) -> Vec<[f64; 4]> {
    rows.iter()
        .map(|row| {
            let mut p = [0.0; 4];
            for k in 0..row.count {
                for d in 0..4 {
                    p[d] += row.weights[k] * points[row.first + k][d];
                }
            }
            p
        })
        .collect()
}

#[test]
fn surface_agrees_with_scipy() {
    let knots_v = KnotVector::new(2, vec![0.0, 0.0, 0.0, 0.4, 0.7, 1.0, 1.0, 1.0]).expect("valid");
    let knots_u = KnotVector::new(3, KNOTS.to_vec()).expect("valid");
    let mut points = Vec::new();
    for i in (0..9).map(|i| i as f64) {
        for j in (0..5).map(|j| j as f64) {
            let z = (i * 0.9).sin() * (j * 1.1).cos();
            points.push([i + 0.3 * (j * 1.3 + i).sin(), j - 0.2 * (i * 0.7).cos(), z, 1.0]);
        }
    }
    let surface = Surface::new(knots_u.clone(), knots_v.clone());
    assert_eq!(surface.shape(), (9, 5));
    let jet = surface.jet(&points, 1.7, 0.95);
    assert!(close(&jet.position, [6.6400899679557615, 3.6720703160400228, 0.06700092910125337], 1e-13));
    assert!(close(&jet.d_u, [3.5735085231063697, -0.39812459166186365, -1.1967343166042472], 1e-13));
    assert!(close(&jet.d_v, [0.4350309458672914, 6.111111111111111, -0.4676444263221242], 1e-13));
    assert!(close(&jet.d_uu, [6.445842487124253, -0.5398444630251795, -2.278037268722162], 1e-13));
    assert!(close(&jet.d_uv, [5.03984238742828, 0.0, 8.352811527473634], 1e-13));
    assert!(close(&jet.d_vv, [4.833097750097995, 11.111111111111109, -2.5699810925315028], 1e-13));
    let point = surface.point(&points, 1.7, 0.95);
    assert_eq!((point.position, point.d_u, point.d_v), (jet.position, jet.d_u, jet.d_v));
    assert_eq!(surface.position(&points, 1.7, 0.95), jet.position);
    // The rational path with unit weights is the same surface.
    let rational = Surface::rational(knots_u, knots_v).jet(&points, 1.7, 0.95);
    assert!((rational.d_uv - jet.d_uv).norm() < 1e-13 * jet.d_uv.norm());
}

#[test]
fn bases_of_all_degrees_are_partitions_of_unity_with_consistent_derivatives() {
    for degree in 1..=MAX_DEGREE {
        let mut knots = vec![0.0; degree + 1];
        knots.extend([0.1, 0.35, 0.35 + 1e-3, 0.8]);
        knots.extend(vec![1.0; degree + 1]);
        let knots = KnotVector::new(degree, knots).expect("valid");
        for k in 0..=200 {
            let u = k as f64 / 200.0;
            let b = knots.basis(u, 2);
            assert!((b.value().iter().sum::<f64>() - 1.0).abs() < 1e-14);
            assert!(b.value().iter().all(|&n| n >= 0.0));
            let scale: f64 = b.derivative(1).iter().map(|d| d.abs()).sum();
            assert!(b.derivative(1).iter().sum::<f64>().abs() <= 1e-13 * scale);
            // Linear precision: the Greville abscissae reproduce u, with derivative 1.
            let g = knots.greville();
            let along = |order: usize| -> f64 {
                b.derivative(order).iter().enumerate().map(|(i, n)| n * g[b.first + i]).sum()
            };
            assert!((along(0) - u).abs() < 1e-14 && (along(1) - 1.0).abs() < 1e-11 * scale.max(1.0));
            // Central differences within an interval.
            let h = 1e-5;
            if knots.interval(u - h) == knots.interval(u + h) && u > h && u < 1.0 - h {
                let (m, p) = (knots.basis(u - h, 1), knots.basis(u + h, 1));
                for i in 0..b.count {
                    let d = (p.values[0][i] - m.values[0][i]) / (2.0 * h);
                    assert!((d - b.values[1][i]).abs() < 1e-4 * (1.0 + scale));
                    let dd = (p.values[1][i] - m.values[1][i]) / (2.0 * h);
                    assert!((dd - b.values[2][i]).abs() < 1e-4 * (1.0 + dd.abs() + scale * scale));
                }
            }
        }
    }
}

#[test]
fn polynomials_are_reproduced_by_their_blossoms() {
    // The cubic u^3 - 2 u: the control point of knots a, b, c is its polar form a b c - 2 (a + b + c) / 3.
    let knots = KnotVector::new(3, KNOTS.to_vec()).expect("valid");
    let points: Vec<[f64; 4]> = (0..9)
        .map(|i| {
            let (a, b, c) = (KNOTS[i + 1], KNOTS[i + 2], KNOTS[i + 3]);
            [a * b * c - 2.0 * (a + b + c) / 3.0, 0.0, 0.0, 1.0]
        })
        .collect();
    let curve = Curve::new(knots);
    for k in 0..=100 {
        let u = 0.02 * k as f64;
        let jet = curve.jet(&points, u);
        assert!((jet.position.x - (u * u * u - 2.0 * u)).abs() < 1e-14);
        assert!((jet.d.x - (3.0 * u * u - 2.0)).abs() < 1e-13);
        assert!((jet.dd.x - 6.0 * u).abs() < 1e-12);
    }
}

#[test]
fn a_rational_quadratic_is_a_circle() {
    let w = FRAC_1_SQRT_2;
    let points = [[1.0, 0.0, 0.0, 1.0], [w, w, 0.0, w], [0.0, 1.0, 0.0, 1.0]];
    let knots = KnotVector::clamped_uniform(2, 3).expect("valid");
    let curve = Curve::for_control_points(knots, &points);
    assert!(curve.is_rational());
    for k in 0..=50 {
        let jet = curve.jet(&points, k as f64 / 50.0);
        assert!((jet.position.norm() - 1.0).abs() < 1e-15);
        // Differentiating |c|^2 = 1 twice.
        assert!(jet.position.dot(&jet.d).abs() < 1e-14);
        assert!((jet.position.dot(&jet.dd) + jet.d.norm_squared()).abs() < 1e-13);
    }
}

#[test]
fn a_rational_biquadratic_is_a_sphere() {
    let w = FRAC_1_SQRT_2;
    let profile = [(1.0, 0.0, 1.0), (1.0, 1.0, w), (0.0, 1.0, 1.0)];
    let circle = [(1.0, 0.0, 1.0), (1.0, 1.0, w), (0.0, 1.0, 1.0)];
    let mut points = Vec::new();
    for (r, z, wp) in profile {
        for (c, s, wc) in circle {
            let w = wp * wc;
            points.push([w * r * c, w * r * s, w * z, w]);
        }
    }
    let knots = || KnotVector::clamped_uniform(2, 3).expect("valid");
    let surface = Surface::for_control_points(knots(), knots(), &points);
    for i in 0..=20 {
        for j in 0..=20 {
            let s = surface.jet(&points, i as f64 / 20.0, j as f64 / 20.0);
            let p = s.position;
            assert!((p.norm() - 1.0).abs() < 1e-15);
            assert!(p.dot(&s.d_u).abs() < 1e-14 && p.dot(&s.d_v).abs() < 1e-14);
            assert!((p.dot(&s.d_uv) + s.d_u.dot(&s.d_v)).abs() < 1e-13);
            assert!((p.dot(&s.d_vv) + s.d_v.norm_squared()).abs() < 1e-13);
        }
    }
}

#[test]
fn bezier_points_and_inserted_knots_keep_the_curve() {
    let knots = KnotVector::new(3, KNOTS.to_vec()).expect("valid");
    let points: Vec<[f64; 4]> =
        (0..9).map(|i| i as f64).map(|i| [i, (1.3 * i).sin(), (0.4 * i * i).cos(), 1.0]).collect();
    let curve = Curve::new(knots.clone());
    for interval in 0..knots.interval_count() {
        let bezier = combine(&knots.bezier(interval), &points);
        let (a, b) = (knots.breaks()[interval], knots.breaks()[interval + 1]);
        for t in [0.0, 0.25, 0.6, 1.0f64] {
            let s = 1.0 - t;
            let bernstein = [s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t];
            let mut p = Vector3::zeros();
            for (w, c) in bernstein.iter().zip(&bezier) {
                p += Vector3::new(c[0], c[1], c[2]) * *w;
            }
            assert!((p - curve.position(&points, a + t * (b - a))).norm() < 1e-13);
        }
    }
    let finer = KnotVector::new(
        3,
        vec![0.0, 0.0, 0.0, 0.0, 0.1, 0.3, 0.5, 0.5, 0.5, 0.9, 1.0, 1.4, 1.4, 2.0, 2.0, 2.0, 2.0],
    )
    .expect("valid");
    let moved = combine(&knots.refinement(&finer), &points);
    let same = Curve::new(finer);
    for k in 0..=100 {
        let u = 0.02 * k as f64;
        assert!((curve.position(&points, u) - same.position(&moved, u)).norm() < 1e-13);
    }
}

#[test]
fn volumes_map_back_and_forth() {
    let knots = [(3, 6), (2, 5), (1, 3)].map(|(p, n)| KnotVector::clamped_uniform(p, n).expect("valid"));
    let volume = Volume::new(knots);
    let [n0, n1, n2] = volume.shape();
    let g = [0, 1, 2].map(|d| volume.knots()[d].greville());
    let mut lattice = Vec::new();
    let mut straight = Vec::new();
    for i in 0..n0 {
        for j in 0..n1 {
            for k in 0..n2 {
                let p = [4.0 * g[0][i] - 1.0, 2.0 * g[1][j], 3.0 * g[2][k] + 5.0];
                straight.push(p);
                let bump = 0.15 * ((i + 2 * j) as f64).sin();
                lattice.push([p[0] + bump, p[1] - 0.5 * bump, p[2] + 0.3 * p[0]]);
            }
        }
    }
    for k in 0..50 {
        let xi = [0.618, 0.414, 0.732].map(|s| (s * (k as f64 + 0.5)).fract());
        // A lattice at the Greville points is the identity, scaled.
        let p = volume.position(&straight, xi);
        assert!((p - Vector3::new(4.0 * xi[0] - 1.0, 2.0 * xi[1], 3.0 * xi[2] + 5.0)).norm() < 1e-13);
        let x = volume.position(&lattice, xi);
        let found = volume.locate(&lattice, &x).expect("inside");
        assert!((volume.position(&lattice, found) - x).norm() < 1e-13);
        for d in 0..3 {
            assert!((found[d] - xi[d]).abs() < 1e-11, "{found:?} {xi:?}");
        }
        let total: f64 = volume.weights(xi, 0).entries().map(|e| e.1).sum();
        assert!((total - 1.0).abs() < 1e-14);
        let (_, jacobian) = volume.point(&lattice, xi);
        for d in 0..3 {
            let mut at = [xi, xi];
            at[0][d] -= 1e-6;
            at[1][d] += 1e-6;
            let difference = (volume.position(&lattice, at[1]) - volume.position(&lattice, at[0])) / 2e-6;
            assert!((difference - jacobian.column(d)).norm() < 1e-7);
        }
    }
    let far = volume.locate(&straight, &Vector3::new(5.0, 1.0, 6.5));
    assert!(matches!(far, Err(LocateError::Outside { distance, .. }) if (distance - 2.0).abs() < 1e-9));
}

#[test]
fn bad_knots_are_named() {
    let new = |p, k: &[f64]| KnotVector::new(p, k.to_vec()).expect_err("refused");
    assert_eq!(new(0, &[0.0, 1.0]), KnotError::Degree { degree: 0 });
    assert_eq!(new(10, &[0.0; 30]), KnotError::Degree { degree: 10 });
    assert_eq!(new(3, &[0.0, 1.0]), KnotError::TooFew { degree: 3, count: 2 });
    assert!(matches!(
        new(1, &[0.0, 0.0, f64::NAN, 1.0]),
        KnotError::NotFinite { index: 2, value } if value.is_nan()
    ));
    assert_eq!(
        new(1, &[0.0, 0.0, 0.7, 0.5, 1.0, 1.0]),
        KnotError::Decreasing { index: 3, value: 0.5, previous: 0.7 }
    );
    assert_eq!(
        new(1, &[0.0, 0.0, 0.5, 0.5, 1.0, 1.0]),
        KnotError::Multiplicity { index: 2, value: 0.5, multiplicity: 2, degree: 1 }
    );
    assert_eq!(new(2, &[1.0; 6]), KnotError::EmptyDomain { value: 1.0 });
    assert_eq!(
        KnotVector::clamped_uniform(3, 3).expect_err("refused"),
        KnotError::TooFew { degree: 3, count: 7 }
    );
    let message = new(1, &[0.0, 0.0, 0.5, 0.5, 1.0, 1.0]).to_string();
    assert!(message.contains("0.5") && message.contains("index 2"));
}
