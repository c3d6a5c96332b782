//! The chain of a deformation (Algorithm 1 of the paper): its steps in order, and in reverse for the adjoint.
//!
//! bodies -> seam points -> motions of the seams -> field values -> vertices on their components -> smoothed ->
//! on the outer mold line -> scalar outputs
//!
//! Each step is a type in a file of its own, with what the set-up decides about it (`new`, or a builder), its value (`eval`),
//! its derivative at that value (`linearise`) and products with it (`jvp`, `vjp`). `linearise` takes what `eval` found and
//! searches nothing.

pub mod field;
pub(crate) mod foot;
pub(crate) mod motion;
pub mod outputs;
pub(crate) mod parallel;
pub(crate) mod placement;
pub(crate) mod projection;
pub mod seams;
pub(crate) mod smoothing;

use std::sync::Arc;

use moldline_geometry::{Block, Body};
use moldline_mesh::SurfaceMesh;

use crate::{DeformError, Monitor, Stage, ownership::Ownership};
use field::Fields;
use foot::Placed;
use motion::{Motions, MotionsDerivative};
use outputs::{Measured, Outputs, OutputsDerivative};
use placement::{Placement, PlacementDerivative};
use projection::{Projected, Projection, ProjectionDerivative};
use seams::{SeamDerivative, SeamPoint, SeamSolver, SeamTangents};
use smoothing::{Smoothing, SmoothingDerivative};

/// The steps of a set-up.
#[derive(Debug)]
pub(crate) struct Chain {
    pub seams: SeamSolver,
    pub motions: Motions,
    pub fields: Fields,
    pub placement: Placement,
    pub smoothing: Smoothing,
    pub projection: Projection,
    pub outputs: Outputs,
    /// The components in the reference state.
    pub reference: Arc<[Body]>,
    pub mesh: Arc<SurfaceMesh>,
    pub ownership: Arc<Ownership>,
}

/// What each step found.
#[derive(Debug)]
pub(crate) struct State {
    /// The deformed components.
    pub bodies: Vec<Body>,
    pub seams: Vec<SeamPoint>,
    /// Motions of the seam vertices, a block a field.
    motions: Vec<Block>,
    /// Field values, a block a field.
    values: Vec<Block>,
    /// All vertices on their components, and after each round of smoothing.
    placed: Vec<Placed>,
    rounds: Vec<Vec<Placed>>,
    pub projected: Projected,
    pub functions: Vec<f64>,
}

/// The derivative of each step at a state.
#[derive(Debug)]
pub(crate) struct ChainDerivative {
    /// The deformed components, without the trees of closest-point searches.
    pub bodies: Vec<Body>,
    pub seams: SeamDerivative,
    motions: MotionsDerivative,
    placement: PlacementDerivative,
    smoothing: SmoothingDerivative,
    projection: ProjectionDerivative,
    outputs: OutputsDerivative,
}

/// Tangents between the control points and the outer mold line, on their way through the chain.
pub(crate) struct Passing<'a> {
    pub seams: &'a SeamTangents,
    pub motions: &'a [Block],
    pub values: &'a [Block],
    pub placed: &'a Block,
}

impl Chain {
    /// The vertices and outputs of the deformed `bodies`, with all that the steps find.
    ///
    /// # Errors
    /// [`DeformError`] of the step that fails.
    pub fn eval(&self, bodies: Vec<Body>, monitor: &dyn Monitor<Stage>) -> Result<State, DeformError> {
        let enter = |stage| {
            monitor.progress(stage, 0.0);
            if monitor.cancelled() { Err(DeformError::Cancelled) } else { Ok(()) }
        };
        enter(Stage::SeamSearch)?;
        let seams = self.seams.eval(&self.reference, &bodies, monitor)?;
        enter(Stage::Field)?;
        let motions = self.motions.eval(&seams, &bodies, monitor)?;
        let values = self.fields.eval(&motions, &bodies);
        enter(Stage::Projection)?;
        let placed = self.placement.eval(&self.fields, &values, &seams, &bodies, monitor)?;
        let rounds = self.smoothing.eval(&placed, &bodies, monitor)?;
        let smoothed = rounds.last().unwrap_or(&placed);
        let projected = self.projection.eval(smoothed, &self.seams, &seams, &bodies, monitor)?;
        enter(Stage::Quality)?;
        let functions = self.outputs.eval(self.measured(&projected.vertices, &bodies));
        Ok(State { bodies, seams, motions, values, placed, rounds, projected, functions })
    }

    /// The derivative at a state.
    pub fn linearise(&self, state: &State) -> ChainDerivative {
        let State { bodies, seams, motions, values, placed, rounds, projected, .. } = state;
        let without_tree = |b: &Body| Body::new(b.component().clone(), b.control_points().to_vec());
        ChainDerivative {
            seams: self.seams.linearise(seams, &self.reference, bodies),
            motions: self.motions.linearise(seams, motions),
            placement: self.placement.linearise(&self.fields, values, placed, bodies),
            smoothing: self.smoothing.linearise(rounds),
            projection: self.projection.linearise(projected),
            outputs: self.outputs.linearise(self.measured(&projected.vertices, bodies)),
            bodies: bodies.iter().map(without_tree).collect(),
        }
    }

    /// Tangents of the vertices and of the outputs for those of the internal control points, a block a component. `watch`
    /// sees those in between.
    pub fn jvp(
        &self,
        derivative: &ChainDerivative,
        control_points: &[Block],
        watch: impl FnOnce(&Passing<'_>),
    ) -> (Block, Block) {
        let (d, bodies) = (derivative, &derivative.bodies[..]);
        let seams = d.seams.jvp(bodies, control_points);
        let motions = self.motions.jvp(&d.motions, bodies, &seams, control_points);
        let values = self.fields.jvp(bodies, &motions, control_points);
        let placed = self.placement.jvp(&d.placement, bodies, &self.fields, &values, &seams, control_points);
        let placed = self.smoothing.jvp(&d.smoothing, bodies, placed, control_points);
        watch(&Passing { seams: &seams, motions: &motions, values: &values, placed: &placed });
        let vertices = self.projection.jvp(&d.projection, bodies, placed, control_points);
        let functions = d.outputs.jvp(&vertices, control_points);
        (vertices, functions)
    }

    /// The transpose of [`jvp`](Self::jvp): seeds of the internal control points for those of the vertices and of the outputs.
    pub fn vjp(&self, derivative: &ChainDerivative, vertices: Block, functions: &Block) -> Vec<Block> {
        let (d, bodies) = (derivative, &derivative.bodies[..]);
        let width = vertices.width();
        let mut control_points: Vec<Block> =
            bodies.iter().map(|b| Block::zeros(b.control_points().len(), width)).collect();
        let control = &mut control_points[..];
        let vertices = d.outputs.vjp(functions, vertices, control);
        let placed = self.projection.vjp(&d.projection, bodies, vertices, control);
        let placed = self.smoothing.vjp(&d.smoothing, bodies, placed, control);
        let mut seams = d.seams.zeros(width / 3);
        let values = self.placement.vjp(&d.placement, bodies, &self.fields, placed, &mut seams, control);
        let motions = self.fields.vjp(bodies, &values, control);
        self.motions.vjp(&d.motions, bodies, &motions, &mut seams, control);
        d.seams.vjp(bodies, seams, control);
        control_points
    }

    /// The mesh that the outputs are measured on.
    pub fn measured<'a>(&'a self, vertices: &'a [[f64; 3]], bodies: &'a [Body]) -> Measured<'a> {
        Measured {
            cells: &self.mesh.cells,
            owners: &self.ownership.cell_owner,
            vertices,
            bodies,
            origin: self.outputs.origin(),
        }
    }
}

impl State {
    /// All vertices on their components, after the last round of smoothing.
    pub fn smoothed(&self) -> &[Placed] {
        self.rounds.last().unwrap_or(&self.placed)
    }
}

impl ChainDerivative {
    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let control_points: usize = self.bodies.iter().map(|b| size_of_val(b.control_points())).sum();
        control_points
            + self.seams.bytes()
            + self.motions.bytes()
            + self.placement.bytes()
            + self.smoothing.bytes()
            + self.projection.bytes()
            + self.outputs.bytes()
    }
}
