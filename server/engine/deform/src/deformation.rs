//! Deformed meshes: the vertices and outputs of the chain, their residuals and quality.

use moldline_geometry::{Body, Location};
use moldline_mesh::{CellQuality, QualityReport, quality};

use crate::{DeformError, Inputs, Monitor, Setup, Stage, chain::State};

/// A deformed mesh.
#[derive(Clone, Debug)]
pub struct Deformation {
    /// All vertices, m, in the order of the set-up's mesh.
    pub vertices: Vec<[f64; 3]>,
    /// Values of the scalar outputs, in the order of [`Setup::functions`].
    pub functions: Vec<f64>,
    /// Parameters of each vertex on its first owner (for `Smooth`: before the projection onto the fillet).
    pub locations: Vec<Location>,
    /// Quality of the mesh against the deformed components.
    pub quality: QualityReport,
    /// Measures of every cell.
    pub cell_quality: Vec<CellQuality>,
    /// Largest distance of a seam vertex from one of its components before the smooth projection, m.
    pub seam_residual: f64,
    /// Largest distance of a protected or stationary vertex from a component that it lies on, m.
    pub held_residual: f64,
    /// Largest `|Phi|` of an active vertex at the end, m; zero for `Sharp`.
    pub projection_residual: f64,
    /// Most projection steps that a vertex took.
    pub projection_steps: usize,
    /// Pairs of cells that pass through each other and did not in the set-up's mesh (at most 1000); a cell that meets its own mirror image is a pair
    /// with itself.
    pub crossings: Vec<[u32; 2]>,
}

impl Setup {
    /// The mesh of a design (one number a variable, in the declared units), or of other [`Inputs`].
    ///
    /// # Errors
    /// [`DeformError`]: the inputs are refused, a seam is lost, or the projection does not converge.
    pub fn deform(
        &self,
        inputs: impl Into<Inputs>,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Deformation, DeformError> {
        self.deform_control_points(&self.control_points(&inputs.into(), monitor)?, monitor)
    }

    /// The mesh of components whose control points all come from elsewhere: per component, the user's, Cartesian, m. The bounds of
    /// the design variables do not count.
    ///
    /// # Errors
    /// As [`Setup::deform`], and [`DeformError::ControlPoints`] if they do not fit.
    pub fn deform_control_points(
        &self,
        control_points: &[Vec<[f64; 3]>],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Deformation, DeformError> {
        let state = self.chain.eval(self.bodies(control_points)?, monitor)?;
        self.measure(state, monitor)
    }

    /// The deformed mesh of a state, with its quality.
    ///
    /// # Errors
    /// [`DeformError::Held`] if a constraint is not kept, [`DeformError::Collision`] if cells pass through each other; cancelled.
    pub(crate) fn measure(
        &self,
        state: State,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Deformation, DeformError> {
        let locations: Vec<Location> = state.smoothed().iter().map(|p| p.location).collect();
        let State { bodies, seams, projected, functions, .. } = state;
        let held_residual = self.constraints.residual(&projected.vertices, &bodies)?;
        let names = |component: u32| self.components[component as usize].name().to_owned();
        let crossings = self.collisions.find(&projected.vertices, names, monitor)?;
        let (cell_quality, quality) = self.quality(&projected.vertices, &locations, &bodies);
        monitor.progress(Stage::Quality, 1.0);
        Ok(Deformation {
            functions,
            locations,
            quality,
            cell_quality,
            seam_residual: seams.iter().map(|p| p.residual).fold(0.0, f64::max),
            held_residual,
            crossings,
            projection_residual: projected.residual,
            projection_steps: projected.most_steps(),
            vertices: projected.vertices,
        })
    }

    fn quality(
        &self,
        vertices: &[[f64; 3]],
        locations: &[Location],
        bodies: &[Body],
    ) -> (Vec<CellQuality>, QualityReport) {
        let (cells, owners) = (&self.mesh.cells, &self.ownership.cell_owner);
        let normals = self.inspection.normals(cells, owners, vertices, locations, bodies);
        let of_cells = quality::evaluate(vertices, cells, &normals);
        // A set-up has cells, so that there is a report.
        let report =
            self.inspection.report(&of_cells, owners).unwrap_or_else(|| self.report().quality.clone());
        (of_cells, report)
    }
}
