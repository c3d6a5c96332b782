//! Triangular solves with a Cholesky factor for a few columns, in parallel over rows, where libraries are parallel over many columns.
//! Every number is summed in one order, whatever the number of threads.

use faer::Mat;
use moldline_foundation::simd::widest;
use rayon::prelude::*;

use crate::LANES;

/// Unknowns found one after another before they are taken from the rest, and rows of a tile.
const TILE: usize = 64;
/// Tiles of one task ...
const TILES: usize = 8;
/// ... and least number of unknowns.
const UNKNOWNS: usize = 16;

/// Numbers for the rows of a matrix, a column for each right-hand side: tile after tile of rows, column after column within each.
pub(crate) struct Tiles {
    values: Vec<f64>,
    columns: usize,
}

impl Tiles {
    pub(crate) fn zeros(rows: usize, columns: usize) -> Self {
        Self { values: vec![0.0; rows.next_multiple_of(TILE) * columns], columns }
    }

    pub(crate) fn get_mut(&mut self, row: usize, column: usize) -> &mut f64 {
        &mut self.values[(row / TILE * self.columns + column) * TILE + row % TILE]
    }
}

/// Solves `L L^T x = b` in place. Of `lower` only the lower triangle is read.
pub(crate) fn solve(lower: &Mat<f64>, b: &mut Tiles) {
    if b.columns > 0 {
        forward(lower, b);
        backward(lower, b);
    }
}

/// `L y = b`.
fn forward(lower: &Mat<f64>, b: &mut Tiles) {
    let length = TILE * b.columns;
    for first in (0..lower.nrows()).step_by(TILE) {
        let last = lower.nrows().min(first + TILE);
        let (found, rest) = b.values.split_at_mut((first / TILE + 1) * length);
        let found = &mut found[first / TILE * length..];
        for y in found.chunks_exact_mut(TILE) {
            for j in first..last {
                let (column, y) = (&lower.col_as_slice(j)[j..last], &mut y[j - first..]);
                y[0] /= column[0];
                let found = y[0];
                y[1..].iter_mut().zip(&column[1..]).for_each(|(rest, l)| *rest -= l * found);
            }
        }
        let found = &*found;
        rest.par_chunks_mut(TILES * length).enumerate().for_each(|(task, rest)| {
            let begin = last + task * TILES * TILE;
            widest(
                #[inline(always)]
                || {
                    for j in first..last {
                        let column = lower.col_as_slice(j)[begin..].chunks(TILE);
                        for (rest, column) in rest.chunks_exact_mut(length).zip(column) {
                            for (rest, y) in rest.chunks_exact_mut(TILE).zip(found.chunks_exact(TILE)) {
                                let y = y[j - first];
                                rest.iter_mut().zip(column).for_each(|(rest, l)| *rest -= l * y);
                            }
                        }
                    }
                },
            );
        });
    }
}

/// `L^T x = b`.
fn backward(lower: &Mat<f64>, b: &mut Tiles) {
    let columns = b.columns;
    let length = TILE * columns;
    let mut known = vec![0.0; length];
    for first in (0..lower.nrows()).step_by(TILE).rev() {
        let last = lower.nrows().min(first + TILE);
        let (rest, found) = b.values.split_at_mut((first / TILE + 1) * length);
        let found = &*found;
        known.par_chunks_mut(columns).with_min_len(UNKNOWNS).zip(first..last).for_each(|(known, j)| {
            widest(
                #[inline(always)]
                || {
                    known.fill(0.0);
                    let column = &lower.col_as_slice(j)[last..];
                    for (column, found) in column.chunks(TILE).zip(found.chunks_exact(length)) {
                        for (known, x) in known.iter_mut().zip(found.chunks_exact(TILE)) {
                            *known += dot(column, x);
                        }
                    }
                },
            );
        });
        for (c, x) in rest[first / TILE * length..].chunks_exact_mut(TILE).enumerate() {
            for j in (first..last).rev() {
                let (column, x) = (&lower.col_as_slice(j)[j..last], &mut x[j - first..]);
                let known = known[(j - first) * columns + c] + dot(&column[1..], &x[1..]);
                x[0] = (x[0] - known) / column[0];
            }
        }
    }
}

/// The sum of the products of `a` with as many numbers of `b`, in lanes.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (lanes, rest) = a.as_chunks::<LANES>();
    let mut sums = [0.0; LANES];
    for (a, b) in lanes.iter().zip(b.as_chunks::<LANES>().0) {
        (0..LANES).for_each(|lane| sums[lane] += a[lane] * b[lane]);
    }
    let rest: f64 = rest.iter().zip(&b[a.len() - rest.len()..]).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f64>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sizes of less than a tile, of whole tiles, and of more than a task.
    #[test]
    fn undoes_the_product_of_both_factors() {
        for (size, columns) in [(1, 1), (5, 2), (TILE, 3), (3 * TILE, 1), (TILE * (TILES + 3) + 17, 3)] {
            // The upper triangle must not be read.
            let lower = Mat::from_fn(size, size, |i, j| match i.cmp(&j) {
                std::cmp::Ordering::Less => f64::NAN,
                std::cmp::Ordering::Equal => 2.0 + (0.3 * i as f64).sin(),
                std::cmp::Ordering::Greater => (1.3 * i as f64 + 0.7 * (j * j) as f64).cos() / size as f64,
            });
            let x = Mat::from_fn(size, columns, |i, c| (i as f64 + 0.1).sin() + c as f64);
            let transposed = Mat::from_fn(size, columns, |j, c| -> f64 {
                (j..size).map(|i| lower[(i, j)] * x[(i, c)]).sum()
            });
            let mut b = Tiles::zeros(size, columns);
            for c in 0..columns {
                for i in 0..size {
                    *b.get_mut(i, c) = (0..=i).map(|j| lower[(i, j)] * transposed[(j, c)]).sum();
                }
            }
            solve(&lower, &mut b);
            for c in 0..columns {
                for i in 0..size {
                    let error = (*b.get_mut(i, c) - x[(i, c)]).abs();
                    assert!(error <= 1e-13, "{size} x {columns}: {error:e} at {i}, {c}");
                }
            }
        }
    }
}
