//! Products with the derivative of a deformation: `J V` for blocks of directions, `J^T W` for blocks of seeds.
//!
//! A linearisation keeps the derivative of each step of the [`chain`](crate::chain); applying it iterates and searches nothing.
//! Before these steps come the control points of the inputs.

use std::sync::Arc;

use moldline_geometry::Block;
use moldline_parameterisation::ControlPoints;
use moldline_spline::Vector3;
use rayon::prelude::*;

use crate::{
    DeformError, Deformation, Direction, Inputs, Monitor, Setup, Stage,
    chain::{ChainDerivative, Passing},
};

/// Directions and seeds that are handled at once.
const BLOCK: usize = 48;

/// A change of the outputs in one direction, or the seed of one adjoint.
#[derive(Clone, Debug, PartialEq)]
pub struct Tangent {
    /// Of the mesh's vertices, m (seeds: per m).
    pub vertices: Vec<[f64; 3]>,
    /// Of the scalar outputs, in their units, in the order of [`Setup::functions`].
    pub functions: Vec<f64>,
}

/// The gradient of one seed's product with the outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradient {
    /// With respect to the design variables, per declared unit.
    pub design: Vec<f64>,
    /// With respect to the user's Cartesian control points, per component, 1/m.
    pub control_points: ControlPoints,
}

/// Tangents of everything from the control points to the outputs, in one direction.
#[derive(Clone, Debug, Default)]
pub struct Stages {
    /// Of the user's control points, per component.
    pub control_points: ControlPoints,
    /// Of the seam vertices.
    pub seam_positions: Vec<Vector3>,
    /// Of their parameters `(u, v)`, per owner.
    pub seam_parameters: Vec<Vec<[f64; 2]>>,
    /// Of the motion of each seam vertex in the terms of each field.
    pub motions: Vec<Vec<Vector3>>,
    /// Of the field value of every vertex.
    pub displacements: Vec<Vector3>,
    /// Of every vertex on its component, after smoothing.
    pub placed: Vec<Vector3>,
    /// Of every vertex.
    pub vertices: Vec<Vector3>,
    /// The scalar outputs, each in its unit.
    pub functions: Vec<f64>,
}

/// A deformation with its derivative.
#[derive(Debug)]
pub struct Linearisation {
    setup: Arc<Setup>,
    design: Vec<f64>,
    /// Components whose control points were given.
    given: Vec<usize>,
    deformation: Deformation,
    chain: ChainDerivative,
}

impl Setup {
    /// The mesh of a design, or of other [`Inputs`], with its derivative.
    ///
    /// # Errors
    /// As [`Setup::deform`].
    pub fn linearise(
        self: &Arc<Self>,
        inputs: impl Into<Inputs>,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Linearisation, DeformError> {
        let inputs = inputs.into();
        let control_points = self.control_points(&inputs, monitor)?;
        let state = self.chain.eval(self.bodies(&control_points)?, monitor)?;
        let chain = self.chain.linearise(&state);
        let deformation = self.measure(state, monitor)?;
        let mut given: Vec<usize> = inputs.given.iter().map(|given| given.component).collect();
        given.sort_unstable();
        given.dedup();
        Ok(Linearisation { setup: self.clone(), design: inputs.design, given, deformation, chain })
    }
}

impl Linearisation {
    /// The deformed mesh.
    pub fn deformation(&self) -> &Deformation {
        &self.deformation
    }

    /// The set-up.
    pub fn setup(&self) -> &Arc<Setup> {
        &self.setup
    }

    /// The design.
    pub fn design(&self) -> &[f64] {
        &self.design
    }

    /// Bytes held besides the set-up.
    pub fn bytes(&self) -> usize {
        let deformation = size_of_val(&self.deformation.vertices[..])
            + size_of_val(&self.deformation.locations[..])
            + size_of_val(&self.deformation.cell_quality[..]);
        self.chain.bytes() + deformation + size_of_val(&self.design[..])
    }

    /// `J v` for each of the `directions` in design space, in the declared units.
    ///
    /// # Errors
    /// [`DeformError::Design`] for a direction of the wrong length.
    pub fn jvp<V: AsRef<[f64]>>(&self, directions: &[V]) -> Result<Vec<Tangent>, DeformError> {
        let directions: Vec<Direction> = directions.iter().map(|v| v.as_ref().into()).collect();
        self.jvp_inputs(&directions)
    }

    /// `J v` for each of the `directions` of the inputs.
    ///
    /// # Errors
    /// [`DeformError::Design`] or [`DeformError::ControlPoints`] for a direction that does not fit.
    pub fn jvp_inputs(&self, directions: &[Direction]) -> Result<Vec<Tangent>, DeformError> {
        let mut all = Vec::with_capacity(directions.len());
        let control_points = self.setup.control_points_jvp(&self.design, &self.given, directions)?;
        for control_points in control_points.chunks(BLOCK) {
            all.extend(self.jvp_block(control_points));
        }
        Ok(all)
    }

    /// `J^T w` for each of the `seeds`.
    ///
    /// # Errors
    /// [`DeformError::SeedSize`] if a seed does not have the mesh's vertices and the set-up's functions.
    pub fn vjp(&self, seeds: &[Tangent]) -> Result<Vec<Gradient>, DeformError> {
        let mut control_points = self.vjp_control_points(seeds)?;
        let design = self.setup.control_points_vjp(&self.design, &self.given, &mut control_points)?;
        let both = design.into_iter().zip(control_points);
        Ok(both.map(|(design, control_points)| Gradient { design, control_points }).collect())
    }

    /// The part of [`vjp`](Self::vjp) with respect to the control points, per component, 1/m.
    ///
    /// # Errors
    /// As `vjp`.
    pub fn vjp_control_points(&self, seeds: &[Tangent]) -> Result<Vec<ControlPoints>, DeformError> {
        let refuse = |index, what, found, expected| DeformError::SeedSize { index, what, found, expected };
        let (vertices, functions) = (self.deformation.vertices.len(), self.deformation.functions.len());
        for (index, seed) in seeds.iter().enumerate() {
            if seed.vertices.len() != vertices {
                return Err(refuse(index, "vertices", seed.vertices.len(), vertices));
            }
            if seed.functions.len() != functions {
                return Err(refuse(index, "functions", seed.functions.len(), functions));
            }
        }
        Ok(seeds.chunks(BLOCK).flat_map(|seeds| self.vjp_block(seeds)).collect())
    }

    /// All tangents from the control points to the outputs for one direction of the inputs.
    ///
    /// # Errors
    /// As [`Linearisation::jvp_inputs`].
    pub fn stages(&self, direction: &Direction) -> Result<Stages, DeformError> {
        let directions = std::slice::from_ref(direction);
        let control_points = self.setup.control_points_jvp(&self.design, &self.given, directions)?;
        let mut stages = Stages::default();
        let watch = |passing: &Passing<'_>| stages = self.passing(passing);
        let (vertices, functions) = self.setup.chain.jvp(&self.chain, &self.internal(&control_points), watch);
        stages.control_points = control_points.into_iter().next().unwrap_or_default();
        stages.vertices = self.vectors(&vertices);
        stages.functions = functions.data().to_vec();
        Ok(stages)
    }

    fn passing(&self, Passing { seams, motions, values, placed }: &Passing<'_>) -> Stages {
        let chain = &self.setup.chain;
        let wide = |row: &[f64]| Vector3::from_fn(|axis, _| row.get(axis).copied().unwrap_or(0.0));
        let seam_vertices = || 0..chain.seams.vertices.len();
        let rows = chain.seams.first_rows();
        let parameters = |row| [seams.parameters.row(row)[0], seams.parameters.row(row)[1]];
        Stages {
            seam_positions: seam_vertices().map(|i| seams.positions.vector(i, 0)).collect(),
            seam_parameters: rows.windows(2).map(|of| (of[0]..of[1]).map(parameters).collect()).collect(),
            motions: motions
                .iter()
                .map(|block| seam_vertices().map(|i| wide(block.row(i))).collect())
                .collect(),
            displacements: self
                .setup
                .ownership
                .vertices()
                .map(|v| wide(chain.fields.value(values, v)))
                .collect(),
            placed: self.vectors(placed),
            ..Stages::default()
        }
    }

    fn vectors(&self, block: &Block) -> Vec<Vector3> {
        (0..self.deformation.vertices.len()).map(|v| block.vector(v, 0)).collect()
    }

    /// Blocks of the internal control points for directions of the user's.
    fn internal(&self, directions: &[ControlPoints]) -> Vec<Block> {
        self.setup
            .components
            .par_iter()
            .enumerate()
            .map(|(c, component)| {
                let mut user = Block::zeros(component.user_control_point_count(), 3 * directions.len());
                for (d, direction) in directions.iter().enumerate() {
                    for (i, point) in direction[c].iter().enumerate() {
                        user.row_mut(i)[3 * d..3 * d + 3].copy_from_slice(point);
                    }
                }
                component.internal_jvp(&user)
            })
            .collect()
    }

    fn jvp_block(&self, directions: &[ControlPoints]) -> Vec<Tangent> {
        let (vertices, functions) = self.setup.chain.jvp(&self.chain, &self.internal(directions), |_| {});
        (0..directions.len())
            .into_par_iter()
            .map(|d| Tangent {
                vertices: (0..self.deformation.vertices.len())
                    .map(|v| vertices.vector(v, d).into())
                    .collect(),
                functions: (0..self.deformation.functions.len()).map(|f| functions.row(f)[d]).collect(),
            })
            .collect()
    }

    fn vjp_block(&self, seeds: &[Tangent]) -> Vec<ControlPoints> {
        let k = seeds.len();
        let mut vertices = Block::zeros(self.deformation.vertices.len(), 3 * k);
        let mut functions = Block::zeros(self.deformation.functions.len(), k);
        for (d, seed) in seeds.iter().enumerate() {
            for (v, x) in seed.vertices.iter().enumerate() {
                vertices.row_mut(v)[3 * d..3 * d + 3].copy_from_slice(x);
            }
            seed.functions.iter().enumerate().for_each(|(f, s)| functions.row_mut(f)[d] = *s);
        }
        let control_points = self.setup.chain.vjp(&self.chain, vertices, &functions);
        let user: Vec<Block> = control_points
            .par_iter()
            .zip(&self.setup.components)
            .map(|(block, component)| component.internal_vjp(block))
            .collect();
        (0..k)
            .map(|d| {
                let points = |block: &Block| {
                    (0..block.data().len() / (3 * k)).map(|i| block.vector(i, d).into()).collect()
                };
                user.iter().map(points).collect()
            })
            .collect()
    }
}
