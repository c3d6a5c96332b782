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
