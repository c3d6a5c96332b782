//! A component in one state of its control points: evaluation, foot points and signed distances (eqs. 1, 2 and 5).
//!
//! The sign comes from the surface's normal at the foot point. On an edge or at a vertex it comes from the mean of the
//! adjoining faces' normals weighted by the angles under which the faces meet there; for foot points that mean decides
//! between inside and outside as the normal does on a face (Baerentzen and Aanaes, 2005, whose proof for polyhedra looks
//! at the tangent cone only). At a collapsed side the weighted mean is an integral over the directions that leave it.

use crate::hierarchy::Hierarchy;
use crate::newton::{self, Iterate, Progress};
use crate::topology::Incidence;
use crate::{Aabb, Component, Side, SurfaceJet, SurfacePoint, Vector3, VertexKind};
use std::sync::{Arc, OnceLock};

/// Steps of a local descent; five are usual.
const MAX_STEPS: usize = 200;
/// Patch sides it crosses before it settles for the patch that it is on.
const MAX_MOVES: usize = 50;

/// A point of a component: `mu = (i, u, v)` with the parameters in the patch's own domain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Location {
    /// Index of the internal patch.
    pub patch: u32,
    /// First parameter.
    pub u: f64,
    /// Second parameter.
    pub v: f64,
}

/// Where on a component a foot point lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Feature {
    /// Inside a face, or on a smooth edge between patches.
    Face,
    /// On a sharp or boundary edge.
    Edge {
        /// Index in [`Component::edges`].
        edge: u32,
    },
    /// At a pole, or where sharp edges meet at an angle.
    Corner {
        /// Index in [`Component::vertices`].
        vertex: u32,
    },
}

/// The nearest point of a component to a given point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FootPoint {
    /// Its parameters.
    pub location: Location,
    /// What it lies on.
    pub feature: Feature,
    /// Its position, metres.
    pub position: Vector3,
    /// The outward unit normal of the surface; on edges and at corners the angle-weighted mean of the faces' normals.
    pub normal: Vector3,
    /// Signed distance from it to the given point, metres, negative inside.
    pub distance: f64,
}

/// A parameter of a patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ParameterDirection {
    /// `v` held, `u` moving.
    U,
    /// `u` held, `v` moving.
    V,
}

/// A component in one state, reference or deformed. Closest-point queries build a bounding hierarchy on first use.
#[derive(Debug, Clone)]
pub struct Body {
    component: Arc<Component>,
    control_points: Vec<[f64; 4]>,
    bounds: Aabb,
    hierarchy: OnceLock<Hierarchy>,
}

/// How a body goes on behind a side of a patch.
#[derive(Debug, Clone, Copy)]
struct Crossing {
    edge: u32,
    side: Side,
    to: Location,
    /// How fast the parameter along the side runs behind it, in terms of that before it.
    slope: f64,
}

/// The end of a line of one parameter and how it depends on its start and its length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Walk {
    /// Where it ends.
    pub end: Location,
    /// `d(u, v)` of the end by the `(u, v)` of the start.
    pub by_start: [[f64; 2]; 2],
    /// `d(u, v)` of the end by the length.
    pub by_length: [f64; 2],
}

impl Body {
    /// The component with the given internal control points.
    ///
    /// # Panics
    /// If their number is not the component's.
    pub fn new(component: Arc<Component>, control_points: Vec<[f64; 4]>) -> Self {
        assert_eq!(
            control_points.len(),
            component.control_point_count(),
            "a body has as many control points as its component"
        );
        let bounds = Aabb::around(control_points.iter().map(|c| Vector3::new(c[0], c[1], c[2]) / c[3]));
        Self { component, control_points, bounds, hierarchy: OnceLock::new() }
    }

    /// The component.
    pub fn component(&self) -> &Arc<Component> {
        &self.component
    }

    /// The internal control points of this state.
    pub fn control_points(&self) -> &[[f64; 4]] {
        &self.control_points
    }

    /// The box around the control points, which contains the body.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// The length all tolerances are relative to: the diagonal of the bounds.
    pub fn size(&self) -> f64 {
        self.bounds.diagonal()
    }

    pub(crate) fn patch_points(&self, patch: u32) -> &[[f64; 4]] {
        &self.control_points[self.component.patches()[patch as usize].range.clone()]
    }

    /// The position of a location, metres.
    #[inline]
    pub fn position(&self, l: &Location) -> Vector3 {
        let patch = &self.component.patches()[l.patch as usize];
        patch.surface.position(self.patch_points(l.patch), l.u, l.v)
    }

    /// Position and first derivatives.
    #[inline]
    pub fn point(&self, l: &Location) -> SurfacePoint {
        let patch = &self.component.patches()[l.patch as usize];
        patch.surface.point(self.patch_points(l.patch), l.u, l.v)
    }

    /// Position, first and second derivatives.
    #[inline]
    pub fn jet(&self, l: &Location) -> SurfaceJet {
        let patch = &self.component.patches()[l.patch as usize];
        patch.surface.jet(self.patch_points(l.patch), l.u, l.v)
    }

    /// The outward unit normal; at poles and collapsed sides its limit from inside the patch. Zero where there is no
    /// limit (patches without area).
    pub fn normal(&self, l: &Location) -> Vector3 {
        self.normal_at(l, &self.point(l))
    }

    #[inline]
    fn normal_at(&self, l: &Location, point: &SurfacePoint) -> Vector3 {
        let patch = &self.component.patches()[l.patch as usize];
        let n = patch.normal_at(&self.control_points, l.u, l.v, point);
        if patch.flipped { -n } else { n }
    }

    fn hierarchy(&self) -> &Hierarchy {
        self.hierarchy.get_or_init(|| Hierarchy::new(self))
    }

    /// The nearest point of the whole component: the global minimum of the distance, by branch and bound.
    pub fn closest_point(&self, x: &Vector3) -> FootPoint {
        let nearest = self.hierarchy().closest(self, x, f64::INFINITY);
        // Without a bound there is always one; a point that is not finite gets an arbitrary one.
        let location = nearest.unwrap_or(Location { patch: 0, u: f64::NEG_INFINITY, v: f64::NEG_INFINITY });
        self.foot_point(x, &location)
    }

    /// The nearest point of the whole component, unless everything is further away than `upper_bound` metres.
    pub fn closest_point_within(&self, x: &Vector3, upper_bound: f64) -> Option<FootPoint> {
        if self.bounds.squared_distance(x) > upper_bound * upper_bound {
            return None;
        }
        let location = self.hierarchy().closest(self, x, upper_bound)?;
        let foot = self.foot_point(x, &location);
        (foot.distance.abs() <= upper_bound).then_some(foot)
    }

    /// Signed distance, metres, negative inside.
    pub fn signed_distance(&self, x: &Vector3) -> f64 {
        self.closest_point(x).distance
    }

    /// The local minimum of the distance that descent from `hint` leads to. It walks over patch edges and stays on the
    /// hint's sheet of a thin body. `None` if it does not converge.
    pub fn closest_point_near(&self, x: &Vector3, hint: &Location) -> Option<FootPoint> {
        self.descend(x, hint).map(|l| self.foot_point(x, &l))
    }

    /// Descends to a local minimum of the distance, over patch edges.
    pub(crate) fn descend(&self, x: &Vector3, hint: &Location) -> Option<Location> {
        let size = self.size();
        let patches = self.component.patches();
        let start = |l: &Location| {
            let [u, v] = patches[l.patch as usize].surface.domain();
            let l = Location { patch: l.patch, u: l.u.clamp(u.0, u.1), v: l.v.clamp(v.0, v.1) };
            (l.patch, [u, v], Iterate::new(x, size, (l.u, l.v), self.jet(&l)))
        };
        let (mut patch, mut domain, mut i) = start(hint);
        let mut moves = 0;
        for _ in 0..MAX_STEPS {
            let held = i.held(domain);
            if held != [false; 2] && moves < MAX_MOVES {
                // At a side that the gradient pushes against: go on behind it if that leads down.
                let l = Location { patch, u: i.u, v: i.v };
                if let Some(to) = self.descending_neighbour(&l, &i.r, held) {
                    moves += 1;
                    (patch, domain, i) = start(&to);
                    continue;
                }
            }
            let surface = &patches[patch as usize].surface;
            let points = self.patch_points(patch);
            if i.advance(domain, |u, v| surface.jet(points, u, v)) == Progress::Converged {
                return Some(Location { patch, u: i.u, v: i.v });
            }
        }
        None
    }

    /// A location at the same point behind one of the sides that `l` is held at, from which the distance decreases.
    fn descending_neighbour(&self, l: &Location, r: &Vector3, held: [bool; 2]) -> Option<Location> {
        let [u, v] = self.component.patches()[l.patch as usize].surface.domain();
        let side_u = if l.u <= u.0 { Side::UMin } else { Side::UMax };
        let side_v = if l.v <= v.0 { Side::VMin } else { Side::VMax };
        for (side, _) in [(side_u, held[0]), (side_v, held[1])].into_iter().filter(|(_, held)| *held) {
            let Some(crossing) = self.cross(l, side) else {
                if let Some(to) = self.leave_pole(l, side, r) {
                    return Some(to);
                }
                continue;
            };
            let (_, inward) = crossing.side.along_and_inward(&self.point(&crossing.to));
            if inward.dot(r) < -1e-12 * inward.norm() * (r.norm() + 1e-3 * self.size()) {
                return Some(crossing.to);
            }
        }
        None
    }

    /// If `side` is collapsed: a location close to the pole in the direction of steepest descent, if there is one.
    fn leave_pole(&self, l: &Location, side: Side, r: &Vector3) -> Option<Location> {
        let t = if side.holds_u() { l.v } else { l.u };
        let edge = self.component.piece(l.patch, side, t)?.edge;
        let edge = &self.component.edges()[edge as usize];
        if !edge.collapsed {
            return None;
        }
        let vertex = &self.component.vertices()[edge.vertices[0] as usize];
        let mut best = (-1e-9 * r.norm(), None);
        for incidence in &vertex.incidences {
            let Incidence::Pole { patch, side } = *incidence else { continue };
            let p = &self.component.patches()[patch as usize];
            let domain = p.surface.domain();
            let (low, high) = domain[usize::from(!side.holds_u())];
            let step = if side.is_min() { 1e-6 } else { -1e-6 } * (high - low);
            for t in p.side_samples(side, 4) {
                let at = p.on_side(patch, side, t);
                let (_, inward) = side.along_and_inward(&self.point(&at));
                let slope = inward.dot(r) / inward.norm();
                if slope < best.0 {
                    let (mut u, mut v) = (at.u, at.v);
                    if side.holds_u() {
                        u += step
                    } else {
                        v += step
                    }
                    let to = Location { patch, u, v };
                    let closer =
                        (self.position(&to) - (self.position(l) - r)).norm_squared() < r.norm_squared();
                    if closer {
                        best = (slope, Some(to));
                    }
                }
            }
        }
        best.1
    }

    /// The same point seen from the patch behind a side, if there is one.
    fn cross(&self, l: &Location, side: Side) -> Option<Crossing> {
        let t = if side.holds_u() { l.v } else { l.u };
        let piece = self.component.piece(l.patch, side, t)?;
        let edge = &self.component.edges()[piece.edge as usize];
        let (here, there) = match (&edge.sides[..], piece.index) {
            ([a, b], 0) => (a, b),
            ([a, b], _) => (b, a),
            _ => return None,
        };
        let fraction = ((t - here.range.0) / (here.range.1 - here.range.0)).clamp(0.0, 1.0);
        let patch = &self.component.patches()[there.patch as usize];
        let mut other = there.range.0 + fraction * (there.range.1 - there.range.0);
        let mut slope = (there.range.1 - there.range.0) / (here.range.1 - here.range.0);
        if !edge.affine {
            let range = (there.range.0.min(there.range.1), there.range.0.max(there.range.1));
            other = patch.closest_on_side(&self.control_points, there.side, range, &self.position(l)).0;
            let (before, _) = side.along_and_inward(&self.point(l));
            let (behind, _) =
                there.side.along_and_inward(&self.point(&patch.on_side(there.patch, there.side, other)));
            slope = behind.dot(&before) / behind.norm_squared();
        }
        Some(Crossing {
            edge: piece.edge,
            side: there.side,
            to: patch.on_side(there.patch, there.side, other),
            slope,
        })
    }

    /// Continues a line of one parameter by `delta` (in that parameter), over smooth edges into the neighbouring patches;
    /// it ends at sharp and boundary edges and at poles. Behind an edge the parameter advances at the speed that keeps
    /// the line's speed in space.
    pub fn walk(&self, from: &Location, along: ParameterDirection, delta: f64) -> Location {
        self.follow(from, along, delta, None)
    }

    /// [`walk`](Self::walk) with its derivative. Where the line ends at an edge, its end no longer depends on its length.
    pub fn walk_derivative(&self, from: &Location, along: ParameterDirection, delta: f64) -> Walk {
        let mut d = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        let end = self.follow(from, along, delta, Some(&mut d));
        Walk { end, by_start: d.map(|row| [row[0], row[1]]), by_length: d.map(|row| row[2]) }
    }

    /// The end of a line of one parameter. `derivative` goes along with it: `d(u, v)` by the start's `u`, `v` and by the
    /// length.
    fn follow(
        &self,
        from: &Location,
        along: ParameterDirection,
        delta: f64,
        mut derivative: Option<&mut [[f64; 3]; 2]>,
    ) -> Location {
        let mut l = *from;
        let mut along = along;
        let mut delta = delta;
        let mut d_delta = [0.0, 0.0, 1.0];
        // A closed body could be walked around for ever only by an absurd `delta`.
        for _ in 0..1000 {
            let domain = self.component.patches()[l.patch as usize].surface.domain();
            let moves_u = along == ParameterDirection::U;
            let moving = usize::from(!moves_u);
            let (value, (low, high)) = if moves_u { (l.u, domain[0]) } else { (l.v, domain[1]) };
            let target = value + delta;
            let reached = target.clamp(low, high);
            if moves_u {
                l.u = reached
            } else {
                l.v = reached
            }
            let rest = target - reached;
            let mut d_rest = [0.0; 3];
            if let Some(d) = &mut derivative {
                d_rest = std::array::from_fn(|k| d[moving][k] + d_delta[k]);
                d[moving] = if rest == 0.0 { d_rest } else { [0.0; 3] };
            }
            if rest == 0.0 || !rest.is_finite() {
                return l;
            }
            let side = match (moves_u, rest < 0.0) {
                (true, true) => Side::UMin,
                (true, false) => Side::UMax,
                (false, true) => Side::VMin,
                (false, false) => Side::VMax,
            };
            let Some(crossing) = self.cross(&l, side) else { return l };
            if self.component.edges()[crossing.edge as usize].sharp {
                return l;
            }
            let (_, here) = side.along_and_inward(&self.point(&l));
            let (_, there) = crossing.side.along_and_inward(&self.point(&crossing.to));
            let ratio = here.norm() / there.norm();
            if !ratio.is_finite() {
                return l;
            }
            let inwards = if crossing.side.is_min() { 1.0 } else { -1.0 };
            let holds_u = crossing.side.holds_u();
            if let Some(d) = &mut derivative {
                let held = d[1 - moving];
                let behind = held.map(|x| crossing.slope * x);
                // How fast the speeds across the side change along it.
                let growth_here = here.dot(&side.inward_along(&self.jet(&l))) / here.norm_squared();
                let twist = crossing.side.inward_along(&self.jet(&crossing.to));
                let growth_there = there.dot(&twist) / there.norm_squared();
                d_delta = std::array::from_fn(|k| {
                    let d_ratio = ratio * (growth_here * held[k] - growth_there * behind[k]);
                    inwards * (rest.signum() * ratio * d_rest[k] + rest.abs() * d_ratio)
                });
                **d = if holds_u { [[0.0; 3], behind] } else { [behind, [0.0; 3]] };
            }
            delta = rest.abs() * ratio * inwards;
            along = if holds_u { ParameterDirection::U } else { ParameterDirection::V };
            l = crossing.to;
        }
        l
    }

    /// The foot point along an edge, from a hint; if the hint is not on the edge, from the best of a number of samples.
    ///
    /// # Panics
    /// If there is no such edge.
    pub fn closest_point_on_edge(&self, x: &Vector3, edge: u32, hint: &Location) -> FootPoint {
        let e = &self.component.edges()[edge as usize];
        let on = |s: &&crate::EdgeSide| {
            let [u, v] = self.component.patches()[s.patch as usize].surface.domain();
            let held = if s.side.holds_u() { (hint.u, u) } else { (hint.v, v) };
            let bound = if s.side.is_min() { held.1.0 } else { held.1.1 };
            s.patch == hint.patch && held.0 == bound
        };
        let hinted = e.sides.iter().find(on);
        let s = hinted.unwrap_or(&e.sides[0]);
        let patch = &self.component.patches()[s.patch as usize];
        let range = (s.range.0.min(s.range.1), s.range.0.max(s.range.1));
        let (t, _) = match hinted {
            Some(_) => {
                let start = if s.side.holds_u() { hint.v } else { hint.u };
                newton::on_side(patch, &self.control_points, s.side, range, x, start)
            }
            None => patch.closest_on_side(&self.control_points, s.side, range, x),
        };
        self.foot_point(x, &patch.on_side(s.patch, s.side, t))
    }

    /// What a location is to `x`, if it is its foot point: feature, normal and signed distance.
    pub fn foot_point(&self, x: &Vector3, l: &Location) -> FootPoint {
        let patch = &self.component.patches()[l.patch as usize];
        let [ru, rv] = patch.surface.domain();
        let l = Location { patch: l.patch, u: l.u.clamp(ru.0, ru.1), v: l.v.clamp(rv.0, rv.1) };
        let point = self.point(&l);
        let position = point.position;
        let d = x - position;
        let (feature, sum) = self.feature_and_normal(&l, &point);
        let norm = sum.norm();
        let length = d.norm();
        let (normal, distance) = if norm <= 1e-7 {
            // Opposite normals: an edge without wedge. What is nearest to it is outside.
            let away = if length > 0.0 { d / length } else { self.normal_at(&l, &point) };
            (away, length)
        } else {
            let n = sum / norm;
            let along = n.dot(&d);
            // Close to the surface the normal component is the more accurate one.
            let square_on = length - along.abs() <= 1e-13 * self.size();
            (n, if feature == Feature::Face && square_on { along } else { length.copysign(along) })
        };
        FootPoint { location: l, feature, position, normal, distance }
    }

    /// The feature that a location lies on, and the mean normal there, not normalised.
    fn feature_and_normal(&self, l: &Location, point: &SurfacePoint) -> (Feature, Vector3) {
        let [u, v] = self.component.patches()[l.patch as usize].surface.domain();
        let side_u = (l.u <= u.0).then_some(Side::UMin).or((l.u >= u.1).then_some(Side::UMax));
        let side_v = (l.v <= v.0).then_some(Side::VMin).or((l.v >= v.1).then_some(Side::VMax));
        let (Some(side), other) = (side_u.or(side_v), side_v) else {
            return (Feature::Face, self.normal_at(l, point));
        };
        let t = if side.holds_u() { l.v } else { l.u };
        let Some(piece) = self.component.piece(l.patch, side, t) else {
            return (Feature::Face, self.normal_at(l, point));
        };
        let edge = &self.component.edges()[piece.edge as usize];
        let range = edge.sides[piece.index as usize].range;
        let near = |end: f64| (t - end).abs() <= 1e-12 * (range.1 - range.0).abs();
        let vertex = if edge.collapsed || near(range.0) {
            Some(edge.vertices[0])
        } else if near(range.1) {
            Some(edge.vertices[1])
        } else {
            // The other side of a patch's corner may be the collapsed one.
            other.filter(|o| *o != side).and_then(|o| {
                let t = if o.holds_u() { l.v } else { l.u };
                let e = &self.component.edges()[self.component.piece(l.patch, o, t)?.edge as usize];
                e.collapsed.then_some(e.vertices[0])
            })
        };
        if let Some(vertex) = vertex {
            let feature = match self.component.vertices()[vertex as usize].kind {
                VertexKind::Smooth => Feature::Face,
                VertexKind::OnEdge { edge } => Feature::Edge { edge },
                VertexKind::Corner => Feature::Corner { vertex },
            };
            return (feature, self.vertex_normal(vertex));
        }
        let feature = if edge.sharp { Feature::Edge { edge: piece.edge } } else { Feature::Face };
        let behind = self.cross(l, side).map_or(Vector3::zeros(), |c| self.normal(&c.to));
        (feature, self.normal_at(l, point) + behind)
    }

    /// The angle-weighted mean of the normals around a vertex, divided by the whole angle.
    pub(crate) fn vertex_normal(&self, vertex: u32) -> Vector3 {
        let mut sum = Vector3::zeros();
        let mut whole = 0.0;
        for incidence in &self.component.vertices()[vertex as usize].incidences {
            match *incidence {
                Incidence::Corner { location } => {
                    let p = self.point(&location);
                    let [u, v] = self.component.patches()[location.patch as usize].surface.domain();
                    let du = if location.u == u.0 { p.d_u } else { -p.d_u };
                    let dv = if location.v == v.0 { p.d_v } else { -p.d_v };
                    let angle = du.angle(&dv);
                    sum += self.normal(&location) * angle;
                    whole += angle;
                }
                Incidence::OnSide { location } => {
                    sum += self.normal(&location) * std::f64::consts::PI;
                    whole += std::f64::consts::PI;
                }
                Incidence::Pole { patch, side } => {
                    let p = &self.component.patches()[patch as usize];
                    let mut previous: Option<(Vector3, Vector3)> = None;
                    for t in p.side_samples(side, 8) {
                        let at = p.on_side(patch, side, t);
                        let (_, direction) = side.along_and_inward(&self.point(&at));
                        let normal = self.normal(&at);
                        if direction.norm() == 0.0 {
                            continue;
                        }
                        if let Some((d, n)) = previous {
                            let angle = d.angle(&direction);
                            sum += (n + normal) * (0.5 * angle);
                            whole += angle;
                        }
                        previous = Some((direction, normal));
                    }
                }
            }
        }
        if whole > 0.0 { sum / whole } else { sum }
    }
}
