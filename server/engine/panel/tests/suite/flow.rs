//! Flows with known solutions.

use moldline_mesh::{Cell, SurfaceMesh};
use moldline_panel::{Analysis, Flow, NoMonitor, Options, PanelSetup, Reference, Symmetry, TrailingEdges};

use moldline_testing::{Random, Wing, sphere};

pub fn flow(alpha_degrees: f64, area: f64) -> Flow {
    Flow {
        alpha: alpha_degrees.to_radians(),
        sideslip: 0.0,
        reference: Reference { area, chord: 1.0, span: 8.0, point: [0.25, 0.0, 0.0] },
    }
}

fn body(symmetry: Symmetry) -> Options {
    Options { symmetry, trailing_edges: TrailingEdges::None, ..Options::default() }
}

/// Cp = 1 - 9/4 sin^2 theta, at the middle of cells; the whole sphere, and half of it with its image.
#[test]
fn sphere_pressure() {
    for symmetry in [Symmetry::None, Symmetry::Automatic] {
        let errors = [8, 16].map(|n| {
            let mesh = sphere(n);
            let setup = PanelSetup::new(&mesh, body(symmetry)).unwrap();
            let solution = setup.solve(&mesh.vertices, 0.0, &NoMonitor).unwrap();
            let a = solution.analyse(&flow(0.0, 1.0)).unwrap();
            let mut sum = 0.0;
            for (cell, cp) in mesh.cells.iter().zip(&a.cp) {
                let mut c = [0.0; 3];
                for v in cell.vertices() {
                    (0..3).for_each(|k| c[k] += 0.25 * mesh.vertices[*v as usize][k]);
                }
                let r2 = c[0] * c[0] + c[1] * c[1] + c[2] * c[2];
                let exact = 1.0 - 2.25 * (1.0 - c[0] * c[0] / r2);
                sum += (cp - exact).powi(2);
            }
            (sum / a.cp.len() as f64).sqrt()
        });
        assert!(errors[1] <= 0.004, "{symmetry:?}: {errors:?}");
        // Nearly of second order: a quarter at half the size.
        assert!(errors[0] / errors[1] >= 2.8, "{symmetry:?}: {errors:?}");
    }
}

/// NACA 0012, aspect ratio 8, flat tips, 5 degrees: PANAIR A502 gives C_L = 0.4323 on 32 x 20 cells, 0.4315 on 60 x 40.
#[test]
fn rectangular_wing() {
    for (around, along, lift, apart) in [(32, 20, 0.4323, 4e-3), (60, 40, 0.4315, 1e-3)] {
        let mesh = Wing::rectangular(around, along).mesh();
        let setup = PanelSetup::new(&mesh, Options::default()).unwrap();
        let solution = setup.solve(&mesh.vertices, 0.0, &NoMonitor).unwrap();
        let a = solution.analyse(&flow(5.0, 8.0)).unwrap();
        let cl = a.scalars.lift;
        assert!((cl / lift - 1.0).abs() <= 0.01, "C_L = {cl}");
        assert!(a.disagreement.abs() <= apart, "pressure and wake against circulation: {}", a.disagreement);
        // Without the wake's force they differ by 0.3 % more.
        assert!((0.002..0.004).contains(&(a.wake_lift / cl)), "on the wake: {}", a.wake_lift);
    }
}

/// A wing of elliptic planform carries an elliptic load: C_Di = C_L^2 / (pi AR). The last hundredths of the span are cut off, where
/// cells would taper to nothing.
#[test]
fn elliptic_wing() {
    let chord: fn(f64) -> f64 = |eta| (1.0 - (0.98 * eta).powi(2)).sqrt();
    let wing = Wing {
        around: 60,
        span: 40,
        half_span: 4.0,
        chord,
        leading_edge: |eta| -0.25 * (1.0 - (0.98 * eta).powi(2)).sqrt(),
        thickness: 0.06,
        half: true,
    };
    let mesh = wing.mesh();
    let setup = PanelSetup::new(&mesh, Options::default()).unwrap();
    let solution = setup.solve(&mesh.vertices, 0.0, &NoMonitor).unwrap();
    // Coefficients by the square of the span.
    let a = solution.analyse(&flow(4.0, 64.0)).unwrap();
    let efficiency = a.scalars.lift.powi(2) / (std::f64::consts::PI * a.scalars.induced_drag);
    assert!((efficiency - 1.0).abs() <= 0.01, "span efficiency {efficiency}");
    assert!(a.disagreement.abs() <= 0.01, "pressure and wake against circulation: {}", a.disagreement);
}

/// No plane wake has less drag than C_L^2 / (pi AR) (Munk). A vortex lattice on the plane of a rectangular wing of aspect ratio 8
/// converges to a span efficiency of 0.972; the tips of the thick one are loaded a little less.
#[test]
fn induced_drag_of_the_rectangular_wing() {
    for (around, along) in [(32, 20), (40, 40)] {
        let mesh = Wing { half: true, ..Wing::rectangular(around, along) }.mesh();
        let setup = PanelSetup::new(&mesh, Options::default()).unwrap();
        let solution = setup.solve(&mesh.vertices, 0.0, &NoMonitor).unwrap();
        let a = solution.analyse(&flow(5.0, 64.0)).unwrap();
        let efficiency = a.scalars.lift.powi(2) / (std::f64::consts::PI * a.scalars.induced_drag);
        assert!((0.952..0.972).contains(&efficiency), "{around} x {along}: {efficiency}");
    }
}

/// Pressure and circulation agree about the lift of a swept wing as well.
#[test]
fn swept_wing() {
    for mach in [0.0, 0.6] {
        let wing = Wing {
            around: 40,
            span: 40,
            leading_edge: |eta| 4.0 * 30_f64.to_radians().tan() * eta.abs(),
            half: true,
            ..Wing::rectangular(0, 0)
        };
        let mesh = wing.mesh();
        let setup = PanelSetup::new(&mesh, Options::default()).unwrap();
        let solution = setup.solve(&mesh.vertices, mach, &NoMonitor).unwrap();
        let a = solution.analyse(&flow(5.0, 8.0)).unwrap();
        assert!(a.disagreement.abs() <= 0.01, "Mach {mach}: {}", a.disagreement);
        assert!(a.scalars.lift > 0.3, "Mach {mach}: {}", a.scalars.lift);
    }
}

/// A way to cut quadrilaterals into triangles: whether from the first corner.
type Cut = fn(index: usize, diagonals: [f64; 2], random: &mut Random) -> bool;

/// All one way, in turns, at random, along the shorter diagonal.
const CUTS: [Cut; 4] = [|_, _, _| true, |i, _, _| i % 2 == 0, |_, _, r| r.coin(), |_, d, _| d[0] <= d[1]];

fn in_triangles(mesh: &SurfaceMesh, cut: Cut) -> SurfaceMesh {
    let mut random = Random::new(3);
    let mut cells = Vec::new();
    for (index, cell) in mesh.cells.iter().enumerate() {
        let &[a, b, c, d] = cell.vertices() else {
            cells.push(*cell);
            continue;
        };
        let distance = |p: u32, q: u32| {
            let [p, q] = [p, q].map(|v| mesh.vertices[v as usize]);
            (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f64>()
        };
        let [a, b, c, d] = if cut(index, [distance(a, c), distance(b, d)], &mut random) {
            [a, b, c, d]
        } else {
            [b, c, d, a]
        };
        cells.extend([Cell::triangle(a, b, c), Cell::triangle(a, c, d)]);
    }
    SurfaceMesh::new(mesh.vertices.clone(), cells, Vec::new(), Vec::new()).unwrap()
}

fn analysis(mesh: &SurfaceMesh, alpha_degrees: f64) -> Analysis {
    let setup = PanelSetup::new(mesh, Options::default()).unwrap();
    setup.solve(&mesh.vertices, 0.0, &NoMonitor).unwrap().analyse(&flow(alpha_degrees, 8.0)).unwrap()
}

/// However a mesh is cut into triangles, it has the lift, the induced drag and the balance of its quadrilaterals: straight wings (PANAIR: 0.4315 at 5
/// degrees) and such with 35 and 60 degrees of sweep.
#[test]
fn wings_in_triangles() {
    type Sweep = (fn(f64) -> f64, Option<f64>);
    let sweeps: [Sweep; 3] = [
        (|_| 0.0, Some(0.4315)),
        (|eta| 4.0 * 35_f64.to_radians().tan() * eta.abs(), None),
        (|eta| 4.0 * 60_f64.to_radians().tan() * eta.abs(), None),
    ];
    for (leading_edge, panair) in sweeps {
        let wing = Wing { around: 40, span: 24, leading_edge, half: true, ..Wing::rectangular(0, 0) };
        let mesh = wing.mesh();
        for alpha in [2.0, 5.0] {
            let quadrilaterals = analysis(&mesh, alpha);
            let (lift, drag) = (quadrilaterals.scalars.lift, quadrilaterals.scalars.induced_drag);
            assert!(quadrilaterals.disagreement.abs() < 0.01, "{alpha}: {}", quadrilaterals.disagreement);
            if let Some(panair) = panair.filter(|_| alpha > 4.0) {
                assert!((lift / panair - 1.0).abs() < 0.01, "{lift}");
            }
            for cut in CUTS {
                let triangles = analysis(&in_triangles(&mesh, cut), alpha);
                assert!(
                    (triangles.scalars.lift / lift - 1.0).abs() < 0.01,
                    "{alpha}: {} {lift}",
                    triangles.scalars.lift
                );
                let cut_drag = triangles.scalars.induced_drag;
                assert!((cut_drag / drag - 1.0).abs() < 0.02, "{alpha}: {cut_drag} {drag}");
                assert!(triangles.disagreement.abs() < 0.01, "{alpha}: {}", triangles.disagreement);
            }
        }
    }
}

/// On a sphere in triangles the error falls at least with first order, in the mean and at its largest.
#[test]
fn sphere_in_triangles() {
    for cut in CUTS {
        let errors = [8, 16].map(|n| {
            let mesh = in_triangles(&sphere(n), cut);
            let setup = PanelSetup::new(&mesh, body(Symmetry::None)).unwrap();
            let solution = setup.solve(&mesh.vertices, 0.0, &NoMonitor).unwrap();
            let cp = solution.analyse(&flow(0.0, 1.0)).unwrap().cp;
            let error = |(cell, cp): (&Cell, &f64)| {
                let mut c = [0.0; 3];
                for v in cell.vertices() {
                    (0..3).for_each(|k| c[k] += mesh.vertices[*v as usize][k]);
                }
                let r2 = c[0] * c[0] + c[1] * c[1] + c[2] * c[2];
                (cp - (1.0 - 2.25 * (1.0 - c[0] * c[0] / r2))).abs()
            };
            let errors: Vec<f64> = mesh.cells.iter().zip(&cp).map(error).collect();
            let mean = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
            [mean, errors.iter().copied().fold(0.0, f64::max)]
        });
        assert!(errors[1][0] < 0.006, "{errors:?}");
        assert!((0..2).all(|norm| errors[0][norm] > 2.0 * errors[1][norm]), "{errors:?}");
    }
}
