//! LU factorisation with partial pivoting, in parallel with the same bits on any number of threads.
//!
//! Right-looking, by blocks of columns. A block is factorised by one task; then every chunk of columns to its right is
//! permuted, solved and updated by one task, whatever the number of threads.

use faer::{
    Accum, Mat, MatMut, MatRef, Par, Spec,
    dyn_stack::{MemBuffer, MemStack},
    linalg::{lu::partial_pivoting::factor, matmul::matmul, triangular_solve as triangular},
    traits::RealField,
};
use rayon::prelude::*;

use super::operator::{Inverse, maximum};
use crate::{Monitor, PanelError, Stage};

/// Columns of a block.
const BLOCK: usize = 192;
/// Columns of a chunk.
const CHUNK: usize = 192;
/// Right-hand sides that are solved for at a time.
const RIGHT: usize = 8;

/// A factorised square matrix: `P A = L U`.
#[derive(Clone, Debug)]
pub(crate) struct Factor<T> {
    /// L below the diagonal, U on and above it.
    matrix: Mat<T>,
    /// Row i of `P A` is row `rows[i]` of A.
    rows: Vec<usize>,
}

impl<T: RealField + Send + Sync> Factor<T> {
    /// Factorises in place. `report` gets the fraction of work done and returns whether to go on.
    pub fn new(mut matrix: Mat<T>, report: impl Fn(f64) -> bool + Sync) -> Result<Self, PanelError> {
        let n = matrix.nrows();
        let mut rows: Vec<usize> = (0..n).collect();
        for first in (0..n).step_by(BLOCK) {
            let done = 1.0 - ((n - first) as f64 / n as f64).powi(3);
            if !report(done) {
                return Err(PanelError::Cancelled);
            }
            let width = BLOCK.min(n - first);
            let (left, rest) = matrix.as_mut().split_at_col_mut(first);
            let (mut block, right) = rest.split_at_col_mut(width);
            let moves = factorise_block(block.as_mut().get_mut(first.., ..));
            let block = block.as_ref();
            left.par_col_chunks_mut(CHUNK).for_each(|chunk| permute(chunk.get_mut(first.., ..), &moves));
            right.par_col_chunks_mut(CHUNK).for_each(|chunk| {
                // The rest of a large matrix takes seconds.
                if !report(done) {
                    return;
                }
                let mut chunk = chunk.get_mut(first.., ..);
                permute(chunk.as_mut(), &moves);
                let (mut top, bottom) = chunk.split_at_row_mut(width);
                let (diagonal, below) = block.get(first.., ..).split_at_row(width);
                triangular::solve_unit_lower_triangular_in_place(diagonal, top.as_mut(), Par::Seq);
                matmul(bottom, Accum::Add, below, top.as_ref(), -T::one_impl(), Par::Seq);
            });
            let old: Vec<usize> = moves.iter().map(|(_, from)| rows[first + from]).collect();
            moves.iter().zip(old).for_each(|((to, _), row)| rows[first + to] = row);
        }
        if report(1.0) { Ok(Self { matrix, rows }) } else { Err(PanelError::Cancelled) }
    }

    /// Solves `A X = B`, or `A^T X = B`, in place; leaves off once `monitor` has cancelled.
    pub fn solve_in_place(&self, right: &mut Mat<T>, transposed: bool, monitor: &dyn Monitor<Stage>) {
        if transposed { self.solve_transposed(right, monitor) } else { self.solve_plain(right, monitor) }
    }

    fn solve_plain(&self, right: &mut Mat<T>, monitor: &dyn Monitor<Stage>) {
        let permuted = Mat::from_fn(right.nrows(), right.ncols(), |i, j| right[(self.rows[i], j)].clone());
        *right = permuted;
        let matrix = self.matrix.as_ref();
        in_steps(
            right,
            monitor,
            [&|chunk| triangular::solve_unit_lower_triangular_in_place(matrix, chunk, Par::Seq), &|chunk| {
                triangular::solve_upper_triangular_in_place(matrix, chunk, Par::Seq)
            }],
        );
    }

    fn solve_transposed(&self, right: &mut Mat<T>, monitor: &dyn Monitor<Stage>) {
        let transposed: MatRef<'_, T> = self.matrix.transpose();
        in_steps(
            right,
            monitor,
            [&|chunk| triangular::solve_lower_triangular_in_place(transposed, chunk, Par::Seq), &|chunk| {
                triangular::solve_unit_upper_triangular_in_place(transposed, chunk, Par::Seq)
            }],
        );
        let mut out = right.clone();
        for (i, &row) in self.rows.iter().enumerate() {
            (0..right.ncols()).for_each(|j| out[(row, j)] = right[(i, j)].clone());
        }
        *right = out;
    }
}

/// A solution by a triangle, in place.
type Step<'a, T> = &'a (dyn Fn(MatMut<'_, T>) + Sync);

/// Two solutions by triangles, one after the other for every few columns, which are independent.
fn in_steps<T: RealField + Send + Sync>(
    right: &mut Mat<T>,
    monitor: &dyn Monitor<Stage>,
    steps: [Step<'_, T>; 2],
) {
    right.as_mut().par_col_chunks_mut(RIGHT).for_each(|mut chunk| {
        for step in steps {
            if monitor.cancelled() {
                return;
            }
            step(chunk.as_mut());
        }
    });
}

impl Inverse for Factor<f64> {
    fn solve(&self, right: &[Vec<f64>], transposed: bool, monitor: &dyn Monitor<Stage>) -> Vec<Vec<f64>> {
        let mut columns = Mat::from_fn(right[0].len(), right.len(), |i, j| right[j][i]);
        self.solve_in_place(&mut columns, transposed, monitor);
        (0..right.len()).map(|j| columns.col_as_slice(j).to_vec()).collect()
    }
}

/// With columns scaled to their maximum norm, so that a small residual does not underflow.
impl Inverse for Factor<f32> {
    fn solve(&self, right: &[Vec<f64>], transposed: bool, monitor: &dyn Monitor<Stage>) -> Vec<Vec<f64>> {
        let scales: Vec<f64> =
            right.iter().map(|b| maximum(b)).map(|s| if s > 0.0 { s } else { 1.0 }).collect();
        let mut columns = Mat::from_fn(right[0].len(), right.len(), |i, j| (right[j][i] / scales[j]) as f32);
        self.solve_in_place(&mut columns, transposed, monitor);
        let column = |j: usize| columns.col_as_slice(j).iter().map(|x| f64::from(*x) * scales[j]).collect();
        (0..right.len()).map(column).collect()
    }
}

/// Factorises a tall block; the rows that have moved, as `(to, from)`.
fn factorise_block<T: RealField>(block: MatMut<'_, T>) -> Vec<(usize, usize)> {
    let (rows, columns) = (block.nrows(), block.ncols());
    let (mut forward, mut inverse) = (vec![0_usize; rows], vec![0_usize; rows]);
    let parameters = Spec::default();
    let mut memory =
        MemBuffer::new(factor::lu_in_place_scratch::<usize, T>(rows, columns, Par::Seq, parameters));
    factor::lu_in_place(block, &mut forward, &mut inverse, Par::Seq, MemStack::new(&mut memory), parameters);
    forward.into_iter().enumerate().filter(|(to, from)| to != from).collect()
}

fn permute<T: RealField>(mut columns: MatMut<'_, T>, moves: &[(usize, usize)]) {
    let mut values = Vec::with_capacity(moves.len());
    for j in 0..columns.ncols() {
        values.clear();
        values.extend(moves.iter().map(|(_, from)| columns[(*from, j)].clone()));
        for ((to, _), value) in moves.iter().zip(values.drain(..)) {
            columns[(*to, j)] = value;
        }
    }
}
