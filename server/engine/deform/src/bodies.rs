//! Components in one state, from the user's control points.

use std::sync::Arc;

use moldline_geometry::{Body, Component};
use rayon::prelude::*;

use crate::error::ControlPointsError;

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
