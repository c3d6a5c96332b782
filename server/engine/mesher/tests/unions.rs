//! Unions with closed forms: volume, Euler characteristic, distances from the components, quality.

use std::{collections::BTreeMap, f64::consts::PI};

use moldline_foundation::{NoMonitor, Vector3};
use moldline_geometry::{Body, Component, ComponentOptions, PatchInput, Primitive};
use moldline_mesh::{Topology, topology::enclosed_volume};
use moldline_mesher::{Generated, MesherError, Options, generate};
use moldline_spline::KnotVector;

fn body(name: &str, shape: &Primitive) -> Body {
    let (component, points) = Component::primitive(name.into(), shape).expect("a valid shape");
    Body::new(component.into(), points)
}

fn sphere(name: &str, center: [f64; 3], radius: f64) -> Body {
    body(name, &Primitive::Sphere { center: center.into(), radius })
}

fn mesh(bodies: &[Body], options: &Options) -> Result<Generated, MesherError> {
    generate(&bodies.iter().collect::<Vec<_>>(), options, &NoMonitor)
}

fn cells(cells: usize) -> Options {
    Options { cells, ..Options::default() }
}

/// Watertight, every vertex on the components of its cells to 1e-10 of the length, and of good quality.
fn verify(bodies: &[Body], generated: &Generated, euler: i64) {
    let mesh = &generated.mesh;
    mesh.validate(&Default::default()).expect("a valid mesh");
    let topology = Topology::of_cells(mesh.vertices.len(), &mesh.cells);
    assert!(topology.is_watertight(&mesh.vertices, None));
    assert_eq!(topology.euler(), euler);
    for (cell, &owner) in mesh.cells.iter().zip(&generated.owner) {
        let body = &bodies[owner as usize];
        for &v in cell.vertices() {
            let distance = body.signed_distance(&Vector3::from(mesh.vertices[v as usize])).abs();
            assert!(distance <= 1e-10 * body.size(), "vertex {v}: {distance:e} m");
        }
    }
    // No point of the boundary lies inside a component.
    for x in &mesh.vertices {
        for body in bodies {
            assert!(body.signed_distance(&Vector3::from(*x)) >= -1e-10 * body.size());
        }
    }
    let total = &generated.quality.total;
    assert_eq!(total.folded, 0);
    assert!(total.aspect_ratio.p95 <= 1.5, "{}", generated.quality);
    assert!(total.aspect_ratio.max <= 5.0, "{}", generated.quality);
}

/// Volume of the union of two unit spheres whose centres are `d` apart.
fn two_spheres(d: f64) -> f64 {
    8.0 * PI / 3.0 - PI / 12.0 * (4.0 + d) * (2.0 - d) * (2.0 - d)
}

#[test]
fn two_spheres_have_their_volume() {
    let bodies = [sphere("a", [0.0, 0.1, 0.0], 1.0), sphere("b", [1.2, 0.1, 0.0], 1.0)];
    let exact = two_spheres(1.2);
    let errors: Vec<f64> = [1500, 6000]
        .iter()
        .map(|&n| {
            let generated = mesh(&bodies, &cells(n)).expect("a mesh");
            verify(&bodies, &generated, 2);
            let count = generated.mesh.cells.len() as f64;
            assert!((count / n as f64 - 1.0).abs() < 0.25, "{count} cells for {n}");
            (enclosed_volume(&generated.mesh.vertices, &generated.mesh.cells, None) / exact - 1.0).abs()
        })
        .collect();
    // Second order in the size of the cells: a quarter for four times the cells.
    assert!(errors[0] < 1e-2 && errors[1] < 0.4 * errors[0], "{errors:?}");
}

#[test]
fn a_symmetric_union_is_symmetric_to_the_last_bit() {
    let bodies = [sphere("a", [0.0, 0.0, 0.0], 1.0), sphere("b", [0.9, 0.0, 0.7], 0.8)];
    let generated = mesh(&bodies, &cells(2000)).expect("a mesh");
    verify(&bodies, &generated, 2);
    assert!(generated.symmetric);
    let key = |[x, y, z]: [f64; 3]| [x, y + 0.0, z].map(f64::to_bits);
    let all: std::collections::HashSet<_> = generated.mesh.vertices.iter().map(|x| key(*x)).collect();
    assert!(generated.mesh.vertices.iter().all(|&[x, y, z]| all.contains(&key([x, -y, z]))));
}

#[test]
fn sharp_edges_through_a_sphere_keep_their_corners() {
    let cube = body(
        "box",
        &Primitive::Box { low: Vector3::new(0.1, -0.25, -0.4), high: Vector3::new(1.7, 0.35, 0.4) },
    );
    let bodies = [sphere("ball", [0.0, 0.0, 0.0], 1.0), cube];
    let generated = mesh(&bodies, &cells(3000)).expect("a mesh");
    verify(&bodies, &generated, 2);
    // The four long edges of the box leave the ball at |x| = 1.
    for (y, z) in [(-0.25, -0.4), (-0.25, 0.4), (0.35, -0.4), (0.35, 0.4f64)] {
        let corner = Vector3::new((1.0 - y * y - z * z).sqrt(), y, z);
        let nearest = generated.mesh.vertices.iter().map(|x| (Vector3::from(*x) - corner).norm());
        let nearest = nearest.fold(f64::INFINITY, f64::min);
        assert!(nearest < 1e-12, "{nearest:e}");
    }
}

#[test]
fn three_components_meet_at_points() {
    let bodies = [
        sphere("a", [0.0, 0.0, 0.0], 1.0),
        sphere("b", [1.0, 0.1, 0.0], 0.9),
        sphere("c", [0.45, 0.8, 0.2], 0.85),
    ];
    let generated = mesh(&bodies, &cells(4000)).expect("a mesh");
    verify(&bodies, &generated, 2);
    assert_eq!(generated.seams.len(), 3);
}

#[test]
fn the_same_bits_for_any_number_of_threads() {
    let bodies = [sphere("a", [0.0, 0.1, 0.0], 1.0), sphere("b", [1.2, 0.0, 0.3], 0.7)];
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| mesh(&bodies, &cells(1000)).expect("a mesh").mesh)
    };
    assert!(run(1) == run(3));
}

#[test]
fn bad_input_is_refused() {
    let apart = [sphere("a", [0.0; 3], 1.0), sphere("b", [5.0, 0.0, 0.0], 1.0)];
    assert!(
        matches!(mesh(&apart, &cells(1000)), Err(MesherError::Pieces { pieces: 2, component }) if component == "b")
    );
    let accepted = mesh(&apart, &Options { pieces: true, ..cells(1000) }).expect("a mesh");
    verify(&apart, &accepted, 4);
    let inside = [sphere("a", [0.0; 3], 1.0), sphere("b", [0.1, 0.0, 0.0], 0.5)];
    assert!(
        matches!(mesh(&inside, &cells(1000)), Err(MesherError::Hidden { component }) if component == "b")
    );
    assert!(matches!(mesh(&apart, &cells(3)), Err(MesherError::Cells { cells: 3, .. })));
    assert!(matches!(mesh(&[], &cells(1000)), Err(MesherError::Empty)));
    let sizes = |name: &str, size| Options {
        sizes: BTreeMap::from([(name.into(), size)]),
        pieces: true,
        ..cells(1000)
    };
    assert!(matches!(mesh(&apart, &sizes("c", 1.0)), Err(MesherError::UnknownComponent { .. })));
    assert!(matches!(mesh(&apart, &sizes("a", f64::NAN)), Err(MesherError::Size { .. })));
}

/// A wing over `|y| <= span` of chord 1 and thickness about `2 h`: round leading edge, sharp trailing edge, and flat caps that
/// have no length at either.
fn wing(span: f64, h: f64) -> Body {
    let quadratic = || KnotVector::clamped_uniform(2, 4).expect("valid");
    let linear = || KnotVector::clamped_uniform(1, 2).expect("valid");
    // From the trailing to the leading edge; the last leg is along z, so that the sheets meet smoothly.
    let section = [(1.0, 0.0), (0.6, 1.2), (0.0, 1.0), (0.0, 0.0)];
    let patch = |name: &str, along, control_points| PatchInput {
        name: name.into(),
        knots_u: quadratic(),
        knots_v: along,
        control_points,
        weights: None,
    };
    let sheet = |sign: f64| {
        let row = |(x, z): (f64, f64)| [-span, span].map(|y| [x, y, sign * h * z]);
        section.into_iter().flat_map(row).collect()
    };
    let cap = |y: f64| section.into_iter().flat_map(|(x, z)| [-h, h].map(|h| [x, y, h * z])).collect();
    let patches = vec![
        patch("lower", linear(), sheet(-1.0)),
        patch("upper", linear(), sheet(1.0)),
        patch("port tip", linear(), cap(-span)),
        patch("starboard tip", linear(), cap(span)),
    ];
    let (component, points) =
        Component::new("wing".into(), patches, &ComponentOptions::default()).expect("a closed wing");
    Body::new(component.into(), points)
}

#[test]
fn thin_wings_keep_both_sheets() {
    for h in [0.06, 0.03] {
        let bodies = [sphere("hull", [0.45, 0.0, 0.01], 0.8), wing(3.0, h)];
        let generated = mesh(&bodies, &cells(6000)).expect("a mesh");
        let mesh = &generated.mesh;
        let topology = Topology::of_cells(mesh.vertices.len(), &mesh.cells);
        assert!(topology.is_watertight(&mesh.vertices, None));
        assert_eq!(topology.euler(), 2);
        for (cell, &owner) in mesh.cells.iter().zip(&generated.owner) {
            let body = &bodies[owner as usize];
            for &v in cell.vertices() {
                let distance = body.signed_distance(&Vector3::from(mesh.vertices[v as usize])).abs();
                assert!(distance <= 1e-10 * body.size(), "vertex {v}: {distance:e} m");
            }
        }
        assert_eq!(generated.quality.total.folded, 0);
        assert!(generated.quality.total.aspect_ratio.p95 <= 1.6, "{}", generated.quality);
        assert!(generated.symmetric);
    }
}
