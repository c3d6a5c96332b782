//! Foot points on a wing: globally for points near and far, and locally from a good hint.

#[path = "../tests/common/mod.rs"]
mod common;

use common::{Random, Trailing, body, wing_patches};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use moldline_geometry::{Body, Location, Vector3};
use std::hint::black_box;

const COUNT: usize = 15_000;

/// Half of the points within a hundredth of the wing's size from its surface, half anywhere around it.
fn points(wing: &Body) -> Vec<Vector3> {
    let mut random = Random::new(1);
    let bounds = wing.bounds();
    let extent = (bounds.high - bounds.low).add_scalar(5.0);
    (0..COUNT)
        .map(|k| {
            if k % 2 == 0 {
                return bounds.center() + random.vector(0.5).component_mul(&extent);
            }
            let l = Location { patch: (k / 2 % 2) as u32, u: random.unit(), v: random.unit() };
            wing.position(&l) + random.vector(0.01 * wing.size())
        })
        .collect()
}

fn closest_point(criterion: &mut Criterion) {
    let wing = body("wing", wing_patches(Trailing::Wedge));
    let points = points(&wing);

    let mut group = criterion.benchmark_group("closest_point");
    group.sample_size(10);
    group.throughput(Throughput::Elements(COUNT as u64));
    group.bench_function("global_15000_with_hierarchy", |b| {
        b.iter(|| {
            // A new body, so that the building of its hierarchy is in the time.
            let wing = Body::new(wing.component().clone(), wing.control_points().to_vec());
            points.iter().map(|x| wing.closest_point(x).distance).sum::<f64>()
        })
    });
    group.finish();

    let hinted: Vec<(Vector3, Location)> = points
        .iter()
        .map(|x| {
            let foot = wing.closest_point(x);
            (foot.position + foot.normal * (1e-3 * wing.size()), foot.location)
        })
        .map(|(x, l)| (x, Location { u: (l.u + 1e-3).min(1.0), v: (l.v + 1e-3).min(1.0), ..l }))
        .collect();
    let mut next = 0;
    criterion.bench_function("closest_point_near", |b| {
        b.iter(|| {
            next = (next + 1) % COUNT;
            let (x, hint) = &hinted[next];
            black_box(wing.closest_point_near(x, hint))
        })
    });
}

criterion_group!(benches, closest_point);
criterion_main!(benches);
