//! Charts: common surface coordinates over the patches of a component.
//!
//! Coordinates are the parameters of the component's patches. Where patches join, their parameters may be swapped, reversed or
//! scaled against each other; a chart carries each patch's parameters over to those of the first one. Lines of constant
//! parameter then stay what they are: a wing's vertices slide along the span at a constant fraction of the chord.
//!
//! A *departure* is a displacement in these coordinates. [`Chart::walk`] moves a location by a departure, across the edges of
//! patches (the exponential map of the chart); [`Chart::unroll`] is its inverse, the departure between two locations.

use moldline_geometry::{Body, EdgeSide, Location, ParameterDirection};
use moldline_mesh::Plane;
use moldline_spline::Vector3;

/// Steps at most of the search for the departure between two locations.
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
    /// Patches whose parameters cannot be brought to agree with the others' (a wing's tip caps) have no map; departures end at
    /// them.
    maps: Vec<Option<PatchMap>>,
    /// Lengths of the parameter ranges of patches that are closed in themselves, per patch and parameter.
    periods: Vec<[Option<f64>; 2]>,
}

/// Two patches that meet along an edge.
#[derive(Clone, Copy)]
struct Join {
    here: EdgeSide,
    there: EdgeSide,
    smooth: bool,
}

impl Chart {
    /// The chart of a component in its reference state. It covers all `required` patches and as many others as agree; `None`
    /// if the required ones do not (the six faces of a box).
    pub fn new(body: &Body, required: &[bool]) -> Option<Self> {
        let component = body.component();
        let mut joins: Vec<Join> = Vec::new();
        for edge in component.edges().iter().filter(|e| !e.collapsed) {
            if let [here, there] = edge.sides[..] {
                joins.push(Join { here, there, smooth: !edge.sharp });
                joins.push(Join { here: there, there: here, smooth: !edge.sharp });
            }
        }
        let patches = component.patches().len();
        let mut maps: Vec<Option<PatchMap>> = vec![None; patches];
        let mut refused = vec![false; patches];
        let first = required.iter().position(|r| *r)?;
        maps[first] = Some(PatchMap { axis: [0, 1], scale: [1.0, 1.0] });
        // Over smooth edges first: over a sharp one nothing moves, so that it matters less how it is continued.
        loop {
            let next = joins
                .iter()
                .filter(|j| maps[j.here.patch as usize].is_some())
                .filter(|j| maps[j.there.patch as usize].is_none() && !refused[j.there.patch as usize])
                .max_by_key(|j| {
                    (j.smooth, required[j.there.patch as usize], std::cmp::Reverse(j.there.patch))
                });
            let Some(join) = next else { break };
            let patch = join.there.patch as usize;
            let map =
                maps[join.here.patch as usize].and_then(|map| carry(body, map, &join.here, &join.there));
            maps[patch] = map.map(|(map, _)| map);
            let agrees = joins.iter().filter(|j| j.there.patch as usize == patch).all(|j| {
                match (maps[j.here.patch as usize], maps[patch]) {
                    (Some(from), Some(to)) => agree(body, from, to, j),
                    (None, _) => true,
                    _ => false,
                }
            });
            if !agrees {
                maps[patch] = None;
                refused[patch] = true;
            }
        }
        let itself = joins.iter().filter(|j| j.here.patch == j.there.patch);
        let mut periods = vec![[None; 2]; patches];
        for join in itself {
            let patch = join.here.patch as usize;
            if maps[patch].is_some_and(|map| !agree(body, map, map, join)) {
                maps[patch] = None;
            } else if join.here.side != join.there.side {
                let axis = usize::from(!join.here.side.holds_u());
                let (low, high) = component.patches()[patch].surface.domain()[axis];
                periods[patch][axis] = Some(high - low);
            }
        }
        let covered = required.iter().zip(&maps).all(|(required, map)| !required || map.is_some());
        covered.then_some(Self { maps, periods })
    }

    /// The parameter of a patch (0: u, 1: v) that each of the chart's coordinates moves, and how far for one unit of it;
    /// `None` where the patch has no map.
    pub fn map(&self, patch: u32) -> Option<([usize; 2], [f64; 2])> {
        self.maps[patch as usize].map(|map| (map.axis, map.scale))
    }

    /// The location a departure away from `from`: first along one coordinate line, then along the other.
    pub fn walk(&self, body: &Body, from: &Location, departure: [f64; 2]) -> Location {
        let mut at = *from;
        for k in 0..2 {
            let Some(map) = &self.maps[at.patch as usize] else { return at };
            at = body.walk(&at, direction(map.axis[k]), map.scale[k] * departure[k]);
        }
        at
    }

    /// The end of [`walk`](Self::walk) and the derivative of its `(u, v)` with respect to the departure: rows u and v.
    pub fn walk_derivative(
        &self,
        body: &Body,
        from: &Location,
        departure: [f64; 2],
    ) -> (Location, [[f64; 2]; 2]) {
        let mut at = *from;
        let mut d = [[0.0; 2]; 2];
        for k in 0..2 {
            let Some(map) = &self.maps[at.patch as usize] else { break };
            let walk = body.walk_derivative(&at, direction(map.axis[k]), map.scale[k] * departure[k]);
            d = product(&walk.by_start, &d);
            (0..2).for_each(|row| d[row][k] += map.scale[k] * walk.by_length[row]);
            at = walk.end;
        }
        (at, d)
    }

    /// The departure that leads from one location to another, or `None` if Newton's method does not find it within `tolerance`, m.
    pub fn unroll(&self, body: &Body, from: &Location, to: &Location, tolerance: f64) -> Option<[f64; 2]> {
        let map = self.maps[from.patch as usize].as_ref()?;
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
            let map = self.maps[at.patch as usize]?;
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

    /// The derivative of a [`departure`](Self::unroll) from `from` with respect to the `(u, v)` of `to`: rows are coordinates.
    pub fn unroll_derivative(
        &self,
        body: &Body,
        from: &Location,
        to: &Location,
        departure: [f64; 2],
    ) -> [[f64; 2]; 2] {
        let (end, d) = self.walk_derivative(body, from, departure);
        // The end is the same point as `to`, perhaps with the parameters of another patch.
        let (end, to) = (body.point(&end), body.point(to));
        let a: [Vector3; 2] = std::array::from_fn(|k| end.d_u * d[0][k] + end.d_v * d[1][k]);
        let (aa, ab, bb) = (a[0].norm_squared(), a[0].dot(&a[1]), a[1].norm_squared());
        let determinant = aa * bb - ab * ab;
        let dual = [(a[0] * bb - a[1] * ab) / determinant, (a[1] * aa - a[0] * ab) / determinant];
        dual.map(|row| [row.dot(&to.d_u), row.dot(&to.d_v)])
    }

    /// The coordinates of a departure that run along a side: those that a vertex on a sharp edge may move in.
    pub fn along_edge(&self, location: &Location, side: &EdgeSide) -> [bool; 2] {
        let along = usize::from(side.side.holds_u());
        match &self.maps[location.patch as usize] {
            Some(map) => map.axis.map(|axis| axis == along),
            None => [false; 2],
        }
    }

    /// Signs of a departure's mirror image at a plane that the component is symmetric about.
    pub fn mirror_signs(&self, body: &Body, location: &Location, plane: &Plane) -> Option<[f64; 2]> {
        let mirrored = |x: Vector3| Vector3::from(plane.mirror(&x.into()));
        let image = body.closest_point(&mirrored(body.position(location))).location;
        let origin = mirrored(Vector3::zeros());
        let tangents = |l: &Location| {
            let point = body.point(l);
            let map = self.maps[l.patch as usize]?;
            Some([0, 1].map(|k| if map.axis[k] == 0 { point.d_u } else { point.d_v } * map.scale[k].signum()))
        };
        let (here, there) = (tangents(location)?, tangents(&image)?);
        Some([0, 1].map(|k| (mirrored(here[k]) - origin).dot(&there[k]).signum()))
    }
}

/// Product of 2 x 2 matrices.
pub(crate) fn product(a: &[[f64; 2]; 2], b: &[[f64; 2]; 2]) -> [[f64; 2]; 2] {
    std::array::from_fn(|i| std::array::from_fn(|j| a[i][0] * b[0][j] + a[i][1] * b[1][j]))
}

fn direction(axis: usize) -> ParameterDirection {
    if axis == 0 { ParameterDirection::U } else { ParameterDirection::V }
}

/// Whether the maps on both sides of an edge continue each other: the same parameters in the same directions, with the same
/// scale along the edge.
fn agree(body: &Body, from: PatchMap, to: PatchMap, join: &Join) -> bool {
    carry(body, from, &join.here, &join.there).is_some_and(|(expected, along)| {
        (0..2).all(|k| {
            let ratio = to.scale[k] / expected.scale[k];
            to.axis[k] == expected.axis[k] && ratio > 0.0 && (k != along || (ratio - 1.0).abs() <= SAME_SCALE)
        })
    })
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
