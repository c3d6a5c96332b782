//! Inputs of a deformation: a design, and control points given in place of what it makes of some components.

use moldline_parameterisation::{ControlPoints, Override};

use crate::{DeformError, Monitor, Setup, Stage, bodies::check_points};

/// What a deformation starts from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Inputs {
    /// Values of the design variables, each in its declared unit.
    pub design: Vec<f64>,
    /// Components whose control points are given; the design does not reach them.
    pub given: Vec<Override>,
}

impl From<Vec<f64>> for Inputs {
    fn from(design: Vec<f64>) -> Self {
        Self { design, given: Vec::new() }
    }
}

impl From<&[f64]> for Inputs {
    fn from(design: &[f64]) -> Self {
        design.to_vec().into()
    }
}

impl From<&Vec<f64>> for Inputs {
    fn from(design: &Vec<f64>) -> Self {
        design.clone().into()
    }
}

impl<const N: usize> From<&[f64; N]> for Inputs {
    fn from(design: &[f64; N]) -> Self {
        design.to_vec().into()
    }
}

/// A direction of the inputs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Direction {
    /// Of the design variables, each in its declared unit; `None`: they stay.
    pub design: Option<Vec<f64>>,
    /// Of the control points of some components (index, vectors in m), on top of what the design does to them.
    pub control_points: Vec<(usize, Vec<[f64; 3]>)>,
}

impl From<&[f64]> for Direction {
    fn from(design: &[f64]) -> Self {
        Self { design: Some(design.to_vec()), control_points: Vec::new() }
    }
}

impl From<ControlPoints> for Direction {
    fn from(control_points: ControlPoints) -> Self {
        Self { design: None, control_points: control_points.into_iter().enumerate().collect() }
    }
}

impl Setup {
    /// The control points of inputs within the bounds of the design variables: per component, the user's, Cartesian, m.
    pub(crate) fn control_points(
        &self,
        inputs: &Inputs,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<ControlPoints, DeformError> {
        monitor.progress(Stage::Geometry, 0.0);
        self.parameterisation.validate(&inputs.design)?;
        let control_points = self.parameterisation.control_points_with(&inputs.design, &inputs.given)?;
        let given = |component| inputs.given.iter().any(|given| given.component == component);
        self.reach.check(&self.components, &control_points, &given)?;
        Ok(control_points)
    }

    /// Tangents of all control points for directions of the inputs at a design. `given`: the components that the design does not
    /// reach.
    pub(crate) fn control_points_jvp(
        &self,
        design: &[f64],
        given: &[usize],
        directions: &[Direction],
    ) -> Result<Vec<ControlPoints>, DeformError> {
        let designs: Vec<&[f64]> = directions.iter().filter_map(|d| d.design.as_deref()).collect();
        let mut of_designs = self.parameterisation.linearise(design)?.jvp(&designs)?.into_iter();
        let tangent = |direction: &Direction| {
            let of_design = direction.design.as_ref().and_then(|_| of_designs.next());
            let mut tangents = of_design.unwrap_or_else(|| self.no_control_points());
            given.iter().for_each(|&component| tangents[component].fill([0.0; 3]));
            for (component, vectors) in &direction.control_points {
                check_points(&self.components, *component, vectors)?;
                let coordinates = tangents[*component].as_flattened_mut();
                coordinates.iter_mut().zip(vectors.as_flattened()).for_each(|(sum, x)| *sum += x);
            }
            Ok(tangents)
        };
        directions.iter().map(tangent).collect()
    }

    /// The transpose of [`control_points_jvp`](Self::control_points_jvp): gradients with respect to the design for those with
    /// respect to the control points.
    pub(crate) fn control_points_vjp(
        &self,
        design: &[f64],
        given: &[usize],
        gradients: &mut [ControlPoints],
    ) -> Result<Vec<Vec<f64>>, DeformError> {
        let at = self.parameterisation.linearise(design)?;
        let by_design = |gradient: &mut ControlPoints| {
            // The design does not reach these: their gradients are put aside for a moment.
            let aside: Vec<Vec<[f64; 3]>> = given
                .iter()
                .map(|&component| {
                    let zeros = vec![[0.0; 3]; gradient[component].len()];
                    std::mem::replace(&mut gradient[component], zeros)
                })
                .collect();
            let design = at.vjp(std::slice::from_ref(gradient))?.swap_remove(0);
            given.iter().zip(aside).for_each(|(&component, points)| gradient[component] = points);
            Ok(design)
        };
        gradients.iter_mut().map(by_design).collect()
    }

    fn no_control_points(&self) -> ControlPoints {
        self.components.iter().map(|c| vec![[0.0; 3]; c.user_control_point_count()]).collect()
    }
}
