//! Distances along mesh edges from many sources at once (Dijkstra).

use std::{
    cmp::{Ordering, Reverse},
    collections::BinaryHeap,
};

use crate::{Csr, Topology, Vector3};

/// No source can be reached.
pub const UNREACHED: u32 = u32::MAX;

/// Distance to the nearest source, and which it is.
#[derive(Clone, Debug, PartialEq)]
pub struct NearestSource {
    /// Length of the shortest path, `INFINITY` where there is none.
    pub distance: Vec<f64>,
    /// The source's vertex, [`UNREACHED`] where there is none; the smallest of equally near ones.
    pub source: Vec<u32>,
}

/// Up to k sources of each vertex with their distances, nearest first.
#[derive(Clone, Debug, PartialEq)]
pub struct NearestSources {
    /// The sources' vertices, one row a vertex.
    pub sources: Csr,
    /// Lengths of the shortest paths, beside `sources.items`.
    pub distances: Vec<f64>,
}

impl NearestSources {
    /// `(source, distance)` of one vertex, nearest first.
    pub fn of(&self, vertex: usize) -> impl ExactSizeIterator<Item = (u32, f64)> + '_ {
        self.sources.range(vertex).map(|k| (self.sources.items[k], self.distances[k]))
    }
}

/// Shortest paths along edges from the nearest of `sources`, `INFINITY` where no path leads. Paths visit only vertices
/// that `allowed` admits; sources that it does not admit are left out.
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

/// As [`graph_distance`], with the source that is nearest.
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

/// The `k` nearest sources of each vertex within `radius`, fewer where fewer are reached.
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

/// A path's end that waits for its turn; ordered by distance, then by indices so that ties are settled alike always.
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

/// Dijkstra's algorithm: offers path ends in order of distance, and goes on from those that `settle` takes.
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
