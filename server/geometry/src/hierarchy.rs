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
//! So the result is the global minimum up to `TOLERANCE` of the body's size. The exception are points with (nearly) a
//! continuum of nearest points, such as those on the axis of a tube: halving would not end there within reason. After
//! every `PATIENCE` halvings the tolerance doubles; the point returned is an exact local minimum all the same.

use crate::bezier::{Net, SIDE, Shape, position};
use crate::newton::{self, Rectangle};
use crate::{Aabb, Body, Location, Vector3};
use moldline_spline::Surface;

/// Relative to the size of the body.
const TOLERANCE: f64 = 1e-14;
const PATIENCE: usize = 1024;
/// Leaves are cut until their tangents turn less than this...
const TURNING: f64 = 0.6;
/// ... but not more often than this: at poles they turn whatever the size.
const MAX_CUTS: usize = 4;
/// Pieces smaller than this, relative to the body, are not halved any more.
const SMALLEST: f64 = 1e-14;
/// Control points a side of the nets of cubic patches; the others' are much larger.
const SMALL: usize = 4;
/// Entries of the stack of a traversal: the tree is balanced, so its depth is the logarithm of the number of leaves.
const STACK: usize = 64;

#[derive(Debug, Clone)]
struct Leaf {
    patch: u32,
    rectangle: Rectangle,
    shape: Shape,
}

#[derive(Debug, Clone, Copy)]
struct Node {
    bounds: Aabb,
    /// Right child (the left one is next to its parent), or the leaf.
    target: u32,
    is_leaf: bool,
}

#[derive(Debug, Clone)]
pub(crate) struct Hierarchy {
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
}

/// The best point so far of a query.
struct Query<'a> {
    body: &'a Body,
    x: &'a Vector3,
    best: Option<Location>,
    position: Vector3,
    distance: f64,
    size: f64,
    halvings: usize,
}

impl Hierarchy {
    pub fn new(body: &Body) -> Self {
        let mut leaves = Vec::new();
        let mut boxes = Vec::new();
        for (index, patch) in body.component().patches().iter().enumerate() {
            let points = body.patch_points(index as u32);
            let surface = &patch.surface;
            let mut add = |bounds, shape, rectangle| {
                boxes.push(bounds);
                leaves.push(Leaf { patch: index as u32, rectangle, shape });
            };
            for u in surface.knots_u().breaks().windows(2) {
                for v in surface.knots_v().breaks().windows(2) {
                    let rectangle = [(u[0], u[1]), (v[0], v[1])];
                    if is_small(surface) {
                        let net = Net::<SMALL>::new(surface, points, rectangle);
                        cut(&net, rectangle, surface.is_rational(), MAX_CUTS, &mut add);
                    } else {
                        let net = Net::<SIDE>::new(surface, points, rectangle);
                        cut(&net, rectangle, surface.is_rational(), MAX_CUTS, &mut add);
                    }
                }
            }
        }
        let mut order: Vec<u32> = (0..leaves.len() as u32).collect();
        let mut nodes = Vec::with_capacity(2 * leaves.len());
        build(&mut nodes, &mut order, &boxes);
        Self { nodes, leaves }
    }

    /// The nearest location not further away than `bound`.
    pub fn closest(&self, body: &Body, x: &Vector3, bound: f64) -> Option<Location> {
        let mut query =
            Query { body, x, best: None, position: *x, distance: bound, size: body.size(), halvings: 0 };
        let leaf = &self.leaves[self.nearest_center(x, bound)? as usize];
        let [u, v] = leaf.rectangle;
        let center = Location { patch: leaf.patch, u: 0.5 * (u.0 + u.1), v: 0.5 * (v.0 + v.1) };
        query.offer(body.descend(x, &center).unwrap_or(center));
        self.visit(x, query.limit(), |leaf| {
            query.examine(&self.leaves[leaf as usize]);
            query.limit()
        });
        query.best
    }

    /// The leaf whose middle is nearest, among those whose boxes are not further away than `bound`.
    fn nearest_center(&self, x: &Vector3, bound: f64) -> Option<u32> {
        let mut best = (f64::INFINITY, None);
        let limit = bound * bound;
        self.visit(x, limit, |leaf| {
            let d = (self.leaves[leaf as usize].shape.center - x).norm_squared();
            if d < best.0 {
                best = (d, Some(leaf));
            }
            best.0.min(limit)
        });
        best.1
    }

    /// Calls `examine` for the leaves whose boxes are nearer than the square root of `limit`, near ones first by and
    /// large; it returns the new limit.
    #[inline]
    fn visit(&self, x: &Vector3, mut limit: f64, mut examine: impl FnMut(u32) -> f64) {
        let mut stack = [(0u32, 0.0); STACK];
        let mut height = 1;
        stack[0].1 = self.nodes[0].bounds.squared_distance(x);
        while height > 0 {
            height -= 1;
            let (index, squared) = stack[height];
            if squared >= limit {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.is_leaf {
                limit = examine(node.target);
                continue;
            }
            let children = [index + 1, node.target];
            let [a, b] = children.map(|c| (c, self.nodes[c as usize].bounds.squared_distance(x)));
            let (near, far) = if a.1 <= b.1 { (a, b) } else { (b, a) };
            for child in [far, near] {
                if child.1 < limit {
                    stack[height] = child;
                    height += 1;
                }
            }
        }
    }
}

impl Query<'_> {
    fn tolerance(&self) -> f64 {
        TOLERANCE * self.size * f64::exp2((self.halvings / PATIENCE) as f64)
    }

    /// Square of the distance from which on nothing can be closer than what is known.
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

    /// Examines a leaf of which nothing more is proven than that its minimum is in `part`.
    fn refine<const N: usize>(&mut self, leaf: &Leaf, part: Rectangle, net: &Net<N>) {
        if self.is_beyond(net) {
            return;
        }
        if part == leaf.rectangle {
            self.halve(leaf.patch, part, net, &leaf.shape);
        } else {
            self.examine_net(leaf.patch, part, &net.restricted(leaf.rectangle, part));
        }
    }

    fn examine_net<const N: usize>(&mut self, patch: u32, rectangle: Rectangle, net: &Net<N>) {
        if self.is_beyond(net) {
            return;
        }
        let rational = self.body.component().patches()[patch as usize].surface.is_rational();
        let shape = Shape::new(net, rational);
        if shape.squared_distance(self.x) >= self.limit() {
            return;
        }
        match shape.minimum_part(self.x, rectangle) {
            (part, true) => self.minimise_convex(patch, part),
            (part, false) if part == rectangle => self.halve(patch, rectangle, net, &shape),
            (part, false) => self.examine_net(patch, part, &net.restricted(rectangle, part)),
        }
    }

    fn halve<const N: usize>(&mut self, patch: u32, rectangle: Rectangle, net: &Net<N>, shape: &Shape) {
        let [u, v] = rectangle;
        let (middle_u, middle_v) = (0.5 * (u.0 + u.1), 0.5 * (v.0 + v.1));
        if shape.radius <= SMALLEST * self.size {
            return self.minimise(patch, rectangle, (middle_u, middle_v), None);
        }
        self.halvings += 1;
        let along_u = shape.cut_along_u();
        let halves = net.halves(along_u);
        let rectangles = if along_u {
            [[(u.0, middle_u), v], [(middle_u, u.1), v]]
        } else {
            [[u, (v.0, middle_v)], [u, (middle_v, v.1)]]
        };
        // The half that reaches further towards the best direction first: its minimum is likely to dismiss the other.
        let reach = |net: &Net<N>| {
            net.points().map(|h| (position(h) - self.x).norm_squared()).fold(f64::INFINITY, f64::min)
        };
        let order = if reach(&halves[0]) <= reach(&halves[1]) { [0, 1] } else { [1, 0] };
        for k in order {
            self.examine_net(patch, rectangles[k], &halves[k]);
        }
    }
}

/// Whether nets of `SMALL` control points a side are enough.
fn is_small(surface: &Surface) -> bool {
    surface.knots_u().degree().max(surface.knots_v().degree()) < SMALL
}

/// Cuts a piece until its tangents turn little, and passes the parts on.
fn cut<const N: usize>(
    net: &Net<N>,
    rectangle: Rectangle,
    rational: bool,
    cuts: usize,
    add: &mut impl FnMut(Aabb, Shape, Rectangle),
) {
    let shape = Shape::new(net, rational);
    if cuts == 0 || shape.turning() <= TURNING {
        return add(Aabb::around(net.points().map(position)), shape, rectangle);
    }
    let [u, v] = rectangle;
    let along_u = shape.cut_along_u();
    let halves = net.halves(along_u);
    let rectangles = if along_u {
        let middle = 0.5 * (u.0 + u.1);
        [[(u.0, middle), v], [(middle, u.1), v]]
    } else {
        let middle = 0.5 * (v.0 + v.1);
        [[u, (v.0, middle)], [u, (middle, v.1)]]
    };
    for k in 0..2 {
        cut(&halves[k], rectangles[k], rational, cuts - 1, add);
    }
}

/// Appends the tree over the given leaves, halved at the median along the longest extent of their middles.
fn build(nodes: &mut Vec<Node>, order: &mut [u32], boxes: &[Aabb]) {
    let of = |leaf: &u32| &boxes[*leaf as usize];
    let bounds = order.iter().fold(Aabb::empty(), |b, leaf| b.union(of(leaf)));
    let index = nodes.len();
    if let [leaf] = *order {
        nodes.push(Node { bounds, target: leaf, is_leaf: true });
        return;
    }
    nodes.push(Node { bounds, target: 0, is_leaf: false });
    let middles = Aabb::around(order.iter().map(|leaf| of(leaf).center()));
    let axis = (middles.high - middles.low).imax();
    let half = order.len() / 2;
    order.select_nth_unstable_by(half, |a, b| {
        of(a).center()[axis].total_cmp(&of(b).center()[axis]).then(a.cmp(b))
    });
    let (low, high) = order.split_at_mut(half);
    build(nodes, low, boxes);
    nodes[index].target = nodes.len() as u32;
    build(nodes, high, boxes);
}
