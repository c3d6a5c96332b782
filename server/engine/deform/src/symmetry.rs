//! Mirror symmetry at the plane y = 0, and holes of the mesh: the open side of a half model in that plane is none.

use std::sync::Arc;

use moldline_mesh::{Plane, SurfaceMesh, Topology, symmetry::pair_vertices};
use moldline_spline::Vector3;

use crate::SetupError;

/// How the configuration mirrors itself at y = 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Symmetry {
    /// It does not.
    None,
    /// Both halves are meshed, vertex by vertex mirror images.
    Full,
    /// One half is meshed; its border lies in the plane.
    Half,
}

/// The symmetry of a mesh.
pub(crate) struct MeshSymmetry {
    pub kind: Symmetry,
    /// The plane.
    pub plane: Plane,
    /// Distance within which a vertex lies in it, m.
    pub tolerance: f64,
    /// The mirror image of every vertex of a mesh with both halves.
    pub mirror: Option<Vec<u32>>,
}

/// The vertices that stay in the symmetry plane.
#[derive(Clone, Debug)]
pub(crate) struct InPlane(Arc<[bool]>);

impl MeshSymmetry {
    /// The symmetry that is `wanted`, or that of the mesh if that is `None`.
    ///
    /// # Errors
    /// [`SetupError::NotSymmetric`] if the mesh does not have the symmetry wanted.
    pub fn find(
        mesh: &SurfaceMesh,
        topology: &Topology,
        tolerance: f64,
        wanted: Option<bool>,
    ) -> Result<Self, SetupError> {
        let plane = Plane::y_zero();
        let (kind, mirror) = kind(mesh, topology, &plane, tolerance, wanted)?;
        Ok(Self { kind, plane, tolerance, mirror })
    }

    /// Plane and tolerance of a half model.
    pub fn half(&self) -> Option<(&Plane, f64)> {
        (self.kind == Symmetry::Half).then_some((&self.plane, self.tolerance))
    }

    /// The vertices that stay in the plane.
    pub fn in_plane(&self, mesh: &SurfaceMesh) -> InPlane {
        let in_plane = |x: &[f64; 3]| {
            self.kind != Symmetry::None && self.plane.signed_distance(x).abs() <= self.tolerance
        };
        InPlane(mesh.vertices.iter().map(in_plane).collect())
    }

    /// The edges with one cell that are not on the border in the plane.
    pub fn open_edges(&self, mesh: &SurfaceMesh, topology: &Topology) -> Vec<u32> {
        topology.open_edges(&mesh.vertices, self.half())
    }
}

impl InPlane {
    /// Whether a vertex stays in the plane.
    pub fn contains(&self, vertex: u32) -> bool {
        self.0[vertex as usize]
    }

    /// How many vertices stay in it.
    pub fn count(&self) -> usize {
        self.0.iter().filter(|in_plane| **in_plane).count()
    }

    /// A vertex at `x`, or its projection onto the plane if it stays there. Linear.
    pub fn project(&self, vertex: u32, x: Vector3) -> Vector3 {
        if self.contains(vertex) { Vector3::new(x.x, 0.0, x.z) } else { x }
    }

    /// The same for tangents or seeds of a vertex in several directions.
    pub fn project_row(&self, vertex: u32, row: &mut [f64]) {
        if self.contains(vertex) {
            row.iter_mut().skip(1).step_by(3).for_each(|y| *y = 0.0);
        }
    }
}

fn kind(
    mesh: &SurfaceMesh,
    topology: &Topology,
    plane: &Plane,
    tolerance: f64,
    wanted: Option<bool>,
) -> Result<(Symmetry, Option<Vec<u32>>), SetupError> {
    if wanted == Some(false) {
        return Ok((Symmetry::None, None));
    }
    let side = |sign: f64| mesh.vertices.iter().all(|x| sign * plane.signed_distance(x) >= -tolerance);
    let border_in_plane = !topology.boundary_edges.is_empty()
        && topology.open_edges(&mesh.vertices, Some((plane, tolerance))).len()
            < topology.boundary_edges.len();
    if border_in_plane && (side(1.0) || side(-1.0)) {
        return Ok((Symmetry::Half, None));
    }
    match pair_vertices(&mesh.vertices, plane, tolerance) {
        Ok(mirror) => Ok((Symmetry::Full, Some(mirror))),
        Err(error) if wanted == Some(true) => Err(SetupError::NotSymmetric(error)),
        Err(_) => Ok((Symmetry::None, None)),
    }
}
