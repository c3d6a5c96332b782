//! Blunt trailing edges, as open NACA sections have them: their bases are closed.
//!
//! A base is a strip of one or more rows of cells that face aft between an upper and a lower side. Its vertices on a line from the upper to the
//! lower side become one point, at their mean, and its cells vanish. So the wake leaves the middle of the base, neither side is preferred, and
//! the section has no lift that its mean line does not give. Points are linear in the mesh's vertices, hence derivatives stay exact.

use std::borrow::Cow;

use moldline_mesh::{Cell, SurfaceMesh, Topology, Vector3};

use crate::{
    PanelError, TrailingEdges,
    wake::{Face, Sight},
};

/// Angles by which the surface turns from a side to a base, degrees.
const RIM: [f64; 2] = [40.0, 140.0];
/// Least cosine between the flow and the normal of a base, and between the flow and the way in which a side ends at it.
const AFT: f64 = 0.7;
/// Largest turn between rows of a base, degrees.
const SMOOTH: f64 = 30.0;
/// Largest cosine between the normals of the upper and the lower side: they turn by 120 degrees or more from one to the other.
const OPPOSED: f64 = -0.5;
/// Largest height of a base, as a fraction of its length.
const HEIGHT: f64 = 0.25;

/// Which vertices become one, and which cells vanish. Empty if the mesh has no blunt trailing edges.
#[derive(Clone, Debug, Default)]
pub(crate) struct Closing {
    /// Vertices that become one; the first, which has the least number, stands for them.
    groups: Vec<Vec<u32>>,
    /// The vertex that stands for each vertex.
    pub representative: Vec<u32>,
    /// Vertices and cells of the closed mesh, by their numbers before.
    pub vertex_of: Vec<u32>,
    pub cell_of: Vec<u32>,
    /// For every cell the cell of the closed mesh that has its pressure: itself, or for cells of a base a cell beside it.
    pub stands_for: Vec<u32>,
}

/// A border edge of a base.
struct Rim {
    edge: [u32; 2],
    /// The unit normal and the number of the side's cell.
    normal: Vector3,
    side: u32,
}

/// Geometry and connections of the mesh's cells.
struct Cells<'a> {
    mesh: &'a SurfaceMesh,
    topology: &'a Topology,
    faces: Vec<Face>,
    /// Edges of each cell.
    edges: Vec<Vec<u32>>,
}

impl<'a> Cells<'a> {
    fn new(mesh: &'a SurfaceMesh, topology: &'a Topology) -> Self {
        let at = |v: &u32| Vector3::from(mesh.vertices[*v as usize]);
        let face = |cell: &Cell| {
            let v = cell.vertices();
            Face::new(&[at(&v[0]), at(&v[1]), at(&v[2]), at(&v[v.len() - 1])])
        };
        let mut edges = vec![Vec::new(); mesh.cells.len()];
        for (edge, cells) in (0..).zip(topology.edge_cells.rows()) {
            cells.iter().for_each(|cell| edges[*cell as usize].push(edge));
        }
        Self { mesh, topology, faces: mesh.cells.iter().map(face).collect(), edges }
    }

    fn at(&self, vertex: u32) -> Vector3 {
        Vector3::from(self.mesh.vertices[vertex as usize])
    }

    /// The cell on the other side of an edge, and how the flow sees the edge with `cell` first.
    fn across(&self, cell: u32, edge: u32) -> Option<(u32, Sight)> {
        let other = *self.topology.edge_cells.row(edge as usize).iter().find(|other| **other != cell)?;
        let [a, b] = self.topology.edges[edge as usize];
        let runs = self.mesh.cells[cell as usize].edges().any(|side| side == [a, b]);
        let along = self.at(b) - self.at(a);
        let along = if runs { along } else { -along };
        let faces = [cell, other].map(|c| self.faces[c as usize]);
        Some((other, Sight::between(along, &faces)))
    }

    /// The side beside a base's edge, if the cell is of a base there.
    fn side(&self, cell: u32, edge: u32) -> Option<u32> {
        let (other, sight) = self.across(cell, edge)?;
        let is_rim = (RIM[0]..=RIM[1]).contains(&sight.turn);
        (is_rim && sight.aft[0] >= AFT && sight.off[1] >= AFT).then_some(other)
    }

    /// Connected cells of bases.
    fn patches(&self) -> Vec<Vec<u32>> {
        let count = self.mesh.cells.len();
        let is_rim =
            |cell: &u32| self.edges[*cell as usize].iter().any(|edge| self.side(*cell, *edge).is_some());
        let on_rim: Vec<bool> = (0..count as u32).map(|cell| is_rim(&cell)).collect();
        let mut seen = vec![false; count];
        let mut patches = Vec::new();
        for start in (0..count as u32).filter(|cell| on_rim[*cell as usize]) {
            if std::mem::replace(&mut seen[start as usize], true) {
                continue;
            }
            let (mut patch, mut next) = (vec![start], 0);
            while let Some(&cell) = patch.get(next) {
                next += 1;
                for &edge in &self.edges[cell as usize] {
                    let Some((other, sight)) = self.across(cell, edge) else { continue };
                    if sight.turn.abs() <= SMOOTH && !std::mem::replace(&mut seen[other as usize], true) {
                        patch.push(other);
                    }
                }
            }
            patches.push(patch);
        }
        patches
    }

    /// The groups of vertices by which a base closes; none if it is no trailing edge.
    fn close(&self, patch: &[u32]) -> Option<(Vec<Vec<u32>>, Vec<Rim>)> {
        let mut rims = Vec::new();
        for &cell in patch {
            for &edge in &self.edges[cell as usize] {
                if let Some(side) = self.side(cell, edge) {
                    let normal = self.faces[side as usize].normal;
                    rims.push(Rim { edge: self.topology.edges[edge as usize], normal, side });
                }
            }
        }
        let mut vertices: Vec<u32> = patch
            .iter()
            .flat_map(|cell| self.mesh.cells[*cell as usize].vertices().iter().copied())
            .collect();
        vertices.sort_unstable();
        vertices.dedup();
        let first = self.at(*vertices.first()?);
        let (low, high) = vertices.iter().fold((first, first), |(low, high), v| {
            let at = self.at(*v);
            (low.inf(&at), high.sup(&at))
        });
        let highest = HEIGHT * (high - low).norm();
        let nearest = |vertex: u32| -> Option<u32> {
            let own: Vec<&Rim> = rims.iter().filter(|rim| rim.edge.contains(&vertex)).collect();
            let opposed = |rim: &&Rim| own.iter().any(|own| own.normal.dot(&rim.normal) <= OPPOSED);
            let distance = |v: u32| (self.at(v) - self.at(vertex)).norm();
            let candidates = rims.iter().filter(opposed).flat_map(|rim| rim.edge);
            candidates
                .filter(|v| *v != vertex && distance(*v) <= highest)
                .min_by(|a, b| distance(*a).total_cmp(&distance(*b)).then(a.cmp(b)))
        };
        let mut groups: Vec<Vec<u32>> = Vec::new();
        let mut rest = Vec::new();
        for &vertex in &vertices {
            match nearest(vertex) {
                Some(partner) if nearest(partner) != Some(vertex) => return None,
                Some(partner) if partner > vertex => groups.push(vec![vertex, partner]),
                Some(_) => {}
                None => rest.push(vertex),
            }
        }
        // Vertices of inner rows go with the line on which they lie.
        let lines: Vec<[Vector3; 2]> = groups.iter().map(|g| [self.at(g[0]), self.at(g[1])]).collect();
        for vertex in rest {
            let at = self.at(vertex);
            let line =
                (0..lines.len()).min_by(|i, j| apart(&at, &lines[*i]).total_cmp(&apart(&at, &lines[*j])))?;
            groups[line].push(vertex);
        }
        let group_of = |vertex: &u32| groups.iter().position(|group| group.contains(vertex));
        let closes = |cell: &u32| {
            let mut corners: Vec<_> =
                self.mesh.cells[*cell as usize].vertices().iter().map(group_of).collect();
            corners.sort_unstable();
            corners.dedup();
            corners.len() <= 2 && corners.iter().all(Option::is_some)
        };
        (!groups.is_empty() && patch.iter().all(closes)).then_some((groups, rims))
    }
}

/// Distance of a point from a segment.
fn apart(at: &Vector3, [a, b]: &[Vector3; 2]) -> f64 {
    let along = b - a;
    let t = ((at - a).dot(&along) / along.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    (at - a - along * t).norm()
}

impl Closing {
    /// Finds the bases that are blunt trailing edges: all of them by an angle, else those with a vertex that the rule names.
    pub fn new(mesh: &SurfaceMesh, topology: &Topology, rule: &TrailingEdges) -> Self {
        let named: Option<Vec<u32>> = match rule {
            TrailingEdges::None => return Self::default(),
            TrailingEdges::Angle { .. } => None,
            TrailingEdges::Groups(names) => Some(
                names
                    .iter()
                    .filter_map(|name| mesh.vertex_group(name))
                    .flat_map(|g| g.indices.clone())
                    .collect(),
            ),
            TrailingEdges::Edges(edges) => Some(edges.as_flattened().to_vec()),
        };
        let mut is_named = vec![named.is_none(); mesh.vertices.len()];
        named
            .iter()
            .flatten()
            .filter(|v| (**v as usize) < mesh.vertices.len())
            .for_each(|v| is_named[*v as usize] = true);
        let cells = Cells::new(mesh, topology);
        let mut closing = Self::default();
        for patch in cells.patches() {
            let of_patch = patch.iter().flat_map(|cell| mesh.cells[*cell as usize].vertices());
            if !of_patch.into_iter().any(|v| is_named[*v as usize]) {
                continue;
            }
            let Some((groups, rims)) = cells.close(&patch) else { continue };
            let mut with = closing.clone();
            if with.add(mesh, groups, &rims, &cells) {
                closing = with;
            }
        }
        closing
    }

    /// Adds a base; false if the surface would not be one afterwards.
    fn add(&mut self, mesh: &SurfaceMesh, groups: Vec<Vec<u32>>, rims: &[Rim], cells: &Cells<'_>) -> bool {
        self.groups.extend(groups);
        self.representative = (0..mesh.vertices.len() as u32).collect();
        for group in &mut self.groups {
            group.sort_unstable();
            group.iter().for_each(|v| self.representative[*v as usize] = group[0]);
        }
        let Some(closed) = self.cells(mesh) else { return false };
        let topology = Topology::of_cells(
            mesh.vertices.len(),
            &closed.iter().map(|(_, cell)| *cell).collect::<Vec<_>>(),
        );
        if !topology.non_manifold_edges.is_empty() || !topology.inconsistent_edges.is_empty() {
            return false;
        }
        self.vertex_of = closed.iter().flat_map(|(_, cell)| cell.vertices().to_vec()).collect();
        self.vertex_of.sort_unstable();
        self.vertex_of.dedup();
        self.cell_of = closed.iter().map(|(cell, _)| *cell).collect();
        let position = |cell: u32| self.cell_of.binary_search(&cell).ok().map(|k| k as u32);
        let beside = |cell: u32| {
            let centre = cells.faces[cell as usize].centre;
            let distance =
                |rim: &Rim| (0.5 * (cells.at(rim.edge[0]) + cells.at(rim.edge[1])) - centre).norm();
            let left = rims.iter().filter_map(|rim| Some((distance(rim), position(rim.side)?)));
            left.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, side)| side)
        };
        let stands_for: Option<Vec<u32>> =
            (0..mesh.cells.len() as u32).map(|cell| position(cell).or_else(|| beside(cell))).collect();
        match stands_for {
            Some(list) => self.stands_for = list,
            None => return false,
        }
        true
    }

    /// The cells that are left, by the vertices that stand for theirs; none if one of them is folded.
    fn cells(&self, mesh: &SurfaceMesh) -> Option<Vec<(u32, Cell)>> {
        let mut closed = Vec::with_capacity(mesh.cells.len());
        for (index, cell) in (0..).zip(&mesh.cells) {
            let mut corners: Vec<u32> =
                cell.vertices().iter().map(|v| self.representative[*v as usize]).collect();
            corners.dedup();
            if corners.len() > 1 && corners.first() == corners.last() {
                corners.pop();
            }
            let mut distinct = corners.clone();
            distinct.sort_unstable();
            distinct.dedup();
            match corners[..] {
                [a, b, c] if distinct.len() == 3 => closed.push((index, Cell::triangle(a, b, c))),
                [a, b, c, d] if distinct.len() == 4 => closed.push((index, Cell::quad(a, b, c, d))),
                [] | [_] | [_, _] => {}
                _ => return None,
            }
        }
        Some(closed)
    }

    /// The closed mesh; none if nothing is to be closed.
    pub fn apply(&self, mesh: &SurfaceMesh) -> Result<Option<SurfaceMesh>, PanelError> {
        if self.is_empty() {
            return Ok(None);
        }
        let vertices = self.gather(&mesh.vertices);
        let vertices = self.vertex_of.iter().map(|v| vertices[*v as usize]).collect();
        let number = |v: u32| self.vertex_of.partition_point(|other| *other < v) as u32;
        let cells = self.cells(mesh).unwrap_or_default().iter().map(|(_, cell)| cell.map(number)).collect();
        Ok(Some(SurfaceMesh::new(vertices, cells, Vec::new(), Vec::new())?))
    }

    pub fn is_empty(&self) -> bool {
        self.groups.is_empty()
    }

    /// Whether a cell of the mesh vanishes.
    pub fn closes(&self, cell: u32) -> bool {
        !self.is_empty() && self.cell_of.binary_search(&cell).is_err()
    }

    /// Whether a vertex stands for those of a closed base.
    pub fn is_closed(&self, vertex: u32) -> bool {
        self.groups.iter().any(|group| group[0] == vertex)
    }

    /// The cells that vanish.
    pub fn closed(&self) -> Vec<u32> {
        (0..self.stands_for.len() as u32).filter(|cell| self.closes(*cell)).collect()
    }

    /// Positions with those of every group at their mean.
    pub fn gather<'a>(&self, vertices: &'a [[f64; 3]]) -> Cow<'a, [[f64; 3]]> {
        if self.is_empty() {
            return Cow::Borrowed(vertices);
        }
        let mut out = vertices.to_vec();
        for group in &self.groups {
            let mean = group.iter().map(|v| Vector3::from(vertices[*v as usize])).sum::<Vector3>()
                / group.len() as f64;
            out[group[0] as usize] = mean.into();
        }
        Cow::Owned(out)
    }

    /// The transpose of [`gather`](Self::gather).
    pub fn scatter(&self, seeds: &mut [[f64; 3]]) {
        for group in &self.groups {
            let part = seeds[group[0] as usize].map(|x| x / group.len() as f64);
            group.iter().for_each(|v| seeds[*v as usize] = part);
        }
    }
}
