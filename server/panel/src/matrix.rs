//! The dense matrix, stored as it is made: tiles of rows, and within a tile column after column.

use faer::{Mat, traits::RealField};
use rayon::prelude::*;

use crate::lanes::{LANES, Lane};

/// Columns that one task handles.
const COLUMNS: usize = 64;

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

    pub fn size(&self) -> usize {
        self.size
    }

    /// The tiles of [`LANES`] rows each, to be filled in parallel.
    pub fn tiles_mut(&mut self) -> rayon::slice::ChunksMut<'_, Lane> {
        self.lanes.par_chunks_mut(self.size.max(1))
    }

    pub fn get(&self, row: usize, column: usize) -> f64 {
        self.lanes[row / LANES * self.size + column][row % LANES]
    }

    /// `A x`.
    pub fn times(&self, x: &[f64]) -> Vec<f64> {
        let tiles: Vec<Lane> = self
            .lanes
            .par_chunks(self.size.max(1))
            .map(|tile| {
                // Four sums at a time: one would wait for its additions.
                let mut sums = [[0.0; LANES]; 4];
                for (columns, x) in tile.chunks(4).zip(x.chunks(4)) {
                    for (sum, (column, x)) in sums.iter_mut().zip(columns.iter().zip(x)) {
                        for l in 0..LANES {
                            sum[l] += column[l] * x;
                        }
                    }
                }
                std::array::from_fn(|l| (sums[0][l] + sums[1][l]) + (sums[2][l] + sums[3][l]))
            })
            .collect();
        tiles.into_iter().flatten().take(self.size).collect()
    }

    /// `A^T x`.
    pub fn transposed_times(&self, x: &[f64]) -> Vec<f64> {
        let mut padded = x.to_vec();
        padded.resize(self.size.div_ceil(LANES) * LANES, 0.0);
        let x = padded.as_chunks::<LANES>().0;
        let mut out = vec![0.0; self.size];
        out.par_chunks_mut(COLUMNS).enumerate().for_each(|(chunk, out)| {
            let mut sums = [[0.0; LANES]; COLUMNS];
            let first = chunk * COLUMNS;
            for (tile, x) in self.lanes.chunks(self.size.max(1)).zip(x) {
                for (sum, column) in sums.iter_mut().zip(&tile[first..first + out.len()]) {
                    for l in 0..LANES {
                        sum[l] += column[l] * x[l];
                    }
                }
            }
            for (out, sum) in out.iter_mut().zip(&sums) {
                *out = crate::lanes::total(sum);
            }
        });
        out
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
