//! The panels that are solved: their points, edges and neighbours, as far as they do not depend on positions.

use moldline_mesh::{
    Cell, Limits, Plane, SurfaceMesh, Topology, Vector3,
    cracks::{self, Crack},
    topology::enclosed_volume,
};

use crate::{
    PanelError, Symmetry,
    symmetry::{Partners, mirrored, symmetry_tolerance},
};

/// An edge of solved panels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Edge {
    /// From here, as its left panel runs through it ...
    pub a: u32,
    /// ... to here.
    pub b: u32,
    /// The panel that runs from `a` to `b`.
    pub left: u32,
    /// The panel that runs from `b` to `a`; none on the symmetry plane.
    pub right: Option<u32>,
}

/// The solved panels, with their own numbering of vertices ("points").
#[derive(Clone, Debug)]
pub(crate) struct Panels {
    /// Points of each panel; a triangle's last one twice.
    pub corners: Vec<[u32; 4]>,
    pub edges: Vec<Edge>,
    /// Edges at each point.
    pub point_edges: Vec<Vec<u32>>,
    /// Connected piece of each point.
    pub piece: Vec<u32>,
    /// Mesh vertex of each point.
    pub vertex_of: Vec<u32>,
    /// Mesh cell of each panel.
    pub cell_of: Vec<u32>,
    /// Panel of each mesh cell, and whether the cell is its mirror image.
    pub panel_of: Vec<(u32, bool)>,
    /// Whether panels have images in y = 0.
    pub symmetric: bool,
    /// Points on the symmetry plane.
    pub on_plane: Vec<bool>,
    /// For a mesh with both halves of which one is solved: the partner vertex of each point.
    pub partner: Option<Vec<u32>>,
    /// Number of mesh vertices.
    pub vertices: usize,
}

impl Panels {
    /// Checks the mesh and picks the panels that are solved.
    pub fn new(mesh: &SurfaceMesh, symmetry: Symmetry) -> Result<Self, PanelError> {
        mesh.validate(&Limits::default())?;
        let topology = Topology::new(mesh);
        if let Some(&edge) = topology.non_manifold_edges.first() {
            let cells = topology.edge_cells.row(edge as usize).to_vec();
            return Err(PanelError::NonManifold { edge: topology.edges[edge as usize], cells });
        }
        if let Some(&edge) = topology.inconsistent_edges.first() {
            let cells = topology.edge_cells.row(edge as usize).to_vec();
            return Err(PanelError::Inconsistent { edge: topology.edges[edge as usize], cells });
        }
        let [low, high] = mesh.bounds();
        let tolerance = symmetry_tolerance(&mesh.vertices);
        let plane = Plane::y_zero();
        let half = match symmetry {
            Symmetry::Half => true,
            Symmetry::Automatic => !topology.boundary_edges.is_empty(),
            Symmetry::None | Symmetry::Mirror => false,
        };
        let open = topology.open_edges(&mesh.vertices, half.then_some((&plane, tolerance)));
        if let Some(&edge) = open.first() {
            let edges: Vec<[u32; 2]> = open.iter().map(|&edge| topology.edges[edge as usize]).collect();
            let size = (Vector3::from(high) - Vector3::from(low)).norm();
            if let Some(crack) = cracks::find(&mesh.vertices, &edges, size) {
                let Crack { edges, distance, first } = crack;
                let position = mesh.vertices[first[0] as usize];
                let tolerance = crack.tolerance(size);
                return Err(PanelError::Crack { count: edges, edge: first, position, distance, tolerance });
            }
            let cell = topology.edge_cells.row(edge as usize)[0];
            return Err(PanelError::Open { count: open.len(), edge: topology.edges[edge as usize], cell });
        }
        if half && low[1] < -tolerance && high[1] > tolerance {
            let text = format!("a half model lies on one side, y ranges over {}..={}", low[1], high[1]);
            return Err(PanelError::NotSymmetric(text));
        }
        let mirror = match symmetry {
            Symmetry::Mirror => Some(Partners::new(mesh, tolerance)?),
            Symmetry::Automatic if !half => Partners::new(mesh, tolerance).ok(),
            _ => None,
        };
        let panels = Self::pick(mesh, half, mirror, tolerance);
        panels.check_orientation(mesh)?;
        Ok(panels)
    }

    fn pick(mesh: &SurfaceMesh, half: bool, mirror: Option<Partners>, tolerance: f64) -> Self {
        let symmetric = half || mirror.is_some();
        let (cell_of, panel_of) = solved_cells(mesh, mirror.as_ref());
        let mut vertex_of: Vec<u32> =
            cell_of.iter().flat_map(|&c| mesh.cells[c as usize].vertices().iter().copied()).collect();
        vertex_of.sort_unstable();
        vertex_of.dedup();
        let point_of = |vertex: u32| vertex_of.partition_point(|v| *v < vertex) as u32;
        let cells: Vec<Cell> = cell_of.iter().map(|&c| mesh.cells[c as usize].map(point_of)).collect();
        let corners: Vec<[u32; 4]> = cells
            .iter()
            .map(|cell| {
                let v = cell.vertices();
                [v[0], v[1], v[2], v[v.len() - 1]]
            })
            .collect();
        let topology = Topology::of_cells(vertex_of.len(), &cells);
        let edges = oriented_edges(&topology, &cells);
        let mut point_edges = vec![Vec::new(); vertex_of.len()];
        for (index, edge) in (0..).zip(&edges) {
            [edge.a, edge.b].iter().for_each(|&point| point_edges[point as usize].push(index));
        }
        let on_plane =
            vertex_of.iter().map(|&v| symmetric && mesh.vertices[v as usize][1].abs() <= tolerance).collect();
        let partner =
            mirror.map(|partners| vertex_of.iter().map(|&v| partners.vertices[v as usize]).collect());
        Self {
            corners,
            edges,
            point_edges,
            piece: topology.vertex_piece,
            vertex_of,
            cell_of,
            panel_of,
            symmetric,
            on_plane,
            partner,
            vertices: mesh.vertices.len(),
        }
    }

    /// Checks that every closed piece encloses a positive volume.
    fn check_orientation(&self, mesh: &SurfaceMesh) -> Result<(), PanelError> {
        let pieces = self.piece.iter().max().map_or(0, |p| *p as usize + 1);
        let mut members = vec![Vec::new(); pieces];
        for (panel, corners) in self.corners.iter().enumerate() {
            members[self.piece[corners[0] as usize] as usize].push(self.cell_of[panel]);
        }
        let plane = Plane::y_zero();
        for cells in members {
            let of_piece: Vec<Cell> = cells.iter().map(|&c| mesh.cells[c as usize]).collect();
            let volume = enclosed_volume(&mesh.vertices, &of_piece, self.symmetric.then_some(&plane));
            if volume < 0.0 {
                return Err(PanelError::Inwards { cell: cells[0], volume });
            }
        }
        Ok(())
    }

    /// Number of unknowns.
    pub fn len(&self) -> usize {
        self.corners.len()
    }

    /// Weights of a panel's corners in its centre.
    pub fn weights(&self, panel: usize) -> [f64; 4] {
        if self.is_triangle(panel) { [1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0, 0.0] } else { [0.25; 4] }
    }

    /// Number of a panel's sides.
    pub fn sides(&self, panel: usize) -> usize {
        if self.is_triangle(panel) { 3 } else { 4 }
    }

    pub fn is_triangle(&self, panel: usize) -> bool {
        self.corners[panel][2] == self.corners[panel][3]
    }

    /// Axes along which unit onset flows are solved.
    pub fn axes(&self) -> &'static [usize] {
        if self.symmetric { &[0, 2] } else { &[0, 1, 2] }
    }

    /// The point of a mesh vertex, if it belongs to the solved panels.
    pub fn point_of(&self, vertex: u32) -> Option<u32> {
        self.vertex_of.binary_search(&vertex).ok().map(|point| point as u32)
    }

    /// The edge between two points.
    pub fn edge_between(&self, a: u32, b: u32) -> Option<u32> {
        let same = |e: &&u32| {
            let e = &self.edges[**e as usize];
            (e.a, e.b) == (a, b) || (e.a, e.b) == (b, a)
        };
        self.point_edges.get(a as usize)?.iter().find(same).copied()
    }

    /// The end of an edge that is not the point.
    pub fn other_end(&self, edge: u32, point: u32) -> u32 {
        let edge = &self.edges[edge as usize];
        if edge.a == point { edge.b } else { edge.a }
    }

    /// Checks that both halves are still each other's image.
    pub fn check_symmetry(&self, vertices: &[[f64; 3]]) -> Result<(), PanelError> {
        // Those that were found at this tolerance stay within it, whichever way the distance is rounded.
        let tolerance = 1.001 * symmetry_tolerance(vertices);
        for (point, &vertex) in self.vertex_of.iter().enumerate() {
            let x = Vector3::from(vertices[vertex as usize]);
            if self.on_plane[point] && x.y.abs() > tolerance {
                let text = format!("vertices[{vertex}] has left the plane, y = {}", x.y);
                return Err(PanelError::NotSymmetric(text));
            }
            let Some(partner) = &self.partner else { continue };
            let image = mirrored(Vector3::from(vertices[partner[point] as usize]));
            if (x - image).norm() > tolerance {
                let text = format!(
                    "vertices[{vertex}] and the image of vertices[{}] are {} m apart, more than {tolerance}",
                    partner[point],
                    (x - image).norm()
                );
                return Err(PanelError::NotSymmetric(text));
            }
        }
        Ok(())
    }

    /// Points of the solved half: the mean of both halves if the mesh has both, and y = 0 on the plane.
    pub fn gather(&self, vertices: &[[f64; 3]]) -> Vec<Vector3> {
        let at = |v: u32| Vector3::from(vertices[v as usize]);
        (0..self.vertex_of.len())
            .map(|point| {
                let mut x = at(self.vertex_of[point]);
                if let Some(partner) = &self.partner {
                    x = 0.5 * (x + mirrored(at(partner[point])));
                }
                if self.on_plane[point] {
                    x.y = 0.0;
                }
                x
            })
            .collect()
    }

    /// The transpose of [`gather`](Self::gather).
    pub fn scatter(&self, seeds: &[Vector3]) -> Vec<[f64; 3]> {
        let mut out = vec![[0.0; 3]; self.vertices];
        let mut add = |v: u32, x: Vector3| (0..3).for_each(|k| out[v as usize][k] += x[k]);
        for (point, seed) in seeds.iter().enumerate() {
            let mut x = *seed;
            if self.on_plane[point] {
                x.y = 0.0;
            }
            match &self.partner {
                Some(partner) => {
                    add(self.vertex_of[point], 0.5 * x);
                    add(partner[point], 0.5 * mirrored(x));
                }
                None => add(self.vertex_of[point], x),
            }
        }
        out
    }
}

/// The mesh cells that are solved, and of every mesh cell its panel and whether it is the panel's mirror image. Of a mesh with both halves
/// the starboard one is solved.
fn solved_cells(mesh: &SurfaceMesh, mirror: Option<&Partners>) -> (Vec<u32>, Vec<(u32, bool)>) {
    let starboard =
        |cell: &Cell| cell.vertices().iter().map(|v| mesh.vertices[*v as usize][1]).sum::<f64>() > 0.0;
    let cell_of: Vec<u32> = (0..mesh.cells.len() as u32)
        .filter(|&cell| mirror.is_none() || starboard(&mesh.cells[cell as usize]))
        .collect();
    let mut panel_of = vec![(0, false); mesh.cells.len()];
    for (panel, &cell) in cell_of.iter().enumerate() {
        panel_of[cell as usize] = (panel as u32, false);
        if let Some(partners) = mirror {
            panel_of[partners.cells[cell as usize] as usize] = (panel as u32, true);
        }
    }
    (cell_of, panel_of)
}

/// The edges, each as its first panel runs through it.
fn oriented_edges(topology: &Topology, cells: &[Cell]) -> Vec<Edge> {
    let edge = |(&[a, b], around): (&[u32; 2], &[u32])| {
        let first = around[0];
        let runs = cells[first as usize].edges().any(|side| side == [a, b]);
        let [a, b] = if runs { [a, b] } else { [b, a] };
        Edge { a, b, left: first, right: around.get(1).copied() }
    };
    topology.edges.iter().zip(topology.edge_cells.rows()).map(edge).collect()
}
