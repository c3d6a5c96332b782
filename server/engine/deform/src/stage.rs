//! Stages of set-up and deformation, for progress reports.

/// A stage of a computation, in the order in which they run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// Set-up: topology and symmetry of the mesh.
    Mesh,
    /// Set-up: projection of the vertices onto their components.
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
    /// The stages of a set-up, in order.
    pub const OF_SETUP: [Self; 6] =
        [Self::Mesh, Self::Ownership, Self::Seams, Self::Training, Self::Factorisation, Self::Report];

    /// Its name in reports and protocols.
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
}

impl std::fmt::Display for Stage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}
