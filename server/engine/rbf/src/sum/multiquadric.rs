//! Sums over multiquadrics, `sum_j -sqrt(|t - s_j|^2 + c^2) w_j + a . [1, t]`, in double precision.

use std::ops::Range;

use faer::{Accum, MatMut, MatRef, Par, linalg::matmul::matmul};
use moldline_foundation::simd::widest;
use rayon::prelude::*;

use super::{PANEL, Sums, TILE};
use crate::{
    Block, FEW, LANES, Vector3,
    coefficients::Part,
    points::Points,
    polynomial::{AFFINE, monomials},
};

/// `-sqrt(r^2 + c^2)` from the squares.
#[inline(always)]
pub(crate) fn value(squared: f64, shape_squared: f64) -> f64 {
    -(squared + shape_squared).sqrt()
}

/// The sums at each target. In parallel over tiles of targets; each value is summed in one fixed order.
pub(crate) fn sum(targets: &[Vector3], sources: &Points, coefficients: &Part, shape_squared: f64) -> Sums {
    let columns = coefficients.columns();
    let mut out = Block::zeros(targets.len(), columns);
    radial(targets, sources, &coefficients.weights, shape_squared, &mut out);
    let rows = out.data_mut().chunks_mut(columns.max(1));
    for (row, x) in rows.zip(targets) {
        for (k, p) in monomials(x).into_iter().enumerate() {
            row.iter_mut().zip(coefficients.affine.row(k)).for_each(|(out, a)| *out += a * p);
        }
    }
    Sums { leading: out, remainder: None }
}

/// `sum_j w_j [1, s_j]`.
pub(crate) fn moments(sources: &Points, weights: &Part) -> Sums {
    let columns = weights.columns();
    let mut out = Block::zeros(AFFINE, columns);
    for column in 0..columns {
        for (j, weight) in weights.weights_of(column)[..sources.count()].iter().enumerate() {
            for (k, p) in monomials(&sources.get(j)).into_iter().enumerate() {
                out.row_mut(k)[column] += p * weight;
            }
        }
    }
    Sums { leading: out, remainder: None }
}

/// The radial part of the sums.
fn radial(targets: &[Vector3], sources: &Points, weights: &[f64], shape_squared: f64, out: &mut Block) {
    let columns = out.width();
    if columns == 0 {
        return;
    }
    let tiles = targets.par_chunks(TILE).zip(out.data_mut().par_chunks_mut(TILE * columns));
    if columns <= FEW {
        tiles.for_each(|(targets, out)| {
            widest(
                #[inline(always)]
                || match columns {
                    1 => few::<1>(targets, sources, weights, shape_squared, out),
                    2 => few::<2>(targets, sources, weights, shape_squared, out),
                    _ => few::<3>(targets, sources, weights, shape_squared, out),
                },
            );
        });
    } else {
        tiles.for_each_init(
            || vec![0.0; TILE * PANEL],
            |panel, (targets, out)| {
                for first in (0..sources.count()).step_by(PANEL) {
                    let last = (first + PANEL).min(sources.count());
                    widest(
                        #[inline(always)]
                        || kernel_panel(targets, sources, first..last, shape_squared, panel),
                    );
                    let (rows, width) = (targets.len(), last - first);
                    let panel = MatRef::from_column_major_slice_with_stride(panel, rows, width, TILE);
                    let weights = MatRef::from_column_major_slice_with_stride(
                        &weights[first..],
                        width,
                        columns,
                        sources.padded(),
                    );
                    let out = MatMut::from_row_major_slice_mut(out, rows, columns);
                    matmul(out, Accum::Add, panel, weights, 1.0, Par::Seq);
                }
            },
        );
    }
}

/// Sums of one tile for up to [`FEW`] columns: kernel values are formed and used in registers.
#[inline(always)]
fn few<const N: usize>(
    targets: &[Vector3],
    sources: &Points,
    weights: &[f64],
    shape_squared: f64,
    out: &mut [f64],
) {
    let [x, y, z] = sources.lanes();
    let padded = sources.padded();
    let weights: [&[[f64; LANES]]; N] =
        std::array::from_fn(|k| weights[k * padded..(k + 1) * padded].as_chunks::<LANES>().0);
    for (target, out) in targets.iter().zip(out.chunks_exact_mut(N)) {
        let mut sums = [[0.0; LANES]; N];
        for chunk in 0..x.len() {
            for lane in 0..LANES {
                let dx = target.x - x[chunk][lane];
                let dy = target.y - y[chunk][lane];
                let dz = target.z - z[chunk][lane];
                let value = value(dx * dx + dy * dy + dz * dz, shape_squared);
                for k in 0..N {
                    sums[k][lane] += value * weights[k][chunk][lane];
                }
            }
        }
        for (out, lanes) in out.iter_mut().zip(&sums) {
            *out = lanes.iter().sum();
        }
    }
}

/// Kernel values between the targets of a tile and some sources, source after source.
#[inline(always)]
fn kernel_panel(
    targets: &[Vector3],
    sources: &Points,
    range: Range<usize>,
    shape_squared: f64,
    panel: &mut [f64],
) {
    let mut tile = [[0.0; TILE]; 3];
    for (i, target) in targets.iter().enumerate() {
        (0..3).for_each(|axis| tile[axis][i] = target[axis]);
    }
    for (column, j) in panel.chunks_exact_mut(TILE).zip(range) {
        let source = sources.get(j);
        for i in 0..TILE {
            let dx = tile[0][i] - source.x;
            let dy = tile[1][i] - source.y;
            let dz = tile[2][i] - source.z;
            column[i] = value(dx * dx + dy * dy + dz * dz, shape_squared);
        }
    }
}
