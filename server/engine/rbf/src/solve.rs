//! Solutions of the factorised system: interpolation, and its transpose.

use faer::{
    Mat, Par,
    dyn_stack::{MemBuffer, MemStack},
    linalg::cholesky::llt,
};
use rayon::prelude::*;

use crate::{
    Block, Coefficients, FEW, RadialBasis, Vector3,
    coefficients::Part,
    error_free::{two_product, two_sum},
    polynomial::AFFINE,
    triangular::{self, Tiles},
};

/// Columns solved by one task.
const COLUMNS: usize = 16;
/// Refinements of a solution with the cubic kernel, at most: each leaves a ten-thousandth or less.
const REFINEMENTS: usize = 3;
/// One that changes a solution by no more than this part is the last: sums keep about this part of what doubles round, and the
/// next one would leave no less.
const REFINED: f64 = 1.0 / (1 << 20) as f64;

impl RadialBasis {
    /// The interpolants through `data`: a row for each centre, a column for each interpolant. Linear in the data.
    ///
    /// # Panics
    /// If there is not one row for each centre.
    pub fn fit(&self, data: &Block) -> Coefficients {
        assert_eq!(data.data().len(), self.centres.count() * data.width(), "one row for each centre");
        let moments = Block::zeros(AFFINE, data.width());
        let leading = Part::from_rows(moments, data, self.centres.padded());
        self.solve(&Coefficients { leading, remainder: None })
    }

    /// The transpose of [`fit`](Self::fit): seeds of the data for seeds of the coefficients. The system is symmetric.
    pub fn fit_vjp(&self, seeds: &Coefficients) -> Block {
        self.solve(seeds).leading.rows(self.centres.count())
    }

    /// Solves `[[Psi, P], [P^T, 0]] [w; a] = [data; moments]`.
    fn solve(&self, right: &Coefficients) -> Coefficients {
        let leading = self.solve_in_doubles(&right.leading);
        if self.kernel.is_refined() {
            self.refine(right, leading)
        } else {
            Coefficients { leading, remainder: None }
        }
    }

    /// The solution to the accuracy of the factor.
    fn solve_in_doubles(&self, right: &Part) -> Part {
        let (count, padded) = (self.centres.count(), self.centres.padded());
        let mut solution = right.clone();
        let parts: Vec<Vec<[f64; AFFINE]>> = solution
            .weights
            .par_chunks_mut(padded * COLUMNS)
            .enumerate()
            .map(|(chunk, weights)| {
                let first = COLUMNS * chunk;
                let width = weights.len() / padded;
                let mut data = Mat::<f64>::from_fn(count, width, |i, c| weights[c * padded + i]);
                let moments: Vec<[f64; AFFINE]> =
                    (first..first + width).map(|c| std::array::from_fn(|k| right.affine.row(k)[c])).collect();
                let affine = self.solve_columns(&moments, &mut data);
                for (column, weights) in weights.chunks_mut(padded).enumerate() {
                    weights[..count].copy_from_slice(data.col_as_slice(column));
                }
                affine
            })
            .collect();
        for (column, part) in parts.iter().flatten().enumerate() {
            (0..AFFINE).for_each(|k| solution.affine.row_mut(k)[column] = part[k]);
        }
        solution
    }

    /// Iterative refinement: adds solutions for the residual until they change little.
    fn refine(&self, right: &Coefficients, start: Part) -> Coefficients {
        let centres = self.centres.to_vectors();
        let (mut solution, mut remainder) = (start.clone(), start);
        remainder.numbers_mut().for_each(|x| *x = 0.0);
        for _ in 0..REFINEMENTS {
            let residual = self.residual(right, &centres, &solution, &remainder);
            let correction = self.solve_in_doubles(&residual);
            let change =
                correction.largest_weights().zip(solution.largest_weights()).map(|(step, x)| step / x);
            // Where both are zero there is nothing to refine.
            let change = change.fold(0.0, f64::max);
            let numbers = solution.numbers_mut().zip(remainder.numbers_mut());
            for ((x, remainder), step) in numbers.zip(correction.numbers()) {
                let (sum, rounded) = two_sum(*x, *step);
                (*x, *remainder) = two_sum(sum, *remainder + rounded);
            }
            if change <= REFINED {
                break;
            }
        }
        Coefficients { leading: solution, remainder: Some(remainder) }
    }

    /// `right` less the product of the system with `leading + remainder`.
    fn residual(&self, right: &Coefficients, centres: &[Vector3], leading: &Part, remainder: &Part) -> Part {
        let affine = self.kernel.moments(&self.centres, leading, Some(remainder));
        let rows = self.kernel.sum(self.shape_squared, centres, &self.centres, leading, Some(remainder));
        let product = Coefficients::from_rows(affine, rows, &self.centres);
        let mut residual = right.leading.clone();
        residual.numbers_mut().zip(product.leading.numbers()).for_each(|(r, product)| *r -= product);
        if let Some(product) = &product.remainder {
            residual.numbers_mut().zip(product.numbers()).for_each(|(r, product)| *r -= product);
        }
        if let Some(remainder) = &right.remainder {
            residual.numbers_mut().zip(remainder.numbers()).for_each(|(r, remainder)| *r += remainder);
        }
        if self.regularisation != 0.0 {
            let weights = leading.weights.iter().zip(&remainder.weights);
            for (r, (w, remainder)) in residual.weights.iter_mut().zip(weights) {
                let (product, rounded) = two_product(self.regularisation, *w);
                *r = (*r - product) - (rounded + self.regularisation * remainder);
            }
        }
        residual
    }

    /// [`solve_in_doubles`](Self::solve_in_doubles) in place, column by column; returns the affine parts.
    fn solve_columns(&self, moments: &[[f64; AFFINE]], data: &mut Mat<f64>) -> Vec<[f64; AFFINE]> {
        // In the basis Q: w_1 = R^-T moments, A_22 w_2 = d_2 - A_21 w_1, a = R^-1 (d_1 - A_11 w_1 - A_12 w_2).
        let count = self.centres.count();
        self.affine.apply_transpose(data);
        let mut affine: Vec<[f64; AFFINE]> = Vec::with_capacity(moments.len());
        for (column, moments) in moments.iter().enumerate() {
            let first = self.affine.solve_transpose(*moments);
            let column = data.col_as_slice_mut(column);
            affine.push(std::array::from_fn(|k| column[k]));
            column[..AFFINE].copy_from_slice(&first);
            for i in AFFINE..count {
                column[i] -= (0..AFFINE).map(|k| self.top[(k, i)] * first[k]).sum::<f64>();
            }
        }
        self.solve_factor(data);
        for (column, affine) in affine.iter_mut().enumerate() {
            let column = data.col_as_slice(column);
            for k in 0..AFFINE {
                affine[k] -= (0..count).map(|i| self.top[(k, i)] * column[i]).sum::<f64>();
            }
            *affine = self.affine.solve(*affine);
        }
        self.affine.apply(data);
        affine
    }

    /// Solves with the Cholesky factor, for rows beyond the first four.
    fn solve_factor(&self, data: &mut Mat<f64>) {
        let (size, width) = (self.factor.nrows(), data.ncols());
        // Longer sums leave a little more rounding, which is refined away.
        if self.kernel.is_refined() && width <= FEW {
            let mut tiles = Tiles::zeros(size, width);
            for column in 0..width {
                let data = &data.col_as_slice(column)[AFFINE..];
                data.iter().enumerate().for_each(|(row, x)| *tiles.get_mut(row, column) = *x);
            }
            triangular::solve(&self.factor, &mut tiles);
            for column in 0..width {
                let data = &mut data.col_as_slice_mut(column)[AFFINE..];
                data.iter_mut().enumerate().for_each(|(row, x)| *x = *tiles.get_mut(row, column));
            }
            return;
        }
        let mut memory = MemBuffer::new(llt::solve::solve_in_place_scratch::<f64>(size, width, Par::Seq));
        let rows = data.get_mut(AFFINE.., ..);
        llt::solve::solve_in_place(self.factor.as_ref(), rows, Par::Seq, MemStack::new(&mut memory));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Kernel;

    /// With moments that are not zero, as seeds have them; against the matrix itself.
    #[test]
    fn solves_the_saddle_point_system() {
        let coordinate = |i: usize, k: usize| (1.7 * (i * i + 5 * i * k) as f64 + k as f64).sin();
        let centres: Vec<Vector3> = (0..37)
            .map(|i| Vector3::new(15.0 * coordinate(i, 1), 5.0 * coordinate(i, 2), 2.0 * coordinate(i, 3)))
            .collect();
        let basis = RadialBasis::new(Kernel::Cubic, &centres, 0.0).unwrap();
        let scaled = basis.centres.to_vectors();
        let mut data = Block::zeros(37, 3);
        data.data_mut().iter_mut().enumerate().for_each(|(i, x)| *x = (i as f64).sin());
        let mut moments = Block::zeros(AFFINE, 3);
        (0..AFFINE).for_each(|k| moments.row_mut(k).copy_from_slice(&[k as f64, 1.0, -0.3]));
        let right = Part::from_rows(moments.clone(), &data, basis.centres.padded());
        let solution = basis.solve(&Coefficients { leading: right, remainder: None });
        for axis in 0..3 {
            let w = solution.weights(axis);
            // Rounding of sums over weights larger than the data.
            let bound = 100.0 * f64::EPSILON * (1.0 + w.iter().map(|w| w.abs()).sum::<f64>());
            for i in 0..37 {
                let radial: f64 = (0..37)
                    .map(|j| Kernel::Cubic.value((scaled[i] - scaled[j]).norm_squared(), 0.0) * w[j])
                    .sum();
                let p = [1.0, scaled[i].x, scaled[i].y, scaled[i].z];
                let affine: f64 = (0..AFFINE).map(|k| p[k] * solution.leading.affine.row(k)[axis]).sum();
                assert!((radial + affine - data.row(i)[axis]).abs() < bound);
            }
            assert!((w[..37].iter().sum::<f64>() - moments.row(0)[axis]).abs() < bound);
            let first: f64 = (0..37).map(|j| w[j] * scaled[j].x).sum();
            assert!((first - moments.row(1)[axis]).abs() < bound);
        }
    }
}
