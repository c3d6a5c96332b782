//! Flows with known solutions.

use moldline_panel::{Flow, Options, PanelSetup, Reference, Silent, Symmetry, TrailingEdges};

use crate::meshes::{Wing, sphere};

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
            let solution = setup.solve(&mesh.vertices, 0.0, &Silent).unwrap();
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
    for (around, along, lift) in [(32, 20, 0.4323), (60, 40, 0.4315)] {
        let mesh = Wing::rectangular(around, along).mesh();
        let setup = PanelSetup::new(&mesh, Options::default()).unwrap();
        let solution = setup.solve(&mesh.vertices, 0.0, &Silent).unwrap();
        let a = solution.analyse(&flow(5.0, 8.0)).unwrap();
        let cl = a.scalars.lift;
        assert!((cl / lift - 1.0).abs() <= 0.01, "C_L = {cl}");
        assert!(a.disagreement.abs() <= 0.01, "pressure against circulation: {}", a.disagreement);
    }
}
