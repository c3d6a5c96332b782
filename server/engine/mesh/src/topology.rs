//! Edges, adjacency, and the global topology of a surface.

use crate::{Cell, Plane, SurfaceMesh, Vector3};

/// Rows of indices, one after another: row `i` is `items[offsets[i]..offsets[i + 1]]`.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct Csr {
    /// Start of each row, with the total at the end: one more than the number of rows.
    pub offsets: Vec<u32>,
    /// The rows' entries.
    pub items: Vec<u32>,
}

impl Csr {
    /// Sorts `(row, item)` pairs into `rows` rows; within a row the items keep their order.
    pub fn from_pairs(rows: usize, pairs: impl Iterator<Item = (u32, u32)> + Clone) -> Self {
        let mut offsets = vec![0_u32; rows + 1];
        for (row, _) in pairs.clone() {
            offsets[row as usize + 1] += 1;
        }
        for row in 0..rows {
            offsets[row + 1] += offsets[row];
        }
        let mut next = offsets.clone();
        let mut items = vec![0; offsets[rows] as usize];
        for (row, item) in pairs {
            items[next[row as usize] as usize] = item;
            next[row as usize] += 1;
        }
        Self { offsets, items }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// True without rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Entries of row `i`.
    pub fn row(&self, i: usize) -> &[u32] {
        &self.items[self.range(i)]
    }

    /// The range of row `i` within `items`.
    pub fn range(&self, i: usize) -> std::ops::Range<usize> {
        self.offsets[i] as usize..self.offsets[i + 1] as usize
    }

    /// All rows in order.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &[u32]> + Clone {
        (0..self.len()).map(|i| self.row(i))
    }
}

/// The edges and neighbourhoods of a mesh's cells.
#[derive(Clone, Debug)]
pub struct Topology {
    /// Undirected edges `[a, b]`, `a < b`, in increasing order.
    pub edges: Vec<[u32; 2]>,
    /// The cells at each edge.
    pub edge_cells: Csr,
    /// The vertices that share an edge with each vertex, increasing.
    pub vertex_neighbours: Csr,
    /// The cells at each vertex, increasing.
    pub vertex_cells: Csr,
    /// Edges with one cell.
    pub boundary_edges: Vec<u32>,
    /// Edges with three cells or more.
    pub non_manifold_edges: Vec<u32>,
    /// Edges that two of their cells traverse in the same direction.
    pub inconsistent_edges: Vec<u32>,
    /// The connected piece each vertex belongs to, numbered by first appearance.
    pub vertex_piece: Vec<u32>,
    /// Number of connected pieces.
    pub pieces: usize,
    cells: usize,
}

impl Topology {
    /// The topology of a validated mesh.
    pub fn new(mesh: &SurfaceMesh) -> Self {
        Self::of_cells(mesh.vertices.len(), &mesh.cells)
    }

    /// The topology of cells whose indices are known to be below `vertex_count`.
    ///
    /// # Panics
    /// If an index is not.
    pub fn of_cells(vertex_count: usize, cells: &[Cell]) -> Self {
        // One entry for each side of each cell: its edge, its cell, whether it runs from the larger vertex down.
        let mut sides: Vec<([u32; 2], u32, bool)> = Vec::with_capacity(4 * cells.len());
        for (index, cell) in cells.iter().enumerate() {
            sides.extend(cell.edges().map(|[a, b]| ([a.min(b), a.max(b)], index as u32, a > b)));
        }
        sides.sort_unstable();

        let mut edges = Vec::with_capacity(sides.len() / 2);
        let mut edge_cells = Csr { offsets: vec![0], items: Vec::with_capacity(sides.len()) };
        let (mut boundary_edges, mut non_manifold_edges, mut inconsistent_edges) = (vec![], vec![], vec![]);
        for around in sides.chunk_by(|a, b| a.0 == b.0) {
            let edge = edges.len() as u32;
            edges.push(around[0].0);
            edge_cells.items.extend(around.iter().map(|side| side.1));
            edge_cells.offsets.push(edge_cells.items.len() as u32);
            match around.len() {
                1 => boundary_edges.push(edge),
                2 => {}
                _ => non_manifold_edges.push(edge),
            }
            let down = around.iter().filter(|side| side.2).count();
            if down > 1 || around.len() - down > 1 {
                inconsistent_edges.push(edge);
            }
        }

        // The order of the sorted edges makes each row increase: first the smaller neighbours, then the larger.
        let smaller = edges.iter().map(|&[a, b]| (b, a));
        let larger = edges.iter().map(|&[a, b]| (a, b));
        let vertex_neighbours = Csr::from_pairs(vertex_count, smaller.chain(larger));
        let corners = cells.iter().enumerate();
        let corners =
            corners.flat_map(|(index, cell)| cell.vertices().iter().map(move |&v| (v, index as u32)));
        let vertex_cells = Csr::from_pairs(vertex_count, corners);
        let (vertex_piece, pieces) = connected_pieces(&vertex_neighbours);
        Self {
            edges,
            edge_cells,
            vertex_neighbours,
            vertex_cells,
            boundary_edges,
            non_manifold_edges,
            inconsistent_edges,
            vertex_piece,
            pieces,
            cells: cells.len(),
        }
    }

    /// Euler number: vertices - edges + cells; 2 for each closed piece without handles.
    pub fn euler(&self) -> i64 {
        self.vertex_cells.len() as i64 - self.edges.len() as i64 + self.cells as i64
    }

    /// The edge between two vertices, whichever is named first.
    pub fn edge_between(&self, a: u32, b: u32) -> Option<u32> {
        self.edges.binary_search(&[a.min(b), a.max(b)]).ok().map(|edge| edge as u32)
    }

    /// Boundary edges, less those with both ends within `tolerance` of the symmetry plane, if one is given.
    pub fn open_edges(&self, vertices: &[[f64; 3]], symmetry: Option<(&Plane, f64)>) -> Vec<u32> {
        let on_plane = |vertex: u32| {
            symmetry.is_some_and(|(plane, tolerance)| {
                plane.signed_distance(&vertices[vertex as usize]).abs() <= tolerance
            })
        };
        let open = |edge: &u32| !self.edges[*edge as usize].iter().all(|&vertex| on_plane(vertex));
        self.boundary_edges.iter().copied().filter(open).collect()
    }

    /// True if each edge has two cells that traverse it in opposite directions; edges on the given symmetry plane may have one.
    pub fn is_watertight(&self, vertices: &[[f64; 3]], symmetry: Option<(&Plane, f64)>) -> bool {
        self.non_manifold_edges.is_empty()
            && self.inconsistent_edges.is_empty()
            && self.open_edges(vertices, symmetry).is_empty()
    }
}

/// Connected pieces of vertices, by breadth-first search along edges.
fn connected_pieces(neighbours: &Csr) -> (Vec<u32>, usize) {
    const UNSEEN: u32 = u32::MAX;
    let mut piece = vec![UNSEEN; neighbours.len()];
    let mut pieces = 0;
    let mut queue = Vec::new();
    for start in 0..neighbours.len() {
        if piece[start] != UNSEEN {
            continue;
        }
        piece[start] = pieces;
        queue.push(start as u32);
        while let Some(vertex) = queue.pop() {
            for &next in neighbours.row(vertex as usize) {
                if piece[next as usize] == UNSEEN {
                    piece[next as usize] = pieces;
                    queue.push(next);
                }
            }
        }
        pieces += 1;
    }
    (piece, pieces as usize)
}

/// Signed volume that the cells enclose, m^3: positive if they point outwards.
///
/// Divergence theorem; a warped quadrilateral counts as the bilinear patch through its edges, which is the mean of its
/// two splits into triangles. With a symmetry plane, the volume between the cells and the plane.
pub fn enclosed_volume(vertices: &[[f64; 3]], cells: &[Cell], symmetry: Option<&Plane>) -> f64 {
    let Some(origin) = cells.first().map(|cell| vertices[cell.vertices()[0] as usize]) else { return 0.0 };
    // Seen from a point of the plane, the missing faces on it add nothing.
    let origin = symmetry.map_or(origin, |plane| plane.project(&origin));
    let origin = Vector3::from(origin);
    let at = |vertex: u32| Vector3::from(vertices[vertex as usize]) - origin;
    let six_volumes = |a: &Vector3, b: &Vector3, c: &Vector3| a.dot(&b.cross(c));
    let of_cell = |cell: &Cell| match *cell.vertices() {
        [a, b, c] => six_volumes(&at(a), &at(b), &at(c)),
        [a, b, c, d] => {
            let [a, b, c, d] = [at(a), at(b), at(c), at(d)];
            0.5 * (six_volumes(&a, &b, &c)
                + six_volumes(&a, &c, &d)
                + six_volumes(&b, &c, &d)
                + six_volumes(&b, &d, &a))
        }
        _ => 0.0,
    };
    cells.iter().map(of_cell).sum::<f64>() / 6.0
}
