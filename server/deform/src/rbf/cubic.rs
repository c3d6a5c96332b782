//! Sums over cubic functions, `sum_j |t - s_j|^3 w_j + a . [1, t]`, whose terms may be millions of times as large as they are.
//!
//! Every kernel value and every weight is cut in two, `k = k_1 + k_2` and `w = w_1 + w_2`, the first parts so short that all
//! products and sums of them are exact in double precision, whatever the order (Ozaki, Ogita, Oishi and Rump, Error-free
//! transformations of matrix multiplication, Numerical Algorithms 59, 2012). What remains, `k_1 w_2 + k_2 w`, is
//! `2^-b` times as large, and so is its rounding; b is about 20.
//!
//! Kernel values are formed with some 75 bits. Coordinates are cut in two as well, so that `t - s = d_1 + d_2` and `q = sum d_1^2`
//! is exact; then `r^2 = q + e` with `e = sum (2 d_1 + d_2) d_2`. From any `r` near the root, `t = (q - r^2) + e` is what it is off by
//! in the square, and `r^3 + 3/2 r t = r q + r (e + t / 2)` the cube, beyond which there is nothing left.

use faer::{Accum, MatMut, MatRef, Par, linalg::matmul::matmul};
use moldline_geometry::Block;
use moldline_spline::Vector3;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::{AFFINE, Cloud, FEW, PANEL, Part, TILE, largest, monomials};

/// Bits of the first parts of coordinates: three squares of their differences have one more than twice as many, and two.
const COORDINATE_BITS: i32 = 25;
/// Sources whose kernel values are used at once by all vectors of a tile: spread over their lanes, they fit the innermost cache.
const BLOCK: usize = 16;

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

    /// Both parts.
    #[inline(always)]
    fn both(self, x: f64) -> [f64; 2] {
        let first = self.first(x);
        [first, x - first]
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

    /// First parts, second parts and wholes of one row.
    fn row<const N: usize>(&self, row: usize) -> [[f64; N]; 3] {
        [&self.first, &self.second, &self.whole].map(|of| std::array::from_fn(|k| of[k * self.rows + row]))
    }
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
    let points = sources.points();
    let reach = points.iter().map(Vector3::norm).fold(0.0, f64::max);
    let farthest = targets.iter().map(Vector3::amax).fold(reach, f64::max);
    let cut = Cut::new(2.0 * farthest, COORDINATE_BITS);
    let split: Vec<Split<f64>> = points.iter().map(|s| Split::new(s, cut)).collect();
    let tile = |targets: &[Vector3]| Tile::new(targets, cut, reach, bits);
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
    sums
}

/// Targets of a task, and where its sums go, exact ones and the rest.
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
        let [firsts, rests] = arch.dispatch(Radial { tile: &tile, sources, weights });
        let rows = exact.chunks_exact_mut(N).zip(rest.chunks_exact_mut(N));
        for (i, ((exact, rest), target)) in rows.zip(targets).enumerate() {
            (0..N).for_each(|c| (exact[c], rest[c]) = (firsts[c].0[i], rests[c].0[i]));
            for (value, [w_1, w_2, w]) in monomials(target).into_iter().zip(affine) {
                let [first, second] = Cut(tile.cuts.0[i]).both(value);
                for c in 0..N {
                    exact[c] += first * w_1[c];
                    rest[c] += first * w_2[c] + second * w[c];
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
        |[firsts, seconds], ((targets, exact), rest)| {
            let (tile, rows) = (tile(targets), targets.len());
            let mut first = 0;
            while first < weights.rows {
                let width = match sources.get(first..) {
                    Some(sources) if !sources.is_empty() => {
                        let sources = &sources[..PANEL.min(sources.len())];
                        arch.dispatch(Panel { tile: &tile, sources, firsts, seconds });
                        sources.len()
                    }
                    _ => tile.affine(targets, firsts, seconds),
                };
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
                first += width;
            }
        },
    );
}

/// Points whose coordinates are cut in two: one, or as many as a number of type `T` has parts. Vectors do not cross cache lines.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Split<T> {
    first: [T; 3],
    second: [T; 3],
    /// `2 first + second`, rounded.
    twice: [T; 3],
}

impl Split<f64> {
    fn new(point: &Vector3, cut: Cut) -> Self {
        let both: [[f64; 2]; 3] = std::array::from_fn(|axis| cut.both(point[axis]));
        Self {
            first: both.map(|[first, _]| first),
            second: both.map(|[_, second]| second),
            twice: both.map(|[first, second]| 2.0 * first + second),
        }
    }
}

impl<T> Split<T> {
    #[inline(always)]
    fn map<U>(&self, mut f: impl FnMut(&T) -> U) -> Split<U> {
        let [[a, b, c], [d, e, g], [h, k, l]] = [&self.first, &self.second, &self.twice];
        Split { first: [f(a), f(b), f(c)], second: [f(d), f(e), f(g)], twice: [f(h), f(k), f(l)] }
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
    /// How each of them cuts its kernel values.
    cuts: Row,
}

impl Tile {
    /// `coordinates` cuts these; `reach`: distance of the farthest source from the origin.
    fn new(targets: &[Vector3], coordinates: Cut, reach: f64, bits: i32) -> Self {
        let zeros = [Row::ZEROS; 3];
        let mut tile = Self { at: Split { first: zeros, second: zeros, twice: zeros }, cuts: Row::ZEROS };
        for (i, target) in targets.iter().enumerate() {
            let split = Split::new(target, coordinates);
            for axis in 0..3 {
                tile.at.first[axis].0[i] = split.first[axis];
                tile.at.second[axis].0[i] = split.second[axis];
                tile.at.twice[axis].0[i] = split.twice[axis];
            }
            // Not less than any kernel value, nor than any of the affine functions.
            tile.cuts.0[i] = Cut::new((1.001 * (target.norm() + reach)).powi(3).max(1.0), bits).0;
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

    /// First and second parts of the affine functions, one after the other; returns how many there are.
    fn affine(&self, targets: &[Vector3], firsts: &mut [f64], seconds: &mut [f64]) -> usize {
        for (i, target) in targets.iter().enumerate() {
            for (k, value) in monomials(target).into_iter().enumerate() {
                [firsts[k * TILE + i], seconds[k * TILE + i]] = Cut(self.cuts.0[i]).both(value);
            }
        }
        AFFINE
    }
}

/// A distance: `squares + small` is its square, `r` nearly the root of that, or what the root is to be taken of.
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
        let first = difference(simd, target.first, source.first);
        let squares = dot(simd, first, first);
        let second = difference(simd, target.second, source.second);
        let small = dot(simd, difference(simd, target.twice, source.twice), second);
        // Rounding may take it below zero where first parts differ and wholes hardly do.
        let r = simd.max_f64s(simd.add_f64s(squares, small), simd.splat_f64s(0.0));
        Self { squares, small, r }
    }

    #[inline(always)]
    fn take_root(&mut self, simd: S) {
        self.r = simd.sqrt_f64s(self.r);
    }

    /// Its third power, cut in two.
    #[inline(always)]
    fn cube(&self, simd: S, cut: S::f64s) -> [S::f64s; 2] {
        let Self { squares, small, r } = *self;
        let off = simd.add_f64s(simd.mul_add_f64s(simd.neg_f64s(r), r, squares), small);
        let more = simd.mul_add_f64s(simd.splat_f64s(0.5), off, small);
        let first = simd.sub_f64s(simd.mul_add_f64s(r, squares, cut), cut);
        let second = simd.mul_add_f64s(r, squares, simd.neg_f64s(first));
        [first, simd.mul_add_f64s(r, more, second)]
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
        let at = [Split { first: zeros, second: zeros, twice: zeros }; BLOCK];
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
    /// First parts, second parts and wholes of each source.
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
                    let cut = self.tile.cuts.get::<S>(at);
                    let [mut exact, mut rest] = [[zero; N]; 2];
                    for c in 0..N {
                        (exact[c], rest[c]) = (sums[0][c].get::<S>(at), sums[1][c].get::<S>(at));
                    }
                    for ((distance, [w_1, w_2, w]), next) in these.iter().zip(&weights).zip(next) {
                        next.take_root(simd);
                        let [first, second] = distance.cube(simd, cut);
                        for c in 0..N {
                            exact[c] = simd.mul_add_f64s(first, w_1[c], exact[c]);
                            let more = simd.mul_add_f64s(second, w[c], simd.mul_f64s(first, w_2[c]));
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

/// First and second parts of the kernel values of a tile, source after source.
struct Panel<'a> {
    tile: &'a Tile,
    sources: &'a [Split<f64>],
    firsts: &'a mut [f64],
    seconds: &'a mut [f64],
}

impl WithSimd for Panel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let vectors = TILE / S::F64_LANES;
        let (firsts, seconds) = (S::as_mut_simd_f64s(self.firsts).0, S::as_mut_simd_f64s(self.seconds).0);
        let mut near = Near::new(simd);
        let parts = firsts.chunks_mut(BLOCK * vectors).zip(seconds.chunks_mut(BLOCK * vectors));
        for (sources, (firsts, seconds)) in self.sources.chunks(BLOCK).zip(parts) {
            near.each_vector(
                self.tile,
                sources,
                #[inline(always)]
                |at, these, next| {
                    let cut = self.tile.cuts.get::<S>(at);
                    for (j, (distance, next)) in these.iter().zip(next).enumerate() {
                        next.take_root(simd);
                        [firsts[j * vectors + at], seconds[j * vectors + at]] = distance.cube(simd, cut);
                    }
                },
            );
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    struct Cubes {
        target: Vector3,
        source: Vector3,
        coordinates: Cut,
        cut: Cut,
    }

    impl WithSimd for Cubes {
        type Output = [f64; 2];

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> [f64; 2] {
            let [target, source] =
                [&self.target, &self.source].map(|point| spread(simd, &Split::new(point, self.coordinates)));
            let mut distance = Distance::new(simd, &target, &source);
            distance.take_root(simd);
            let parts = distance.cube(simd, simd.splat_f64s(self.cut.0));
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
        let mut state = 5_u64;
        let mut next = |bits: i32| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            // Multiples of 2^-40 up to 2^bits: their differences are exact.
            ((state >> 23) as f64 * 2_f64.powi(-40) - 1.0) * 2_f64.powi(bits)
        };
        let (coordinates, cut) = (Cut::new(2.0, COORDINATE_BITS), Cut::new(64.0, 20));
        for i in 0..4000 {
            let on_grid = |x: f64| (x * 2_f64.powi(40)).round() * 2_f64.powi(-40);
            let target = Vector3::new(next(0), next(0), next(0));
            // Far, near, within what first parts see, and the same.
            let reach = [0, -8, -24, -60][i % 4];
            let source = target + Vector3::new(next(reach), next(reach), next(reach)).map(on_grid);
            let [first, second] = Arch::new().dispatch(Cubes { target, source, coordinates, cut });
            assert_eq!(first, cut.first(first));
            let d = target - source;
            let squared = d.iter().map(|&x| two_product(x, x)).fold((0.0, 0.0), plus);
            let sixth = times(times(squared, squared), squared);
            let value = two_sum(first, second);
            let (off, rest) = plus(times(value, value), (-sixth.0, -sixth.1));
            let error = (off + rest).abs() / (2.0 * value.0).max(2_f64.powi(-66));
            // Largest values are 2^6.
            assert!(error <= 2_f64.powi(-66), "{target} {source}: {error:e} of {}", value.0);
        }
    }
}
