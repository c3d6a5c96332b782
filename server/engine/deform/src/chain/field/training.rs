//! Training vertices and their data (sec. III.D of the paper, eq. 15): distances to the seams along the mesh, blending
//! weights, and which vertices carry the displacement field.
//!
//! A training datum is a fixed linear combination of the motions of the seam vertices, so that data and field depend linearly
//! on these.

use moldline_foundation::smooth_step::smooth_step;
use moldline_mesh::{Topology, graph, nearest_sources};
use moldline_spline::Vector3;

use crate::{Monitor, Stage};

/// Seam vertices whose motions are averaged near a training vertex.
const NEAREST_SEAMS: usize = 8;

/// One training vertex.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingVertex {
    /// Index into the mesh.
    pub vertex: u32,
    /// `(seam, weight)`: the seam points (by index among them) whose motion it takes, weights `alpha * average`. Their
    /// sum `alpha` is one at the seam and zero from the blending radius on.
    pub seams: Vec<(u32, f64)>,
}

impl TrainingVertex {
    /// The blending weight `alpha`.
    pub fn alpha(&self) -> f64 {
        self.seams.iter().map(|(_, weight)| weight).sum()
    }
}

/// The part of the mesh that one field covers.
pub struct Region<'a> {
    /// Adjacency of the whole mesh.
    pub topology: &'a Topology,
    /// Positions of the whole mesh, m.
    pub vertices: &'a [[f64; 3]],
    /// Whether a vertex belongs to the region.
    pub contains: &'a dyn Fn(u32) -> bool,
    /// Mirror images; a vertex of the symmetry plane is its own. Training sets keep the symmetry.
    pub mirror: Option<&'a [u32]>,
    /// Vertices of the seam points, in their order, those outside the region included.
    pub seam_vertices: &'a [u32],
    /// Vertices that follow their component at fixed parameters (corners, poles, protected groups).
    pub held: &'a [u32],
    /// Blending radius as a fraction of the largest distance from a seam.
    pub blend_radius: f64,
    /// Ends the search early; what is returned then is incomplete.
    pub monitor: &'a dyn Monitor<Stage>,
}

/// C2 step: 1 at 0, 0 at 1 and beyond.
pub fn blending_weight(distance_over_radius: f64) -> f64 {
    1.0 - smooth_step(distance_over_radius.clamp(0.0, 1.0))
}

impl Region<'_> {
    fn members(&self) -> impl Iterator<Item = u32> + '_ {
        (0u32..).zip(self.vertices).map(|(v, _)| v).filter(|&v| (self.contains)(v))
    }

    /// Seam points inside the region: `(index among the seam points, vertex)`.
    fn seams(&self) -> Vec<(u32, u32)> {
        (0u32..).zip(self.seam_vertices.iter().copied()).filter(|&(_, v)| (self.contains)(v)).collect()
    }

    /// Distance `d_G` to the nearest seam along the region's edges, and the blending radius, m.
    fn seam_distance(&self, seams: &[(u32, u32)]) -> (Vec<f64>, f64) {
        let sources: Vec<u32> = seams.iter().map(|&(_, v)| v).collect();
        let distance = graph::graph_distance(self.topology, self.vertices, &sources, self.contains);
        let farthest = distance.iter().filter(|d| d.is_finite()).fold(0.0, |a: f64, &b| a.max(b));
        (distance, self.blend_radius * farthest)
    }

    /// Training set of a departure: the seam vertices, which carry it, and vertices beyond the blending radius, which do
    /// not depart. In between the field interpolates. Empty if the region has no seam.
    pub fn departure_set(&self, count: usize) -> Vec<TrainingVertex> {
        let seams = self.seams();
        if seams.is_empty() {
            return Vec::new();
        }
        let (distance, radius) = self.seam_distance(&seams);
        let mut chosen = vec![false; self.vertices.len()];
        let mut set: Vec<TrainingVertex> = thinned(&seams, count / 2)
            .map(|(seam, vertex)| TrainingVertex { vertex, seams: vec![(seam, 1.0)] })
            .collect();
        seams.iter().for_each(|&(_, v)| chosen[v as usize] = true);
        let at_rest = |vertex: u32| TrainingVertex { vertex, seams: Vec::new() };
        for &vertex in self.held {
            if (self.contains)(vertex) && !std::mem::replace(&mut chosen[vertex as usize], true) {
                set.push(at_rest(vertex));
            }
        }
        let far: Vec<u32> =
            self.members().filter(|&v| !chosen[v as usize] && distance[v as usize] >= radius).collect();
        let start: Vec<u32> = set.iter().map(|t| t.vertex).collect();
        let room = count.saturating_sub(set.len());
        set.extend(self.farthest_points(&start, &far, room).into_iter().map(at_rest));
        set
    }

    /// Training set of absolute displacements (the paper's): seam and held vertices first, then farthest points over
    /// the whole region, each with its blend of nearby seams.
    pub fn absolute_set(&self, count: usize) -> Vec<TrainingVertex> {
        let seams = self.seams();
        let mut chosen = vec![false; self.vertices.len()];
        let mut set: Vec<TrainingVertex> = thinned(&seams, count / 2)
            .map(|(seam, vertex)| TrainingVertex { vertex, seams: vec![(seam, 1.0)] })
            .collect();
        seams.iter().for_each(|&(_, v)| chosen[v as usize] = true);
        let mut start: Vec<u32> = set.iter().map(|t| t.vertex).collect();
        let held: Vec<(u32, u32)> = self.held.iter().map(|&v| (0, v)).collect();
        for (_, vertex) in thinned(&held, count / 4) {
            if (self.contains)(vertex) && !std::mem::replace(&mut chosen[vertex as usize], true) {
                start.push(vertex);
            }
        }
        let others: Vec<u32> = self.members().filter(|&v| !chosen[v as usize]).collect();
        let room = count.saturating_sub(start.len());
        let first_held = set.len();
        let more = self.farthest_points(&start, &others, room);
        let blends = self.blends(&seams);
        set.extend(
            start[first_held..]
                .iter()
                .chain(&more)
                .map(|&vertex| TrainingVertex { vertex, seams: blends(vertex) }),
        );
        set
    }

    /// Blend of the seams for any vertex of the region: `alpha(d_G)` times an average of the nearest seam vertices that
    /// changes smoothly where the nearest one does.
    fn blends(&self, seams: &[(u32, u32)]) -> impl Fn(u32) -> Vec<(u32, f64)> + use<> {
        let (distance, radius) = self.seam_distance(seams);
        let sources: Vec<u32> = seams.iter().map(|&(_, v)| v).collect();
        let nearest = nearest_sources(
            self.topology,
            self.vertices,
            &sources,
            NEAREST_SEAMS,
            radius.max(f64::MIN_POSITIVE),
            self.contains,
        );
        let seam_at: std::collections::HashMap<u32, u32> = seams.iter().map(|&(s, v)| (v, s)).collect();
        move |vertex| {
            let alpha = blending_weight(distance[vertex as usize] / radius.max(f64::MIN_POSITIVE));
            let near: Vec<(u32, f64)> = nearest.of(vertex as usize).collect();
            let Some(&(_, last)) = near.last() else { return Vec::new() };
            if alpha == 0.0 {
                return Vec::new();
            }
            // The farthest of the nearest has weight zero, so that it can be replaced without a jump.
            let reach = if near.len() == NEAREST_SEAMS { last } else { f64::INFINITY };
            let raw: Vec<f64> = near
                .iter()
                .map(|&(_, d)| if reach > d { (1.0 - d / reach).powi(2) / d.powi(2) } else { 0.0 })
                .collect();
            let total: f64 = raw.iter().sum();
            if !(total > 0.0 && total.is_finite()) {
                return vec![(seam_at[&near[0].0], alpha)];
            }
            near.iter()
                .zip(&raw)
                .filter(|(_, w)| **w > 0.0)
                .map(|(&(v, _), w)| (seam_at[&v], alpha * w / total))
                .collect()
        }
    }

    /// Up to `count` of `candidates`, each the farthest from `start` and all before it; a vertex and its mirror image come
    /// together. Ties go to the smaller index.
    fn farthest_points(&self, start: &[u32], candidates: &[u32], count: usize) -> Vec<u32> {
        let at = |v: u32| Vector3::from(self.vertices[v as usize]);
        let mut distance: Vec<f64> = candidates
            .iter()
            .map(|&v| {
                let start = if self.monitor.cancelled() { &[] } else { start };
                start.iter().map(|&s| (at(v) - at(s)).norm_squared()).fold(f64::INFINITY, f64::min)
            })
            .collect();
        let mut found = Vec::with_capacity(count.min(candidates.len()));
        while found.len() < count && !self.monitor.cancelled() {
            let best = (0..candidates.len()).fold(None, |best: Option<usize>, i| match best {
                Some(b) if distance[b] >= distance[i] => best,
                _ => Some(i),
            });
            let Some(best) = best.filter(|&b| distance[b] > 0.0) else { break };
            let vertex = candidates[best];
            let image = self.mirror.map(|mirror| mirror[vertex as usize]).filter(|&m| m != vertex);
            for new in std::iter::once(vertex).chain(image) {
                found.push(new);
                for (d, &v) in distance.iter_mut().zip(candidates) {
                    *d = d.min((at(v) - at(new)).norm_squared());
                }
            }
        }
        found
    }
}

/// All items if they are at most `count`, else an even subset.
fn thinned(items: &[(u32, u32)], count: usize) -> impl Iterator<Item = (u32, u32)> + '_ {
    let step = items.len().div_ceil(count.max(1)).max(1);
    items.iter().step_by(step).copied()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NoMonitor;
    use moldline_mesh::Cell;

    #[test]
    fn blending_weight_is_c2() {
        assert_eq!((blending_weight(0.0), blending_weight(1.0), blending_weight(3.0)), (1.0, 0.0, 0.0));
        assert!((blending_weight(0.5) - 0.5).abs() < 1e-15);
        let h = 1e-3;
        for end in [0.0, 1.0] {
            let second = blending_weight(end - h) - 2.0 * blending_weight(end) + blending_weight(end + h);
            assert!((second / (h * h)).abs() < 0.1, "second derivative at {end}");
        }
    }

    /// A strip of `n` unit quads along x; vertices `2 i` at y = 0 and `2 i + 1` at y = 1.
    fn strip(n: u32) -> (Vec<[f64; 3]>, Topology) {
        let vertices = (0..=n).flat_map(|i| [[f64::from(i), 0.0, 0.0], [f64::from(i), 1.0, 0.0]]).collect();
        let cells: Vec<Cell> = (0..n).map(|i| Cell::quad(2 * i, 2 * i + 2, 2 * i + 3, 2 * i + 1)).collect();
        let topology = Topology::of_cells(2 * (n as usize + 1), &cells);
        (vertices, topology)
    }

    #[test]
    fn departure_set_holds_what_is_far() {
        let (vertices, topology) = strip(10);
        let everything = |_: u32| true;
        let region = Region {
            topology: &topology,
            vertices: &vertices,
            contains: &everything,
            mirror: None,
            seam_vertices: &[0, 1],
            held: &[11],
            blend_radius: 0.9,
            monitor: &NoMonitor,
        };
        let set = region.departure_set(100);
        let at_rest: Vec<u32> = set.iter().filter(|t| t.alpha() == 0.0).map(|t| t.vertex).collect();
        assert_eq!(set[0], TrainingVertex { vertex: 0, seams: vec![(0, 1.0)] });
        assert_eq!(set[1].alpha(), 1.0);
        assert!(at_rest.contains(&11) && at_rest.contains(&20) && at_rest.contains(&18));
        assert!(!at_rest.contains(&10), "five of ten metres are within the radius of nine");
    }

    #[test]
    fn absolute_set_blends_by_distance() {
        let (vertices, topology) = strip(10);
        let everything = |_: u32| true;
        let region = Region {
            topology: &topology,
            vertices: &vertices,
            contains: &everything,
            mirror: None,
            seam_vertices: &[0, 1],
            held: &[],
            blend_radius: 0.5,
            monitor: &NoMonitor,
        };
        let set = region.absolute_set(100);
        assert_eq!(set.len(), vertices.len());
        for t in &set {
            let x = vertices[t.vertex as usize][0];
            assert!((t.alpha() - blending_weight(x / 5.0)).abs() < 1e-12, "vertex {} at {x}", t.vertex);
        }
    }
}
