//! Mirror planes, and the pairing of vertices across them.

use thiserror::Error;

use crate::{Vector3, grid::HashGrid};

/// A plane `normal . x = offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    normal: Vector3,
    offset: f64,
}

/// Why a plane is not valid, or vertices cannot be paired.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SymmetryError {
    /// The normal has no direction.
    #[error("plane normal {normal:?} with offset {offset} is not a finite vector with a length")]
    Plane {
        /// The normal given.
        normal: [f64; 3],
        /// The offset given.
        offset: f64,
    },
    /// Vertices without a mirror image.
    #[error(
        "{count} vertices have no mirror image within {tolerance}, the first is vertices[{vertex}] = {position:?}; \
         mirror one half of the mesh, or raise the tolerance"
    )]
    Unpaired {
        /// Number of such vertices.
        count: usize,
        /// Index of the first.
        vertex: usize,
        /// Position of the first, m.
        position: [f64; 3],
        /// The tolerance, m.
        tolerance: f64,
    },
}

impl Plane {
    /// The plane through `offset * normal / |normal|`, perpendicular to `normal` (of any length).
    ///
    /// # Errors
    /// [`SymmetryError::Plane`] if the normal is zero or anything is not finite.
    pub fn new(normal: [f64; 3], offset: f64) -> Result<Self, SymmetryError> {
        let length = Vector3::from(normal).norm();
        if length > 0.0 && length.is_finite() && offset.is_finite() {
            Ok(Self { normal: Vector3::from(normal) / length, offset })
        } else {
            Err(SymmetryError::Plane { normal, offset })
        }
    }

    /// The aircraft's usual plane, y = 0.
    pub fn y_zero() -> Self {
        Self { normal: Vector3::y(), offset: 0.0 }
    }

    /// The unit normal.
    pub fn normal(&self) -> &Vector3 {
        &self.normal
    }

    /// Distance from the plane, positive on the normal's side, m.
    pub fn signed_distance(&self, x: &[f64; 3]) -> f64 {
        self.normal.dot(&Vector3::from(*x)) - self.offset
    }

    /// The mirror image. Exact for coordinate planes.
    pub fn mirror(&self, x: &[f64; 3]) -> [f64; 3] {
        (Vector3::from(*x) - 2.0 * self.signed_distance(x) * self.normal).into()
    }

    /// The nearest point of the plane.
    pub fn project(&self, x: &[f64; 3]) -> [f64; 3] {
        (Vector3::from(*x) - self.signed_distance(x) * self.normal).into()
    }
}

/// `mirror[v]`: the vertex within `tolerance` of the mirror image of `v`; `v` itself for vertices within `tolerance` of
/// the plane. The pairing is its own inverse.
///
/// # Errors
/// [`SymmetryError::Unpaired`] if a vertex has no partner, or if its partner already has another.
pub fn pair_vertices(
    vertices: &[[f64; 3]],
    plane: &Plane,
    tolerance: f64,
) -> Result<Vec<u32>, SymmetryError> {
    let extent = vertices.iter().flatten().fold(0.0, |extent: f64, x| extent.max(x.abs()));
    let mut grid = HashGrid::new(tolerance, extent);
    let on_plane = |x: &[f64; 3]| plane.signed_distance(x).abs() <= tolerance;
    for (vertex, x) in vertices.iter().enumerate().filter(|(_, x)| !on_plane(x)) {
        grid.insert(x, vertex as u32);
    }
    let partner = |(vertex, x): (usize, &[f64; 3])| {
        if on_plane(x) { Some(vertex as u32) } else { grid.nearest(&plane.mirror(x), vertices) }
    };
    let partners: Vec<Option<u32>> = vertices.iter().enumerate().map(partner).collect();
    let mutual =
        |vertex: usize| partners[vertex].filter(|&partner| partners[partner as usize] == Some(vertex as u32));
    let mirror: Vec<u32> = (0..vertices.len()).map_while(mutual).collect();
    match vertices.get(mirror.len()) {
        None => Ok(mirror),
        Some(&position) => {
            let count = (0..vertices.len()).filter(|&vertex| mutual(vertex).is_none()).count();
            Err(SymmetryError::Unpaired { count, vertex: mirror.len(), position, tolerance })
        }
    }
}
