//! Constraints (sec. III.F of the paper), and the check that the vertices that they hold still lie on their components at the
//! end.

use std::{collections::HashSet, sync::Arc};

use moldline_geometry::Body;
use moldline_mesh::SurfaceMesh;
use moldline_spline::Vector3;
use rayon::prelude::*;

use crate::{
    DeformError,
    error::{Constraint, LISTED, VertexDistance},
    ownership::{Freedom, Ownership},
};

/// The constraints of a set-up.
#[derive(Clone, Debug)]
pub(crate) struct Constraints {
    /// That of each vertex.
    of: Vec<Option<Constraint>>,
    ownership: Arc<Ownership>,
    /// Distance within which a vertex lies on a component, m.
    tolerance: f64,
}

impl Constraints {
    /// `stationary`: the vertices that stay where they are in space. `polished`: whether the seam search ends on the seams.
    pub fn new(stationary: &[bool], ownership: Arc<Ownership>, polished: bool, tolerance: f64) -> Self {
        let constraint = |(v, stationary): (u32, &bool)| {
            // A soft bracket alone leaves the seam off its target: `seam_residual` says by how much.
            let searched = !polished && ownership.is_seam(v);
            let protected = || !searched && ownership.of(v).iter().any(|a| a.freedom != Freedom::Surface);
            if *stationary {
                Some(Constraint::Stationary)
            } else {
                protected().then_some(Constraint::Protected)
            }
        };
        let of = ownership.vertices().zip(stationary).map(constraint).collect();
        Self { of, ownership, tolerance }
    }

    /// Largest distance of a held vertex from a component that it lies on, m.
    ///
    /// # Errors
    /// [`DeformError::Held`] where it is more than the tolerance with which the mesh was attached to its components.
    pub fn residual(&self, vertices: &[[f64; 3]], bodies: &[Body]) -> Result<f64, DeformError> {
        let distances: Vec<(u32, Constraint, f64)> = self
            .ownership
            .vertices()
            .into_par_iter()
            .zip(&self.of)
            .filter_map(|(v, constraint)| {
                let constraint = (*constraint)?;
                let x = Vector3::from(vertices[v as usize]);
                let owners = self.ownership.of(v).iter().map(|a| &bodies[a.component as usize]);
                let farthest = owners.map(|body| distance(body, &x, self.tolerance)).fold(0.0, f64::max);
                Some((v, constraint, farthest))
            })
            .collect();
        for constraint in [Constraint::Stationary, Constraint::Protected] {
            let mut off: Vec<VertexDistance> = distances
                .iter()
                .filter(|&&(_, of, distance)| of == constraint && distance > self.tolerance)
                .map(|&(vertex, _, distance)| VertexDistance { vertex, distance })
                .collect();
            if !off.is_empty() {
                let count = off.len();
                off.truncate(LISTED);
                return Err(DeformError::Held { constraint, count, tolerance: self.tolerance, worst: off });
            }
        }
        Ok(distances.iter().map(|&(_, _, distance)| distance).fold(0.0, f64::max))
    }
}

/// Whether a vertex is in one of the named groups, for each vertex.
pub(crate) fn in_groups(mesh: &SurfaceMesh, names: &[String]) -> Vec<bool> {
    let mut mask = vec![false; mesh.vertices.len()];
    let names: HashSet<&str> = names.iter().map(String::as_str).collect();
    let groups = mesh.vertex_groups.iter().filter(|g| names.contains(g.name.as_str()));
    groups.flat_map(|g| &g.indices).for_each(|&v| mask[v as usize] = true);
    mask
}

/// The distance of a point that is expected within `near` of a component.
fn distance(body: &Body, x: &Vector3, near: f64) -> f64 {
    body.closest_point_within(x, near).unwrap_or_else(|| body.closest_point(x)).distance.abs()
}
