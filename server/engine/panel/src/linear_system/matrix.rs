//! The dense matrix, stored as it is assembled: tiles of rows, and within a tile column after column.

use faer::{Mat, traits::RealField};
use moldline_foundation::simd::widest;
use rayon::prelude::*;

use super::operator::Operator;
use crate::lanes::{LANES, Lane, total};

/// Columns that one task handles.
const COLUMNS: usize = 32;

/// A square matrix.
#[derive(Clone, Debug)]
pub(crate) struct Matrix {
    size: usize,
    /// Tile after tile; rows beyond the last one are unused.
    lanes: Vec<Lane>,
}

impl Matrix {
    pub fn zeros(size: usize) -> Self {
        Self { size, lanes: vec![[0.0; LANES]; size.div_ceil(LANES) * size] }
    }

    /// Bytes of a matrix of that size.
    pub fn bytes(size: usize) -> u64 {
        (size.div_ceil(LANES) * LANES) as u64 * size as u64 * 8
    }

    /// The tiles of [`LANES`] rows each, to be filled in parallel.
    pub fn tiles_mut(&mut self) -> rayon::slice::ChunksMut<'_, Lane> {
        self.lanes.par_chunks_mut(self.size.max(1))
    }

    fn get(&self, row: usize, column: usize) -> f64 {
        self.lanes[row / LANES * self.size + column][row % LANES]
    }

    /// `A x` for several x.
    pub fn times(&self, columns: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let tiles: Vec<Vec<Lane>> = self
            .lanes
            .par_chunks(self.size.max(1))
            .map(|tile| {
                // A piece of the tile serves all columns while it is near.
                let mut sums = vec![[[0.0; LANES]; 2]; columns.len()];
                widest(
                    #[inline(always)]
                    || {
                        for (piece, entries) in tile.chunks(COLUMNS).enumerate() {
                            for (x, sums) in columns.iter().zip(&mut sums) {
                                row_piece(entries, &x[piece * COLUMNS..], sums);
                            }
                        }
                    },
                );
                sums.iter().map(|[a, b]| std::array::from_fn(|l| a[l] + b[l])).collect()
            })
            .collect();
        let column = |c: usize| tiles.iter().flat_map(|tile| tile[c]).take(self.size).collect();
        (0..columns.len()).map(column).collect()
    }

    /// `A^T x` for several x.
    fn transposed_times(&self, columns: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let padded: Vec<Vec<f64>> = columns
            .iter()
            .map(|x| {
                let mut padded = x.clone();
                padded.resize(self.size.div_ceil(LANES) * LANES, 0.0);
                padded
            })
            .collect();
        let chunks: Vec<Vec<[f64; COLUMNS]>> = (0..self.size.div_ceil(COLUMNS))
            .into_par_iter()
            .map(|chunk| {
                let first = chunk * COLUMNS;
                let last = (first + COLUMNS).min(self.size);
                let mut sums = vec![[[0.0; LANES]; COLUMNS]; columns.len()];
                widest(
                    #[inline(always)]
                    || {
                        for (index, tile) in self.lanes.chunks(self.size.max(1)).enumerate() {
                            for (sums, x) in sums.iter_mut().zip(&padded) {
                                column_piece(&tile[first..last], &x.as_chunks::<LANES>().0[index], sums);
                            }
                        }
                    },
                );
                sums.iter().map(|sums| sums.each_ref().map(total)).collect()
            })
            .collect();
        let column = |c: usize| chunks.iter().flat_map(|chunk| chunk[c]).take(self.size).collect();
        (0..columns.len()).map(column).collect()
    }

    /// A copy for factorisation.
    pub fn to_dense<T: RealField>(&self, convert: impl Fn(f64) -> T + Sync) -> Mat<T> {
        let mut dense = Mat::<T>::zeros(self.size, self.size);
        dense.par_col_chunks_mut(COLUMNS).enumerate().for_each(|(chunk, mut columns)| {
            let first = chunk * COLUMNS;
            for (index, tile) in self.lanes.chunks(self.size.max(1)).enumerate() {
                for j in 0..columns.ncols() {
                    let rows = LANES.min(self.size - index * LANES);
                    for l in 0..rows {
                        columns[(index * LANES + l, j)] = convert(tile[first + j][l]);
                    }
                }
            }
        });
        dense
    }
}

impl Operator for Matrix {
    fn size(&self) -> usize {
        self.size
    }

    fn times(&self, columns: &[Vec<f64>], transposed: bool) -> Vec<Vec<f64>> {
        if transposed { self.transposed_times(columns) } else { Self::times(self, columns) }
    }

    fn block(&self, members: &[u32]) -> Mat<f64> {
        Mat::from_fn(members.len(), members.len(), |i, j| self.get(members[i] as usize, members[j] as usize))
    }
}

/// Adds entries times x; two sums at a time, since one would wait for its additions.
#[inline(always)]
fn row_piece(entries: &[Lane], x: &[f64], sums: &mut [Lane; 2]) {
    for (entries, x) in entries.chunks(2).zip(x.chunks(2)) {
        for (sum, (entry, x)) in sums.iter_mut().zip(entries.iter().zip(x)) {
            for l in 0..LANES {
                sum[l] += entry[l] * x;
            }
        }
    }
}

/// Adds the products of every column's entries with x, lane by lane.
#[inline(always)]
fn column_piece(entries: &[Lane], x: &Lane, sums: &mut [Lane; COLUMNS]) {
    for (sum, entry) in sums.iter_mut().zip(entries) {
        for l in 0..LANES {
            sum[l] += entry[l] * x[l];
        }
    }
}
