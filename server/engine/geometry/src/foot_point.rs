//! Foot points: the feature that a location lies on, the normal there, and the signed distance (eqs. 2 and 5).
//!
//! The sign comes from the surface's normal at the foot point. On an edge or at a vertex it comes from the mean of the
//! adjoining faces' normals weighted by the angles under which the faces meet there; for foot points that mean decides
//! between inside and outside as the normal does on a face (Baerentzen and Aanaes, 2005, whose proof for polyhedra looks
//! at the tangent cone only). At a collapsed side the weighted mean is an integral over the directions that leave it.

use crate::body::Body;
use crate::location::{Location, Side};
use crate::topology::{EdgeSide, Incidence, VertexKind};
use moldline_foundation::Vector3;
use moldline_spline::SurfacePoint;

/// The feature of a component that a foot point lies on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Feature {
    /// Inside a face, or on a smooth edge between patches.
    Face,
    /// On a sharp or boundary edge.
    Edge {
        /// Index in [`Component::edges`](crate::Component::edges).
        edge: u32,
    },
    /// At a pole, or where sharp edges meet at an angle.
    Corner {
        /// Index in [`Component::vertices`](crate::Component::vertices).
        vertex: u32,
    },
}

/// The nearest point of a component to a given point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FootPoint {
    /// Its parameters.
    pub location: Location,
    /// The feature that it lies on.
    pub feature: Feature,
    /// Its position, metres.
    pub position: Vector3,
    /// The outward unit normal of the surface; on edges and at corners the angle-weighted mean of the faces' normals.
    pub normal: Vector3,
    /// Signed distance from it to the given point, metres, negative inside.
    pub distance: f64,
}

impl Body {
    /// The foot point along an edge, from a hint; if the hint is not on the edge, from the best of a number of samples.
    ///
    /// # Panics
    /// If there is no such edge.
    pub fn closest_point_on_edge(&self, x: &Vector3, edge: u32, hint: &Location) -> FootPoint {
        let e = &self.component().edges()[edge as usize];
        let on = |s: &&EdgeSide| {
            let [u, v] = self.component().patches()[s.patch as usize].surface.domain();
            let held = if s.side.holds_u() { (hint.u, u) } else { (hint.v, v) };
            let bound = if s.side.is_min() { held.1.0 } else { held.1.1 };
            s.patch == hint.patch && held.0 == bound
        };
        let hinted = e.sides.iter().find(on);
        let s = hinted.unwrap_or(&e.sides[0]);
        let patch = &self.component().patches()[s.patch as usize];
        let range = (s.range.0.min(s.range.1), s.range.0.max(s.range.1));
        let (t, _) = match hinted {
            Some(_) => {
                let start = if s.side.holds_u() { hint.v } else { hint.u };
                patch.closest_on_side_near(self.control_points(), s.side, range, x, start)
            }
            None => patch.closest_on_side(self.control_points(), s.side, range, x),
        };
        self.foot_point(x, &patch.on_side(s.patch, s.side, t))
    }

    /// The foot point of `x` at a location that is known to be one: feature, normal and signed distance.
    pub fn foot_point(&self, x: &Vector3, l: &Location) -> FootPoint {
        let patch = &self.component().patches()[l.patch as usize];
        let [ru, rv] = patch.surface.domain();
        let l = Location { patch: l.patch, u: l.u.clamp(ru.0, ru.1), v: l.v.clamp(rv.0, rv.1) };
        let point = self.point(&l);
        let position = point.position;
        let d = x - position;
        let (feature, sum) = self.feature_and_normal(&l, &point);
        let norm = sum.norm();
        let length = d.norm();
        let (normal, distance) = if norm <= 1e-7 {
            // Opposite normals: an edge without wedge. Points nearest to it are outside.
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
        let [u, v] = self.component().patches()[l.patch as usize].surface.domain();
        let side_u = (l.u <= u.0).then_some(Side::UMin).or((l.u >= u.1).then_some(Side::UMax));
        let side_v = (l.v <= v.0).then_some(Side::VMin).or((l.v >= v.1).then_some(Side::VMax));
        let (Some(side), other) = (side_u.or(side_v), side_v) else {
            return (Feature::Face, self.normal_at(l, point));
        };
        let t = if side.holds_u() { l.v } else { l.u };
        let Some(piece) = self.component().piece(l.patch, side, t) else {
            return (Feature::Face, self.normal_at(l, point));
        };
        let edge = &self.component().edges()[piece.edge as usize];
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
                let e = &self.component().edges()[self.component().piece(l.patch, o, t)?.edge as usize];
                e.collapsed.then_some(e.vertices[0])
            })
        };
        if let Some(vertex) = vertex {
            let feature = match self.component().vertices()[vertex as usize].kind {
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
        for incidence in &self.component().vertices()[vertex as usize].incidences {
            match *incidence {
                Incidence::Corner { location } => {
                    let p = self.point(&location);
                    let [u, v] = self.component().patches()[location.patch as usize].surface.domain();
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
                    let p = &self.component().patches()[patch as usize];
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
