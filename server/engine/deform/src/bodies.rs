//! Components in one state, from the user's control points.

use std::sync::Arc;

use moldline_geometry::{Body, Component, Vector3};
use rayon::prelude::*;

use crate::error::{ControlPointsError, Source};

/// The components with the given control points, per component.
///
/// # Errors
/// If counts do not match or a coordinate is not finite.
pub(crate) fn bodies(
    components: &[Arc<Component>],
    control_points: &[Vec<[f64; 3]>],
) -> Result<Vec<Body>, ControlPointsError> {
    if components.len() != control_points.len() {
        let (found, expected) = (control_points.len(), components.len());
        return Err(ControlPointsError::Components { found, expected });
    }
    for (component, points) in control_points.iter().enumerate() {
        check_points(components, component, points)?;
    }
    Ok(components
        .par_iter()
        .zip(control_points)
        .map(|(component, points)| Body::new(component.clone(), component.internal_control_points(points)))
        .collect())
}

/// The space that control points may lie in: a ball around the mesh. Far outside of it lies nothing that the mesh could
/// follow, and coordinates are too coarse for the tolerances of the searches.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reach {
    middle: Vector3,
    radius: f64,
}

impl Reach {
    /// Radius, in reference lengths.
    pub(crate) const LENGTHS: f64 = 1000.0;

    /// `middle`: that of the mesh; `length`: the reference length, m.
    pub(crate) fn new(middle: Vector3, length: f64) -> Self {
        Self { middle, radius: Self::LENGTHS * length }
    }

    /// Refuses control points outside. `source`: where those of a component come from.
    pub(crate) fn check(
        &self,
        components: &[Arc<Component>],
        control_points: &[Vec<[f64; 3]>],
        source: impl Fn(usize) -> Source,
    ) -> Result<(), ControlPointsError> {
        let squared = self.radius * self.radius;
        for (component, points) in control_points.iter().enumerate() {
            // Squares that overflow are outside, too; coordinates that are not finite have an error of their own.
            let outside = |x: &[f64; 3]| {
                x.iter().all(|x| x.is_finite()) && (Vector3::from(*x) - self.middle).norm_squared() > squared
            };
            if let Some(point) = points.iter().position(outside) {
                return Err(ControlPointsError::Far {
                    component,
                    name: components.get(component).map_or_else(String::new, |c| c.name().to_owned()),
                    point,
                    position: points[point],
                    limit: self.radius,
                    moved_by: source(component),
                });
            }
        }
        Ok(())
    }
}

/// Whether there is such a component, and `points` are one finite vector for each of its control points.
pub(crate) fn check_points(
    components: &[Arc<Component>],
    component: usize,
    points: &[[f64; 3]],
) -> Result<(), ControlPointsError> {
    let Some(of) = components.get(component) else {
        return Err(ControlPointsError::Components { found: component + 1, expected: components.len() });
    };
    let (found, expected) = (points.len(), of.user_control_point_count());
    if found != expected {
        let name = of.name().to_owned();
        return Err(ControlPointsError::Points { component, name, found, expected });
    }
    for (point, x) in points.iter().enumerate() {
        if let Some(axis) = x.iter().position(|x| !x.is_finite()) {
            return Err(ControlPointsError::NotFinite { component, point, axis, value: x[axis] });
        }
    }
    Ok(())
}
