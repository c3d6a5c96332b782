//! Cost of evaluating a bicubic patch: position, with first, and with second derivatives.

use criterion::{Criterion, criterion_group, criterion_main};
use moldline_spline::{KnotVector, Surface};
use std::hint::black_box;

fn evaluate(criterion: &mut Criterion) {
    let (n, m) = (22, 15);
    let knots = |count| KnotVector::clamped_uniform(3, count).expect("valid");
    let surface = Surface::new(knots(n), knots(m));
    let control_points: Vec<[f64; 4]> =
        (0..n * m).map(|k| [(k / m) as f64, (k % m) as f64, ((k * 7919) % 31) as f64 / 31.0, 1.0]).collect();
    // Pseudo-random parameters, so that interval look-up and caches see a real sequence.
    let parameters: Vec<(f64, f64)> = (0..1024)
        .map(|k| ((k as f64 * 0.618_033_988_75) % 1.0, (k as f64 * 0.754_877_666_25) % 1.0))
        .collect();
    let mut next = 0;
    let mut parameter = move || {
        next = (next + 1) % 1024;
        parameters[next]
    };
    criterion.bench_function("bicubic_position", |b| {
        b.iter(|| {
            let (u, v) = parameter();
            black_box(surface.position(&control_points, u, v))
        })
    });
    criterion.bench_function("bicubic_first_derivatives", |b| {
        b.iter(|| {
            let (u, v) = parameter();
            black_box(surface.point(&control_points, u, v))
        })
    });
    criterion.bench_function("bicubic_second_derivatives", |b| {
        b.iter(|| {
            let (u, v) = parameter();
            black_box(surface.jet(&control_points, u, v))
        })
    });
}

criterion_group!(benches, evaluate);
criterion_main!(benches);
