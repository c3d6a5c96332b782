//! Graph Laplacians `L = I - W` with row sums of zero, for smoothing steps `x' = (I - omega L) x`, and their transposes.

use rayon::prelude::*;

use crate::{Csr, Topology, Vector3};

/// Rows of one task.
const CHUNK: usize = 2048;

/// A sparse `L = I - W`: row `i` of `W` holds positive weights of the neighbours of vertex `i` that sum to one. Rows of
/// fixed vertices are zero, so that `I - omega L` is the identity there.
#[derive(Clone, Debug, PartialEq)]
pub struct Laplacian {
    rows: Csr,
    weights: Vec<f64>,
    /// The transpose as a gather in a fixed order: for each vertex the rows that refer to it, and their weights.
    columns: Csr,
    column_weights: Vec<f64>,
}

impl Laplacian {
    /// Equal weights for all neighbours.
    pub fn uniform(topology: &Topology, fixed: impl Fn(u32) -> bool) -> Self {
        Self::from_rows(topology, fixed, |_, neighbours, weights| {
            weights.extend(neighbours.iter().map(|&neighbour| (neighbour, 1.0)));
        })
    }

    /// Mean value weights (Floater 2003, eq. 2.1) of the neighbours, rotated into each vertex's tangent plane. They are
    /// positive, and on the given mesh the weighted mean of the neighbours differs from the vertex along its normal only.
    ///
    /// `normals`: one per vertex, of any length. Where the neighbours leave a gap of half a turn or more (boundaries, or
    /// a vertex outside its neighbours' polygon) only the two beside the gap count, weighted inversely to their distance.
    ///
    /// # Panics
    /// If there are fewer vertices or normals than the topology has.
    pub fn reference_preserving(
        topology: &Topology,
        vertices: &[[f64; 3]],
        normals: &[Vector3],
        fixed: impl Fn(u32) -> bool,
    ) -> Self {
        let mut around = Vec::new();
        Self::from_rows(topology, fixed, |vertex, neighbours, weights| {
            mean_value_weights(vertex, neighbours, vertices, &normals[vertex as usize], &mut around, weights);
        })
    }

    /// Takes each row's `(neighbour, positive weight)` from `fill` and scales them to a sum of one.
    fn from_rows(
        topology: &Topology,
        fixed: impl Fn(u32) -> bool,
        mut fill: impl FnMut(u32, &[u32], &mut Vec<(u32, f64)>),
    ) -> Self {
        let mut rows = Csr { offsets: vec![0], items: Vec::new() };
        let mut weights = Vec::new();
        let mut row = Vec::new();
        for (vertex, neighbours) in topology.vertex_neighbours.rows().enumerate() {
            row.clear();
            if !fixed(vertex as u32) {
                fill(vertex as u32, neighbours, &mut row);
            }
            let sum: f64 = row.iter().map(|&(_, weight)| weight).sum();
            rows.items.extend(row.iter().map(|&(neighbour, _)| neighbour));
            weights.extend(row.iter().map(|&(_, weight)| weight / sum));
            rows.offsets.push(rows.items.len() as u32);
        }
        let entries = (0..rows.len()).flat_map(|row| rows.range(row).map(move |entry| (row as u32, entry)));
        let columns =
            Csr::from_pairs(rows.len(), entries.clone().map(|(row, entry)| (rows.items[entry], row)));
        let by_column =
            Csr::from_pairs(rows.len(), entries.map(|(_, entry)| (rows.items[entry], entry as u32)));
        let column_weights = by_column.items.iter().map(|&entry| weights[entry as usize]).collect();
        Self { rows, weights, columns, column_weights }
    }

    /// Neighbours and weights of one row; empty if the vertex is fixed.
    pub fn row(&self, vertex: usize) -> impl ExactSizeIterator<Item = (u32, f64)> + '_ {
        self.rows.range(vertex).map(|k| (self.rows.items[k], self.weights[k]))
    }

    /// `out = L x`.
    ///
    /// # Panics
    /// Here and in the other products, if a slice's length is not the number of vertices.
    pub fn apply(&self, x: &[[f64; 3]], out: &mut [[f64; 3]]) {
        self.product(x, out, |x, lx| lx.map_or_else(Vector3::zeros, |mean| x - mean));
    }

    /// `out = L^T x`.
    pub fn apply_transposed(&self, x: &[[f64; 3]], out: &mut [[f64; 3]]) {
        self.transposed_product(x, out, |_, ltx| ltx);
    }

    /// `out = (I - omega L) x`.
    pub fn smooth(&self, omega: f64, x: &[[f64; 3]], out: &mut [[f64; 3]]) {
        // x itself, to the last bit, on fixed vertices.
        self.product(x, out, |x, mean| mean.map_or(x, |mean| x - omega * (x - mean)));
    }

    /// `out = (I - omega L)^T x`.
    pub fn smooth_transposed(&self, omega: f64, x: &[[f64; 3]], out: &mut [[f64; 3]]) {
        self.transposed_product(x, out, |x, ltx| x - omega * ltx);
    }

    /// `out_i = f(x_i, sum_j w_ij x_j)`, without the sum on fixed vertices.
    fn product(
        &self,
        x: &[[f64; 3]],
        out: &mut [[f64; 3]],
        f: impl Fn(Vector3, Option<Vector3>) -> Vector3 + Sync,
    ) {
        assert!(x.len() == self.rows.len() && out.len() == x.len(), "one position per vertex");
        out.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, out)| {
            for (vertex, out) in (chunk * CHUNK..).zip(out) {
                let range = self.rows.range(vertex);
                let mean = (!range.is_empty()).then(|| gather(&self.rows.items, &self.weights, range, x));
                *out = f(x[vertex].into(), mean).into();
            }
        });
    }

    /// `out_i = f(x_i, (L^T x)_i)`.
    fn transposed_product(
        &self,
        x: &[[f64; 3]],
        out: &mut [[f64; 3]],
        f: impl Fn(Vector3, Vector3) -> Vector3 + Sync,
    ) {
        assert!(x.len() == self.rows.len() && out.len() == x.len(), "one position per vertex");
        out.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, out)| {
            for (vertex, out) in (chunk * CHUNK..).zip(out) {
                let here = Vector3::from(x[vertex]);
                let own = if self.rows.range(vertex).is_empty() { Vector3::zeros() } else { here };
                let others = gather(&self.columns.items, &self.column_weights, self.columns.range(vertex), x);
                *out = f(here, own - others).into();
            }
        });
    }
}

fn gather(items: &[u32], weights: &[f64], range: std::ops::Range<usize>, x: &[[f64; 3]]) -> Vector3 {
    let mut sum = Vector3::zeros();
    for (item, weight) in items[range.clone()].iter().zip(&weights[range]) {
        sum += *weight * Vector3::from(x[*item as usize]);
    }
    sum
}

/// A neighbour in polar coordinates about the vertex.
struct Spoke {
    angle: f64,
    length: f64,
    neighbour: u32,
}

fn mean_value_weights(
    vertex: u32,
    neighbours: &[u32],
    vertices: &[[f64; 3]],
    normal: &Vector3,
    spokes: &mut Vec<Spoke>,
    weights: &mut Vec<(u32, f64)>,
) {
    /// Slightly less than half a turn: beyond, the tangent of half the angle grows without bound.
    const WIDEST: f64 = 3.1;

    let here = Vector3::from(vertices[vertex as usize]);
    let spoke = |neighbour: u32| Vector3::from(vertices[neighbour as usize]) - here;
    let Some(normal) = normal.try_normalize(0.0) else {
        // No tangent plane, such as at the tip of a spike: equal weights.
        weights.extend(neighbours.iter().map(|&neighbour| (neighbour, 1.0)));
        return;
    };
    // Axes of the tangent plane, from the coordinate axis that is most nearly in it.
    let least = normal.iamin();
    let first = normal.cross(&Vector3::ith(least, 1.0)).normalize();
    let second = normal.cross(&first);
    spokes.clear();
    spokes.extend(neighbours.iter().map(|&neighbour| {
        let r = spoke(neighbour);
        let (a, b) = (r.dot(&first), r.dot(&second));
        // A spoke of length zero would have an infinite weight.
        Spoke { angle: b.atan2(a), length: a.hypot(b).max(1e-6 * r.norm()).max(f64::MIN_POSITIVE), neighbour }
    }));
    spokes.sort_by(|a, b| a.angle.total_cmp(&b.angle).then(a.neighbour.cmp(&b.neighbour)));

    let count = spokes.len();
    let gap = |k: usize| {
        let turn = if k + 1 == count { std::f64::consts::TAU } else { 0.0 };
        spokes[(k + 1) % count].angle - spokes[k].angle + turn
    };
    match (0..count).find(|&k| gap(k) > WIDEST) {
        Some(wide) if count > 1 => {
            for spoke in [&spokes[wide], &spokes[(wide + 1) % count]] {
                weights.push((spoke.neighbour, 1.0 / spoke.length));
            }
        }
        Some(_) => weights.push((spokes[0].neighbour, 1.0)),
        None => {
            let half_tangent = |k: usize| (0.5 * gap(k)).tan();
            for k in 0..count {
                let weight = (half_tangent((k + count - 1) % count) + half_tangent(k)) / spokes[k].length;
                weights.push((spokes[k].neighbour, weight));
            }
        }
    }
}
