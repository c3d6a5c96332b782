//! How the patches of a component join: edges, vertices, orientation, found by comparing positions.
//!
//! Each patch has four sides. A side is cut where a corner of another patch touches it, so that the pieces match one to
//! one (a wing's skin meets a tip cap along half of its own side). Two pieces with the same ends and the same points are
//! one edge; a side without length is a collapsed edge (a pole); a piece without partner is a boundary.

use crate::component::{ComponentError, ComponentOptions, Patch};
use crate::{Location, Vector3};
use moldline_spline::{SurfaceJet, SurfacePoint};

/// A side of a patch's parameter rectangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Side {
    /// `u` at its first value.
    UMin,
    /// `u` at its last value.
    UMax,
    /// `v` at its first value.
    VMin,
    /// `v` at its last value.
    VMax,
}

impl Side {
    /// All four.
    pub const ALL: [Side; 4] = [Side::UMin, Side::UMax, Side::VMin, Side::VMax];

    /// Whether `u` is constant along the side.
    #[inline]
    pub fn holds_u(self) -> bool {
        matches!(self, Side::UMin | Side::UMax)
    }

    /// Whether the held parameter is at its first value, so that the patch lies in the increasing direction.
    #[inline]
    pub fn is_min(self) -> bool {
        matches!(self, Side::UMin | Side::VMin)
    }

    /// Whether the side's increasing parameter runs counter-clockwise around the rectangle.
    fn counter_clockwise(self) -> bool {
        matches!(self, Side::VMin | Side::UMax)
    }

    /// The derivative along the side and the one across it, pointing into the patch.
    #[inline]
    pub(crate) fn along_and_inward(self, point: &SurfacePoint) -> (Vector3, Vector3) {
        let (along, across) = if self.holds_u() { (point.d_v, point.d_u) } else { (point.d_u, point.d_v) };
        (along, if self.is_min() { across } else { -across })
    }

    /// How the derivative across the side, pointing into the patch, changes along it.
    pub(crate) fn inward_along(self, jet: &SurfaceJet) -> Vector3 {
        if self.is_min() { jet.d_uv } else { -jet.d_uv }
    }
}

/// A piece of a patch's side as part of an edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeSide {
    /// Patch index.
    pub patch: u32,
    /// Which side.
    pub side: Side,
    /// Parameter along the side at the edge's first and at its last vertex; decreasing if the edge runs against it.
    pub range: (f64, f64),
}

impl EdgeSide {
    /// The location at a fraction (0 to 1) of the piece.
    pub(crate) fn at(&self, patches: &[Patch], fraction: f64) -> Location {
        let t = self.range.0 + fraction * (self.range.1 - self.range.0);
        patches[self.patch as usize].on_side(self.patch, self.side, t)
    }

    /// Whether the edge runs counter-clockwise around the patch's parameter rectangle.
    fn counter_clockwise(&self) -> bool {
        (self.range.1 >= self.range.0) == self.side.counter_clockwise()
    }
}

/// A curve in which patches meet or end, or a side collapsed into a point.
#[derive(Debug, Clone, PartialEq)]
pub struct Edge {
    /// The one or two pieces of patch sides that lie on it.
    pub sides: Vec<EdgeSide>,
    /// First and last vertex.
    pub vertices: [u32; 2],
    /// The normals of its two sides differ by more than the component's sharp angle somewhere, or it is a boundary.
    pub sharp: bool,
    /// It has no length: a pole.
    pub collapsed: bool,
    /// Its two sides have the same points at the same fractions of their ranges.
    pub(crate) affine: bool,
}

impl Edge {
    /// A boundary of an open shell.
    pub fn is_boundary(&self) -> bool {
        self.sides.len() == 1 && !self.collapsed
    }

    /// Whether its two sides have the same points at the same fractions of their ranges.
    pub fn is_affine(&self) -> bool {
        self.affine
    }
}

/// What a vertex is to a foot point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VertexKind {
    /// Every edge that ends here is smooth: an ordinary point of a face.
    Smooth,
    /// A sharp edge passes through without a kink: an ordinary point of that edge.
    OnEdge {
        /// One of the two sharp edges.
        edge: u32,
    },
    /// A pole, or sharp edges that meet at an angle.
    Corner,
}

/// How a patch touches a vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Incidence {
    /// With a corner of its parameter rectangle.
    Corner {
        /// The corner.
        location: Location,
    },
    /// With an inner point of a side.
    OnSide {
        /// The point.
        location: Location,
    },
    /// With a whole side that is collapsed.
    Pole {
        /// The patch.
        patch: u32,
        /// Its side.
        side: Side,
    },
}

/// A point where edges end.
#[derive(Debug, Clone, PartialEq)]
pub struct Vertex {
    /// What it is to a foot point.
    pub kind: VertexKind,
    pub(crate) incidences: Vec<Incidence>,
}

impl Vertex {
    /// How patches touch it.
    pub fn incidences(&self) -> &[Incidence] {
        &self.incidences
    }
}

/// A side's pieces in increasing order of the parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Piece {
    pub low: f64,
    pub high: f64,
    pub edge: u32,
    /// Index in the edge's `sides`.
    pub index: u8,
}

#[derive(Debug, Clone)]
pub(crate) struct Topology {
    pub edges: Vec<Edge>,
    pub vertices: Vec<Vertex>,
    /// Pieces by patch and side.
    pub pieces: Vec<[Vec<Piece>; 4]>,
    /// Whether a patch's `S_u x S_v` points inwards.
    pub flipped: Vec<bool>,
}

impl Topology {
    pub fn find(
        patches: &[Patch],
        control_points: &[[f64; 4]],
        size: f64,
        options: &ComponentOptions,
    ) -> Result<Self, ComponentError> {
        let finder = Finder { patches, control_points, tolerance: options.edge_tolerance * size };
        let mut topology = finder.match_sides()?;
        topology.flipped = finder.orient(&topology, options)?;
        finder.classify(&mut topology, options);
        Ok(topology)
    }
}

/// A piece of a side before it has found its partner.
struct Candidate {
    side: EdgeSide,
    vertices: [u32; 2],
    collapsed: bool,
}

struct Finder<'a> {
    patches: &'a [Patch],
    control_points: &'a [[f64; 4]],
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
        // Vertices: the corners of all patches, those within the tolerance being one.
        let mut positions: Vec<Vector3> = Vec::new();
        let mut vertex_of = |p: Vector3| {
            let found = positions.iter().position(|q| (q - p).norm() <= self.tolerance);
            found.unwrap_or_else(|| {
                positions.push(p);
                positions.len() - 1
            }) as u32
        };
        let mut ends = Vec::new();
        for (i, patch) in self.patches.iter().enumerate() {
            for side in Side::ALL {
                let (a, b) = patch.side_domain(side);
                let at = |t| self.position(&patch.on_side(i as u32, side, t));
                ends.push([vertex_of(at(a)), vertex_of(at(b))]);
            }
        }

        let mut candidates = Vec::new();
        let mut incidences: Vec<Vec<Incidence>> = vec![Vec::new(); positions.len()];
        for (i, patch) in self.patches.iter().enumerate() {
            let index = i as u32;
            for (k, side) in Side::ALL.into_iter().enumerate() {
                let [first, last] = ends[4 * i + k];
                let (a, b) = patch.side_domain(side);
                if first == last && self.is_collapsed(index, side) {
                    let side_of = EdgeSide { patch: index, side, range: (a, b) };
                    candidates.push(Candidate { side: side_of, vertices: [first, last], collapsed: true });
                    incidences[first as usize].push(Incidence::Pole { patch: index, side });
                    continue;
                }
                let mut cuts = vec![(a, first)];
                for (vertex, p) in positions.iter().enumerate() {
                    let vertex = vertex as u32;
                    if vertex == first || vertex == last {
                        continue;
                    }
                    if let Some(t) = self.touches(index, side, p) {
                        cuts.push((t, vertex));
                        let location = patch.on_side(index, side, t);
                        incidences[vertex as usize].push(Incidence::OnSide { location });
                    }
                }
                cuts.push((b, last));
                cuts.sort_by(|x, y| x.0.total_cmp(&y.0));
                for w in cuts.windows(2) {
                    let side = EdgeSide { patch: index, side, range: (w[0].0, w[1].0) };
                    candidates.push(Candidate { side, vertices: [w[0].1, w[1].1], collapsed: false });
                }
            }
            // Corners whose two sides both have a length; the others belong to a pole.
            let [u, v] = patch.surface.domain();
            for (cu, cv, su, sv) in [(u.0, v.0, 0, 2), (u.1, v.0, 1, 2), (u.0, v.1, 0, 3), (u.1, v.1, 1, 3)] {
                let collapsed = |k: usize| {
                    let [a, b] = ends[4 * i + k];
                    a == b && self.is_collapsed(index, Side::ALL[k])
                };
                if !collapsed(su) && !collapsed(sv) {
                    let vertex = ends[4 * i + su][usize::from(cv != v.0)];
                    let location = Location { patch: index, u: cu, v: cv };
                    incidences[vertex as usize].push(Incidence::Corner { location });
                }
            }
        }

        let edges = self.pair(&candidates)?;
        let mut pieces: Vec<[Vec<Piece>; 4]> = vec![Default::default(); self.patches.len()];
        for (e, edge) in edges.iter().enumerate() {
            for (index, s) in edge.sides.iter().enumerate() {
                let (low, high) = (s.range.0.min(s.range.1), s.range.0.max(s.range.1));
                let piece = Piece { low, high, edge: e as u32, index: index as u8 };
                pieces[s.patch as usize][s.side as usize].push(piece);
            }
        }
        for sides in &mut pieces {
            for side in sides {
                side.sort_by(|a, b| a.low.total_cmp(&b.low));
            }
        }
        let vertices =
            incidences.into_iter().map(|i| Vertex { kind: VertexKind::Smooth, incidences: i }).collect();
        Ok(Topology { edges, vertices, pieces, flipped: Vec::new() })
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

    /// Largest distance from inner points of `a` to `b`.
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

    /// Consistent orientation over each shell, outward by the sign of its volume.
    fn orient(&self, topology: &Topology, options: &ComponentOptions) -> Result<Vec<bool>, ComponentError> {
        let mut flipped: Vec<Option<bool>> = vec![None; self.patches.len()];
        for start in 0..self.patches.len() {
            if flipped[start].is_some() {
                continue;
            }
            flipped[start] = Some(false);
            let mut shell = vec![start];
            let mut next = 0;
            while next < shell.len() {
                let patch = shell[next];
                next += 1;
                let flip = flipped[patch] == Some(true);
                for edge in &topology.edges {
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
            let in_shell = |e: &&Edge| shell.contains(&(e.sides[0].patch as usize));
            let boundary: Vec<&Edge> =
                topology.edges.iter().filter(in_shell).filter(|e| e.is_boundary()).collect();
            if let (false, Some(edge)) = (options.allow_open, boundary.first()) {
                let s = edge.sides[0];
                return Err(ComponentError::Open {
                    patch: self.patches[s.patch as usize].name.clone(),
                    side: s.side,
                    from: self.position(&s.at(self.patches, 0.0)).into(),
                    to: self.position(&s.at(self.patches, 1.0)).into(),
                    count: boundary.len(),
                });
            }
            // Seen from the middle of its boundary an open shell with one plane boundary has the volume it would have
            // if it were closed by that plane; a closed shell has the same volume from everywhere.
            let samples: Vec<Vector3> = if boundary.is_empty() {
                vec![self.position(&self.patches[start].on_side(start as u32, Side::UMin, 0.0))]
            } else {
                let at = |e: &&Edge| {
                    (0..8)
                        .map(|k| self.position(&e.sides[0].at(self.patches, k as f64 / 8.0)))
                        .collect::<Vec<_>>()
                };
                boundary.iter().flat_map(at).collect()
            };
            let origin = samples.iter().sum::<Vector3>() / samples.len() as f64;
            let volume: f64 = shell
                .iter()
                .map(|&i| {
                    let v = self.patches[i].cone_volume(self.control_points, &origin);
                    if flipped[i] == Some(true) { -v } else { v }
                })
                .sum();
            if volume < 0.0 {
                for &i in &shell {
                    flipped[i] = flipped[i].map(|f| !f);
                }
            }
        }
        Ok(flipped.into_iter().map(|f| f == Some(true)).collect())
    }

    /// Sharp edges by the angle between the normals of their sides, and what that makes of the vertices.
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
