//! A bounding hierarchy over the Bezier pieces of a body's patches, which are cut until their tangents turn little.

use crate::bezier::{Net, SIDE, Shape, position};
use crate::bounds::Aabb;
use crate::location::Rectangle;
use crate::patch::Patch;
use moldline_foundation::Vector3;
use moldline_spline::Surface;

/// Leaves are cut until their tangents turn less than this...
const TURNING: f64 = 0.6;
/// ... but at most this often: at poles they turn whatever the size.
const MAX_CUTS: usize = 4;
/// Control points per side of the nets of cubic patches; nets of other patches are much larger.
pub(crate) const SMALL: usize = 4;
/// Entries of the stack of a traversal: the tree is balanced, so its depth is the logarithm of the number of leaves.
const STACK: usize = 64;

/// A Bezier piece of a patch.
#[derive(Debug, Clone)]
pub(crate) struct Leaf {
    pub patch: u32,
    pub rectangle: Rectangle,
    pub shape: Shape,
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
    pub leaves: Vec<Leaf>,
}

impl Hierarchy {
    pub fn new(patches: &[Patch], control_points: &[[f64; 4]]) -> Self {
        let mut leaves = Vec::new();
        let mut boxes = Vec::new();
        for (index, patch) in patches.iter().enumerate() {
            let points = &control_points[patch.range.clone()];
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

    /// The leaf whose middle is nearest, among those whose boxes are not further away than `bound`.
    pub fn nearest_center(&self, x: &Vector3, bound: f64) -> Option<u32> {
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
    pub fn visit(&self, x: &Vector3, mut limit: f64, mut examine: impl FnMut(u32) -> f64) {
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

/// Whether nets of `SMALL` control points a side are enough.
pub(crate) fn is_small(surface: &Surface) -> bool {
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
