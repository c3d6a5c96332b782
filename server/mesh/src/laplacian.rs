//! Graph Laplacians `L = I - W` with row sums of zero, for smoothing steps `x' = (I - omega L) x`, and their transposes.

use crate::{Csr, Topology};

/// A sparse `L = I - W`: row `i` of `W` holds positive weights of the neighbours of vertex `i` that sum to one. Rows of
/// fixed vertices are zero, so that `I - omega L` is the identity there.
#[derive(Clone, Debug, PartialEq)]
pub struct Laplacian {
    rows: Csr,
    weights: Vec<f64>,
    /// For each vertex the rows that refer to it, and where in `weights`: the transpose as a gather, in a fixed order.
    columns: Csr,
    column_entries: Vec<u32>,
}

impl Laplacian {
    /// Equal weights for all neighbours.
    pub fn uniform(topology: &Topology, fixed: impl Fn(u32) -> bool) -> Self {
        let _ = (topology, fixed(0));
        todo!()
    }

    /// Mean value weights of the neighbours projected onto each vertex's tangent plane: positive, and on the mesh they
    /// are made from the weighted mean of the neighbours differs from the vertex along its normal only.
    ///
    /// `normals`: one per vertex, of any length. Where the neighbours leave a gap of half a turn or more (boundaries, or
    /// a vertex outside its neighbours' polygon) the two beside the gap are taken, weighted inversely to their distance.
    pub fn reference_preserving(
        topology: &Topology,
        vertices: &[[f64; 3]],
        normals: &[[f64; 3]],
        fixed: impl Fn(u32) -> bool,
    ) -> Self {
        let _ = (topology, vertices, normals, fixed(0));
        todo!()
    }

    /// Neighbours and weights of one row; empty if the vertex is fixed.
    pub fn row(&self, vertex: usize) -> impl ExactSizeIterator<Item = (u32, f64)> + '_ {
        self.rows.range(vertex).map(|k| (self.rows.items[k], self.weights[k]))
    }

    /// `out = L x`.
    pub fn apply(&self, x: &[[f64; 3]], out: &mut [[f64; 3]]) {
        let _ = (x, out);
        todo!()
    }

    /// `out = L^T x`.
    pub fn apply_transposed(&self, x: &[[f64; 3]], out: &mut [[f64; 3]]) {
        let _ = (x, out);
        todo!()
    }

    /// `out = (I - omega L) x`.
    pub fn smooth(&self, omega: f64, x: &[[f64; 3]], out: &mut [[f64; 3]]) {
        let _ = (x, out, omega);
        todo!()
    }

    /// `out = (I - omega L)^T x`.
    pub fn smooth_transposed(&self, omega: f64, x: &[[f64; 3]], out: &mut [[f64; 3]]) {
        let _ = (x, out, omega);
        todo!()
    }
}

/// Vertex normals of any length: the sum of the area vectors of the cells at each vertex.
pub fn vertex_normals(vertices: &[[f64; 3]], cells: &[crate::Cell]) -> Vec<[f64; 3]> {
    let _ = (vertices, cells);
    todo!()
}
