//! The engine's own linearisation as the one under test.

use moldline_deform::{DeformError, Linearisation, Tangent};

use crate::{
    Stages,
    check::{Linear, Outputs},
};

impl Linear for Linearisation {
    fn outputs(&self) -> Outputs {
        let deformation = self.deformation();
        Outputs { vertices: deformation.vertices.clone(), functions: deformation.functions.clone() }
    }

    fn jvp(&self, directions: &[Vec<f64>]) -> Result<Vec<Outputs>, DeformError> {
        let tangents = Self::jvp(self, directions)?;
        Ok(tangents.into_iter().map(|t| Outputs { vertices: t.vertices, functions: t.functions }).collect())
    }

    fn vjp(&self, seeds: &[Outputs]) -> Result<Vec<Vec<f64>>, DeformError> {
        let seeds: Vec<Tangent> = seeds
            .iter()
            .map(|s| Tangent { vertices: s.vertices.clone(), functions: s.functions.clone() })
            .collect();
        Ok(Self::vjp(self, &seeds)?.into_iter().map(|gradient| gradient.design).collect())
    }

    fn stages(&self, direction: &[f64]) -> Result<Stages, DeformError> {
        let stages = Self::stages(self, &direction.into())?;
        Ok(Stages {
            control_points: stages.control_points,
            seam_positions: stages.seam_positions,
            seam_parameters: stages.seam_parameters,
            motions: stages.motions,
            displacements: stages.displacements,
            placed: stages.placed,
            vertices: stages.vertices,
            functions: stages.functions,
        })
    }
}
