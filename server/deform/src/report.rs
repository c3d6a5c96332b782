//! What a set-up found, as plain data and as text.

use std::fmt;

use moldline_mesh::QualityReport;

use crate::{Options, seam_setup::SeamSummary};

/// One component of a set-up.
#[derive(Clone, Debug, PartialEq)]
pub struct ComponentSummary {
    /// Its name.
    pub name: String,
    /// Patches, after splitting at C0 knots.
    pub patches: usize,
    /// Vertices of the mesh on it, seam vertices included.
    pub vertices: usize,
    /// Cells of the mesh on it.
    pub cells: usize,
    /// Largest distance of its vertices from it, as given, m.
    pub largest_distance: f64,
    /// Root mean square of these distances, m.
    pub rms_distance: f64,
}

/// Vertices by what the constraints leave to them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ProtectedSummary {
    /// Slide along a sharp edge.
    pub on_edges: usize,
    /// Follow their component at fixed parameters.
    pub fixed: usize,
    /// Stay in the symmetry plane.
    pub in_plane: usize,
    /// Stay where they are in space.
    pub stationary: usize,
}

/// One displacement field.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldSummary {
    /// Component it moves, or `all`.
    pub region: String,
    /// Training vertices.
    pub training_vertices: usize,
    /// Of them, vertices of seams.
    pub seam_vertices: usize,
    /// What the field is measured in: `surface parameters` or `space`.
    pub coordinates: &'static str,
    /// Memory of the factor, bytes.
    pub bytes: usize,
}

/// How the configuration mirrors itself at y = 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Symmetry {
    /// It does not.
    None,
    /// Both halves are meshed, vertex by vertex mirror images.
    Full,
    /// One half is meshed; its border lies in the plane.
    Half,
}

/// What a set-up found.
#[derive(Clone, Debug, PartialEq)]
pub struct SetupReport {
    /// Number of vertices.
    pub vertices: usize,
    /// Number of quadrilaterals.
    pub quadrilaterals: usize,
    /// Number of triangles.
    pub triangles: usize,
    /// Reference length (diagonal of the bounding box), m.
    pub length: f64,
    /// Distance within which a vertex lies on a component, m.
    pub surface_tolerance: f64,
    /// The components.
    pub components: Vec<ComponentSummary>,
    /// The seams.
    pub seams: Vec<SeamSummary>,
    /// Largest distance from its components of a seam vertex as searched in the reference state, m.
    pub seam_residual: f64,
    /// No open edges but those in the symmetry plane of a half model.
    pub watertight: bool,
    /// Edges with one cell.
    pub open_edges: usize,
    /// Vertices - edges + cells.
    pub euler: i64,
    /// Pieces that are not connected to one another.
    pub pieces: usize,
    /// Enclosed volume, m^3 (of a half model: that of the half).
    pub volume: f64,
    /// Mirror symmetry.
    pub symmetry: Symmetry,
    /// Cells whose normal points against their component's, and the least cosine between the two.
    pub against_normal: usize,
    /// Least cosine between a cell's normal and its component's.
    pub least_normal_agreement: f64,
    /// Constrained vertices.
    pub protected: ProtectedSummary,
    /// The displacement fields.
    pub fields: Vec<FieldSummary>,
    /// Sharpness of the smooth union, 1/m.
    pub rho: f64,
    /// The options in force.
    pub options: Options,
    /// Quality of the reference mesh.
    pub quality: QualityReport,
}

impl fmt::Display for SetupReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let cells = self.quadrilaterals + self.triangles;
        writeln!(
            f,
            "mesh        {} vertices, {cells} cells ({} quadrilaterals, {} triangles), {} piece{}",
            self.vertices,
            self.quadrilaterals,
            self.triangles,
            self.pieces,
            if self.pieces == 1 { "" } else { "s" }
        )?;
        let closed = if self.watertight { "watertight" } else { "open" };
        writeln!(
            f,
            "topology    {closed} ({} open edges), Euler number {}, volume {:.4} m^3, symmetry: {}",
            self.open_edges,
            self.euler,
            self.volume,
            match self.symmetry {
                Symmetry::None => "none",
                Symmetry::Full => "both halves",
                Symmetry::Half => "half model",
            }
        )?;
        writeln!(
            f,
            "normals     {} cells against their component, least cosine {:.4}",
            self.against_normal, self.least_normal_agreement
        )?;
        writeln!(f, "tolerance   {:.3e} m (reference length {:.3} m)", self.surface_tolerance, self.length)?;
        writeln!(
            f,
            "components  name               patches  vertices     cells  largest distance   rms [m]"
        )?;
        for c in &self.components {
            writeln!(
                f,
                "            {:<18} {:>7} {:>9} {:>9}        {:>10.2e}  {:>8.2e}",
                c.name, c.patches, c.vertices, c.cells, c.largest_distance, c.rms_distance
            )?;
        }
        for s in &self.seams {
            if s.reference.is_empty() {
                writeln!(f, "junctions   {}: {} vertices", s.components.join(" + "), s.vertices)?;
            } else {
                writeln!(
                    f,
                    "seam        {}: {} vertices, searched {} of {}, crossing at {:.1} deg or more, brackets {:.2} to \
                     {:.2} of the line",
                    s.components.join(" + "),
                    s.vertices,
                    match s.direction {
                        "across" => "across it, along lines".to_owned(),
                        parameter => format!("along {parameter}"),
                    },
                    s.reference,
                    s.transversality.min(1.0).asin().to_degrees(),
                    s.bracket[0],
                    s.bracket[1]
                )?;
            }
        }
        if !self.seams.is_empty() {
            writeln!(f, "            found again in the reference state to {:.2e} m", self.seam_residual)?;
        }
        let p = &self.protected;
        writeln!(
            f,
            "protected   {} on sharp edges, {} fixed to their component, {} in the symmetry plane, {} stationary",
            p.on_edges, p.fixed, p.in_plane, p.stationary
        )?;
        for field in &self.fields {
            writeln!(
                f,
                "field       {}: in {}, {} training vertices, {} of them on seams, factor {:.1} MB",
                field.region,
                field.coordinates,
                field.training_vertices,
                field.seam_vertices,
                field.bytes as f64 / 1e6
            )?;
        }
        write!(f, "\n{}", self.quality)
    }
}
