//! Cells that pass through each other: where a surface crosses itself or another one.
//!
//! A hierarchy of boxes over the cells finds the pairs that come near ([`Crossings::find`]); whether they meet is decided exactly ([`exact`]). A
//! quadrilateral is two triangles whichever way it is cut, and two cells cross if they meet for every way of cutting them: so a warped cell
//! beside a thin edge gives no false alarm. Cells that share corners cross if they meet elsewhere. Touching counts as crossing, so that surfaces
//! that coincide are found.

mod exact;

use rayon::prelude::*;

use crate::{Cell, SurfaceMesh, Vector3};
use exact::{Corner, triangles_meet};

/// Cells of a leaf at most.
const LEAF: usize = 4;
/// Pairs of nodes from which on they are divided among threads.
const TASKS: usize = 128;
/// Part of a cell's size by which neighbours must be apart for a quick answer.
const APART: f64 = 1e-9;

/// A box: lowest and highest coordinates.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    low: [f64; 3],
    high: [f64; 3],
}

impl Bounds {
    const NONE: Self = Self { low: [f64::INFINITY; 3], high: [f64::NEG_INFINITY; 3] };

    fn of(cell: &Cell, vertices: &[[f64; 3]]) -> Self {
        let mut around = Self::NONE;
        for vertex in cell.vertices() {
            around.add(&vertices[*vertex as usize], &vertices[*vertex as usize]);
        }
        around
    }

    fn add(&mut self, low: &[f64; 3], high: &[f64; 3]) {
        for axis in 0..3 {
            self.low[axis] = self.low[axis].min(low[axis]);
            self.high[axis] = self.high[axis].max(high[axis]);
        }
    }

    fn meets(&self, other: &Self) -> bool {
        (0..3).all(|axis| self.low[axis] <= other.high[axis] && self.high[axis] >= other.low[axis])
    }
}

/// A node of the hierarchy: a range of cells in its order, and its children.
#[derive(Clone, Copy, Debug)]
struct Node {
    first: u32,
    last: u32,
    /// The first child; the second follows it. None for a leaf.
    child: Option<u32>,
}

/// A mesh whose vertices have moved: boxes of the nodes, and of the cells in the hierarchy's order.
struct Moved<'a> {
    vertices: &'a [[f64; 3]],
    nodes: Vec<Bounds>,
    cells: Vec<Bounds>,
}

/// The search for crossing cells of a mesh whose vertices move.
#[derive(Clone, Debug)]
pub struct Crossings {
    cells: Vec<Cell>,
    /// Cells in the hierarchy's order.
    order: Vec<u32>,
    /// Nodes, parents before their children.
    nodes: Vec<Node>,
}

impl Crossings {
    /// The search for a mesh; its positions shape the hierarchy, and any others may be searched.
    pub fn new(mesh: &SurfaceMesh) -> Self {
        let centre = |cell: &Cell| -> Vector3 {
            let corners = cell.vertices();
            corners.iter().map(|v| Vector3::from(mesh.vertices[*v as usize])).sum::<Vector3>()
                / corners.len() as f64
        };
        let centres: Vec<Vector3> = mesh.cells.iter().map(centre).collect();
        let mut order: Vec<u32> = (0..mesh.cells.len() as u32).collect();
        let mut nodes = vec![Node { first: 0, last: order.len() as u32, child: None }];
        let mut next = 0;
        while next < nodes.len() {
            let Node { first, last, .. } = nodes[next];
            let range = first as usize..last as usize;
            if range.len() > LEAF {
                let start = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
                let around = order[range.clone()].iter().map(|cell| &centres[*cell as usize]);
                let (low, high) = around.fold(start, |(low, high), c| (low.inf(c), high.sup(c)));
                let axis = (high - low).imax();
                let key = |cell: &u32| (centres[*cell as usize][axis], *cell);
                let middle = range.len() / 2;
                order[range].select_nth_unstable_by(middle, |a, b| {
                    let (a, b) = (key(a), key(b));
                    a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))
                });
                let middle = first + middle as u32;
                nodes[next].child = Some(nodes.len() as u32);
                nodes.push(Node { first, last: middle, child: None });
                nodes.push(Node { first: middle, last, child: None });
            }
            next += 1;
        }
        Self { cells: mesh.cells.clone(), order, nodes }
    }

    /// Pairs of cells that cross, the lower index first, in ascending order; at most `most` of them. `None` if `cancelled` said so.
    pub fn find(
        &self,
        vertices: &[[f64; 3]],
        most: usize,
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Option<Vec<[u32; 2]>> {
        let cells: Vec<Bounds> =
            self.order.iter().map(|cell| Bounds::of(&self.cells[*cell as usize], vertices)).collect();
        let moved = Moved { vertices, nodes: self.bounds(&cells), cells };
        let mut pairs = Vec::new();
        // Level by level until there is enough for many threads; the same division for any number of them.
        let mut tasks = vec![[0, 0]];
        while !tasks.is_empty() && tasks.len() < TASKS {
            let mut next = Vec::new();
            tasks.into_iter().for_each(|nodes| self.step(&moved, nodes, &mut next, &mut pairs));
            tasks = next;
        }
        let below = |nodes: [u32; 2]| {
            let (mut stack, mut pairs, mut steps) = (vec![nodes], Vec::new(), 0_u32);
            while let Some(nodes) = stack.pop().filter(|_| pairs.len() <= most) {
                if steps.is_multiple_of(4096) && cancelled() {
                    return None;
                }
                steps = steps.wrapping_add(1);
                self.step(&moved, nodes, &mut stack, &mut pairs);
            }
            Some(pairs)
        };
        let found: Option<Vec<Vec<[u32; 2]>>> = tasks.into_par_iter().map(below).collect();
        pairs.extend(found?.into_iter().flatten());
        pairs.sort_unstable();
        pairs.truncate(most);
        Some(pairs)
    }

    /// Looks at two nodes: adds pairs of their children to the stack, or crossing pairs of their cells.
    fn step(
        &self,
        moved: &Moved<'_>,
        [one, two]: [u32; 2],
        stack: &mut Vec<[u32; 2]>,
        pairs: &mut Vec<[u32; 2]>,
    ) {
        let (a, b) = (&self.nodes[one as usize], &self.nodes[two as usize]);
        if one == two {
            match a.child {
                Some(child) => stack.extend([[child, child], [child + 1, child + 1], [child, child + 1]]),
                None => self.leaves(moved, [a, a], pairs),
            }
            return;
        }
        if !moved.nodes[one as usize].meets(&moved.nodes[two as usize]) {
            return;
        }
        // The larger one is divided, if it can be.
        let first = a.last - a.first >= b.last - b.first;
        match (a.child, b.child, first) {
            (None, None, _) => self.leaves(moved, [a, b], pairs),
            (Some(child), None, _) | (Some(child), Some(_), true) => {
                stack.extend([[child, two], [child + 1, two]]);
            }
            (_, Some(child), _) => stack.extend([[one, child], [one, child + 1]]),
        }
    }

    /// Boxes of all nodes, from those of the cells in the hierarchy's order.
    fn bounds(&self, cells: &[Bounds]) -> Vec<Bounds> {
        let mut bounds = vec![Bounds::NONE; self.nodes.len()];
        for index in (0..self.nodes.len()).rev() {
            let node = &self.nodes[index];
            let mut around = Bounds::NONE;
            match node.child {
                Some(child) => {
                    for child in [child, child + 1] {
                        let of_child = bounds[child as usize];
                        around.add(&of_child.low, &of_child.high);
                    }
                }
                None => {
                    let of_leaf = &cells[node.first as usize..node.last as usize];
                    of_leaf.iter().for_each(|cell| around.add(&cell.low, &cell.high));
                }
            }
            bounds[index] = around;
        }
        bounds
    }

    /// Adds the pairs of two leaves, or of one with itself, that cross.
    fn leaves(&self, moved: &Moved<'_>, [one, two]: [&Node; 2], pairs: &mut Vec<[u32; 2]>) {
        for i in one.first..one.last {
            let begin = if one.first == two.first { i + 1 } else { two.first };
            for j in begin..two.last {
                if !moved.cells[i as usize].meets(&moved.cells[j as usize]) {
                    continue;
                }
                let [a, b] = [i, j].map(|place| self.order[place as usize]);
                if cross(moved.vertices, &self.cells[a as usize], &self.cells[b as usize]) {
                    pairs.push([a.min(b), a.max(b)]);
                }
            }
        }
    }
}

/// The ways to cut a cell into triangles.
fn cuts(cell: &Cell) -> &'static [&'static [[usize; 3]]] {
    if cell.vertices().len() == 3 {
        &[&[[0, 1, 2]]]
    } else {
        &[&[[0, 1, 2], [0, 2, 3]], &[[1, 2, 3], [1, 3, 0]]]
    }
}

/// Whether two cells cross.
pub fn cross(vertices: &[[f64; 3]], one: &Cell, two: &Cell) -> bool {
    let at = |vertex: &u32| Vector3::from(vertices[*vertex as usize]);
    if apart(one, two, at) {
        return false;
    }
    let triangle = |cell: &Cell, corners: &[usize; 3]| -> [Corner; 3] {
        corners.map(|k| (cell.vertices()[k], vertices[cell.vertices()[k] as usize]))
    };
    let meet = |a: &[usize; 3], b: &[usize; 3]| triangles_meet(&triangle(one, a), &triangle(two, b));
    cuts(one)
        .iter()
        .all(|of_one| cuts(two).iter().all(|of_two| of_one.iter().any(|a| of_two.iter().any(|b| meet(a, b)))))
}

/// Whether a plane shows at once that two cells have no more in common than the corners that they share: it is between the middles, through a shared edge.
fn apart(one: &Cell, two: &Cell, at: impl Fn(&u32) -> Vector3) -> bool {
    let is_shared = |v: &&u32| one.vertices().contains(v) && two.vertices().contains(v);
    let mut shared = one.vertices().iter().filter(is_shared);
    let shared = [shared.next(), shared.next(), shared.next()];
    let middle =
        |cell: &Cell| cell.vertices().iter().map(&at).sum::<Vector3>() / cell.vertices().len() as f64;
    let mut across = middle(two) - middle(one);
    let size = across.norm();
    if let [Some(a), Some(b), None] = shared {
        let edge = at(b) - at(a);
        across -= edge * (edge.dot(&across) / edge.norm_squared());
    }
    let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
    for vertex in one.vertices().iter().filter(|v| !is_shared(v)) {
        low = low.max(across.dot(&at(vertex)));
    }
    for vertex in two.vertices().iter().filter(|v| !is_shared(v)) {
        high = high.min(across.dot(&at(vertex)));
    }
    let margin = APART * size * across.norm();
    match shared {
        [None, ..] => high - low > margin,
        [Some(a), _, None] => {
            let plane = across.dot(&at(a));
            plane - low > margin && high - plane > margin
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mesh(vertices: Vec<[f64; 3]>, cells: Vec<Cell>) -> SurfaceMesh {
        SurfaceMesh::new(vertices, cells, Vec::new(), Vec::new()).unwrap()
    }

    /// Pseudo-random numbers from -1 to 1.
    struct Random(u64);

    impl Random {
        fn next(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        }
    }

    /// A ball, box or ring of quadrilaterals and triangles, of random size and place.
    fn body(random: &mut Random) -> (Vec<[f64; 3]>, Vec<Cell>) {
        let (n, m) = (6 + (random.next().abs() * 6.0) as u32, 8 + (random.next().abs() * 8.0) as u32);
        let stretch = [0, 1, 2].map(|_| 0.6 + 0.4 * random.next());
        let shift = [0, 1, 2].map(|_| 0.9 * random.next());
        let ring = random.next() > 0.0;
        let mut vertices = Vec::new();
        for i in 0..n {
            for j in 0..m {
                let phi = 2.0 * std::f64::consts::PI * f64::from(j) / f64::from(m);
                let x = if ring {
                    let theta = 2.0 * std::f64::consts::PI * f64::from(i) / f64::from(n);
                    let r = 0.7 + 0.25 * theta.cos();
                    [r * phi.cos(), r * phi.sin(), 0.25 * theta.sin()]
                } else {
                    let theta = std::f64::consts::PI * (f64::from(i) + 0.5) / f64::from(n);
                    [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()]
                };
                vertices.push([0, 1, 2].map(|k: usize| stretch[k] * x[k] + shift[k]));
            }
        }
        let at = |i: u32, j: u32| (i % n) * m + j % m;
        let mut cells = Vec::new();
        for i in 0..if ring { n } else { n - 1 } {
            for j in 0..m {
                let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                if (i + j) % 3 == 0 {
                    cells.extend([Cell::triangle(a, b, c), Cell::triangle(a, c, d)]);
                } else {
                    cells.push(Cell::quad(a, b, c, d));
                }
            }
        }
        (vertices, cells)
    }

    /// None is missed and none is false on random pairs of bodies, near and far, against a test of all pairs.
    #[test]
    fn the_hierarchy_finds_what_all_pairs_have() {
        let mut random = Random(7);
        let (mut crossing, mut clear) = (0, 0);
        for _ in 0..200 {
            let (mut vertices, mut cells) = body(&mut random);
            let (others, more) = body(&mut random);
            let first = vertices.len() as u32;
            vertices.extend(others);
            cells.extend(more.iter().map(|cell| cell.map(|v| v + first)));
            let mesh = mesh(vertices, cells);
            let search = Crossings::new(&mesh);
            // Moved since the hierarchy was made.
            let vertices: Vec<[f64; 3]> =
                mesh.vertices.iter().map(|x| [x[0] + 0.3 * x[1] * x[1], x[1], x[2] - 0.2 * x[0]]).collect();
            let found = search.find(&vertices, usize::MAX, &|| false).unwrap();
            let mut expected = Vec::new();
            for a in 0..mesh.cells.len() {
                for b in a + 1..mesh.cells.len() {
                    if cross(&vertices, &mesh.cells[a], &mesh.cells[b]) {
                        expected.push([a as u32, b as u32]);
                    }
                }
            }
            assert_eq!(found, expected);
            // A body does not cross itself.
            let halves = |cell: u32| mesh.cells[cell as usize].vertices()[0] < first;
            assert!(found.iter().all(|[a, b]| halves(*a) != halves(*b)), "{found:?}");
            if found.is_empty() { clear += 1 } else { crossing += 1 }
        }
        assert!(crossing > 20 && clear > 20, "{crossing} {clear}");
    }

    /// Two unit squares, one above the other and turned upright, nearer and nearer.
    #[test]
    fn contact_is_exact() {
        let square = |x: [[f64; 3]; 4]| x.to_vec();
        let flat = square([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]);
        for (height, meets) in [(1e-12, false), (f64::MIN_POSITIVE, false), (0.0, true), (-1e-300, true)] {
            let upright = square([[0.3, 0.2, height], [0.7, 0.6, height], [0.7, 0.6, 1.0], [0.3, 0.2, 1.0]]);
            let mesh =
                mesh([flat.clone(), upright].concat(), vec![Cell::quad(0, 1, 2, 3), Cell::quad(4, 5, 6, 7)]);
            let found = Crossings::new(&mesh).find(&mesh.vertices, 10, &|| false).unwrap();
            assert_eq!(!found.is_empty(), meets, "{height}");
        }
    }

    /// A strip that is folded back onto itself, and one that is bent sharply.
    #[test]
    fn folds() {
        for (end, meets) in [([0.5, 0.0], true), ([0.5, 0.01], false), ([1.5, -0.3], false)] {
            let [x, z] = end;
            let vertices = vec![
                [0.0, 0.0, 0.0],
                [1.0, 0.0, 0.0],
                [1.0, 1.0, 0.0],
                [0.0, 1.0, 0.0],
                [x, 0.0, z],
                [x, 1.0, z],
            ];
            let mesh = mesh(vertices, vec![Cell::quad(0, 1, 2, 3), Cell::quad(1, 4, 5, 2)]);
            let found = Crossings::new(&mesh).find(&mesh.vertices, 10, &|| false).unwrap();
            assert_eq!(!found.is_empty(), meets, "{end:?}");
        }
    }

    /// Two bodies in the same place touch everywhere.
    #[test]
    fn coinciding_bodies_are_found() {
        let mut random = Random(3);
        let (mut vertices, mut cells) = body(&mut random);
        let first = vertices.len() as u32;
        vertices.extend(vertices.clone());
        cells.extend(cells.clone().iter().map(|cell| cell.map(|v| v + first)));
        let mesh = mesh(vertices, cells);
        let found = Crossings::new(&mesh).find(&mesh.vertices, 10, &|| false).unwrap();
        assert_eq!(found.len(), 10, "no more than asked for");
    }

    #[test]
    fn a_cancelled_search_ends() {
        let mut random = Random(5);
        let (mut vertices, mut cells) = (Vec::new(), Vec::new());
        for _ in 0..30 {
            let (more, of_body) = body(&mut random);
            let first = vertices.len() as u32;
            vertices.extend(more);
            cells.extend(of_body.iter().map(|cell| cell.map(|v| v + first)));
        }
        let mesh = mesh(vertices, cells);
        assert!(Crossings::new(&mesh).find(&mesh.vertices, 10_000_000, &|| true).is_none());
    }
}
