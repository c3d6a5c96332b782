//! What does not depend on positions: solved panels, their edges and neighbours, and the symmetry plane.

use std::collections::HashMap;

use moldline_mesh::{
    Cell, Limits, Plane, SurfaceMesh, Topology, Vector3, symmetry::pair_vertices, topology::enclosed_volume,
};

use crate::{PanelError, Symmetry};

/// Distance from the plane y = 0, and between a vertex and its partner's image, as a fraction of the mesh's extent.
pub(crate) const SYMMETRY_TOLERANCE: f64 = 1e-5;

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

/// Panels of a patch at most.
const PATCH: usize = 32;

/// Panels that lie near each other, and the edges of which they are the left ones: all patches together are the surface. Loops over pairs
/// go patch by patch, so that what they need of the points stays near.
#[derive(Clone, Debug)]
pub(crate) struct Patch {
    /// Points of the panels.
    pub points: Vec<u32>,
    pub panels: Vec<u32>,
    /// Corners of the panels, as places in `points`.
    pub corners: Vec<[u32; 4]>,
    pub edges: Vec<u32>,
    /// Ends `[a, b]` of the edges, likewise.
    pub ends: Vec<[u32; 2]>,
}

/// Panels that are solved, with their own numbering of vertices ("points").
#[derive(Clone, Debug)]
pub(crate) struct Panels {
    /// Points of each panel; a triangle's last one twice.
    pub corners: Vec<[u32; 4]>,
    pub edges: Vec<Edge>,
    /// Edges of each panel.
    pub panel_edges: Vec<Vec<u32>>,
    pub patches: Vec<Patch>,
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
        let tolerance = SYMMETRY_TOLERANCE * (Vector3::from(high) - Vector3::from(low)).norm();
        let plane = Plane::y_zero();
        let half = match symmetry {
            Symmetry::Half => true,
            Symmetry::Automatic => !topology.boundary_edges.is_empty(),
            Symmetry::None | Symmetry::Mirror => false,
        };
        let open = topology.open_edges(&mesh.vertices, half.then_some((&plane, tolerance)));
        if let Some(&edge) = open.first() {
            let cell = topology.edge_cells.row(edge as usize)[0];
            return Err(PanelError::Open { count: open.len(), edge: topology.edges[edge as usize], cell });
        }
        if half && low[1] < -tolerance && high[1] > tolerance {
            let text = format!("a half model lies on one side, y ranges over {}..={}", low[1], high[1]);
            return Err(PanelError::NotSymmetric(text));
        }
        let mirror = match symmetry {
            Symmetry::Mirror => Some(mirrored_cells(mesh, &plane, tolerance)?),
            Symmetry::Automatic if !half => mirrored_cells(mesh, &plane, tolerance).ok(),
            _ => None,
        };
        let panels = Self::pick(mesh, half, mirror, tolerance);
        panels.check_orientation(mesh)?;
        Ok(panels)
    }

    fn pick(mesh: &SurfaceMesh, half: bool, mirror: Option<(Vec<u32>, Vec<u32>)>, tolerance: f64) -> Self {
        let symmetric = half || mirror.is_some();
        let (vertex_partner, cell_partner) = mirror.unzip();
        let starboard =
            |cell: &Cell| cell.vertices().iter().map(|v| mesh.vertices[*v as usize][1]).sum::<f64>() > 0.0;
        let cell_of: Vec<u32> = (0..mesh.cells.len() as u32)
            .filter(|&cell| cell_partner.is_none() || starboard(&mesh.cells[cell as usize]))
            .collect();
        let mut panel_of = vec![(0, false); mesh.cells.len()];
        for (panel, &cell) in cell_of.iter().enumerate() {
            panel_of[cell as usize] = (panel as u32, false);
            if let Some(partner) = &cell_partner {
                panel_of[partner[cell as usize] as usize] = (panel as u32, true);
            }
        }
        const UNUSED: u32 = u32::MAX;
        let mut point_of = vec![UNUSED; mesh.vertices.len()];
        let mut vertex_of: Vec<u32> =
            cell_of.iter().flat_map(|&c| mesh.cells[c as usize].vertices().iter().copied()).collect();
        vertex_of.sort_unstable();
        vertex_of.dedup();
        for (point, &vertex) in vertex_of.iter().enumerate() {
            point_of[vertex as usize] = point as u32;
        }
        let cells: Vec<Cell> =
            cell_of.iter().map(|&c| mesh.cells[c as usize].map(|v| point_of[v as usize])).collect();
        let corners: Vec<[u32; 4]> = cells
            .iter()
            .map(|cell| {
                let v = cell.vertices();
                [v[0], v[1], v[2], v[v.len() - 1]]
            })
            .collect();
        let topology = Topology::of_cells(vertex_of.len(), &cells);
        let mut edges = Vec::with_capacity(topology.edges.len());
        let mut panel_edges = vec![Vec::new(); cells.len()];
        let mut point_edges = vec![Vec::new(); vertex_of.len()];
        for (index, (&[a, b], around)) in topology.edges.iter().zip(topology.edge_cells.rows()).enumerate() {
            let runs = |cell: u32, side: [u32; 2]| cells[cell as usize].edges().any(|s| s == side);
            let first = around[0];
            let [a, b] = if runs(first, [a, b]) { [a, b] } else { [b, a] };
            edges.push(Edge { a, b, left: first, right: around.get(1).copied() });
            around.iter().for_each(|&panel| panel_edges[panel as usize].push(index as u32));
            [a, b].iter().for_each(|&point| point_edges[point as usize].push(index as u32));
        }
        let on_plane =
            vertex_of.iter().map(|&v| symmetric && mesh.vertices[v as usize][1].abs() <= tolerance).collect();
        let partner =
            vertex_partner.map(|partner: Vec<u32>| vertex_of.iter().map(|&v| partner[v as usize]).collect());
        let patches = patches(mesh, &corners, &edges, &panel_edges, &vertex_of);
        Self {
            corners,
            edges,
            panel_edges,
            patches,
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

    /// Every closed piece encloses a positive volume.
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

    pub fn is_triangle(&self, panel: usize) -> bool {
        self.corners[panel][2] == self.corners[panel][3]
    }

    /// Axes along which unit onset flows are solved.
    pub fn axes(&self) -> &'static [usize] {
        if self.symmetric { &[0, 2] } else { &[0, 1, 2] }
    }

    /// The edge between two points.
    pub fn edge_between(&self, a: u32, b: u32) -> Option<u32> {
        let same = |e: &&u32| {
            let e = &self.edges[**e as usize];
            (e.a, e.b) == (a, b) || (e.a, e.b) == (b, a)
        };
        self.point_edges.get(a as usize)?.iter().find(same).copied()
    }

    /// The other panel at an edge.
    pub fn across(&self, panel: u32, edge: u32) -> Option<u32> {
        let edge = &self.edges[edge as usize];
        if edge.left == panel { edge.right } else { Some(edge.left) }
    }

    /// That both halves are still each other's image.
    pub fn check_symmetry(&self, vertices: &[[f64; 3]]) -> Result<(), PanelError> {
        let extent = vertices.iter().flatten().fold(0.0_f64, |m, x| m.max(x.abs()));
        let tolerance = SYMMETRY_TOLERANCE * extent;
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

/// Cuts the panels into patches, by halving across the longest extent.
fn patches(
    mesh: &SurfaceMesh,
    corners: &[[u32; 4]],
    edges: &[Edge],
    panel_edges: &[Vec<u32>],
    vertex_of: &[u32],
) -> Vec<Patch> {
    let at = |point: u32| Vector3::from(mesh.vertices[vertex_of[point as usize] as usize]);
    let centres: Vec<Vector3> = corners.iter().map(|c| c.map(at).iter().sum::<Vector3>() / 4.0).collect();
    let mut sets = Vec::new();
    bisect((0..corners.len() as u32).collect(), &centres, PATCH, &mut sets);
    let patch = |panels: Vec<u32>| {
        let mut points: Vec<u32> = panels.iter().flat_map(|p| corners[*p as usize]).collect();
        points.sort_unstable();
        points.dedup();
        let place = |point: u32| points.partition_point(|p| *p < point) as u32;
        let is_own = |panel: u32, edge: u32| edges[edge as usize].left == panel;
        let own = |panel: &u32| {
            let panel = *panel;
            panel_edges[panel as usize].iter().copied().filter(move |e| is_own(panel, *e))
        };
        let own: Vec<u32> = panels.iter().flat_map(own).collect();
        Patch {
            corners: panels.iter().map(|p| corners[*p as usize].map(place)).collect(),
            ends: own.iter().map(|e| [edges[*e as usize].a, edges[*e as usize].b].map(place)).collect(),
            edges: own,
            panels,
            points,
        }
    };
    sets.into_iter().map(patch).collect()
}

/// Halves a set of panels across its longest extent until no part has more than `most`.
pub(crate) fn bisect(mut set: Vec<u32>, centres: &[Vector3], most: usize, out: &mut Vec<Vec<u32>>) {
    if set.len() <= most {
        set.sort_unstable();
        out.push(set);
        return;
    }
    let start = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    let (low, high) = set.iter().map(|i| &centres[*i as usize]).fold(start, |(l, h), c| (l.inf(c), h.sup(c)));
    let axis = (high - low).imax();
    set.sort_unstable_by(|i, j| {
        centres[*i as usize][axis].total_cmp(&centres[*j as usize][axis]).then(i.cmp(j))
    });
    let rest = set.split_off(set.len() / 2);
    bisect(set, centres, most, out);
    bisect(rest, centres, most, out);
}

/// The mirror image in y = 0.
pub(crate) fn mirrored(x: Vector3) -> Vector3 {
    Vector3::new(x.x, -x.y, x.z)
}

/// Partners of vertices and of cells in the plane.
fn mirrored_cells(
    mesh: &SurfaceMesh,
    plane: &Plane,
    tolerance: f64,
) -> Result<(Vec<u32>, Vec<u32>), PanelError> {
    let partner = pair_vertices(&mesh.vertices, plane, tolerance)
        .map_err(|error| PanelError::NotSymmetric(error.to_string()))?;
    let key = |vertices: &mut dyn Iterator<Item = u32>| {
        let mut vertices: Vec<u32> = vertices.collect();
        vertices.sort_unstable();
        vertices
    };
    let by_vertices: HashMap<Vec<u32>, u32> = mesh
        .cells
        .iter()
        .enumerate()
        .map(|(index, cell)| (key(&mut cell.vertices().iter().copied()), index as u32))
        .collect();
    let mut cells = Vec::with_capacity(mesh.cells.len());
    for (index, cell) in mesh.cells.iter().enumerate() {
        let sides = cell.vertices().iter().map(|&v| plane.signed_distance(&mesh.vertices[v as usize]));
        let (low, high) = sides.fold((0.0_f64, 0.0_f64), |(low, high), y| (low.min(y), high.max(y)));
        let image = key(&mut cell.vertices().iter().map(|&v| partner[v as usize]));
        match by_vertices.get(&image) {
            Some(&other) if other != index as u32 && (low >= -tolerance || high <= tolerance) => {
                cells.push(other);
            }
            _ => {
                let text = format!("cells[{index}] has no image, or crosses the plane");
                return Err(PanelError::NotSymmetric(text));
            }
        }
    }
    Ok((partner, cells))
}
