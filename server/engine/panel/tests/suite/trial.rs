use moldline_mesh::{Cell, SurfaceMesh};
use moldline_panel::*;
use moldline_testing::{Random, Wing, sphere};
use crate::flow::flow;

pub fn cut(mesh: &SurfaceMesh, how: usize) -> SurfaceMesh {
    let mut random = Random::new(3);
    let mut cells = Vec::new();
    for (i, cell) in mesh.cells.iter().enumerate() {
        let v = cell.vertices().to_vec();
        if v.len() == 3 { cells.push(*cell); continue; }
        let d = |a: u32, b: u32| { let (p, q) = (mesh.vertices[a as usize], mesh.vertices[b as usize]); (0..3).map(|k| (p[k]-q[k]).powi(2)).sum::<f64>() };
        let one = match how { 0 => true, 1 => i % 2 == 0, 2 => random.coin(), _ => d(v[0], v[2]) <= d(v[1], v[3]) };
        if one { cells.push(Cell::triangle(v[0], v[1], v[2])); cells.push(Cell::triangle(v[0], v[2], v[3])); }
        else { cells.push(Cell::triangle(v[1], v[2], v[3])); cells.push(Cell::triangle(v[1], v[3], v[0])); }
    }
    SurfaceMesh::new(mesh.vertices.clone(), cells, Vec::new(), Vec::new()).unwrap()
}

fn rms(mesh: &SurfaceMesh) -> (f64, f64) {
    let options = Options { trailing_edges: TrailingEdges::None, ..Options::default() };
    let setup = PanelSetup::new(mesh, options).unwrap();
    let a = setup.solve(&mesh.vertices, 0.0, &NoMonitor).unwrap().analyse(&flow(0.0, 1.0)).unwrap();
    let (mut sum, mut most) = (0.0, 0.0_f64);
    for (cell, cp) in mesh.cells.iter().zip(&a.cp) {
        let v = cell.vertices();
        let mut c = [0.0; 3];
        for v in v { (0..3).for_each(|k| c[k] += mesh.vertices[*v as usize][k] / cell.vertices().len() as f64); }
        let r2 = c[0] * c[0] + c[1] * c[1] + c[2] * c[2];
        let e = cp - (1.0 - 2.25 * (1.0 - c[0] * c[0] / r2));
        sum += e * e;
        most = most.max(e.abs());
    }
    ((sum / a.cp.len() as f64).sqrt(), most)
}

#[test]
#[ignore]
fn trial() {
    for n in [8, 16] {
        let m = sphere(n);
        println!("sphere {n} quads {:?} cut {:?}", rms(&m), (0..4).map(|h| rms(&cut(&m, h))).collect::<Vec<_>>());
    }
    for (around, along) in [(32, 20), (60, 40)] {
        let m = Wing { half: true, ..Wing::rectangular(around, along) }.mesh();
        let mut list = vec![m.clone()];
        list.extend((0..4).map(|h| cut(&m, h)));
        for m in list {
            let t = std::time::Instant::now();
            let setup = PanelSetup::new(&m, Options::default()).unwrap();
            let a = setup.solve(&m.vertices, 0.0, &NoMonitor).unwrap().analyse(&flow(5.0, 8.0)).unwrap();
            println!("{around}x{along} CL {:.5} CDi {:.6} pCL {:.5} wake {:.5} apart {:.4}% CM {:.5} n {} {:?}", a.scalars.lift, a.scalars.induced_drag, a.scalars.pressure_lift, a.wake_lift, 100.0 * a.disagreement, a.scalars.moment, setup.summary().unknowns, t.elapsed());
        }
    }
}

#[test]
#[ignore]
fn elliptic() {
    let chord: fn(f64) -> f64 = |eta| (1.0 - (0.98 * eta).powi(2)).sqrt();
    for (around, span) in [(40, 24), (40, 48), (60, 24), (60, 40), (100, 24)] {
        let wing = Wing { around, span, half_span: 4.0, chord, leading_edge: |eta| -0.25 * (1.0 - (0.98 * eta).powi(2)).sqrt(), thickness: 0.06, half: true };
        let mesh = wing.mesh();
        let setup = PanelSetup::new(&mesh, Options::default()).unwrap();
        let a = setup.solve(&mesh.vertices, 0.0, &NoMonitor).unwrap().analyse(&flow(4.0, 64.0)).unwrap();
        let e = a.scalars.lift.powi(2) / (std::f64::consts::PI * a.scalars.induced_drag);
        println!("elliptic {around} {span}: CL {:.6} e {e:.4} pCL {:.6} wake {:.6} apart {:.3}%", a.scalars.lift, a.scalars.pressure_lift, a.wake_lift, 100.0 * a.disagreement);
    }
    for (sweep, name) in [(0.0_f64, "straight"), (30.0, "30"), (35.0, "35"), (60.0, "60")] {
        let _ = sweep;
        let le: fn(f64) -> f64 = match name { "straight" => |_| 0.0, "30" => |e| 4.0 * 0.57735 * e.abs(), "35" => |e| 4.0 * 0.70021 * e.abs(), _ => |e| 4.0 * 1.73205 * e.abs() };
        for (around, span) in [(32, 20), (60, 40)] {
            let m = Wing { around, span, leading_edge: le, half: true, ..Wing::rectangular(0, 0) }.mesh();
            for (k, m) in [m.clone(), cut(&m, 2)].into_iter().enumerate() {
                let Ok(setup) = PanelSetup::new(&m, Options::default()) else { println!("sweep {name}: no set-up"); continue };
                let a = setup.solve(&m.vertices, 0.0, &NoMonitor).unwrap().analyse(&flow(5.0, 8.0)).unwrap();
                println!("sweep {name} {around}x{span} {}: CL {:.5} CDi {:.6} apart {:.3}%", ["quads", "random"][k], a.scalars.lift, a.scalars.induced_drag, 100.0 * a.disagreement);
            }
        }
    }
}

#[test]
#[ignore]
fn e175() {
    for name in ["study/mesh-coarse.msh"] {
        let path = format!("{}/../../../examples/e175/{name}", env!("CARGO_MANIFEST_DIR"));
        let mesh = moldline_mesh::io::msh::read(&std::fs::read(path).unwrap(), &moldline_mesh::Limits::default()).unwrap().mesh;
        let names = ["trailing_edge_wing", "trailing_edge_htail"].map(str::to_owned).to_vec();
        let mut list = vec![mesh.clone()];
        if name.starts_with("study") {
            for how in 0..4 { let mut c = cut(&mesh, how);
            c.vertex_groups = mesh.vertex_groups.clone();
            list.push(c); }
        }
        let list_len = 10;
        for m in list {
            let t = std::time::Instant::now();
            let setup = PanelSetup::new(&m, Options { trailing_edges: TrailingEdges::Groups(names.clone()), ..Options::default() }).unwrap();
            let t1 = t.elapsed();
            let s = std::sync::Arc::new(setup.solve(&m.vertices, 0.7, &NoMonitor).unwrap());
            let t2 = t.elapsed();
            let mut f = flow(2.0, 70.0);
            for alpha in [0.0_f64, 2.0, 4.0] {
                f.alpha = alpha.to_radians();
                let a = s.analyse(&f).unwrap();
                println!("e175 {} cells {:?} {:?}: CL {:.5} CDi {:.6} CM {:.5} wake {:.5} apart {:.3}% n {}", m.cells.len(), t1, t2, a.scalars.lift, a.scalars.induced_drag, a.scalars.moment, a.wake_lift, 100.0 * a.disagreement, setup.summary().unknowns);
            }
            
            let l = s.linearise(&f).unwrap();
            let seed = Outputs { scalars: Scalars { pressure_drag: 1.0, ..Scalars::default() }, ..Outputs::default() };
            let t = std::time::Instant::now();
            l.vjp(&[seed.clone()], &NoMonitor).unwrap();
            println!("one adjoint {:?}", t.elapsed());
            let t = std::time::Instant::now();
            l.vjp(&vec![seed; 6], &NoMonitor).unwrap();
            println!("six adjoints {:?}", t.elapsed());
        }
    }
}
