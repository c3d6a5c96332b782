//! Shortest paths along mesh edges from many sources at once, by Dijkstra's algorithm.

use std::{
    cmp::{Ordering, Reverse},
    collections::BinaryHeap,
};

use crate::{Csr, Topology, Vector3};

/// In place of a source: none can be reached.
pub const UNREACHED: u32 = u32::MAX;

/// The nearest source and its distance.
#[derive(Clone, Debug, PartialEq)]
pub struct NearestSource {
    /// Length of the shortest path, `INFINITY` where there is none.
    pub distance: Vec<f64>,
    /// The source's vertex, [`UNREACHED`] where there is none; of equally near ones the smallest.
    pub source: Vec<u32>,
}

/// Up to k sources of each vertex with their distances, nearest first.
#[derive(Clone, Debug, PartialEq)]
pub struct NearestSources {
    /// The sources' vertices, a row for each vertex.
    pub sources: Csr,
    /// Lengths of the shortest paths, in the order of `sources.items`.
    pub distances: Vec<f64>,
}

impl NearestSources {
    /// `(source, distance)` of one vertex, nearest first.
    pub fn of(&self, vertex: usize) -> impl ExactSizeIterator<Item = (u32, f64)> + '_ {
        self.sources.range(vertex).map(|k| (self.sources.items[k], self.distances[k]))
    }
}

/// Lengths of the shortest paths along edges from the nearest of `sources`, `INFINITY` where there is no path. Paths visit only
/// vertices that `allowed` admits; other sources are left out.
///
/// # Panics
/// If a source is not a vertex.
pub fn graph_distance(
    topology: &Topology,
    vertices: &[[f64; 3]],
    sources: &[u32],
    allowed: impl Fn(u32) -> bool,
) -> Vec<f64> {
    nearest_source(topology, vertices, sources, allowed).distance
}

/// As [`graph_distance`], with the nearest source.
///
/// # Panics
/// If a source is not a vertex.
pub fn nearest_source(
    topology: &Topology,
    vertices: &[[f64; 3]],
    sources: &[u32],
    allowed: impl Fn(u32) -> bool,
) -> NearestSource {
    let mut nearest = NearestSource {
        distance: vec![f64::INFINITY; vertices.len()],
        source: vec![UNREACHED; vertices.len()],
    };
    spread(topology, vertices, sources, f64::INFINITY, allowed, |front| {
        let vertex = front.vertex as usize;
        let first = nearest.source[vertex] == UNREACHED;
        if first {
            nearest.source[vertex] = front.source;
            nearest.distance[vertex] = front.distance;
        }
        first
    });
    nearest
}

/// The `k` nearest sources of each vertex within `radius`, or fewer if fewer are reached.
///
/// # Panics
/// If a source is not a vertex.
pub fn nearest_sources(
    topology: &Topology,
    vertices: &[[f64; 3]],
    sources: &[u32],
    k: usize,
    radius: f64,
    allowed: impl Fn(u32) -> bool,
) -> NearestSources {
    let mut found: Vec<Vec<(u32, f64)>> = vec![Vec::new(); vertices.len()];
    spread(topology, vertices, sources, radius, allowed, |front| {
        let found = &mut found[front.vertex as usize];
        let new = found.len() < k && found.iter().all(|&(source, _)| source != front.source);
        if new {
            found.push((front.source, front.distance));
        }
        new
    });
    let mut nearest =
        NearestSources { sources: Csr { offsets: vec![0], items: Vec::new() }, distances: Vec::new() };
    for found in found {
        nearest.sources.items.extend(found.iter().map(|&(source, _)| source));
        nearest.distances.extend(found.iter().map(|&(_, distance)| distance));
        nearest.sources.offsets.push(nearest.distances.len() as u32);
    }
    nearest
}

/// The end of a path in the queue; ordered by distance, then by indices, so that ties are always resolved in the same way.
#[derive(Clone, Copy, PartialEq)]
struct Front {
    distance: f64,
    vertex: u32,
    source: u32,
}

impl Eq for Front {}

impl Ord for Front {
    fn cmp(&self, other: &Self) -> Ordering {
        let indices = (self.source, self.vertex).cmp(&(other.source, other.vertex));
        self.distance.total_cmp(&other.distance).then(indices)
    }
}

impl PartialOrd for Front {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Dijkstra's algorithm: offers path ends in order of distance, and continues from those that `settle` accepts.
fn spread(
    topology: &Topology,
    vertices: &[[f64; 3]],
    sources: &[u32],
    radius: f64,
    allowed: impl Fn(u32) -> bool,
    mut settle: impl FnMut(&Front) -> bool,
) {
    let at = |vertex: u32| Vector3::from(vertices[vertex as usize]);
    let mut heap: BinaryHeap<Reverse<Front>> = sources
        .iter()
        .filter(|&&source| allowed(source))
        .map(|&source| Reverse(Front { distance: 0.0, vertex: source, source }))
        .collect();
    while let Some(Reverse(front)) = heap.pop() {
        if !settle(&front) {
            continue;
        }
        let here = at(front.vertex);
        for &vertex in topology.vertex_neighbours.row(front.vertex as usize) {
            let distance = front.distance + (at(vertex) - here).norm();
            if distance <= radius && allowed(vertex) {
                heap.push(Reverse(Front { distance, vertex, source: front.source }));
            }
        }
    }
}
