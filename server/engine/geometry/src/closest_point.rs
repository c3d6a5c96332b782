//! The global minimum of the distance to a body, by branch and bound over a tree of boxes.
//!
//! Leaves are Bezier pieces of patches, cut until their tangents turn little. A query starts with the local minimum below
//! the leaf whose middle is nearest; that is an upper bound. Then every piece is dismissed by one of these proofs, or
//! improves the bound:
//! - its box is further away than the bound (axis-aligned boxes in the tree, oriented ones at the leaves);
//! - its control points lie beyond the plane through the best point across the line of sight;
//! - the distance falls towards one of its sides all over it, so that only that side need be looked at;
//! - the squared distance is convex over it, so that a local minimisation, broken off as soon as the tangent plane of the
//!   squared distance exceeds the bound, is a global one;
//! - none of these: it is halved, and the halves are examined in turn.
//!
//! So the result is the global minimum up to `TOLERANCE` of the body's size, or the rounding of its coordinates if that is
//! larger. The exception is points with (nearly) a continuum of nearest points, such as those on the axis of a tube, where
//! halving would take too long. After every `PATIENCE` halvings the tolerance doubles; the point returned is still an exact
//! local minimum.
//!
//! The search ends whatever the numbers: pieces wait on a stack of its own, those whose parameters or coordinates cannot be
//! halved in floating point are halved no more, and neither is anything after `MAX_HALVINGS`.

use crate::bezier::{Net, SIDE, Shape, position};
use crate::body::Body;
use crate::foot_point::FootPoint;
use crate::hierarchy::{Leaf, SMALL, is_small};
use crate::location::{Location, Rectangle};
use crate::newton;
use moldline_foundation::Vector3;

/// Tolerance of the minimum, relative to the size of the body.
const TOLERANCE: f64 = 1e-14;
/// Halvings after which the tolerance doubles.
const PATIENCE: usize = 1024;
/// Pieces smaller than this, relative to the body, are not halved any more...
const SMALLEST: f64 = 1e-14;
/// ... nor those smaller than this, relative to their coordinates: in rounding they cannot become smaller.
const ROUNDING: f64 = 8.0 * f64::EPSILON;
/// A piece is halved this often: far more than it takes to be smaller than `SMALLEST` by bisection in both directions.
const DEPTH: u32 = 256;
/// A query halves this often. The tolerance then exceeds the size of the body, so that there is nothing left to find.
const MAX_HALVINGS: usize = 64 * PATIENCE;

/// The best point so far of a query.
struct Query<'a> {
    body: &'a Body,
    x: &'a Vector3,
    best: Option<Location>,
    position: Vector3,
    distance: f64,
    size: f64,
    /// Tolerance of the distance before any halving, metres.
    tolerance: f64,
    halvings: usize,
}

/// A part of a patch that waits for its examination.
struct Part<const N: usize> {
    rectangle: Rectangle,
    net: Net<N>,
    /// Halvings that made it.
    depth: u32,
}

impl Body {
    /// The nearest point of the whole component: the global minimum of the distance, by branch and bound.
    pub fn closest_point(&self, x: &Vector3) -> FootPoint {
        let nearest = self.nearest(x, f64::INFINITY);
        // Without a bound there is always one; a point that is not finite gets an arbitrary one.
        let location = nearest.unwrap_or(Location { patch: 0, u: f64::NEG_INFINITY, v: f64::NEG_INFINITY });
        self.foot_point(x, &location)
    }

    /// The nearest point of the whole component, unless everything is further away than `upper_bound` metres.
    pub fn closest_point_within(&self, x: &Vector3, upper_bound: f64) -> Option<FootPoint> {
        if self.bounds().squared_distance(x) > upper_bound * upper_bound {
            return None;
        }
        let location = self.nearest(x, upper_bound)?;
        let foot = self.foot_point(x, &location);
        (foot.distance.abs() <= upper_bound).then_some(foot)
    }

    /// Signed distance, metres, negative inside.
    pub fn signed_distance(&self, x: &Vector3) -> f64 {
        self.closest_point(x).distance
    }

    /// The nearest location not further away than `bound`.
    fn nearest(&self, x: &Vector3, bound: f64) -> Option<Location> {
        let hierarchy = self.hierarchy();
        let size = self.size();
        let mut query = Query {
            body: self,
            x,
            best: None,
            position: *x,
            distance: bound,
            size,
            tolerance: (TOLERANCE * size).max(f64::EPSILON * self.bounds().reach().max(x.amax())),
            halvings: 0,
        };
        let leaf = &hierarchy.leaves[hierarchy.nearest_center(x, bound)? as usize];
        let [u, v] = leaf.rectangle;
        let center = Location { patch: leaf.patch, u: 0.5 * (u.0 + u.1), v: 0.5 * (v.0 + v.1) };
        query.offer(self.descend(x, &center).unwrap_or(center));
        hierarchy.visit(x, query.limit(), |leaf| {
            query.examine(&hierarchy.leaves[leaf as usize]);
            query.limit()
        });
        query.best
    }
}

impl Query<'_> {
    fn tolerance(&self) -> f64 {
        self.tolerance * f64::exp2((self.halvings / PATIENCE) as f64)
    }

    /// Square of the distance at and beyond which a piece cannot improve on the best point.
    fn limit(&self) -> f64 {
        let d = (self.distance - self.tolerance()).max(0.0);
        d * d
    }

    fn offer(&mut self, l: Location) {
        let position = self.body.position(&l);
        let distance = (position - self.x).norm();
        if distance < self.distance || (self.best.is_none() && distance <= self.distance) {
            (self.best, self.position, self.distance) = (Some(l), position, distance);
        }
    }

    fn examine(&mut self, leaf: &Leaf) {
        if leaf.shape.squared_distance(self.x) >= self.limit() {
            return;
        }
        let (part, convex) = leaf.shape.minimum_part(self.x, leaf.rectangle);
        if convex {
            return self.minimise_convex(leaf.patch, part);
        }
        let surface = &self.body.component().patches()[leaf.patch as usize].surface;
        let points = self.body.patch_points(leaf.patch);
        if is_small(surface) {
            self.refine(leaf, part, &Net::<SMALL>::new(surface, points, leaf.rectangle));
        } else {
            self.refine(leaf, part, &Net::<SIDE>::new(surface, points, leaf.rectangle));
        }
    }

    /// The rectangle's minimum, if it is below the limit; the squared distance is convex over it.
    fn minimise_convex(&mut self, patch: u32, rectangle: Rectangle) {
        let [u, v] = rectangle;
        let start = match self.best {
            Some(l) if l.patch == patch => (l.u.clamp(u.0, u.1), l.v.clamp(v.0, v.1)),
            _ => (0.5 * (u.0 + u.1), 0.5 * (v.0 + v.1)),
        };
        let limit = self.limit();
        self.minimise(patch, rectangle, start, Some(limit));
    }

    fn minimise(&mut self, patch: u32, rectangle: Rectangle, start: (f64, f64), limit: Option<f64>) {
        let surface = &self.body.component().patches()[patch as usize].surface;
        let points = self.body.patch_points(patch);
        if let Some((u, v)) =
            newton::in_rectangle(surface, points, self.x, rectangle, start, self.size, limit)
        {
            self.offer(Location { patch, u, v });
        }
    }

    /// Whether everything is beyond the plane through the best point across the line of sight.
    fn is_beyond<const N: usize>(&self, net: &Net<N>) -> bool {
        let sight = (self.position - self.x) / self.distance;
        let limit = self.limit().sqrt();
        self.best.is_some() && net.points().all(|h| (position(h) - self.x).dot(&sight) >= limit)
    }

    /// Examines a leaf that is only known to have its minimum in `part`.
    fn refine<const N: usize>(&mut self, leaf: &Leaf, part: Rectangle, net: &Net<N>) {
        if self.is_beyond(net) {
            return;
        }
        // At most `DEPTH + 1` parts: each halving replaces one by two that are one deeper.
        let mut waiting = Vec::new();
        if part == leaf.rectangle {
            self.halve(leaf.patch, &Part { rectangle: part, net: *net, depth: 0 }, &leaf.shape, &mut waiting);
        } else {
            let net = net.restricted(leaf.rectangle, part);
            waiting.push(Part { rectangle: part, net, depth: 0 });
        }
        let rational = self.body.component().patches()[leaf.patch as usize].surface.is_rational();
        while let Some(part) = waiting.pop() {
            self.examine_part(leaf.patch, part, rational, &mut waiting);
        }
    }

    fn examine_part<const N: usize>(
        &mut self,
        patch: u32,
        mut part: Part<N>,
        rational: bool,
        waiting: &mut Vec<Part<N>>,
    ) {
        // A restriction takes one extent away, so that there are at most two of them.
        loop {
            if self.is_beyond(&part.net) {
                return;
            }
            let shape = Shape::new(&part.net, rational);
            if shape.squared_distance(self.x) >= self.limit() {
                return;
            }
            match shape.minimum_part(self.x, part.rectangle) {
                (rectangle, true) => return self.minimise_convex(patch, rectangle),
                (rectangle, false) if rectangle == part.rectangle => {
                    return self.halve(patch, &part, &shape, waiting);
                }
                (rectangle, false) => {
                    part.net = part.net.restricted(part.rectangle, rectangle);
                    part.rectangle = rectangle;
                }
            }
        }
    }

    /// Halves a part, unless it is too small for that: then its minimum is taken.
    fn halve<const N: usize>(
        &mut self,
        patch: u32,
        part: &Part<N>,
        shape: &Shape,
        waiting: &mut Vec<Part<N>>,
    ) {
        let [u, v] = part.rectangle;
        let (middle_u, middle_v) = (0.5 * (u.0 + u.1), 0.5 * (v.0 + v.1));
        let along_u = shape.cut_along_u();
        let (middle, (low, high)) = if along_u { (middle_u, u) } else { (middle_v, v) };
        let smallest = (SMALLEST * self.size).max(ROUNDING * shape.center.amax());
        let divisible = low < middle && middle < high && part.depth < DEPTH;
        if shape.radius <= smallest || !divisible || self.halvings >= MAX_HALVINGS {
            return self.minimise(patch, part.rectangle, (middle_u, middle_v), None);
        }
        self.halvings += 1;
        let halves = part.net.halves(along_u);
        let rectangles = if along_u {
            [[(u.0, middle_u), v], [(middle_u, u.1), v]]
        } else {
            [[u, (v.0, middle_v)], [u, (middle_v, v.1)]]
        };
        // The half that reaches further towards the best direction first: its minimum is likely to dismiss the other.
        let reach = |net: &Net<N>| {
            net.points().map(|h| (position(h) - self.x).norm_squared()).fold(f64::INFINITY, f64::min)
        };
        let first = usize::from(reach(&halves[0]) > reach(&halves[1]));
        for k in [1 - first, first] {
            waiting.push(Part { rectangle: rectangles[k], net: halves[k], depth: part.depth + 1 });
        }
    }
}
