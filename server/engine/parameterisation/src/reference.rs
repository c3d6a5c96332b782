//! The reference geometry: components as patches with control points.

use std::ops::Range;

use moldline_foundation::Vector3;
use moldline_spline::Surface;

use crate::error::ParameterisationError;

/// One patch in its reference state, as the user gave it.
#[derive(Clone, Debug)]
pub struct PatchReference {
    /// The tensor-product basis; its shape is `(n_u, n_v)`.
    pub surface: Surface,
    /// Cartesian control points, m, `n_u * n_v` of them, index `i * n_v + j`.
    pub control_points: Vec<[f64; 3]>,
    /// Weights in the same order; empty for a non-rational patch.
    pub weights: Vec<f64>,
}

/// One component in its reference state. Its control points are those of its patches, one patch after the other.
#[derive(Clone, Debug)]
pub struct ComponentReference {
    /// The name that operations refer to.
    pub name: String,
    /// Its patches.
    pub patches: Vec<PatchReference>,
}

/// The control points of all components, one component after the other, with the range of each.
///
/// # Errors
/// A component without patches, a patch whose lists do not fit its basis, or a number that is not finite.
pub(crate) fn reference_points(
    components: &[ComponentReference],
) -> Result<(Vec<Range<usize>>, Vec<Vector3>), ParameterisationError> {
    let mut points = Vec::new();
    let mut ranges = Vec::with_capacity(components.len());
    for (c, component) in components.iter().enumerate() {
        let start = points.len();
        for (p, patch) in component.patches.iter().enumerate() {
            patch.check(c, p)?;
            points.extend(patch.control_points.iter().map(|&p| Vector3::from(p)));
        }
        if points.len() == start {
            return Err(ParameterisationError::Empty { field: format!("components[{c}].patches") });
        }
        ranges.push(start..points.len());
    }
    Ok((ranges, points))
}

impl PatchReference {
    /// Checks counts and finite numbers; `component` and `patch` are its indices for messages.
    fn check(&self, component: usize, patch: usize) -> Result<(), ParameterisationError> {
        let (n_u, n_v) = self.surface.shape();
        let mismatch = |what, found| {
            Err(ParameterisationError::PatchSize { component, patch, what, found, expected: n_u * n_v })
        };
        if self.control_points.len() != n_u * n_v {
            return mismatch("control points", self.control_points.len());
        }
        if !self.weights.is_empty() && self.weights.len() != n_u * n_v {
            return mismatch("weights", self.weights.len());
        }
        let field = |what: &str, i: usize| {
            format!("components[{component}].patches[{patch}].{what}[{}][{}]", i / n_v, i % n_v)
        };
        for (i, point) in self.control_points.iter().enumerate() {
            if let Some(axis) = point.iter().position(|v| !v.is_finite()) {
                return Err(ParameterisationError::NotFinite {
                    field: format!("{}[{axis}]", field("control_points", i)),
                    value: point[axis],
                });
            }
        }
        if let Some(i) = self.weights.iter().position(|w| !w.is_finite()) {
            return Err(ParameterisationError::NotFinite {
                field: field("weights", i),
                value: self.weights[i],
            });
        }
        Ok(())
    }
}
