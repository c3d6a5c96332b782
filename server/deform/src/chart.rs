//! Common surface coordinates over the patches of a component, for departures along its surface.
//!
//! A departure is measured in the parameters of the component's patches. Where patches join, their parameters may be swapped,
//! reversed or scaled against each other; a chart carries each patch's parameters over to those of the first one.
//! Lines of constant parameter then stay what they are: a wing's vertices slide along the span at a constant fraction
//! of the chord.

use moldline_geometry::{Body, EdgeSide, Location, ParameterDirection};
use moldline_mesh::Plane;
use moldline_spline::Vector3;

/// Steps of the search for the departure between two locations.
const UNROLL_STEPS: usize = 60;
/// Relative difference up to which scales along an edge agree.
const SAME_SCALE: f64 = 1e-6;

/// One patch's parameters in terms of the chart's.
#[derive(Clone, Copy, Debug, PartialEq)]
struct PatchMap {
    /// The patch's parameter (0: u, 1: v) that each of the chart's coordinates moves.
    axis: [usize; 2],
    /// How far it moves for one unit of the chart's coordinate.
    scale: [f64; 2],
}

/// Surface coordinates of one component.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    maps: Vec<PatchMap>,
    /// Lengths of the parameter ranges of patches that are closed in themselves, per patch and parameter.
    periods: Vec<[Option<f64>; 2]>,
}

impl Chart {
    /// The chart over the `used` patches of a component in its reference state; `None` if their parameters cannot be brought
    /// to agree (the six faces of a box).
    pub fn new(body: &Body, used: &[bool]) -> Option<Self> {
        let patches = body.component().patches().len();
        let mut maps: Vec<Option<PatchMap>> = vec![None; patches];
        let mut periods = vec![[None; 2]; patches];
        let joins: Vec<(EdgeSide, EdgeSide)> = body
            .component()
            .edges()
            .iter()
            .filter(|e| !e.collapsed)
            .filter_map(|e| match e.sides[..] {
                [a, b] if used[a.patch as usize] && used[b.patch as usize] => Some((a, b)),
                _ => None,
            })
            .collect();
        for first in 0..patches {
            if maps[first].is_some() {
                continue;
            }
            maps[first] = Some(PatchMap { axis: [0, 1], scale: [1.0, 1.0] });
            let mut front = vec![first];
            while let Some(p) = front.pop() {
                let Some(map) = maps[p] else { continue };
                for (a, b) in joins.iter().flat_map(|&(a, b)| [(a, b), (b, a)]) {
                    let q = b.patch as usize;
                    if a.patch as usize == p && maps[q].is_none() {
                        maps[q] = Some(carry(body, map, &a, &b)?.0);
                        front.push(q);
                    }
                }
            }
        }
        let maps: Vec<PatchMap> = maps.into_iter().collect::<Option<_>>()?;
        for (a, b) in &joins {
            let (expected, along) = carry(body, maps[a.patch as usize], a, b)?;
            let found = maps[b.patch as usize];
            let agree = |k: usize| {
                let ratio = found.scale[k] / expected.scale[k];
                let tolerance = if k == along { SAME_SCALE } else { f64::INFINITY };
                found.axis[k] == expected.axis[k] && ratio > 0.0 && (ratio - 1.0).abs() <= tolerance
            };
            if !(agree(0) && agree(1)) {
                return None;
            }
            if a.patch == b.patch && a.side != b.side && a.side.holds_u() == b.side.holds_u() {
                let axis = usize::from(!a.side.holds_u());
                let (low, high) = body.component().patches()[a.patch as usize].surface.domain()[axis];
                periods[a.patch as usize][axis] = Some(high - low);
            }
        }
        Some(Self { maps, periods })
    }

    /// The location a departure away from `from`: first along one coordinate line, then along the other.
    pub fn walk(&self, body: &Body, from: &Location, departure: [f64; 2]) -> Location {
        let mut at = *from;
        for k in 0..2 {
            let map = &self.maps[at.patch as usize];
            at = body.walk(&at, direction(map.axis[k]), map.scale[k] * departure[k]);
        }
        at
    }

    /// The departure that leads from one location to another, or `None` if it is not found.
    pub fn unroll(&self, body: &Body, from: &Location, to: &Location, tolerance: f64) -> Option<[f64; 2]> {
        let map = &self.maps[from.patch as usize];
        let mut departure = [0.0; 2];
        if from.patch == to.patch {
            let difference = [to.u - from.u, to.v - from.v];
            for k in 0..2 {
                let axis = map.axis[k];
                let wrapped = match self.periods[from.patch as usize][axis] {
                    Some(period) => difference[axis] - period * (difference[axis] / period).round(),
                    None => difference[axis],
                };
                departure[k] = wrapped / map.scale[k];
            }
        }
        let goal = body.position(to);
        let misses = |d: [f64; 2]| {
            let at = self.walk(body, from, d);
            (at, goal - body.position(&at))
        };
        let (mut at, mut miss) = misses(departure);
        for _ in 0..UNROLL_STEPS {
            if miss.norm() <= tolerance {
                return Some(departure);
            }
            let point = body.point(&at);
            let (a, b, c) = (point.d_u.norm_squared(), point.d_u.dot(&point.d_v), point.d_v.norm_squared());
            let (f, g) = (point.d_u.dot(&miss), point.d_v.dot(&miss));
            let determinant = a * c - b * b;
            let step = [(c * f - b * g) / determinant, (a * g - b * f) / determinant];
            let map = self.maps[at.patch as usize];
            let mut damping = 1.0;
            loop {
                let mut next = departure;
                for k in 0..2 {
                    next[k] += damping * step[map.axis[k]] / map.scale[k];
                }
                let (next_at, next_miss) = misses(next);
                if next_miss.norm() < miss.norm() {
                    (departure, at, miss) = (next, next_at, next_miss);
                    break;
                }
                damping *= 0.5;
                if damping < 1e-4 || !next_miss.norm().is_finite() {
                    return None;
                }
            }
        }
        None
    }

    /// The part of a departure along a side's parameter: what a vertex on a sharp edge may do.
    pub fn along_edge(&self, location: &Location, side: &EdgeSide, departure: [f64; 2]) -> [f64; 2] {
        let map = &self.maps[location.patch as usize];
        let along = usize::from(side.side.holds_u());
        std::array::from_fn(|k| if map.axis[k] == along { departure[k] } else { 0.0 })
    }

    /// Signs of a departure's mirror image at a plane that the component is symmetric about.
    pub fn mirror_signs(&self, body: &Body, location: &Location, plane: &Plane) -> [f64; 2] {
        let mirrored = |x: Vector3| Vector3::from(plane.mirror(&x.into()));
        let image = body.closest_point(&mirrored(body.position(location))).location;
        let origin = mirrored(Vector3::zeros());
        let tangents = |l: &Location| {
            let point = body.point(l);
            let map = self.maps[l.patch as usize];
            [0, 1].map(|k| if map.axis[k] == 0 { point.d_u } else { point.d_v } * map.scale[k].signum())
        };
        let (here, there) = (tangents(location), tangents(&image));
        [0, 1].map(|k| (mirrored(here[k]) - origin).dot(&there[k]).signum())
    }
}

fn direction(axis: usize) -> ParameterDirection {
    if axis == 0 { ParameterDirection::U } else { ParameterDirection::V }
}

/// The map of the patch behind an edge, and the chart coordinate that runs along the edge.
fn carry(body: &Body, map: PatchMap, here: &EdgeSide, there: &EdgeSide) -> Option<(PatchMap, usize)> {
    let along_here = usize::from(here.side.holds_u());
    let along_there = usize::from(there.side.holds_u());
    let along = usize::from(map.axis[1] == along_here);
    let across = 1 - along;
    let speed = |side: &EdgeSide| {
        let middle = 0.5 * (side.range.0 + side.range.1);
        let patch = &body.component().patches()[side.patch as usize];
        let [u, v] = patch.surface.domain();
        let end = |(low, high): (f64, f64)| if side.side.is_min() { low } else { high };
        let at = if side.side.holds_u() { (end(u), middle) } else { (middle, end(v)) };
        let point = body.point(&Location { patch: side.patch, u: at.0, v: at.1 });
        if side.side.holds_u() { point.d_u.norm() } else { point.d_v.norm() }
    };
    let out_of_here = if here.side.is_min() { -1.0 } else { 1.0 };
    let into_there = if there.side.is_min() { 1.0 } else { -1.0 };
    let mut next = PatchMap { axis: [0; 2], scale: [0.0; 2] };
    next.axis[along] = along_there;
    next.scale[along] = map.scale[along] * (there.range.1 - there.range.0) / (here.range.1 - here.range.0);
    next.axis[across] = 1 - along_there;
    next.scale[across] = map.scale[across] * out_of_here * into_there * speed(here) / speed(there);
    next.scale.iter().all(|s| s.is_finite() && *s != 0.0).then_some((next, along))
}
