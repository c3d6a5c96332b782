//! Options of a set-up: the user's choices.

use moldline_rbf::Kernel;

use crate::SetupError;

/// The surface on which the deformed mesh ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum OuterMoldLine {
    /// The union of the components as they are: seam vertices on all their components, all others on their owner.
    Sharp,
    /// The zero set of the smooth union (eq. 8 and 18 of the paper): every vertex that is not protected has `Phi = 0`.
    Smooth,
}

/// How the displacement of the training vertices reaches all others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Propagation {
    /// One field of absolute displacements for the whole mesh (eq. 9, 13, 15 to 17 of the paper).
    Absolute,
    /// Every vertex follows its component; only the departure of the seams from that motion is interpolated, component
    /// by component, in the deformed configuration.
    Departure,
    /// As `Departure`, but the departure is measured and interpolated on the undeformed component and moves a vertex
    /// along its surface: stretching, rotation and translation of the component stay out of the interpolation, and
    /// the result lies on the deformed component by construction.
    Surface,
}

/// Numbers of steps and tolerances of the seam search (eq. 10 to 14).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeamOptions {
    /// Soft bisection steps before the polish.
    pub soft_steps: usize,
    /// Whether Newton steps finish the search. Without them the seam is where the paper's soft bisection leaves it, with the
    /// derivative of that: off the target by about the reference length over the square root of `eta`, for comparison.
    pub polish: bool,
    /// Sharpness of the soft indicator `(1 + tanh(eta z)) / 2`, `z` made dimensionless by the reference length.
    pub eta: f64,
    /// Largest residual `|g|` accepted at a root, relative to the reference length.
    pub tolerance: f64,
    /// Distance at which the smooth union of several targets rounds a right angle, relative to the reference length.
    pub fillet: f64,
}

impl Default for SeamOptions {
    fn default() -> Self {
        Self { soft_steps: 6, polish: true, eta: 1e6, tolerance: 1e-13, fillet: 1e-9 }
    }
}

/// Graph-Laplacian smoothing interleaved with the projection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmoothingOptions {
    /// Number of rounds of smoothing and projection; none by default.
    pub rounds: usize,
    /// Weight of the neighbours' mean in a round, 0..=1.
    pub relaxation: f64,
}

impl Default for SmoothingOptions {
    fn default() -> Self {
        Self { rounds: 0, relaxation: 0.5 }
    }
}

/// What is done about an event that a deformation brings: components that come to cross where they did not, or a surface that passes through
/// itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OnEvent {
    /// The design is refused.
    #[default]
    Refuse,
    /// The answer says so.
    Report,
    /// Nothing looks for it.
    Ignore,
}

/// The choices of a set-up. Lengths are relative to the reference length (the diagonal of the bounding box of
/// the mesh) unless a field says metres, so that nothing depends on the unit of length.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// The surface to end on.
    pub outer_mold_line: OuterMoldLine,
    /// Fillet length of the smooth outer mold line, metres: how far it stands off a right-angled seam.
    /// `rho = sqrt(2) ln(2) / fillet`. `None`: 5e-4 of the reference length.
    pub fillet: Option<f64>,
    /// How displacements propagate.
    pub propagation: Propagation,
    /// Radial function; `None`: cubic for `Absolute` and `Departure`, linear for `Surface`.
    pub kernel: Option<Kernel>,
    /// Regularisation added to the diagonal of the radial basis system, relative to its scale; 0 interpolates.
    pub regularisation: f64,
    /// Largest number of training vertices, all components together. Seam and protected vertices come first.
    pub training_vertices: usize,
    /// Blending radius as a fraction of the largest distance from a seam on the same component.
    pub blend_radius: f64,
    /// Other blending fractions for some components, by name.
    pub blend_radius_of: Vec<(String, f64)>,
    /// A vertex belongs to the components that are nearer than this.
    pub surface_tolerance: f64,
    /// Whether a mesh with holes is accepted. The symmetry plane of a half model is no hole.
    pub open_mesh: bool,
    /// Whether the configuration is symmetric about the plane y = 0: found from the mesh when `None`.
    pub symmetric: Option<bool>,
    /// Vertex groups that follow their component exactly.
    pub protected_groups: Vec<String>,
    /// Vertex groups that stay where they are in space.
    pub stationary_groups: Vec<String>,
    /// What is done about collisions.
    pub on_event: OnEvent,
    /// The seam search.
    pub seam: SeamOptions,
    /// Smoothing after the field.
    pub smoothing: SmoothingOptions,
    /// Steps of the projection at most.
    pub projection_steps: usize,
    /// Largest `|Phi|` accepted at the end, relative to the reference length.
    pub projection_tolerance: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            outer_mold_line: OuterMoldLine::Sharp,
            fillet: None,
            propagation: Propagation::Surface,
            kernel: None,
            regularisation: 0.0,
            training_vertices: 1500,
            blend_radius: 0.9,
            blend_radius_of: Vec::new(),
            surface_tolerance: 1e-6,
            open_mesh: false,
            symmetric: None,
            protected_groups: Vec::new(),
            stationary_groups: Vec::new(),
            on_event: OnEvent::default(),
            seam: SeamOptions::default(),
            smoothing: SmoothingOptions::default(),
            projection_steps: 20,
            projection_tolerance: 1e-11,
        }
    }
}

impl Options {
    /// The radial function in force.
    pub fn kernel(&self) -> Kernel {
        self.kernel.unwrap_or(match self.propagation {
            Propagation::Absolute | Propagation::Departure => Kernel::Cubic,
            Propagation::Surface => Kernel::Multiquadric,
        })
    }

    /// Checks every number against its range.
    ///
    /// # Errors
    /// [`SetupError::Option`] naming the field, its value and the range.
    pub fn validate(&self) -> Result<(), SetupError> {
        let check = |field: &str, value: f64, low: f64, high: f64| {
            if value >= low && value <= high {
                Ok(())
            } else {
                Err(SetupError::Option { field: field.to_owned(), value, low, high })
            }
        };
        if let Some(fillet) = self.fillet {
            check("fillet", fillet, f64::MIN_POSITIVE, f64::MAX)?;
        }
        check("regularisation", self.regularisation, 0.0, 1e6)?;
        check("training_vertices", self.training_vertices as f64, 8.0, 20_000.0)?;
        check("blend_radius", self.blend_radius, 1e-3, 1.0)?;
        for (name, radius) in &self.blend_radius_of {
            check(&format!("blend_radius_of.{name}"), *radius, 1e-3, 1.0)?;
        }
        check("surface_tolerance", self.surface_tolerance, 1e-12, 1e-2)?;
        check("seam.soft_steps", self.seam.soft_steps as f64, 0.0, 60.0)?;
        check("seam.eta", self.seam.eta, 1e-3, f64::MAX)?;
        check("seam.tolerance", self.seam.tolerance, 1e-15, 1e-3)?;
        check("seam.fillet", self.seam.fillet, 1e-15, 1e-1)?;
        check("smoothing.rounds", self.smoothing.rounds as f64, 0.0, 1000.0)?;
        check("smoothing.relaxation", self.smoothing.relaxation, 0.0, 1.0)?;
        check("projection_steps", self.projection_steps as f64, 1.0, 1000.0)?;
        check("projection_tolerance", self.projection_tolerance, 1e-15, 1e-3)
    }
}
