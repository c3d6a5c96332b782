//! Central differences of the engine's own deformations.

use moldline_deform::{DeformError, Monitor, Setup, Stage};

/// Displacements of all vertices for a unit of a variable or along a direction, m.
pub type Derivative = Vec<[f64; 3]>;

/// `(x(p + h d) - x(p - h d)) / 2 h` of the vertices; the bounds of the variables are ignored.
///
/// # Errors
/// [`DeformError`] of either deformation.
pub fn central_difference(
    setup: &Setup,
    design: &[f64],
    direction: &[f64],
    step: f64,
    monitor: &dyn Monitor<Stage>,
) -> Result<Derivative, DeformError> {
    let at = |h: f64| -> Result<Vec<[f64; 3]>, DeformError> {
        let design: Vec<f64> = design.iter().zip(direction).map(|(p, d)| p + h * d).collect();
        let control_points = setup.parameterisation().control_points(&design)?;
        Ok(setup.deform_control_points(&control_points, monitor)?.vertices)
    };
    let (above, below) = (at(step)?, at(-step)?);
    let slope = |(a, b): (&[f64; 3], &[f64; 3])| [0, 1, 2].map(|axis| (a[axis] - b[axis]) / (2.0 * step));
    Ok(above.iter().zip(&below).map(slope).collect())
}

/// Root of the sum of squares over all vertices.
pub fn norm(x: &[[f64; 3]]) -> f64 {
    x.iter().flatten().map(|x| x * x).sum::<f64>().sqrt()
}

/// `|a - b| / |b|` over all vertices; zero where both vanish.
pub fn relative_error(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    let difference: Derivative =
        a.iter().zip(b).map(|(a, b)| [a[0] - b[0], a[1] - b[1], a[2] - b[2]]).collect();
    let (difference, size) = (norm(&difference), norm(b));
    if difference == 0.0 { 0.0 } else { difference / size }
}
