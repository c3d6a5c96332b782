//! Nodes of the potential: vertices of the surface after it is cut along trailing edges and paths over bodies.
//!
//! A vertex off the cuts is one node. Cuts divide the panels around a vertex into sectors, and each sector is a node, so that the potential may
//! jump across a cut. Beside a trailing edge every node is an unknown of its own; along a path the jump is given by the circulation at the
//! root, so that a vertex has one unknown, and its other nodes add the jump. At a tip, where the cut ends, there is one node: no circulation.
//!
//! At the end of a path on the plane of symmetry the circulation is that of the root, since the image cancels what leaves the body. Elsewhere
//! it changes along the path so that all that arrive at an aft end cancel ([`Wakes::leaving`]), and no concentrated vortex leaves the body.

use std::collections::BTreeMap;

use moldline_mesh::Vector3;

use crate::{
    PanelError,
    panels::Panels,
    wake::{Beside, Wakes},
};

/// A linear combination of unknowns: factors.
pub(crate) type Combination = Vec<(u32, f64)>;

/// The nodes, their unknowns, and the circulations of the wakes' vertices.
#[derive(Clone, Debug, Default)]
pub(crate) struct Nodes {
    /// Node at each corner of each panel; a triangle's last one twice.
    pub of_corner: Vec<[u32; 4]>,
    /// Unknown whose test function is 1 at the node.
    pub row: Vec<u32>,
    /// The potential at the node.
    pub value: Vec<Combination>,
    /// A point of every unknown.
    pub row_point: Vec<u32>,
    /// Circulations: upper minus lower potential at both ends of every strip.
    pub ends: Vec<[Combination; 2]>,
    /// The same along the paths at both ends of every strip, from root to aft end; empty without a path.
    pub along: Vec<[Vec<Combination>; 2]>,
}

impl Nodes {
    /// # Errors
    /// [`PanelError::NoCarryOver`] where a trailing edge divides the panels around a vertex into more than two sectors.
    pub fn new(panels: &Panels, wakes: &Wakes) -> Result<Self, PanelError> {
        let cut = Cut::new(panels, wakes);
        let mut nodes = Self { of_corner: vec![[u32::MAX; 4]; panels.len()], ..Self::default() };
        let corners_at = corners_at(panels);
        // Nodes and rows of all points; the nodes of a point follow each other.
        let mut first_node = Vec::with_capacity(corners_at.len());
        for (point, corners) in corners_at.iter().enumerate() {
            first_node.push(nodes.row.len() as u32);
            let sectors = cut.sectors(panels, point as u32, corners);
            let trailing = cut.trailing[point];
            if trailing && sectors.count > 2 {
                return Err(PanelError::NoCarryOver { vertex: panels.vertex_of[point] });
            }
            for sector in 0..sectors.count {
                if sector == 0 || trailing {
                    nodes.row_point.push(point as u32);
                }
                let row = nodes.row_point.len() as u32 - 1;
                nodes.row.push(row);
                nodes.value.push(vec![(row, 1.0)]);
            }
            for (&(panel, corner), sector) in corners.iter().zip(&sectors.of_corner) {
                nodes.of_corner[panel as usize][corner as usize] = first_node[point] + sector;
            }
        }
        for (panel, of_corner) in nodes.of_corner.iter_mut().enumerate() {
            if panels.is_triangle(panel) {
                of_corner[3] = of_corner[2];
            }
        }
        nodes.circulations(panels, wakes);
        nodes.jumps(panels, wakes, &corners_at, &cut, &first_node);
        Ok(nodes)
    }

    /// Number of unknowns.
    pub fn rows(&self) -> usize {
        self.row_point.len()
    }

    /// The node of a panel at a point of it.
    pub fn at(&self, panels: &Panels, panel: u32, point: u32) -> u32 {
        let corner = panels.corners[panel as usize].iter().position(|p| *p == point);
        self.of_corner[panel as usize][corner.unwrap_or(0)]
    }

    /// Circulations at the ends of the strips and along the paths.
    fn circulations(&mut self, panels: &Panels, wakes: &Wakes) {
        for strip in &wakes.strips {
            let at = |point: u32| {
                let [upper, lower] = [strip.upper, strip.lower].map(|panel| self.at(panels, panel, point));
                if upper == lower {
                    Vec::new()
                } else {
                    vec![(self.row[upper as usize], 1.0), (self.row[lower as usize], -1.0)]
                }
            };
            self.ends.push([at(strip.a), at(strip.b)]);
        }
        for (index, strip) in wakes.strips.iter().enumerate() {
            let along = [0, 1].map(|side| {
                let Some(path) = &wakes.paths[index][side] else { return Vec::new() };
                let root = &self.ends[index][side];
                let last = match strip.beside[side] {
                    Beside::Body(end) if panels.symmetric && panels.on_plane[end as usize] => root.clone(),
                    Beside::Body(_) => {
                        let ends = |(end, factor): (u32, f64)| {
                            (factor, &self.ends[end as usize / 2][end as usize % 2])
                        };
                        combine(&wakes.leaving(index, side).into_iter().map(ends).collect::<Vec<_>>())
                    }
                    _ => Vec::new(),
                };
                let steps = (path.len() - 1) as f64;
                let at = |step: usize| {
                    let t = step as f64 / steps;
                    combine(&[(1.0 - t, root), (t, &last)])
                };
                (0..path.len()).map(at).collect()
            });
            self.along.push(along);
        }
    }

    /// Potentials of the nodes along paths.
    fn jumps(
        &mut self,
        panels: &Panels,
        wakes: &Wakes,
        corners_at: &[Vec<(u32, u32)>],
        cut: &Cut,
        first_node: &[u32],
    ) {
        // Jumps from the left panel of an edge to its right one, at a point of it.
        let mut jumps: BTreeMap<(u32, u32), Combination> = BTreeMap::new();
        for (paths, along) in wakes.paths.iter().zip(&self.along) {
            for side in 0..2 {
                let Some(path) = &paths[side] else { continue };
                for (step, pair) in path.windows(2).enumerate() {
                    let Some(edge) = panels.edge_between(pair[0], pair[1]) else { continue };
                    // The upper panel runs upstream along a path from the strip's beginning, downstream along one from its end.
                    let from = if side == 0 { pair[1] } else { pair[0] };
                    let upper_is_left = panels.edges[edge as usize].a == from;
                    let sign = if upper_is_left { -1.0 } else { 1.0 };
                    for (place, point) in pair.iter().enumerate() {
                        let jump = jumps.entry((*point, edge)).or_default();
                        *jump = combine(&[(1.0, jump), (sign, &along[side][step + place])]);
                    }
                }
            }
        }
        for (point, corners) in corners_at.iter().enumerate() {
            if !cut.on_path[point] || cut.trailing[point] {
                continue;
            }
            let base = first_node[point];
            let row = self.row[base as usize];
            let mut known: BTreeMap<u32, Combination> = BTreeMap::from([(base, Vec::new())]);
            // As many rounds as there are nodes reach all of them.
            for _ in corners {
                for &edge in &panels.point_edges[point] {
                    let Some(jump) = jumps.get(&(point as u32, edge)) else { continue };
                    let e = &panels.edges[edge as usize];
                    let Some(right) = e.right else { continue };
                    let [left, right] = [e.left, right].map(|panel| self.at(panels, panel, point as u32));
                    match (known.get(&left), known.get(&right)) {
                        (Some(of_left), None) => {
                            let sum = combine(&[(1.0, of_left), (1.0, jump)]);
                            known.insert(right, sum);
                        }
                        (None, Some(of_right)) => {
                            let sum = combine(&[(1.0, of_right), (-1.0, jump)]);
                            known.insert(left, sum);
                        }
                        _ => {}
                    }
                }
            }
            for (node, jump) in known {
                self.value[node as usize] = combine(&[(1.0, &vec![(row, 1.0)]), (1.0, &jump)]);
            }
        }
    }
}

/// Cosine of the angle between normals from which on an edge is a crease: across it velocities are not averaged.
const CREASE: f64 = 0.77;

/// Corners of panels that share a smooth surface: those around a point in sectors between cuts and creases, at the set-up's positions.
#[derive(Clone, Debug, Default)]
pub(crate) struct Smooth {
    pub of_corner: Vec<[u32; 4]>,
    pub count: usize,
}

impl Smooth {
    pub fn new(panels: &Panels, wakes: &Wakes, points: &[Vector3]) -> Self {
        let mut cut = Cut::new(panels, wakes);
        let normal = |panel: u32| {
            let [a, b, c, d] = panels.corners[panel as usize].map(|p| points[p as usize]);
            (c - a).cross(&(d - b)).normalize()
        };
        for (edge, e) in panels.edges.iter().enumerate() {
            cut.edges[edge] |= e.right.is_some_and(|right| normal(e.left).dot(&normal(right)) < CREASE);
        }
        cut.on_path.fill(true);
        let mut smooth = Self { of_corner: vec![[0; 4]; panels.len()], count: 0 };
        for (point, corners) in corners_at(panels).iter().enumerate() {
            let sectors = cut.sectors(panels, point as u32, corners);
            for (&(panel, corner), sector) in corners.iter().zip(&sectors.of_corner) {
                smooth.of_corner[panel as usize][corner as usize] = smooth.count as u32 + sector;
            }
            smooth.count += sectors.count as usize;
        }
        smooth
    }

    /// The corners of a panel.
    pub fn corners(&self, panels: &Panels, panel: usize) -> &[u32] {
        &self.of_corner[panel][..if panels.is_triangle(panel) { 3 } else { 4 }]
    }
}

/// The sum of combinations with factors; terms of the same unknown become one, and zeros vanish.
fn combine(terms: &[(f64, &Combination)]) -> Combination {
    let mut sum: BTreeMap<u32, f64> = BTreeMap::new();
    for (factor, combination) in terms {
        for (unknown, value) in *combination {
            *sum.entry(*unknown).or_default() += factor * value;
        }
    }
    sum.into_iter().filter(|(_, value)| *value != 0.0).collect()
}

/// Panels and corners at every point.
fn corners_at(panels: &Panels) -> Vec<Vec<(u32, u32)>> {
    let mut at = vec![Vec::new(); panels.point_edges.len()];
    for (panel, corners) in panels.corners.iter().enumerate() {
        let count = if panels.is_triangle(panel) { 3 } else { 4 };
        for (corner, point) in corners.iter().take(count).enumerate() {
            at[*point as usize].push((panel as u32, corner as u32));
        }
    }
    at
}

/// The cuts.
struct Cut {
    /// Edges that are cut.
    edges: Vec<bool>,
    /// Points of trailing edges, and of paths.
    trailing: Vec<bool>,
    on_path: Vec<bool>,
}

/// The panels around a point in sectors.
struct Sectors {
    count: u32,
    /// Sector of every corner at the point.
    of_corner: Vec<u32>,
}

impl Cut {
    fn new(panels: &Panels, wakes: &Wakes) -> Self {
        let points = panels.point_edges.len();
        let mut cut = Self {
            edges: wakes.trailing.clone(),
            trailing: vec![false; points],
            on_path: vec![false; points],
        };
        cut.edges.resize(panels.edges.len(), false);
        for strip in &wakes.strips {
            [strip.a, strip.b].iter().for_each(|p| cut.trailing[*p as usize] = true);
        }
        for path in wakes.paths.iter().flatten().flatten() {
            path.iter().for_each(|p| cut.on_path[*p as usize] = true);
            for pair in path.windows(2) {
                if let Some(edge) = panels.edge_between(pair[0], pair[1]) {
                    cut.edges[edge as usize] = true;
                }
            }
        }
        cut
    }

    /// Sectors in the order of their first corner.
    fn sectors(&self, panels: &Panels, point: u32, corners: &[(u32, u32)]) -> Sectors {
        let mut of_corner: Vec<u32> = (0..corners.len() as u32).collect();
        if !self.trailing[point as usize] && !self.on_path[point as usize] {
            return Sectors { count: 1, of_corner: vec![0; corners.len()] };
        }
        let place = |panel: u32| corners.iter().position(|(p, _)| *p == panel);
        for &edge in &panels.point_edges[point as usize] {
            let e = &panels.edges[edge as usize];
            let (false, Some(right)) = (self.edges[edge as usize], e.right) else { continue };
            if let (Some(left), Some(right)) = (place(e.left), place(right)) {
                let (keep, drop) =
                    (of_corner[left].min(of_corner[right]), of_corner[left].max(of_corner[right]));
                of_corner.iter_mut().filter(|s| **s == drop).for_each(|s| *s = keep);
            }
        }
        let mut names = of_corner.clone();
        names.sort_unstable();
        names.dedup();
        let rename = |sector: &u32| names.partition_point(|n| n < sector) as u32;
        let of_corner: Vec<u32> = of_corner.iter().map(rename).collect();
        Sectors { count: names.len() as u32, of_corner }
    }
}
