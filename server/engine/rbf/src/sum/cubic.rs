//! Sums over cubic functions, `sum_j |t - s_j|^3 w_j + a . [1, t]`, with more digits than a double: their terms may be millions of
//! times as large as they are.
//!
//! Every kernel value and every weight is split without error, `k = k_1 + k_2` and `w = w_1 + w_2`, the high parts so short that all
//! products and sums of them are exact in double precision, whatever the order (Ozaki, Ogita, Oishi and Rump, Error-free
//! transformations of matrix multiplication, Numerical Algorithms 59, 2012). What remains, `k_1 w_2 + k_2 w`, is
//! `2^-b` times as large, and so is its rounding; b is about 20.
//!
//! Kernel values are formed with some 75 bits. Coordinates are split as well, so that `t - s = d_1 + d_2` and `q = sum d_1^2`
//! is exact; then `r^2 = q + e` with `e = sum (2 d_1 + d_2) d_2`. Any `r` near the root misses the square by `t = (q - r^2) + e`,
//! and the cube is `r^3 + 3/2 r t = r q + r (e + t / 2)`, up to terms that are too small to count.

use faer::{Accum, MatMut, MatRef, Par, linalg::matmul::matmul};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::{PANEL, Sums, TILE};
use crate::{
    Block, FEW, Vector3,
    coefficients::{Part, largest},
    error_free::{Splitter, two_sum},
    points::Points,
    polynomial::{AFFINE, monomials},
};

/// Bits of the high parts of coordinates: three squares of their differences have one more than twice as many, and two.
const COORDINATE_BITS: i32 = 25;
/// Sources whose kernel values are used at once by all vectors of a tile: spread over their lanes, they fit the innermost cache.
const BLOCK: usize = 16;

/// Sums, a row for each target and a column for each column of weights.
struct SplitSums {
    /// Of products of high parts, without rounding.
    exact: Block,
    /// Of all other products.
    rest: Block,
}

impl SplitSums {
    fn zeros(count: usize, columns: usize) -> Self {
        Self { exact: Block::zeros(count, columns), rest: Block::zeros(count, columns) }
    }

    /// In doubles, and what that rounds off.
    fn round(mut self) -> Sums {
        for (a, b) in self.exact.data_mut().iter_mut().zip(self.rest.data_mut()) {
            (*a, *b) = two_sum(*a, *b);
        }
        Sums { leading: self.exact, remainder: Some(self.rest) }
    }
}

/// Weights and affine parts, one below the other, column after column.
struct Weights {
    rows: usize,
    high: Vec<f64>,
    low: Vec<f64>,
    whole: Vec<f64>,
}

impl Weights {
    fn new(count: usize, leading: &Part, remainder: Option<&Part>, bits: i32) -> Self {
        let columns = leading.columns();
        let column = |part: &Part, c: usize| -> Vec<f64> {
            let affine = (0..AFFINE).map(|k| part.affine.row(k)[c]);
            part.weights_of(c)[..count].iter().copied().chain(affine).collect()
        };
        let whole: Vec<f64> = (0..columns).flat_map(|c| column(leading, c)).collect();
        let mut low: Vec<f64> = match remainder {
            Some(remainder) => (0..columns).flat_map(|c| column(remainder, c)).collect(),
            None => vec![0.0; whole.len()],
        };
        let rows = count + AFFINE;
        let mut high = whole.clone();
        for (high, low) in high.chunks_mut(rows).zip(low.chunks_mut(rows)) {
            let splitter = Splitter::new(largest(high), bits);
            for (high, low) in high.iter_mut().zip(low) {
                let whole = *high;
                *high = splitter.high(whole);
                *low += whole - *high;
            }
        }
        Self { rows, high, low, whole }
    }

    /// High parts, low parts and wholes of one row.
    fn row<const N: usize>(&self, row: usize) -> [[f64; N]; 3] {
        [&self.high, &self.low, &self.whole].map(|of| std::array::from_fn(|k| of[k * self.rows + row]))
    }
}

/// The sums at each target.
pub(crate) fn sum(targets: &[Vector3], sources: &Points, leading: &Part, remainder: Option<&Part>) -> Sums {
    let columns = leading.columns();
    let mut sums = SplitSums::zeros(targets.len(), columns);
    if columns == 0 {
        return sums.round();
    }
    let bits = Splitter::bits(sources.count() + AFFINE);
    let weights = Weights::new(sources.count(), leading, remainder, bits);
    let points = sources.to_vectors();
    let reach = points.iter().map(Vector3::norm).fold(0.0, f64::max);
    let farthest = targets.iter().map(Vector3::amax).fold(reach, f64::max);
    let splitter = Splitter::new(2.0 * farthest, COORDINATE_BITS);
    let split: Vec<Split<f64>> = points.iter().map(|s| Split::new(s, splitter)).collect();
    let tile = |targets: &[Vector3]| Tile::new(targets, splitter, reach, bits);
    let tiles = targets
        .par_chunks(TILE)
        .zip(sums.exact.data_mut().par_chunks_mut(TILE * columns))
        .zip(sums.rest.data_mut().par_chunks_mut(TILE * columns));
    match columns {
        1 => few::<1>(tiles, tile, &split, &weights),
        2 => few::<2>(tiles, tile, &split, &weights),
        FEW => few::<FEW>(tiles, tile, &split, &weights),
        _ => many(tiles, tile, &split, &weights, columns),
    }
    sums.round()
}

/// Targets of a task, and its part of the sums, exact ones and the rest.
type Task<'a> = ((&'a [Vector3], &'a mut [f64]), &'a mut [f64]);

/// The sums of few columns: kernel values are formed and used in registers.
fn few<'a, const N: usize>(
    tasks: impl ParallelIterator<Item = Task<'a>>,
    tile: impl Fn(&[Vector3]) -> Tile + Sync,
    sources: &[Split<f64>],
    weights: &Weights,
) {
    let arch = Arch::new();
    let rows: Vec<[[f64; N]; 3]> = (0..weights.rows).map(|row| weights.row(row)).collect();
    let (weights, affine) = rows.split_at(sources.len());
    tasks.for_each(|((targets, exact), rest)| {
        let tile = tile(targets);
        let [highs, rests] = arch.dispatch(Radial { tile: &tile, sources, weights });
        let rows = exact.chunks_exact_mut(N).zip(rest.chunks_exact_mut(N));
        for (i, ((exact, rest), target)) in rows.zip(targets).enumerate() {
            (0..N).for_each(|c| (exact[c], rest[c]) = (highs[c].0[i], rests[c].0[i]));
            for (value, [w_1, w_2, w]) in monomials(target).into_iter().zip(affine) {
                let [high, low] = Splitter(tile.splitters.0[i]).split(value);
                for c in 0..N {
                    exact[c] += high * w_1[c];
                    rest[c] += high * w_2[c] + low * w[c];
                }
            }
        }
    });
}

/// The sums of many columns, as products of matrices: panels of kernel values, and weights.
fn many<'a>(
    tasks: impl IndexedParallelIterator<Item = Task<'a>>,
    tile: impl Fn(&[Vector3]) -> Tile + Sync,
    sources: &[Split<f64>],
    weights: &Weights,
    columns: usize,
) {
    let arch = Arch::new();
    tasks.for_each_init(
        || [vec![0.0; TILE * PANEL], vec![0.0; TILE * PANEL]],
        |[highs, lows], ((targets, exact), rest)| {
            let (tile, rows) = (tile(targets), targets.len());
            let mut begin = 0;
            while begin < weights.rows {
                let width = match sources.get(begin..) {
                    Some(sources) if !sources.is_empty() => {
                        let sources = &sources[..PANEL.min(sources.len())];
                        arch.dispatch(Panel { tile: &tile, sources, highs, lows });
                        sources.len()
                    }
                    _ => tile.affine(targets, highs, lows),
                };
                let add = |panel: &[f64], weights_of: &[f64], out: &mut [f64]| {
                    let panel = MatRef::from_column_major_slice_with_stride(panel, rows, width, TILE);
                    let below = &weights_of[begin..];
                    let some =
                        MatRef::from_column_major_slice_with_stride(below, width, columns, weights.rows);
                    let out = MatMut::from_row_major_slice_mut(out, rows, columns);
                    matmul(out, Accum::Add, panel, some, 1.0, Par::Seq);
                };
                add(highs, &weights.high, exact);
                add(highs, &weights.low, rest);
                add(lows, &weights.whole, rest);
                begin += width;
            }
        },
    );
}

/// Points whose coordinates are split in two: one, or as many as a number of type `T` has parts. Vectors do not cross cache lines.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Split<T> {
    high: [T; 3],
    low: [T; 3],
    /// `2 high + low`, rounded.
    twice: [T; 3],
}

impl Split<f64> {
    fn new(point: &Vector3, splitter: Splitter) -> Self {
        let both: [[f64; 2]; 3] = std::array::from_fn(|axis| splitter.split(point[axis]));
        Self {
            high: both.map(|[high, _]| high),
            low: both.map(|[_, low]| low),
            twice: both.map(|[high, low]| 2.0 * high + low),
        }
    }
}

impl<T> Split<T> {
    #[inline(always)]
    fn map<U>(&self, mut f: impl FnMut(&T) -> U) -> Split<U> {
        let [[a, b, c], [d, e, g], [h, k, l]] = [&self.high, &self.low, &self.twice];
        Split { high: [f(a), f(b), f(c)], low: [f(d), f(e), f(g)], twice: [f(h), f(k), f(l)] }
    }
}

/// Numbers of a tile's targets.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Row([f64; TILE]);

impl Row {
    const ZEROS: Self = Self([0.0; TILE]);

    #[inline(always)]
    fn get<S: Simd>(&self, at: usize) -> S::f64s {
        S::as_simd_f64s(&self.0).0[at]
    }

    #[inline(always)]
    fn set<S: Simd>(&mut self, at: usize, values: S::f64s) {
        S::as_mut_simd_f64s(&mut self.0).0[at] = values;
    }
}

/// Targets of one task.
struct Tile {
    at: Split<Row>,
    /// The constant that splits the kernel values of each target.
    splitters: Row,
}

impl Tile {
    /// `coordinates` splits these; `reach`: distance of the farthest source from the origin.
    fn new(targets: &[Vector3], coordinates: Splitter, reach: f64, bits: i32) -> Self {
        let zeros = [Row::ZEROS; 3];
        let mut tile = Self { at: Split { high: zeros, low: zeros, twice: zeros }, splitters: Row::ZEROS };
        for (i, target) in targets.iter().enumerate() {
            let split = Split::new(target, coordinates);
            for axis in 0..3 {
                tile.at.high[axis].0[i] = split.high[axis];
                tile.at.low[axis].0[i] = split.low[axis];
                tile.at.twice[axis].0[i] = split.twice[axis];
            }
            // Not less than any kernel value, nor than any of the affine functions.
            tile.splitters.0[i] = Splitter::new((1.001 * (target.norm() + reach)).powi(3).max(1.0), bits).0;
        }
        tile
    }

    /// From targets of one vector, without roots.
    #[inline(always)]
    fn distances<S: Simd>(&self, simd: S, at: usize, sources: &[Split<S::f64s>], out: &mut [Distance<S>]) {
        let targets = self.at.map(
            #[inline(always)]
            |row| row.get::<S>(at),
        );
        for (out, source) in out.iter_mut().zip(sources) {
            *out = Distance::new(simd, &targets, source);
        }
    }

    /// High and low parts of the affine functions, one after the other; returns how many there are.
    fn affine(&self, targets: &[Vector3], highs: &mut [f64], lows: &mut [f64]) -> usize {
        for (i, target) in targets.iter().enumerate() {
            for (k, value) in monomials(target).into_iter().enumerate() {
                [highs[k * TILE + i], lows[k * TILE + i]] = Splitter(self.splitters.0[i]).split(value);
            }
        }
        AFFINE
    }
}

/// A distance: `squares + small` is its square; `r` is that sum rounded, and nearly its root once that is taken.
#[derive(Clone, Copy)]
#[repr(C, align(32))]
struct Distance<S: Simd> {
    squares: S::f64s,
    small: S::f64s,
    r: S::f64s,
}

impl<S: Simd> Distance<S> {
    #[inline(always)]
    fn zero(simd: S) -> Self {
        let zero = simd.splat_f64s(0.0);
        Self { squares: zero, small: zero, r: zero }
    }

    /// Without its root.
    #[inline(always)]
    fn new(simd: S, target: &Split<S::f64s>, source: &Split<S::f64s>) -> Self {
        let high = difference(simd, target.high, source.high);
        let squares = dot(simd, high, high);
        let low = difference(simd, target.low, source.low);
        let small = dot(simd, difference(simd, target.twice, source.twice), low);
        // Rounding may take it below zero where high parts differ and wholes hardly do.
        let r = simd.max_f64s(simd.add_f64s(squares, small), simd.splat_f64s(0.0));
        Self { squares, small, r }
    }

    #[inline(always)]
    fn take_root(&mut self, simd: S) {
        self.r = simd.sqrt_f64s(self.r);
    }

    /// Its third power, split in two.
    #[inline(always)]
    fn cube(&self, simd: S, splitter: S::f64s) -> [S::f64s; 2] {
        let Self { squares, small, r } = *self;
        let off = simd.add_f64s(simd.mul_add_f64s(simd.neg_f64s(r), r, squares), small);
        let more = simd.mul_add_f64s(simd.splat_f64s(0.5), off, small);
        let high = simd.sub_f64s(simd.mul_add_f64s(r, squares, splitter), splitter);
        let low = simd.mul_add_f64s(r, squares, simd.neg_f64s(high));
        [high, simd.mul_add_f64s(r, more, low)]
    }
}

#[inline(always)]
fn difference<S: Simd>(simd: S, a: [S::f64s; 3], b: [S::f64s; 3]) -> [S::f64s; 3] {
    [simd.sub_f64s(a[0], b[0]), simd.sub_f64s(a[1], b[1]), simd.sub_f64s(a[2], b[2])]
}

#[inline(always)]
fn dot<S: Simd>(simd: S, a: [S::f64s; 3], b: [S::f64s; 3]) -> S::f64s {
    let two = simd.mul_add_f64s(a[1], b[1], simd.mul_f64s(a[0], b[0]));
    simd.mul_add_f64s(a[2], b[2], two)
}

/// Some sources, each in all lanes, and their distances from this and from the next vector of targets.
struct Near<S: Simd> {
    simd: S,
    at: [Split<S::f64s>; BLOCK],
    distances: [[Distance<S>; BLOCK]; 2],
}

impl<S: Simd> Near<S> {
    #[inline(always)]
    fn new(simd: S) -> Self {
        let zeros = [simd.splat_f64s(0.0); 3];
        let at = [Split { high: zeros, low: zeros, twice: zeros }; BLOCK];
        Self { simd, at, distances: [[Distance::zero(simd); BLOCK]; 2] }
    }

    /// Calls `f(at, these, next)` with the distances from vector after vector of the tile. Of those from the next one it is to take
    /// the roots, one with each that it uses: a root takes long, but hinders nothing else.
    #[inline(always)]
    fn each_vector(
        &mut self,
        tile: &Tile,
        sources: &[Split<f64>],
        mut f: impl FnMut(usize, &[Distance<S>], &mut [Distance<S>]),
    ) {
        let simd = self.simd;
        for (at, source) in self.at.iter_mut().zip(sources) {
            *at = spread(simd, source);
        }
        let at = &self.at[..sources.len()];
        let [mut these, mut next] = self.distances.each_mut().map(|some| &mut some[..at.len()]);
        tile.distances(simd, 0, at, these);
        these.iter_mut().for_each(
            #[inline(always)]
            |distance| distance.take_root(simd),
        );
        let vectors = TILE / S::F64_LANES;
        for vector in 0..vectors {
            tile.distances(simd, (vector + 1).min(vectors - 1), at, next);
            f(vector, these, next);
            std::mem::swap(&mut these, &mut next);
        }
    }
}

/// A point in all lanes.
#[inline(always)]
fn spread<S: Simd>(simd: S, point: &Split<f64>) -> Split<S::f64s> {
    point.map(
        #[inline(always)]
        |x| simd.splat_f64s(*x),
    )
}

/// Sums over the sources at all targets of a tile, exact ones and the rest, column after column.
struct Radial<'a, const N: usize> {
    tile: &'a Tile,
    sources: &'a [Split<f64>],
    /// High parts, low parts and wholes of each source.
    weights: &'a [[[f64; N]; 3]],
}

impl<const N: usize> WithSimd for Radial<'_, N> {
    type Output = [[Row; N]; 2];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let zero = simd.splat_f64s(0.0);
        let mut near = Near::new(simd);
        let mut weights = [[[zero; N]; 3]; BLOCK];
        let mut sums = [[Row::ZEROS; N]; 2];
        for (sources, own) in self.sources.chunks(BLOCK).zip(self.weights.chunks(BLOCK)) {
            for (weights, own) in weights.iter_mut().zip(own) {
                for (weights, of) in weights.iter_mut().zip(own) {
                    (0..N).for_each(
                        #[inline(always)]
                        |c| weights[c] = simd.splat_f64s(of[c]),
                    );
                }
            }
            near.each_vector(
                self.tile,
                sources,
                #[inline(always)]
                |at, these, next| {
                    let splitter = self.tile.splitters.get::<S>(at);
                    let [mut exact, mut rest] = [[zero; N]; 2];
                    for c in 0..N {
                        (exact[c], rest[c]) = (sums[0][c].get::<S>(at), sums[1][c].get::<S>(at));
                    }
                    for ((distance, [w_1, w_2, w]), next) in these.iter().zip(&weights).zip(next) {
                        next.take_root(simd);
                        let [high, low] = distance.cube(simd, splitter);
                        for c in 0..N {
                            exact[c] = simd.mul_add_f64s(high, w_1[c], exact[c]);
                            let more = simd.mul_add_f64s(low, w[c], simd.mul_f64s(high, w_2[c]));
                            rest[c] = simd.add_f64s(rest[c], more);
                        }
                    }
                    for c in 0..N {
                        sums[0][c].set::<S>(at, exact[c]);
                        sums[1][c].set::<S>(at, rest[c]);
                    }
                },
            );
        }
        sums
    }
}

/// High and low parts of the kernel values of a tile, source after source.
struct Panel<'a> {
    tile: &'a Tile,
    sources: &'a [Split<f64>],
    highs: &'a mut [f64],
    lows: &'a mut [f64],
}

impl WithSimd for Panel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let vectors = TILE / S::F64_LANES;
        let (highs, lows) = (S::as_mut_simd_f64s(self.highs).0, S::as_mut_simd_f64s(self.lows).0);
        let mut near = Near::new(simd);
        let parts = highs.chunks_mut(BLOCK * vectors).zip(lows.chunks_mut(BLOCK * vectors));
        for (sources, (highs, lows)) in self.sources.chunks(BLOCK).zip(parts) {
            near.each_vector(
                self.tile,
                sources,
                #[inline(always)]
                |at, these, next| {
                    let splitter = self.tile.splitters.get::<S>(at);
                    for (j, (distance, next)) in these.iter().zip(next).enumerate() {
                        next.take_root(simd);
                        [highs[j * vectors + at], lows[j * vectors + at]] = distance.cube(simd, splitter);
                    }
                },
            );
        }
    }
}

/// `sum_j w_j [1, s_j]`.
pub(crate) fn moments(sources: &Points, leading: &Part, remainder: Option<&Part>) -> Sums {
    let (count, columns) = (sources.count(), leading.columns());
    let mut sums = SplitSums::zeros(AFFINE, columns);
    let bits = Splitter::bits(count + AFFINE);
    let weights = Weights::new(count, leading, remainder, bits);
    for k in 0..AFFINE {
        let values: Vec<f64> = (0..count).map(|j| monomials(&sources.get(j))[k]).collect();
        let splitter = Splitter::new(largest(&values), bits);
        for column in 0..columns {
            let row = column * weights.rows;
            let (mut exact, mut rest) = (0.0, 0.0);
            for (j, &value) in values.iter().enumerate() {
                let (high, at) = (splitter.high(value), row + j);
                exact += high * weights.high[at];
                rest += high * weights.low[at] + (value - high) * weights.whole[at];
            }
            sums.exact.row_mut(k)[column] = exact;
            sums.rest.row_mut(k)[column] = rest;
        }
    }
    sums.round()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error_free::two_product;
    use moldline_testing::Random;

    struct Cubes {
        target: Vector3,
        source: Vector3,
        coordinates: Splitter,
        splitter: Splitter,
    }

    impl WithSimd for Cubes {
        type Output = [f64; 2];

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> [f64; 2] {
            let [target, source] =
                [&self.target, &self.source].map(|point| spread(simd, &Split::new(point, self.coordinates)));
            let mut distance = Distance::new(simd, &target, &source);
            distance.take_root(simd);
            let parts = distance.cube(simd, simd.splat_f64s(self.splitter.0));
            let mut row = Row::ZEROS;
            parts.map(|part| {
                row.set::<S>(0, part);
                row.0[0]
            })
        }
    }

    type Pair = (f64, f64);

    fn plus(a: Pair, b: Pair) -> Pair {
        let (sum, rest) = two_sum(a.0, b.0);
        two_sum(sum, rest + (a.1 + b.1))
    }

    fn times(a: Pair, b: Pair) -> Pair {
        let (product, rest) = two_product(a.0, b.0);
        two_sum(product, rest + (a.0 * b.1 + a.1 * b.0))
    }

    /// The square of a kernel value is `r^6`, which takes no root.
    #[test]
    fn kernel_values_have_more_digits_than_a_double() {
        let mut random = Random::new(5);
        // Multiples of 2^-40, whose differences are exact.
        let on_grid = |x: f64| (x * 2_f64.powi(40)).round() * 2_f64.powi(-40);
        let mut next = |bits: i32| on_grid(random.signed()) * 2_f64.powi(bits);
        let (coordinates, splitter) = (Splitter::new(2.0, COORDINATE_BITS), Splitter::new(64.0, 20));
        for i in 0..4000 {
            let target = Vector3::new(next(0), next(0), next(0));
            // Far, near, within what high parts see, and the same.
            let reach = [0, -8, -24, -60][i % 4];
            let source = target + Vector3::new(next(reach), next(reach), next(reach)).map(on_grid);
            let [high, low] = Arch::new().dispatch(Cubes { target, source, coordinates, splitter });
            assert_eq!(high, splitter.high(high));
            let d = target - source;
            let squared = d.iter().map(|&x| two_product(x, x)).fold((0.0, 0.0), plus);
            let sixth = times(times(squared, squared), squared);
            let value = two_sum(high, low);
            let (off, rest) = plus(times(value, value), (-sixth.0, -sixth.1));
            let error = (off + rest).abs() / (2.0 * value.0).max(2_f64.powi(-66));
            // Largest values are 2^6.
            assert!(error <= 2_f64.powi(-66), "{target} {source}: {error:e} of {}", value.0);
        }
    }
}
