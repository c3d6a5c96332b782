//! Components in dual numbers: evaluation, foot points with their signs and normals, lines over patch edges.
//!
//! Discrete decisions (patch, feature, side) are taken from a query of the engine at the values; parameters are found again
//! by Newton steps in dual arithmetic from the converged ones, with the slope of the values. The first step makes the
//! derivatives exact, the second removes the rounding of the first.

use moldline_geometry::{
    Body, Component, Feature, FootPoint, Incidence, Location, ParameterDirection, Patch, Side, VertexKind,
};
use moldline_spline::KnotVector;
use nalgebra::Matrix2;
use num_dual::DualNum;

use crate::{
    dual::{Dual, Real, Vector, constant, length, real},
    spline::{Jet, jet},
};

/// Newton steps in dual arithmetic.
pub const STEPS: usize = 2;
/// Largest sine of the angle between the normal and the line to a foot point that no patch side constrains.
const LEANING: f64 = 1e-6;

/// Parameters on a component.
#[derive(Clone, Copy, Debug)]
pub struct At {
    /// Patch index.
    pub patch: u32,
    /// `u` and `v`.
    pub mu: [Dual; 2],
}

impl At {
    /// Parameters that do not depend on the directions.
    pub fn fixed(location: &Location) -> Self {
        Self { patch: location.patch, mu: [constant(location.u), constant(location.v)] }
    }

    /// Their values.
    pub fn location(&self) -> Location {
        Location { patch: self.patch, u: self.mu[0].re, v: self.mu[1].re }
    }
}

/// A foot point.
#[derive(Clone, Copy, Debug)]
pub struct Foot {
    /// Its parameters.
    pub at: At,
    /// Its position, m.
    pub position: Vector,
    /// The normal that the engine uses there.
    pub normal: Vector,
    /// Signed distance to it, m.
    pub distance: Dual,
}

/// The constraint on a foot point.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Constraint {
    /// Nothing: both parameters are free.
    Free,
    /// A side of its patch: one parameter is free.
    Side(Side),
    /// A corner or a pole.
    Corner,
}

/// A component with dual control points. The values are those of `body`.
pub struct DualBody<'a> {
    /// The component at the values.
    pub body: &'a Body,
    points: Vec<[Dual; 4]>,
}

fn domain(patch: &Patch) -> [(f64, f64); 2] {
    patch.surface.domain()
}

/// The parameter that is constant on a side (0: u, 1: v), and its value.
fn held(patch: &Patch, side: Side) -> (usize, f64) {
    let axis = usize::from(!side.holds_u());
    let (low, high) = domain(patch)[axis];
    (axis, if side.is_min() { low } else { high })
}

fn sides_of(patch: &Patch, l: &Location) -> impl Iterator<Item = Side> + use<> {
    let [u, v] = domain(patch);
    let on = [l.u <= u.0, l.u >= u.1, l.v <= v.0, l.v >= v.1];
    Side::ALL.into_iter().zip(on).filter(|(_, on)| *on).map(|(side, _)| side)
}

/// The edge, and the index among its sides, of the piece of a side at parameter `t`.
fn piece(component: &Component, patch: u32, side: Side, t: f64) -> Option<(u32, usize)> {
    let mut pieces: Vec<(f64, u32, usize)> = Vec::new();
    for (e, edge) in (0u32..).zip(component.edges()) {
        for (k, s) in edge.sides.iter().enumerate().filter(|(_, s)| s.patch == patch && s.side == side) {
            pieces.push((s.range.0.max(s.range.1), e, k));
        }
    }
    pieces.sort_by(|a, b| a.0.total_cmp(&b.0));
    pieces.iter().find(|(high, ..)| t <= *high).or(pieces.last()).map(|&(_, e, k)| (e, k))
}

fn samples(knots: &KnotVector, per_interval: usize) -> Vec<f64> {
    let breaks = knots.breaks();
    let mut all: Vec<f64> = breaks
        .windows(2)
        .flat_map(|w| (0..per_interval).map(move |k| w[0] + (w[1] - w[0]) * k as f64 / per_interval as f64))
        .collect();
    all.extend(breaks.last());
    all
}

fn unit(x: &Vector) -> Vector {
    x / length(x)
}

/// The parts of a side across which a line continues.
struct Crossing {
    side: Side,
    sharp: bool,
    to: At,
}

impl<'a> DualBody<'a> {
    /// A component in its reference state, or in any other state that does not depend on the directions.
    pub fn fixed(body: &'a Body) -> Self {
        Self { body, points: body.control_points().iter().map(|p| p.map(constant)).collect() }
    }

    /// A component with the user's dual control points, of which `body` has the values.
    pub fn new(body: &'a Body, user: &[[Dual; 3]]) -> Self {
        // The map to internal control points is linear: it maps each direction as it maps points.
        let part = |of: &dyn Fn(&Dual) -> f64| {
            let part: Vec<[f64; 3]> = user.iter().map(|p| [of(&p[0]), of(&p[1]), of(&p[2])]).collect();
            body.component().internal_control_points(&part)
        };
        let lanes: Vec<Vec<[f64; 4]>> =
            (0..crate::dual::LANES).map(|k| part(&|x| crate::dual::eps(x, k))).collect();
        let points = body
            .control_points()
            .iter()
            .enumerate()
            .map(|(i, value)| {
                let xyz = [0, 1, 2].map(|d| crate::dual::number(value[d], |k| lanes[k][i][d]));
                [xyz[0], xyz[1], xyz[2], constant(value[3])]
            })
            .collect();
        Self { body, points }
    }

    fn patch(&self, patch: u32) -> &'a Patch {
        &self.body.component().patches()[patch as usize]
    }

    fn jet(&self, at: &At, order: usize) -> Jet<Dual> {
        let patch = self.patch(at.patch);
        jet(&patch.surface, &self.points[patch.range.clone()], at.mu[0], at.mu[1], order)
    }

    /// The same at the values alone.
    fn jet_of_values(&self, at: &At, order: usize) -> Jet<f64> {
        let patch = self.patch(at.patch);
        let points = &self.body.control_points()[patch.range.clone()];
        jet(&patch.surface, points, at.mu[0].re, at.mu[1].re, order)
    }

    /// Position.
    pub fn position(&self, at: &At) -> Vector {
        self.jet(at, 0).position
    }

    /// Position and first derivatives.
    pub fn point(&self, at: &At) -> (Vector, [Vector; 2]) {
        let jet = self.jet(at, 1);
        (jet.position, jet.first)
    }

    /// The outward unit normal; on a collapsed side its limit from inside the patch.
    pub fn normal(&self, at: &At) -> Vector {
        let patch = self.patch(at.patch);
        let [(u0, u1), (v0, v1)] = domain(patch);
        let ranges = [u1 - u0, v1 - v0];
        let [d_u, d_v] = self.jet(at, 1).first;
        let outward = |n: Vector| if patch.flipped { -n } else { n };
        if let Some(n) = across(&d_u, &d_v, ranges) {
            return outward(n);
        }
        // Where a derivative vanishes along a side, it grows with the mixed one.
        let mixed = self.jet(at, 2).second[1];
        let l = at.location();
        let inwards =
            |t: f64, low: f64, high: f64| if t < 0.5 * (low + high) { high - low } else { low - high };
        let limits = [
            (d_u * constant(ranges[0]), mixed * constant(inwards(l.u, u0, u1) * ranges[1])),
            (mixed * constant(inwards(l.v, v0, v1) * ranges[0]), d_v * constant(ranges[1])),
        ];
        let at_side = [l.u == u0 || l.u == u1, l.v == v0 || l.v == v1];
        let limit =
            limits.iter().zip(at_side).filter(|(_, at)| *at).find_map(|((a, b), _)| across(a, b, [1.0; 2]));
        limit.map_or_else(Vector::zeros, outward)
    }

    /// The constraint on the foot point of a vector `x - y = d` at a location.
    fn constraint(&self, l: &Location, feature: Feature, d: &Real) -> Constraint {
        let patch = self.patch(l.patch);
        match feature {
            Feature::Corner { .. } => return Constraint::Corner,
            Feature::Edge { edge } => {
                let component = self.body.component();
                let side = sides_of(patch, l).find(|&side| {
                    let t = if side.holds_u() { l.v } else { l.u };
                    let on = |s: &moldline_geometry::EdgeSide| {
                        let (low, high) = (s.range.0.min(s.range.1), s.range.0.max(s.range.1));
                        s.patch == l.patch && s.side == side && t >= low && t <= high
                    };
                    component.edges()[edge as usize].sides.iter().any(on)
                });
                let any = || {
                    sides_of(patch, l).find(|&side| {
                        let t = if side.holds_u() { l.v } else { l.u };
                        piece(component, l.patch, side, t)
                            .is_some_and(|(e, _)| component.edges()[e as usize].sharp)
                    })
                };
                return side.or_else(any).map_or(Constraint::Corner, Constraint::Side);
            }
            Feature::Face => {}
        }
        // A smooth edge with a slight kink constrains foot points as a sharp one does.
        let first = self.jet_of_values(&At::fixed(l), 1).first;
        let leaning = sides_of(patch, l).find(|&side| {
            let (axis, _) = held(patch, side);
            let (along, slope) = (first[axis].norm() * d.norm(), first[axis].dot(d));
            d.norm() > 1e-12 * self.body.size() && slope.abs() > LEANING * along
        });
        leaning.map_or(Constraint::Free, Constraint::Side)
    }

    /// Newton steps from a converged foot point of `x`.
    fn converge(&self, x: &Vector, start: &Location, constraint: Constraint) -> At {
        let mut at = At::fixed(start);
        for _ in 0..STEPS {
            let j = self.jet_of_values(&at, 2);
            let r = j.position - real(x);
            let hessian = Matrix2::new(
                j.first[0].dot(&j.first[0]) + r.dot(&j.second[0]),
                j.first[0].dot(&j.first[1]) + r.dot(&j.second[1]),
                j.first[0].dot(&j.first[1]) + r.dot(&j.second[1]),
                j.first[1].dot(&j.first[1]) + r.dot(&j.second[2]),
            );
            let (position, first) = self.point(&at);
            let r = position - x;
            let gradient = [first[0].dot(&r), first[1].dot(&r)];
            match constraint {
                Constraint::Corner => break,
                Constraint::Side(side) => {
                    let free = usize::from(side.holds_u());
                    at.mu[free] -= gradient[free] / hessian[(free, free)];
                }
                Constraint::Free => {
                    let step = solve(&hessian, &gradient);
                    at.mu[0] -= step[0];
                    at.mu[1] -= step[1];
                }
            }
        }
        at
    }

    /// A foot point of `x` that the engine found at the values.
    pub fn foot(&self, x: &Vector, found: &FootPoint) -> Foot {
        let d = real(x) - found.position;
        let constraint = self.constraint(&found.location, found.feature, &d);
        let at = self.converge(x, &found.location, constraint);
        let position = self.position(&at);
        let d = x - position;
        let sum = self.normal_of_feature(&at, &found.location, found.feature);
        let (norm, gap) = (real(&sum).norm(), real(&d).norm());
        if norm <= 1e-7 {
            // Opposite normals: points nearest to the edge are outside.
            let normal = if gap > 0.0 { unit(&d) } else { self.normal(&at) };
            let distance = if gap > 0.0 { length(&d) } else { constant(0.0) };
            return Foot { at, position, normal, distance };
        }
        let normal = unit(&sum);
        let along = normal.dot(&d);
        let square_on = gap - along.re.abs() <= 1e-13 * self.body.size();
        let distance = if square_on && (found.feature == Feature::Face || gap <= 1e-12 * self.body.size()) {
            along
        } else {
            let length = length(&d);
            if along.re < 0.0 { -length } else { length }
        };
        // Beside an edge or a corner the gradient points away from it.
        let beside = found.feature != Feature::Face && distance.re.abs() > 1e-12 * self.body.size();
        let normal = if beside { d / distance } else { normal };
        Foot { at, position, normal, distance }
    }

    /// The foot point that the engine's local search leads to, or its global one.
    pub fn foot_near(&self, x: &Vector, hint: &Location) -> Foot {
        let value = real(x);
        let found = self.body.closest_point_near(&value, hint);
        self.foot(x, &found.unwrap_or_else(|| self.body.closest_point(&value)))
    }

    /// The foot point of the global search.
    pub fn nearest(&self, x: &Vector) -> Foot {
        self.foot(x, &self.body.closest_point(&real(x)))
    }

    /// The foot point along an edge.
    pub fn foot_on_edge(&self, x: &Vector, edge: u32, hint: &Location) -> Foot {
        let found = self.body.closest_point_on_edge(&real(x), edge, hint);
        let l = found.location;
        let patch = self.patch(l.patch);
        let sides = &self.body.component().edges()[edge as usize].sides;
        let side =
            sides_of(patch, &l).find_map(|side| sides.iter().find(|s| s.patch == l.patch && s.side == side));
        let constraint = match side {
            None => Constraint::Corner,
            Some(side) => {
                // At the end of the edge, and pushed beyond it.
                let free = usize::from(side.side.holds_u());
                let t = [l.u, l.v][free];
                let tangent = self.jet_of_values(&At::fixed(&l), 1).first[free];
                let d = real(x) - found.position;
                let end = t == side.range.0 || t == side.range.1;
                let pushed = tangent.dot(&d).abs() > LEANING * tangent.norm() * d.norm();
                if end && pushed && d.norm() > 1e-12 * self.body.size() {
                    Constraint::Corner
                } else {
                    Constraint::Side(side.side)
                }
            }
        };
        let at = self.converge(x, &l, constraint);
        let position = self.position(&at);
        Foot { at, position, normal: Vector::zeros(), distance: constant(f64::NAN) }
    }

    /// The sum of the normals of the faces at a foot point, weighted as in the engine. `at` is the foot point, which at the values
    /// is at `l`, and may lie on the sides of that patch.
    fn normal_of_feature(&self, at: &At, l: &Location, feature: Feature) -> Vector {
        let component = self.body.component();
        let patch = self.patch(l.patch);
        let sides: Vec<Side> = sides_of(patch, l).collect();
        let along = |side: Side| if side.holds_u() { l.v } else { l.u };
        let on = |side: Side| piece(component, l.patch, side, along(side)).map(|(e, k)| (side, e, k));
        let Some((side, e, k)) = sides.first().and_then(|&s| on(s)) else { return self.normal(at) };
        let edge = &component.edges()[e as usize];
        let range = edge.sides[k].range;
        let near = |end: f64| (along(side) - end).abs() <= 1e-12 * (range.1 - range.0).abs();
        let vertex = if edge.collapsed || near(range.0) {
            Some(edge.vertices[0])
        } else if near(range.1) {
            Some(edge.vertices[1])
        } else {
            let other = sides.get(1).and_then(|&s| on(s)).map(|(_, e, _)| &component.edges()[e as usize]);
            other.filter(|e| e.collapsed).map(|e| e.vertices[0])
        };
        if let Some(vertex) = vertex {
            let smooth = component.vertices()[vertex as usize].kind == VertexKind::Smooth;
            // At an ordinary point of a face any of the patches has the normal and its derivatives.
            let ordinary = smooth && feature == Feature::Face && !edge.collapsed;
            return if ordinary { self.normal(at) } else { self.vertex_normal(vertex) };
        }
        let (axis, bound) = held(patch, side);
        let beyond = at.mu[axis] - bound;
        let mut here = *at;
        if feature != Feature::Face {
            here.mu[axis] = constant(bound);
        }
        let behind = self.cross(&here, side, beyond);
        behind.map_or(self.normal(&here), |c| self.normal(&here) + self.normal(&c.to))
    }

    fn vertex_normal(&self, vertex: u32) -> Vector {
        let (mut sum, mut whole) = (Vector::zeros(), constant(0.0));
        for incidence in self.body.component().vertices()[vertex as usize].incidences() {
            match *incidence {
                Incidence::Corner { location } => {
                    let at = At::fixed(&location);
                    let [d_u, d_v] = self.point(&at).1;
                    let [u, v] = domain(self.patch(location.patch));
                    let du = if location.u == u.0 { d_u } else { -d_u };
                    let dv = if location.v == v.0 { d_v } else { -d_v };
                    let angle = angle(&du, &dv);
                    sum += self.normal(&at) * angle;
                    whole += angle;
                }
                Incidence::OnSide { location } => {
                    sum += self.normal(&At::fixed(&location)) * constant(std::f64::consts::PI);
                    whole += constant(std::f64::consts::PI);
                }
                Incidence::Pole { patch, side } => {
                    let p = self.patch(patch);
                    let knots = if side.holds_u() { p.surface.knots_v() } else { p.surface.knots_u() };
                    let (axis, bound) = held(p, side);
                    let mut previous: Option<(Vector, Vector)> = None;
                    for t in samples(knots, 8) {
                        let mut mu = [constant(t); 2];
                        mu[axis] = constant(bound);
                        let at = At { patch, mu };
                        let across = self.point(&at).1[axis];
                        let direction = if side.is_min() { across } else { -across };
                        let normal = self.normal(&at);
                        if real(&direction).norm() == 0.0 {
                            continue;
                        }
                        if let Some((d, n)) = previous {
                            let angle = angle(&d, &direction);
                            sum += (n + normal) * (angle * 0.5);
                            whole += angle;
                        }
                        previous = Some((direction, normal));
                    }
                }
            }
        }
        if whole.re > 0.0 { sum / whole } else { sum }
    }

    /// The point `at`, on a side of its patch, seen from the patch behind it, and `beyond` further across (in the parameter
    /// of this patch; its value must be past the side).
    fn cross(&self, at: &At, side: Side, beyond: Dual) -> Option<Crossing> {
        let component = self.body.component();
        let patch = self.patch(at.patch);
        let (axis, bound) = held(patch, side);
        let t = at.mu[1 - axis];
        let (e, k) = piece(component, at.patch, side, t.re)?;
        let edge = &component.edges()[e as usize];
        let [here, there] = match (&edge.sides[..], k) {
            ([a, b], 0) => [a, b],
            ([a, b], _) => [b, a],
            _ => return None,
        };
        let mut on_side = *at;
        on_side.mu[axis] = constant(bound);
        let behind = self.patch(there.patch);
        let (to_axis, to_bound) = held(behind, there.side);
        let fraction = (t - here.range.0) / (here.range.1 - here.range.0);
        let inside = constant(fraction.re.clamp(0.0, 1.0));
        let fraction = if (0.0..=1.0).contains(&fraction.re) { fraction } else { inside };
        let mut along = fraction * (there.range.1 - there.range.0) + there.range.0;
        if !edge.is_affine() {
            let start =
                self.nearest_on_side(there.patch, there.side, there.range, &real(&self.position(&on_side)));
            along = self.along_side(there.patch, there.side, start, &self.position(&on_side));
        }
        let mut mu = [along; 2];
        mu[to_axis] = constant(to_bound);
        let mut to = At { patch: there.patch, mu };
        let speed = |at: &At, axis: usize| length(&self.point(at).1[axis]);
        // Lines keep their speed in space across an edge.
        let ratio = speed(&on_side, axis) / speed(&to, to_axis);
        if ratio.re.is_finite() {
            let outwards = if side.is_min() { -beyond } else { beyond };
            let rest = outwards * ratio;
            to.mu[to_axis] += if there.side.is_min() { rest } else { -rest };
        }
        Some(Crossing { side: there.side, sharp: edge.sharp || !ratio.re.is_finite(), to })
    }

    /// The parameter of the point of a side nearest to `x`, at the values.
    fn nearest_on_side(&self, patch: u32, side: Side, range: (f64, f64), x: &Real) -> f64 {
        let p = self.patch(patch);
        let (axis, bound) = held(p, side);
        let (low, high) = (range.0.min(range.1), range.0.max(range.1));
        let at = |t: f64| {
            let mut mu = [constant(t); 2];
            mu[axis] = constant(bound);
            self.jet_of_values(&At { patch, mu }, 2)
        };
        let distance = |t: &f64| (at(*t).position - x).norm();
        let knots = if side.holds_u() { p.surface.knots_v() } else { p.surface.knots_u() };
        let inside = samples(knots, 16).into_iter().filter(|t| *t > low && *t < high);
        let start = inside.chain([low, high]).min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let mut t = start.unwrap_or(low);
        for _ in 0..50 {
            let j = at(t);
            let (d, dd) = (j.first[1 - axis], if axis == 0 { j.second[2] } else { j.second[0] });
            let r = j.position - x;
            let slope = d.norm_squared() + dd.dot(&r);
            let next = (t - d.dot(&r) / if slope > 0.0 { slope } else { d.norm_squared() }).clamp(low, high);
            if next == t {
                break;
            }
            t = next;
        }
        t
    }

    /// The parameter in dual numbers, from the converged value.
    fn along_side(&self, patch: u32, side: Side, start: f64, x: &Vector) -> Dual {
        let (axis, bound) = held(self.patch(patch), side);
        let mut mu = [constant(start); 2];
        mu[axis] = constant(bound);
        self.converge(x, &At { patch, mu }.location(), Constraint::Side(side)).mu[1 - axis]
    }

    /// Continues a line of one parameter by `delta` across smooth edges, as the engine does.
    pub fn walk(&self, from: &At, along: ParameterDirection, delta: Dual) -> At {
        let mut at = *from;
        let mut axis = usize::from(along == ParameterDirection::V);
        let mut delta = delta;
        for _ in 0..1000 {
            let (low, high) = domain(self.patch(at.patch))[axis];
            let target = at.mu[axis] + delta;
            let reached = target.re.clamp(low, high);
            let beyond = target - reached;
            if beyond.re == 0.0 || !beyond.re.is_finite() {
                at.mu[axis] = target;
                return at;
            }
            at.mu[axis] = constant(reached);
            let side = match (axis == 0, beyond.re < 0.0) {
                (true, true) => Side::UMin,
                (true, false) => Side::UMax,
                (false, true) => Side::VMin,
                (false, false) => Side::VMax,
            };
            let Some(crossing) = self.cross(&at, side, beyond) else { return at };
            if crossing.sharp {
                return at;
            }
            let (to_axis, to_bound) = held(self.patch(crossing.to.patch), crossing.side);
            delta = crossing.to.mu[to_axis] - to_bound;
            axis = to_axis;
            at = crossing.to;
            at.mu[axis] = constant(to_bound);
        }
        at
    }

    /// Moves both parameters by `step`, one after the other.
    pub fn walk_both(&self, from: &At, step: [Dual; 2]) -> At {
        let at = self.walk(from, ParameterDirection::U, step[0]);
        self.walk(&at, ParameterDirection::V, step[1])
    }
}

/// `H^-1 g` for a matrix of values.
pub fn solve(hessian: &Matrix2<f64>, gradient: &[Dual; 2]) -> [Dual; 2] {
    let inverse = hessian.try_inverse().unwrap_or_else(|| Matrix2::from_element(f64::NAN));
    [0, 1].map(|a| gradient[0] * inverse[(a, 0)] + gradient[1] * inverse[(a, 1)])
}

/// The unit vector along `a x b`, unless their directions are lost in rounding.
fn across(a: &Vector, b: &Vector, scales: [f64; 2]) -> Option<Vector> {
    let (a, b) = (a * constant(scales[0]), b * constant(scales[1]));
    let n = a.cross(&b);
    let (la, lb, ln) = (real(&a).norm(), real(&b).norm(), real(&n).norm());
    (la.min(lb) > 1e-9 * la.max(lb) && ln > 1e-9 * la * lb).then(|| unit(&n))
}

fn angle(a: &Vector, b: &Vector) -> Dual {
    DualNum::acos(&(a.dot(b) / (length(a) * length(b))))
}
