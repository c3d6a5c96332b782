//! Quality measures of a mesh of 16,384 quadrilaterals, on one thread and on all.

use criterion::{Criterion, criterion_group, criterion_main};
use moldline_mesh::{Cell, QualityReport, Vector3, area_vector, quality::evaluate};

const SIDE: u32 = 128;

fn quality(criterion: &mut Criterion) {
    let at = |i: u32, j: u32| {
        let (u, v) = (f64::from(i), f64::from(j));
        [u + 0.3 * (1.7 * v).sin(), v + 0.3 * (2.3 * u).sin(), (0.1 * u).sin() * (0.1 * v).cos()]
    };
    let vertices: Vec<[f64; 3]> = (0..=SIDE).flat_map(|i| (0..=SIDE).map(move |j| at(i, j))).collect();
    let quad = |i: u32, j: u32| {
        let a = i * (SIDE + 1) + j;
        Cell::quad(a, a + SIDE + 1, a + SIDE + 2, a + 1)
    };
    let cells: Vec<Cell> = (0..SIDE).flat_map(|i| (0..SIDE).map(move |j| quad(i, j))).collect();
    let normals: Vec<Vector3> = cells.iter().map(|cell| area_vector(&vertices, cell).normalize()).collect();
    let owner: Vec<u32> = (0..cells.len() as u32).map(|cell| cell % 3).collect();
    let names = ["fuselage", "wing", "tail"].map(str::to_owned);
    let measured = evaluate(&vertices, &cells, &normals);

    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
        criterion.bench_function(&format!("quality/evaluate/16384/threads_{threads}"), |bencher| {
            pool.install(|| bencher.iter(|| evaluate(&vertices, &cells, &normals)));
        });
        criterion.bench_function(&format!("quality/report/16384/threads_{threads}"), |bencher| {
            pool.install(|| bencher.iter(|| QualityReport::new(&measured, &owner, &names)));
        });
    }
}

criterion_group!(benches, quality);
criterion_main!(benches);
