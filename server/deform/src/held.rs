//! Vertices that the constraints hold (sec. III.F of the paper): whether they still lie on their components at the end.

use moldline_geometry::Body;
use moldline_spline::Vector3;
use rayon::prelude::*;

use crate::{
    DeformError, Setup,
    error::{LISTED, VertexDistance},
    ownership::Freedom,
};

/// What holds a vertex, as errors name it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hold {
    /// It stays where it is in space.
    Stationary,
    /// It keeps to a sharp edge, or to its place on the component.
    Protected,
}

impl std::fmt::Display for Hold {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Stationary => "stationary",
            Self::Protected => "protected",
        })
    }
}

impl Setup {
    /// Largest distance of a held vertex from a component that it lies on, m.
    ///
    /// # Errors
    /// [`DeformError::Held`] where it is more than the tolerance with which the mesh was attached to its components.
    pub(crate) fn held_residual(&self, vertices: &[[f64; 3]], bodies: &[Body]) -> Result<f64, DeformError> {
        let tolerance = self.options.surface_tolerance * self.length;
        let distances: Vec<(u32, Hold, f64)> = (0..vertices.len() as u32)
            .into_par_iter()
            .filter_map(|v| {
                let x = Vector3::from(vertices[v as usize]);
                let hold = self.hold(v)?;
                let owners = self.ownership.of(v).iter().map(|a| &bodies[a.component as usize]);
                Some((v, hold, owners.map(|body| distance(body, &x, tolerance)).fold(0.0, f64::max)))
            })
            .collect();
        for hold in [Hold::Stationary, Hold::Protected] {
            let mut off: Vec<VertexDistance> = distances
                .iter()
                .filter(|&&(_, held, distance)| held == hold && distance > tolerance)
                .map(|&(vertex, _, distance)| VertexDistance { vertex, distance })
                .collect();
            if !off.is_empty() {
                let count = off.len();
                off.truncate(LISTED);
                return Err(DeformError::Held { hold, count, tolerance, worst: off });
            }
        }
        Ok(distances.iter().map(|&(_, _, distance)| distance).fold(0.0, f64::max))
    }

    fn hold(&self, v: u32) -> Option<Hold> {
        // A soft bracket alone leaves the seam off its target: `seam_residual` says by how much.
        let searched = !self.seams.options.polish && self.ownership.is_seam(v);
        let protected = || !searched && self.ownership.of(v).iter().any(|a| a.freedom != Freedom::Surface);
        if self.stationary[v as usize] {
            Some(Hold::Stationary)
        } else {
            protected().then_some(Hold::Protected)
        }
    }
}

/// The distance of a point that is expected within `near` of a component.
fn distance(body: &Body, x: &Vector3, near: f64) -> f64 {
    body.closest_point_within(x, near).unwrap_or_else(|| body.closest_point(x)).distance.abs()
}
