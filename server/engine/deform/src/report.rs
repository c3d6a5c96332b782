//! The report of a set-up, as plain data and as text.

use std::{fmt, sync::Arc};

use moldline_geometry::{Body, Component, Location};
use moldline_mesh::{
    LeftOut, MeshError, QualityReport, SurfaceMesh, Topology, area_vector, quality, topology::enclosed_volume,
};

use crate::{
    Options, SetupError,
    chain::{field::RegionField, seams::setup::SeamSummary},
    inspection::Inspection,
    ownership::{Freedom, Ownership},
    symmetry::{MeshSymmetry, Symmetry},
};

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

/// Numbers of vertices that constraints hold.
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
    /// Coordinates of the field: `surface parameters` or `space`.
    pub coordinates: &'static str,
    /// Memory of the factor, bytes.
    pub bytes: usize,
}

/// The report of a set-up.
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
    /// Cells that pointed inwards and were turned.
    pub turned_cells: usize,
    /// Parts of the mesh file that were left out.
    pub left_out: LeftOut,
    /// Vertices - edges + cells.
    pub euler: i64,
    /// Pieces that are not connected to one another.
    pub pieces: usize,
    /// Enclosed volume, m^3 (of a half model: that of the half).
    pub volume: f64,
    /// Mirror symmetry.
    pub symmetry: Symmetry,
    /// Cells whose normal points against their component's.
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

/// The findings of a set-up that its report is made from.
pub(crate) struct Findings<'a> {
    pub mesh: &'a SurfaceMesh,
    pub topology: &'a Topology,
    pub ownership: &'a Ownership,
    pub reference: &'a [Body],
    pub fields: &'a [RegionField],
    pub inspection: &'a Inspection,
    pub symmetry: &'a MeshSymmetry,
    pub options: &'a Options,
    pub length: f64,
    /// Number of edges with one cell outside the symmetry plane.
    pub open_edges: usize,
    pub turned_cells: usize,
    pub left_out: LeftOut,
    /// Number of vertices in the symmetry plane.
    pub in_plane: usize,
    /// Number of vertices that stay where they are in space.
    pub stationary: usize,
    pub components: Vec<ComponentSummary>,
    pub seams: Vec<SeamSummary>,
    pub seam_residual: f64,
    pub rho: f64,
}

impl SetupReport {
    /// The report of a set-up, with the quality of its reference mesh.
    pub(crate) fn new(found: Findings<'_>) -> Result<Self, SetupError> {
        let Findings { mesh, topology, ownership, reference, inspection, symmetry, .. } = found;
        let locations: Vec<Location> = ownership.vertices().map(|v| ownership.first(v).location).collect();
        let owners = &ownership.cell_owner;
        let normals = inspection.normals(&mesh.cells, owners, &mesh.vertices, &locations, reference);
        let cells = quality::evaluate(&mesh.vertices, &mesh.cells, &normals);
        let quality = inspection.report(&cells, owners).ok_or(MeshError::Empty { what: "cells" })?;
        let (against_normal, least_normal_agreement) =
            mesh.cells.iter().zip(&normals).fold((0, 1.0_f64), |(against, least), (cell, normal)| {
                let area = area_vector(&mesh.vertices, cell);
                let cosine = area.dot(normal) / area.norm().max(f64::MIN_POSITIVE);
                (against + usize::from(cosine < 0.0), least.min(cosine))
            });
        let count = |freedom: fn(&Freedom) -> bool| {
            ownership.vertices().filter(|&v| ownership.of(v).iter().any(|a| freedom(&a.freedom))).count()
        };
        let triangles = mesh.cells.iter().filter(|c| c.is_triangle()).count();
        let half_plane = symmetry.half().map(|(plane, _)| plane);
        Ok(Self {
            vertices: mesh.vertices.len(),
            quadrilaterals: mesh.cells.len() - triangles,
            triangles,
            length: found.length,
            surface_tolerance: symmetry.tolerance,
            components: found.components,
            seams: found.seams,
            seam_residual: found.seam_residual,
            watertight: found.open_edges == 0,
            open_edges: found.open_edges,
            turned_cells: found.turned_cells,
            left_out: found.left_out,
            euler: topology.euler(),
            pieces: topology.pieces,
            volume: enclosed_volume(&mesh.vertices, &mesh.cells, half_plane),
            symmetry: symmetry.kind,
            against_normal,
            least_normal_agreement,
            protected: ProtectedSummary {
                on_edges: count(|f| matches!(f, Freedom::Edge(_))),
                fixed: count(|f| matches!(f, Freedom::Fixed)),
                in_plane: found.in_plane,
                stationary: found.stationary,
            },
            fields: found.fields.iter().map(|field| field_summary(field, reference)).collect(),
            rho: found.rho,
            options: found.options.clone(),
            quality,
        })
    }
}

fn field_summary(region: &RegionField, components: &[Body]) -> FieldSummary {
    let training = region.field.training();
    let name = |c: u32| components[c as usize].component().name().to_owned();
    FieldSummary {
        region: region.component.map_or_else(|| "all".to_owned(), name),
        training_vertices: training.len(),
        seam_vertices: training.iter().filter(|t| t.alpha() == 1.0).count(),
        coordinates: if region.chart.is_some() { "surface parameters" } else { "space" },
        bytes: region.field.bytes(),
    }
}

/// Summaries of the components.
pub(crate) fn components(ownership: &Ownership, components: &[Arc<Component>]) -> Vec<ComponentSummary> {
    (0u32..)
        .zip(components)
        .map(|(index, component)| {
            let on = ownership.vertices().filter_map(|v| ownership.on(v, index));
            let distances: Vec<f64> = on.map(|a| a.distance).collect();
            let squares: f64 = distances.iter().map(|d| d * d).sum();
            ComponentSummary {
                name: component.name().to_owned(),
                patches: component.patches().len(),
                vertices: distances.len(),
                cells: ownership.cell_owner.iter().filter(|&&c| c == index).count(),
                largest_distance: distances.iter().copied().fold(0.0, f64::max),
                rms_distance: (squares / distances.len().max(1) as f64).sqrt(),
            }
        })
        .collect()
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
        let LeftOut { nodes, merged_nodes, other_cells, collapsed_cells } = self.left_out;
        if self.left_out != LeftOut::default() {
            let counts = [
                (nodes, "nodes without cells"),
                (other_cells, "other cells (volumes, ghosts)"),
                (collapsed_cells, "collapsed cells"),
            ];
            let counts = counts.iter().filter(|(count, _)| *count > 0);
            let counts: Vec<String> = counts.map(|(count, what)| format!("{count} {what}")).collect();
            let left_out = if counts.is_empty() { "nothing".to_owned() } else { counts.join(", ") };
            writeln!(f, "left out    {left_out}; {merged_nodes} nodes merged into others")?;
        }
        if self.turned_cells > 0 {
            writeln!(f, "turned      {} cells, which pointed inwards", self.turned_cells)?;
        }
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
