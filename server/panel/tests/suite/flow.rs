//! Flows with known solutions.

use moldline_panel::{Analysis, Flow, Options, PanelSetup, Reference, Silent, Symmetry, TrailingEdges};

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

fn report(name: &str, a: &Analysis) {
    println!("{name}: {:?} disagreement {:.5} residual {:e} rounds {}", a.scalars, a.disagreement, a.residual, a.rounds);
}

#[test]
fn sphere_pressure() {
    for n in [8, 16] {
        let mesh = sphere(n);
        for symmetry in [Symmetry::None, Symmetry::Automatic] {
            let setup = PanelSetup::new(&mesh, body(symmetry)).unwrap();
            let solution = setup.solve(&mesh.vertices, 0.0, &Silent).unwrap();
            let a = solution.analyse(&flow(0.0, 1.0)).unwrap();
            let mut sum = 0.0;
            let mut worst: f64 = 0.0;
            for (cell, cp) in mesh.cells.iter().zip(&a.cp) {
                let mut c = [0.0; 3];
                for v in cell.vertices() {
                    (0..3).for_each(|k| c[k] += 0.25 * mesh.vertices[*v as usize][k]);
                }
                let r2 = c[0] * c[0] + c[1] * c[1] + c[2] * c[2];
                let exact = 1.0 - 2.25 * (1.0 - c[0] * c[0] / r2);
                sum += (cp - exact).powi(2);
                worst = worst.max((cp - exact).abs());
            }
            let rms = (sum / a.cp.len() as f64).sqrt();
            println!("n {n} {symmetry:?} unknowns {} rms {rms:.5} worst {worst:.5}", setup.summary().unknowns);
            report("sphere", &a);
        }
    }
}

#[test]
fn rectangular_wing() {
    for (n, m) in [(32, 20), (60, 40)] {
        let mesh = Wing::rectangular(n, m).mesh();
        let setup = PanelSetup::new(&mesh, Options::default()).unwrap();
        let solution = setup.solve(&mesh.vertices, 0.0, &Silent).unwrap();
        report("wing", &solution.analyse(&flow(5.0, 8.0)).unwrap());
    }
}
