//! Cracks: open edges that coincide pairwise because their vertices are double.

use std::collections::HashMap;

use crate::merge;

/// Tolerances at which edges are tried to meet, as fractions of a length.
const STEPS: [f64; 10] = [1e-15, 1e-13, 1e-11, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3];

/// A crack of a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crack {
    /// Number of edges that coincide with another one.
    pub edges: usize,
    /// Largest distance between their vertices, m.
    pub distance: f64,
    /// The first of the edges.
    pub first: [u32; 2],
}

impl Crack {
    /// A tolerance that merges the vertices: twice their distance, rounded up to one digit; for equal vertices `1e-12 length`.
    pub fn tolerance(&self, length: f64) -> f64 {
        let least = (2.0 * self.distance).max(1e-12 * length);
        let digit = 10_f64.powf(least.log10().floor());
        (least / digit).ceil() * digit
    }
}

/// Finds out whether at least half of the open edges coincide pairwise, at the smallest tolerance that joins them; `length`: the
/// reference length, m. Edges are the vertices' indices.
pub fn find(vertices: &[[f64; 3]], open: &[[u32; 2]], length: f64) -> Option<Crack> {
    // The vertices of open edges, numbered anew.
    let mut border: Vec<u32> = open.iter().flatten().copied().collect();
    border.sort_unstable();
    border.dedup();
    let positions: Vec<[f64; 3]> = border.iter().map(|&v| vertices[v as usize]).collect();
    let number = |v: u32| border.partition_point(|&other| other < v);
    for step in STEPS {
        let target = merge::near(&positions, step * length);
        let ends = |edge: &[u32; 2]| {
            let [a, b] = edge.map(|v| target[number(v)]);
            [a.min(b), a.max(b)]
        };
        let mut meeting: HashMap<[u32; 2], usize> = HashMap::new();
        open.iter().for_each(|edge| *meeting.entry(ends(edge)).or_default() += 1);
        let joined: Vec<&[u32; 2]> =
            open.iter().filter(|edge| ends(edge)[0] != ends(edge)[1] && meeting[&ends(edge)] > 1).collect();
        if 2 * joined.len() < open.len() {
            continue;
        }
        let gap = |v: u32| {
            let (x, y) = (positions[number(v)], positions[target[number(v)] as usize]);
            (0..3).map(|axis| (x[axis] - y[axis]).powi(2)).sum::<f64>().sqrt()
        };
        let distance = joined.iter().flat_map(|edge| edge.iter()).map(|&v| gap(v)).fold(0.0, f64::max);
        return joined.first().map(|&&first| Crack { edges: joined.len(), distance, first });
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distance_of_double_vertices_is_found() {
        for gap in [0.0, 1e-14, 3e-7, 4e-4] {
            // Two rows of vertices that face each other, and one edge that faces none.
            let at = |y: f64| (0..5).map(move |k| [0.25 * f64::from(k), y, 0.0]);
            let mut vertices: Vec<[f64; 3]> = at(0.0).chain(at(gap)).collect();
            vertices.extend([[0.0, 9.0, 0.0], [1.0, 9.0, 0.0]]);
            let row = |first: u32| (first..first + 4).map(|k| [k, k + 1]);
            let open: Vec<[u32; 2]> = row(0).chain(row(5)).chain([[10, 11]]).collect();
            let crack = find(&vertices, &open, 1.0).expect("is found");
            assert_eq!((crack.edges, crack.distance, crack.first), (8, gap, [0, 1]));
            assert!(crack.tolerance(1.0) > gap && crack.tolerance(1.0) <= 4.0 * gap.max(1e-12));
            assert_eq!(find(&vertices, &open[..5], 1.0), None);
        }
    }
}
