//! Sums over cubic functions, `sum_j |t - s_j|^3 w_j + a . [1, t]`, whose terms may be millions of times as large as they are.
//!
//! Every kernel value and every weight is cut in two, `k = k_1 + k_2` and `w = w_1 + w_2`, the first parts so short that all
//! products and sums of them are exact in double precision, whatever the order (Ozaki, Ogita, Oishi and Rump, Error-free
//! transformations of matrix multiplication, Numerical Algorithms 59, 2012). What remains, `k_1 w_2 + k_2 w`, is
//! `2^-b` times as large, and so is its rounding; b is about 20. Kernel values are formed with twice the digits of a double.

use faer::{Accum, MatMut, MatRef, Par, linalg::matmul::matmul};
use moldline_geometry::Block;
use moldline_spline::Vector3;
use pulp::Arch;
use rayon::prelude::*;

use super::{AFFINE, Cloud, PANEL, Part, TILE, monomials};

/// Sums, a row for each target and a column for each column of weights.
pub(super) struct Sums {
    /// Of products of first parts, without rounding.
    exact: Block,
    /// Of all the rest.
    rest: Block,
}

impl Sums {
    fn zeros(count: usize, columns: usize) -> Self {
        Self { exact: Block::zeros(count, columns), rest: Block::zeros(count, columns) }
    }

    /// In doubles.
    pub(super) fn total(self) -> Block {
        self.pair().0
    }

    /// In doubles, and what that rounds off.
    pub(super) fn pair(mut self) -> (Block, Block) {
        for (a, b) in self.exact.data_mut().iter_mut().zip(self.rest.data_mut()) {
            (*a, *b) = two_sum(*a, *b);
        }
        (self.exact, self.rest)
    }
}

/// `a + b` rounded, and what is rounded off (Knuth).
#[inline(always)]
pub(super) fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let part = sum - a;
    (sum, (a - (sum - part)) + (b - part))
}

/// `a b` rounded, and what is rounded off.
#[inline(always)]
pub(super) fn two_product(a: f64, b: f64) -> (f64, f64) {
    let product = a * b;
    (product, a.mul_add(b, -product))
}

/// Cuts numbers in two.
#[derive(Clone, Copy)]
struct Cut(f64);

impl Cut {
    /// First parts of numbers up to `largest` are multiples of `2^-bits` times the next power of two.
    fn new(largest: f64, bits: i32) -> Self {
        let above = f64::from_bits(((largest.to_bits() >> 52) + 1) << 52);
        // Between 2^52 and 2^53 times that multiple, which is the distance between the doubles there.
        Self(1.5 * above * 2_f64.powi(52 - bits))
    }

    /// Bits for which sums of so many products of first parts are exact.
    fn bits(products: usize) -> i32 {
        (53 - products.next_power_of_two().trailing_zeros() as i32) / 2
    }

    /// The first part.
    #[inline(always)]
    fn first(self, x: f64) -> f64 {
        (x + self.0) - self.0
    }
}

/// Weights and affine parts, one below the other, column after column.
struct Weights {
    rows: usize,
    first: Vec<f64>,
    second: Vec<f64>,
    whole: Vec<f64>,
}

impl Weights {
    fn new(count: usize, leading: &Part, rest: Option<&Part>, bits: i32) -> Self {
        let columns = leading.columns();
        let column = |part: &Part, c: usize| -> Vec<f64> {
            let affine = (0..AFFINE).map(|k| part.affine.row(k)[c]);
            part.weights_of(c)[..count].iter().copied().chain(affine).collect()
        };
        let whole: Vec<f64> = (0..columns).flat_map(|c| column(leading, c)).collect();
        let mut second: Vec<f64> = match rest {
            Some(rest) => (0..columns).flat_map(|c| column(rest, c)).collect(),
            None => vec![0.0; whole.len()],
        };
        let rows = count + AFFINE;
        let mut first = whole.clone();
        for (first, second) in first.chunks_mut(rows).zip(second.chunks_mut(rows)) {
            let cut = Cut::new(largest(first), bits);
            for (first, second) in first.iter_mut().zip(second) {
                let whole = *first;
                *first = cut.first(whole);
                *second += whole - *first;
            }
        }
        Self { rows, first, second, whole }
    }
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |largest, x| x.abs().max(largest))
}

/// The sums at each target.
pub(super) fn sums(targets: &[Vector3], sources: &Cloud, leading: &Part, rest: Option<&Part>) -> Sums {
    let columns = leading.columns();
    let mut sums = Sums::zeros(targets.len(), columns);
    if columns == 0 {
        return sums;
    }
    let bits = Cut::bits(sources.count + AFFINE);
    let weights = Weights::new(sources.count, leading, rest, bits);
    let reach = (0..sources.count).map(|j| sources.get(j).norm()).fold(0.0, f64::max);
    let arch = Arch::new();
    targets
        .par_chunks(TILE)
        .zip(sums.exact.data_mut().par_chunks_mut(TILE * columns))
        .zip(sums.rest.data_mut().par_chunks_mut(TILE * columns))
        .for_each_init(
            || [vec![0.0; TILE * PANEL], vec![0.0; TILE * PANEL]],
            |[firsts, seconds], ((targets, exact), rest)| {
                let tile = Tile::new(targets, reach, bits);
                for first in (0..weights.rows).step_by(PANEL) {
                    let range = first..(first + PANEL).min(weights.rows);
                    let width = range.len();
                    arch.dispatch(
                        #[inline(always)]
                        || tile.panel(sources, range, firsts, seconds),
                    );
                    let rows = targets.len();
                    let add = |panel: &[f64], weights_of: &[f64], out: &mut [f64]| {
                        let panel = MatRef::from_column_major_slice_with_stride(panel, rows, width, TILE);
                        let below = &weights_of[first..];
                        let some =
                            MatRef::from_column_major_slice_with_stride(below, width, columns, weights.rows);
                        let out = MatMut::from_row_major_slice_mut(out, rows, columns);
                        matmul(out, Accum::Add, panel, some, 1.0, Par::Seq);
                    };
                    add(firsts, &weights.first, exact);
                    add(firsts, &weights.second, rest);
                    add(seconds, &weights.whole, rest);
                }
            },
        );
    sums
}

/// Targets of one task.
struct Tile {
    coordinates: [[f64; TILE]; 3],
    /// How each of them cuts its kernel values.
    cuts: [Cut; TILE],
}

impl Tile {
    /// `reach`: distance of the farthest source from the origin.
    fn new(targets: &[Vector3], reach: f64, bits: i32) -> Self {
        let mut tile = Self { coordinates: [[0.0; TILE]; 3], cuts: [Cut(0.0); TILE] };
        for (i, target) in targets.iter().enumerate() {
            (0..3).for_each(|axis| tile.coordinates[axis][i] = target[axis]);
            // Not less than any kernel value, nor than any of the affine functions.
            tile.cuts[i] = Cut::new((1.001 * (target.norm() + reach)).powi(3).max(1.0), bits);
        }
        tile
    }

    /// First and second parts of the kernel values, source after source, and after them of the affine functions.
    #[inline(always)]
    fn panel(&self, sources: &Cloud, range: std::ops::Range<usize>, firsts: &mut [f64], seconds: &mut [f64]) {
        let columns = firsts.chunks_exact_mut(TILE).zip(seconds.chunks_exact_mut(TILE));
        for ((firsts, seconds), j) in columns.zip(range) {
            if let Some(k) = j.checked_sub(sources.count) {
                for i in 0..TILE {
                    let x = Vector3::from(self.coordinates.map(|c| c[i]));
                    let value = monomials(&x)[k];
                    firsts[i] = self.cuts[i].first(value);
                    seconds[i] = value - firsts[i];
                }
                continue;
            }
            let source = sources.get(j);
            for i in 0..TILE {
                let (value, rounded) = cube([
                    two_sum(self.coordinates[0][i], -source.x),
                    two_sum(self.coordinates[1][i], -source.y),
                    two_sum(self.coordinates[2][i], -source.z),
                ]);
                firsts[i] = self.cuts[i].first(value);
                seconds[i] = (value - firsts[i]) + rounded;
            }
        }
    }
}

/// The third power of the length of a vector, and what is rounded off, to about 100 bits.
#[inline(always)]
fn cube([(x, x_rest), (y, y_rest), (z, z_rest)]: [(f64, f64); 3]) -> (f64, f64) {
    let square = |hi: f64, lo: f64| {
        let (product, rest) = two_product(hi, hi);
        (product, (2.0 * hi).mul_add(lo, rest))
    };
    let ((xx, xx_rest), (yy, yy_rest), (zz, zz_rest)) =
        (square(x, x_rest), square(y, y_rest), square(z, z_rest));
    let (sum, rest) = two_sum(xx, yy);
    let (sum, more) = two_sum(sum, zz);
    let rest = ((xx_rest + yy_rest) + zz_rest) + (rest + more);
    // With r^2 = s + d: r^3 + 3/2 r d, beyond which there is nothing left.
    let r = sum.sqrt();
    let off = (-r).mul_add(r, sum) + rest;
    let (squared, squared_rest) = two_product(r, r);
    let (cubed, cubed_rest) = two_product(squared, r);
    (cubed, (1.5 * r).mul_add(off, squared_rest.mul_add(r, cubed_rest)))
}

/// `sum_j w_j [1, s_j]`: the transpose of the affine part.
pub(super) fn moments(sources: &Cloud, leading: &Part, rest: Option<&Part>) -> Sums {
    let (count, columns) = (sources.count, leading.columns());
    let mut sums = Sums::zeros(AFFINE, columns);
    let bits = Cut::bits(count + AFFINE);
    let weights = Weights::new(count, leading, rest, bits);
    for k in 0..AFFINE {
        let values: Vec<f64> = (0..count).map(|j| monomials(&sources.get(j))[k]).collect();
        let cut = Cut::new(largest(&values), bits);
        for column in 0..columns {
            let row = column * weights.rows;
            let (mut exact, mut rest) = (0.0, 0.0);
            for (j, &value) in values.iter().enumerate() {
                let (first, at) = (cut.first(value), row + j);
                exact += first * weights.first[at];
                rest += first * weights.second[at] + (value - first) * weights.whole[at];
            }
            sums.exact.row_mut(k)[column] = exact;
            sums.rest.row_mut(k)[column] = rest;
        }
    }
    sums
}
