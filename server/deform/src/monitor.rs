//! Progress and cancellation of long work, seen from the engine.

/// Told how far the work has come, and asked whether to go on.
pub trait Monitor: Sync {
    /// `stage` has come to `fraction` (0..=1) of its work.
    fn progress(&self, stage: Stage, fraction: f64);

    /// Whether the caller has lost interest. Polled inside loops; work then ends with a `Cancelled` error.
    fn cancelled(&self) -> bool {
        false
    }
}

/// Reports nothing and is never cancelled.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Monitor for Silent {
    fn progress(&self, _: Stage, _: f64) {}
}

/// What is being done, in the order in which it is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// Set-up: topology and symmetry of the mesh.
    Mesh,
    /// Set-up: which component each vertex lies on, and where.
    Ownership,
    /// Set-up: seams, their search lines and brackets.
    Seams,
    /// Set-up: distances to the seams and training vertices.
    Training,
    /// Set-up: factorisation of the radial basis functions.
    Factorisation,
    /// Set-up: quality of the reference mesh.
    Report,
    /// Deform: control points of the design.
    Geometry,
    /// Deform: search for the deformed seams.
    SeamSearch,
    /// Deform: displacement field.
    Field,
    /// Deform: vertices onto the outer mold line.
    Projection,
    /// Deform: quality of the deformed mesh.
    Quality,
}

impl Stage {
    /// Those of a set-up.
    pub const OF_SETUP: [Self; 6] =
        [Self::Mesh, Self::Ownership, Self::Seams, Self::Training, Self::Factorisation, Self::Report];

    /// A word for people and protocols.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mesh => "mesh",
            Self::Ownership => "ownership",
            Self::Seams => "seams",
            Self::Training => "training",
            Self::Factorisation => "factorisation",
            Self::Report => "report",
            Self::Geometry => "geometry",
            Self::SeamSearch => "seam search",
            Self::Field => "field",
            Self::Projection => "projection",
            Self::Quality => "quality",
        }
    }

    /// The stages of a set-up.
    pub const SETUP: [Self; 6] =
        [Self::Mesh, Self::Ownership, Self::Seams, Self::Training, Self::Factorisation, Self::Report];

    /// The stages of a deformation.
    pub const DEFORM: [Self; 5] =
        [Self::Geometry, Self::SeamSearch, Self::Field, Self::Projection, Self::Quality];
}

impl std::fmt::Display for Stage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}
