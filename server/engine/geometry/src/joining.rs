//! Joins patches: finds edges, vertices and orientation of a component by comparing positions.
//!
//! Each patch has four sides. A side is cut where a corner of another patch touches it, so that the pieces match one to
//! one (a wing's skin meets a tip cap along half of its own side). Two pieces with the same ends and the same points are
//! one edge; a side without length is a collapsed edge (a pole); a piece without partner is a boundary.

use crate::error::ComponentError;
use crate::location::{Location, Side};
use crate::patch::Patch;
use crate::topology::{Edge, EdgeSide, Incidence, Piece, Topology, Vertex, VertexKind};
use moldline_foundation::Vector3;
use moldline_spline::SurfacePoint;

/// Options for joining patches.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ComponentOptions {
    /// An edge is sharp where the normals of its two sides differ by more than this, degrees.
    pub sharp_angle_degrees: f64,
    /// Patch edges within this distance of each other, relative to the component's size, are one.
    pub edge_tolerance: f64,
    /// Whether a shell may have a boundary (a half model cut at its symmetry plane).
    pub allow_open: bool,
}

impl Default for ComponentOptions {
    fn default() -> Self {
        Self { sharp_angle_degrees: 20.0, edge_tolerance: 1e-7, allow_open: false }
    }
}

/// The topology of patches whose component is `size` metres across.
///
/// # Errors
/// A shell that is open (unless that is allowed), not manifold or one-sided.
pub(crate) fn join(
    patches: &[Patch],
    control_points: &[[f64; 4]],
    size: f64,
    options: &ComponentOptions,
) -> Result<Topology, ComponentError> {
    let finder = Finder { patches, control_points, size, tolerance: options.edge_tolerance * size };
    let mut topology = finder.match_sides()?;
    topology.flipped = finder.orient(&topology, options)?;
    finder.classify(&mut topology, options);
    Ok(topology)
}

/// A piece of a side, not yet paired with its partner.
struct Candidate {
    side: EdgeSide,
    vertices: [u32; 2],
    collapsed: bool,
}

/// Largest gap, as a fraction of the component's size, that a tolerance should close.
const LARGEST_GAP: f64 = 1e-3;

/// The corners of all patches; those within the tolerance of each other are one vertex.
struct Corners {
    /// By vertex.
    positions: Vec<Vector3>,
    /// First and last vertex of every side, by patch.
    ends: Vec<[[u32; 2]; 4]>,
    /// Whether every side has no length, by patch.
    collapsed: Vec<[bool; 4]>,
}

/// The pieces of all sides, and how patches touch each vertex.
struct Cuts {
    candidates: Vec<Candidate>,
    incidences: Vec<Vec<Incidence>>,
}

struct Finder<'a> {
    patches: &'a [Patch],
    control_points: &'a [[f64; 4]],
    /// That of the component, m.
    size: f64,
    tolerance: f64,
}

impl Finder<'_> {
    fn point(&self, l: &Location) -> SurfacePoint {
        self.patches[l.patch as usize].point(self.control_points, l.u, l.v)
    }

    fn position(&self, l: &Location) -> Vector3 {
        self.point(l).position
    }

    fn match_sides(&self) -> Result<Topology, ComponentError> {
        let corners = self.corners();
        let mut cuts = Cuts { candidates: Vec::new(), incidences: vec![Vec::new(); corners.positions.len()] };
        for patch in 0..self.patches.len() {
            for side in Side::ALL {
                self.cut(patch, side, &corners, &mut cuts);
            }
            self.add_corners(patch, &corners, &mut cuts.incidences);
        }
        let edges = self.pair(&cuts.candidates)?;
        let pieces = pieces(&edges, self.patches.len());
        let vertex = |incidences| Vertex { kind: VertexKind::Smooth, incidences };
        let vertices = cuts.incidences.into_iter().map(vertex).collect();
        Ok(Topology { edges, vertices, pieces, flipped: Vec::new() })
    }

    fn corners(&self) -> Corners {
        let mut positions: Vec<Vector3> = Vec::new();
        let mut vertex_of = |p: Vector3| {
            let found = positions.iter().position(|q| (q - p).norm() <= self.tolerance);
            found.unwrap_or_else(|| {
                positions.push(p);
                positions.len() - 1
            }) as u32
        };
        let mut end =
            |i: usize, side, t| vertex_of(self.position(&self.patches[i].on_side(i as u32, side, t)));
        let of_patch = |i: usize| {
            Side::ALL.map(|side| {
                let (a, b) = self.patches[i].side_domain(side);
                [end(i, side, a), end(i, side, b)]
            })
        };
        let ends: Vec<_> = (0..self.patches.len()).map(of_patch).collect();
        let is_collapsed = |(i, ends): (usize, &[[u32; 2]; 4])| {
            Side::ALL.map(|side| {
                let [first, last] = ends[side as usize];
                first == last && self.is_collapsed(i as u32, side)
            })
        };
        let collapsed = ends.iter().enumerate().map(is_collapsed).collect();
        Corners { positions, ends, collapsed }
    }

    /// Cuts a side where vertices touch it.
    fn cut(&self, patch: usize, side: Side, corners: &Corners, cuts: &mut Cuts) {
        let index = patch as u32;
        let [first, last] = corners.ends[patch][side as usize];
        let (a, b) = self.patches[patch].side_domain(side);
        if corners.collapsed[patch][side as usize] {
            let side_of = EdgeSide { patch: index, side, range: (a, b) };
            cuts.candidates.push(Candidate { side: side_of, vertices: [first, last], collapsed: true });
            cuts.incidences[first as usize].push(Incidence::Pole { patch: index, side });
            return;
        }
        let mut stations = vec![(a, first)];
        for (vertex, p) in (0..).zip(&corners.positions).filter(|(v, _)| ![first, last].contains(v)) {
            if let Some(t) = self.touches(index, side, p) {
                stations.push((t, vertex));
                let location = self.patches[patch].on_side(index, side, t);
                cuts.incidences[vertex as usize].push(Incidence::OnSide { location });
            }
        }
        stations.push((b, last));
        stations.sort_by(|x, y| x.0.total_cmp(&y.0));
        for w in stations.windows(2) {
            let side = EdgeSide { patch: index, side, range: (w[0].0, w[1].0) };
            cuts.candidates.push(Candidate { side, vertices: [w[0].1, w[1].1], collapsed: false });
        }
    }

    /// Adds a patch's corners whose two sides both have a length; the others belong to a pole.
    fn add_corners(&self, patch: usize, corners: &Corners, incidences: &mut [Vec<Incidence>]) {
        let [u, v] = self.patches[patch].surface.domain();
        let collapsed = |side: Side| corners.collapsed[patch][side as usize];
        for (v, side_v, end) in [(v.0, Side::VMin, 0), (v.1, Side::VMax, 1)] {
            for (u, side_u) in [(u.0, Side::UMin), (u.1, Side::UMax)] {
                if !collapsed(side_u) && !collapsed(side_v) {
                    let vertex = corners.ends[patch][side_u as usize][end];
                    let location = Location { patch: patch as u32, u, v };
                    incidences[vertex as usize].push(Incidence::Corner { location });
                }
            }
        }
    }

    fn is_collapsed(&self, patch: u32, side: Side) -> bool {
        let p = &self.patches[patch as usize];
        let samples = p.side_samples(side, 4);
        let first = self.position(&p.on_side(patch, side, samples[0]));
        samples.iter().all(|&t| (self.position(&p.on_side(patch, side, t)) - first).norm() <= self.tolerance)
    }

    /// The parameter at which a side passes through `x`, unless that is one of its ends.
    fn touches(&self, patch: u32, side: Side, x: &Vector3) -> Option<f64> {
        let p = &self.patches[patch as usize];
        let (t, distance) = p.closest_on_side(self.control_points, side, p.side_domain(side), x);
        let (a, b) = p.side_domain(side);
        let inside = t - a > 1e-9 * (b - a) && b - t > 1e-9 * (b - a);
        (distance <= self.tolerance && inside).then_some(t)
    }

    /// Whether inner points of `a` lie on `b`.
    fn coincide(&self, a: &EdgeSide, b: &EdgeSide) -> bool {
        (1..8).all(|k| {
            let x = self.position(&a.at(self.patches, k as f64 / 8.0));
            let range = (b.range.0.min(b.range.1), b.range.0.max(b.range.1));
            let patch = &self.patches[b.patch as usize];
            patch.closest_on_side(self.control_points, b.side, range, &x).1 <= self.tolerance
        })
    }

    fn pair(&self, candidates: &[Candidate]) -> Result<Vec<Edge>, ComponentError> {
        let mut edges: Vec<Edge> = Vec::new();
        let mut used = vec![false; candidates.len()];
        for (i, c) in candidates.iter().enumerate() {
            if used[i] {
                continue;
            }
            used[i] = true;
            let mut edge = Edge {
                sides: vec![c.side],
                vertices: c.vertices,
                sharp: false,
                collapsed: c.collapsed,
                affine: true,
            };
            if !c.collapsed {
                let [a, b] = c.vertices;
                for (j, other) in candidates.iter().enumerate().skip(i + 1) {
                    let same_ends = other.vertices == [a, b] || other.vertices == [b, a];
                    if used[j] || other.collapsed || !same_ends || !self.coincide(&c.side, &other.side) {
                        continue;
                    }
                    used[j] = true;
                    let mut side = other.side;
                    // A closed curve starts and ends in one vertex: its direction shows at its quarter points.
                    let reversed = if a != b {
                        other.vertices != [a, b]
                    } else {
                        let quarter = self.position(&c.side.at(self.patches, 0.25));
                        let d = |f| (self.position(&side.at(self.patches, f)) - quarter).norm();
                        d(0.75) < d(0.25)
                    };
                    if reversed {
                        side.range = (side.range.1, side.range.0);
                    }
                    edge.sides.push(side);
                }
                if edge.sides.len() > 2 {
                    let s = edge.sides[2];
                    return Err(ComponentError::NonManifold {
                        patch: self.patches[s.patch as usize].name.clone(),
                        side: s.side,
                        count: edge.sides.len(),
                    });
                }
                if let [s, t] = edge.sides[..] {
                    edge.affine = (1..8).all(|k| {
                        let f = k as f64 / 8.0;
                        let gap =
                            self.position(&s.at(self.patches, f)) - self.position(&t.at(self.patches, f));
                        gap.norm() <= 2.0 * self.tolerance
                    });
                }
            }
            edges.push(edge);
        }
        Ok(edges)
    }

    /// Orients each shell consistently, outward by the sign of its volume.
    fn orient(&self, topology: &Topology, options: &ComponentOptions) -> Result<Vec<bool>, ComponentError> {
        let mut flipped: Vec<Option<bool>> = vec![None; self.patches.len()];
        for start in 0..self.patches.len() {
            if flipped[start].is_some() {
                continue;
            }
            let shell = self.orient_alike(start, &topology.edges, &mut flipped)?;
            let in_shell = |e: &&Edge| shell.contains(&(e.sides[0].patch as usize));
            let boundary: Vec<&Edge> =
                topology.edges.iter().filter(in_shell).filter(|e| e.is_boundary()).collect();
            if let (false, Some(edge)) = (options.allow_open, boundary.first()) {
                return Err(self.open(&edge.sides[0], boundary.len()));
            }
            if self.volume(&shell, &flipped, &self.origin(start, &boundary)) < 0.0 {
                for &i in &shell {
                    flipped[i] = flipped[i].map(|f| !f);
                }
            }
        }
        Ok(flipped.into_iter().map(|f| f == Some(true)).collect())
    }

    /// The patches of the shell of `start`, oriented as `start` is.
    fn orient_alike(
        &self,
        start: usize,
        edges: &[Edge],
        flipped: &mut [Option<bool>],
    ) -> Result<Vec<usize>, ComponentError> {
        flipped[start] = Some(false);
        let mut shell = vec![start];
        let mut next = 0;
        while next < shell.len() {
            let patch = shell[next];
            next += 1;
            let flip = flipped[patch] == Some(true);
            for edge in edges {
                let [a, b] = edge.sides[..] else { continue };
                let (here, there) = if a.patch as usize == patch {
                    (a, b)
                } else if b.patch as usize == patch {
                    (b, a)
                } else {
                    continue;
                };
                // Neighbours agree if they run along their edge in opposite directions.
                let wanted = flip ^ (here.counter_clockwise() == there.counter_clockwise());
                let other = there.patch as usize;
                match flipped[other] {
                    None => {
                        flipped[other] = Some(wanted);
                        shell.push(other);
                    }
                    Some(f) if f != wanted => {
                        return Err(ComponentError::NotOrientable {
                            patch: self.patches[patch].name.clone(),
                            neighbour: self.patches[other].name.clone(),
                        });
                    }
                    Some(_) => {}
                }
            }
        }
        Ok(shell)
    }

    /// The error of a shell with `count` boundary edges, the first of which is `side`.
    fn open(&self, side: &EdgeSide, count: usize) -> ComponentError {
        let gap = self.gap(side);
        // Twice the gap, rounded up to one digit.
        let least = 2.0 * gap / self.size;
        let digit = 10_f64.powf(least.log10().floor());
        ComponentError::Open {
            gap,
            fraction: (least > 0.0 && least <= LARGEST_GAP).then(|| (least / digit).ceil() * digit),
            patch: self.patches[side.patch as usize].name.clone(),
            side: side.side,
            from: self.position(&side.at(self.patches, 0.0)).into(),
            to: self.position(&side.at(self.patches, 1.0)).into(),
            count,
        }
    }

    /// The largest distance of a side from the other side that is nearest to it all along, m.
    fn gap(&self, side: &EdgeSide) -> f64 {
        let samples: Vec<Vector3> =
            (0..=8).map(|k| self.position(&side.at(self.patches, f64::from(k) / 8.0))).collect();
        let others = (0..).zip(self.patches).flat_map(|(index, patch)| {
            Side::ALL
                .into_iter()
                .filter(move |&other| (index, other) != (side.patch, side.side))
                .map(move |s| (patch, s))
        });
        let farthest = |(patch, other): (&Patch, Side)| {
            let domain = patch.side_domain(other);
            let distance = |x| patch.closest_on_side(self.control_points, other, domain, x).1;
            samples.iter().map(distance).fold(0.0, f64::max)
        };
        others.map(farthest).fold(f64::INFINITY, f64::min)
    }

    /// The point from which the volume of a shell is measured. From the middle of its boundary an open shell with one
    /// plane boundary has the volume that the plane would close; a closed shell has the same volume from everywhere.
    fn origin(&self, start: usize, boundary: &[&Edge]) -> Vector3 {
        let along = |e: &&Edge| {
            let side = e.sides[0];
            (0..8).map(move |k| self.position(&side.at(self.patches, k as f64 / 8.0)))
        };
        let samples: Vec<Vector3> = if boundary.is_empty() {
            vec![self.position(&self.patches[start].on_side(start as u32, Side::UMin, 0.0))]
        } else {
            boundary.iter().flat_map(along).collect()
        };
        samples.iter().sum::<Vector3>() / samples.len() as f64
    }

    /// The volume of a shell with its patches turned as `flipped`, seen from `origin`.
    fn volume(&self, shell: &[usize], flipped: &[Option<bool>], origin: &Vector3) -> f64 {
        let cone = |&i: &usize| {
            let v = self.patches[i].cone_volume(self.control_points, origin);
            if flipped[i] == Some(true) { -v } else { v }
        };
        shell.iter().map(cone).sum()
    }

    /// Finds sharp edges by the angle between the normals of their sides, and the kinds of vertices that follow.
    fn classify(&self, topology: &mut Topology, options: &ComponentOptions) {
        let limit = options.sharp_angle_degrees.to_radians().cos();
        let flipped = topology.flipped.clone();
        let normal = |l: &Location| {
            let n = self.patches[l.patch as usize].normal(self.control_points, l.u, l.v);
            if flipped[l.patch as usize] { -n } else { n }
        };
        for edge in &mut topology.edges {
            edge.sharp = match edge.sides[..] {
                [a, b] => (0..9).any(|k| {
                    let f = (k as f64 + 0.5) / 9.0;
                    let here = a.at(self.patches, f);
                    let there = if edge.affine {
                        b.at(self.patches, f)
                    } else {
                        let patch = &self.patches[b.patch as usize];
                        let range = (b.range.0.min(b.range.1), b.range.0.max(b.range.1));
                        let x = self.position(&here);
                        let (t, _) = patch.closest_on_side(self.control_points, b.side, range, &x);
                        patch.on_side(b.patch, b.side, t)
                    };
                    normal(&here).dot(&normal(&there)) < limit
                }),
                _ => !edge.collapsed,
            };
        }
        for index in 0..topology.vertices.len() {
            // Directions in which sharp edges leave the vertex.
            let mut leaving: Vec<(u32, Vector3)> = Vec::new();
            for (e, edge) in topology.edges.iter().enumerate().filter(|(_, e)| e.sharp) {
                for (end, &v) in edge.vertices.iter().enumerate() {
                    if v as usize == index {
                        let s = edge.sides[0];
                        let (from, to) = if end == 0 { (0.0, 1e-3) } else { (1.0, 1.0 - 1e-3) };
                        let d =
                            self.position(&s.at(self.patches, to)) - self.position(&s.at(self.patches, from));
                        leaving.push((e as u32, d.normalize()));
                    }
                }
            }
            let vertex = &mut topology.vertices[index];
            let pole = vertex.incidences.iter().any(|i| matches!(i, Incidence::Pole { .. }));
            vertex.kind = match leaving[..] {
                _ if pole => VertexKind::Corner,
                [] => VertexKind::Smooth,
                [(edge, a), (_, b)] if -a.dot(&b) > limit => VertexKind::OnEdge { edge },
                _ => VertexKind::Corner,
            };
        }
    }
}

/// The pieces of every side, by patch.
fn pieces(edges: &[Edge], patches: usize) -> Vec<[Vec<Piece>; 4]> {
    let mut pieces: Vec<[Vec<Piece>; 4]> = vec![Default::default(); patches];
    for (e, edge) in edges.iter().enumerate() {
        for (index, s) in edge.sides.iter().enumerate() {
            let (low, high) = (s.range.0.min(s.range.1), s.range.0.max(s.range.1));
            let piece = Piece { low, high, edge: e as u32, index: index as u8 };
            pieces[s.patch as usize][s.side as usize].push(piece);
        }
    }
    for side in pieces.iter_mut().flatten() {
        side.sort_by(|a, b| a.low.total_cmp(&b.low));
    }
    pieces
}
