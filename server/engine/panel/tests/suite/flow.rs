//! Flows with known solutions.

use moldline_panel::{Flow, NoMonitor, Options, PanelSetup, Reference, Symmetry, TrailingEdges};

use moldline_testing::{Wing, sphere};

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
        around: 40,
        span: 48,
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
