//! The dense matrix, row after row.

use faer::{Mat, traits::RealField};
use moldline_foundation::simd::widest;
use rayon::prelude::*;

use super::operator::Operator;

/// Rows or columns that one task handles.
const CHUNK: usize = 32;
/// Sums that run beside each other.
const LANES: usize = 16;

/// A square matrix.
#[derive(Clone, Debug)]
pub(crate) struct Matrix {
    size: usize,
    entries: Vec<f64>,
}

impl Matrix {
    pub fn zeros(size: usize) -> Self {
        Self { size, entries: vec![0.0; size * size] }
    }

    /// Bytes of a matrix of that size.
    pub fn bytes(size: usize) -> u64 {
        8 * size as u64 * size as u64
    }

    /// A row.
    pub fn row(&self, row: usize) -> &[f64] {
        &self.entries[row * self.size..(row + 1) * self.size]
    }

    /// A row, to be changed.
    pub fn row_mut(&mut self, row: usize) -> &mut [f64] {
        &mut self.entries[row * self.size..(row + 1) * self.size]
    }

    /// `A x` for several x.
    fn plain_times(&self, columns: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let rows: Vec<Vec<f64>> = self
            .entries
            .par_chunks(self.size.max(1))
            .map(|row| columns.iter().map(|x| product(row, x)).collect())
            .collect();
        (0..columns.len()).map(|c| rows.iter().map(|row| row[c]).collect()).collect()
    }

    /// `A^T x` for several x.
    fn transposed_times(&self, columns: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let chunks: Vec<Vec<[f64; CHUNK]>> = (0..self.size.div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let first = chunk * CHUNK;
                let width = CHUNK.min(self.size - first);
                let mut sums = vec![[0.0; CHUNK]; columns.len()];
                widest(
                    #[inline(always)]
                    || {
                        for (index, row) in self.entries.chunks(self.size).enumerate() {
                            let part = &row[first..first + width];
                            for (sum, x) in sums.iter_mut().zip(columns) {
                                for (s, a) in sum.iter_mut().zip(part) {
                                    *s += a * x[index];
                                }
                            }
                        }
                    },
                );
                sums
            })
            .collect();
        let column = |c: usize| chunks.iter().flat_map(|chunk| chunk[c]).take(self.size).collect();
        (0..columns.len()).map(column).collect()
    }

    /// A copy for factorisation.
    pub fn to_dense<T: RealField>(&self, convert: impl Fn(f64) -> T + Sync) -> Mat<T> {
        let mut dense = Mat::<T>::zeros(self.size, self.size);
        dense.par_col_chunks_mut(CHUNK).enumerate().for_each(|(chunk, mut columns)| {
            let first = chunk * CHUNK;
            for (index, row) in self.entries.chunks(self.size).enumerate() {
                for j in 0..columns.ncols() {
                    columns[(index, j)] = convert(row[first + j]);
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
        if transposed { self.transposed_times(columns) } else { self.plain_times(columns) }
    }

    fn block(&self, members: &[u32]) -> Mat<f64> {
        Mat::from_fn(members.len(), members.len(), |i, j| self.row(members[i] as usize)[members[j] as usize])
    }
}

/// The scalar product, its sums in one fixed order.
fn product(row: &[f64], x: &[f64]) -> f64 {
    let mut sums = [0.0; LANES];
    let (parts, rest) = row.as_chunks::<LANES>();
    let (of_x, rest_of_x) = x.as_chunks::<LANES>();
    widest(
        #[inline(always)]
        || {
            for (a, x) in parts.iter().zip(of_x) {
                for l in 0..LANES {
                    sums[l] += a[l] * x[l];
                }
            }
        },
    );
    sums.iter().sum::<f64>() + rest.iter().zip(rest_of_x).map(|(a, x)| a * x).sum::<f64>()
}
