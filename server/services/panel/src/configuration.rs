//! Configurations: meshes prepared for the panel method, named by the hash of their content.

use std::sync::Arc;

use blake3::Hasher;
use moldline_host::{Claim, ServiceError};
use moldline_mesh::{Cell, Group, SurfaceMesh};
use moldline_panel::{
    Monitor, OnDoubt, Options, PanelError, PanelSetup, SetupSummary, Stage, Symmetry, TrailingEdges,
};

use crate::merging::Merging;

/// Input of a configuration.
#[derive(Clone, Debug)]
pub struct Definition {
    /// Vertices of each cell.
    pub cells: Vec<Cell>,
    /// Reference positions, m.
    pub vertices: Vec<[f64; 3]>,
    /// Named parts of the surface.
    pub cell_groups: Vec<Group>,
    /// Named vertices.
    pub vertex_groups: Vec<Group>,
    /// Options; the memory limit is that of the service.
    pub options: Options,
    /// Distance within which vertices become one, m; none if absent.
    pub merge_tolerance: Option<f64>,
}

/// A prepared mesh. Immutable.
#[derive(Debug)]
pub struct Configuration {
    /// Hash of the content.
    pub id: String,
    /// The set-up of the panel method.
    pub setup: PanelSetup,
    /// Summary of the set-up.
    pub summary: SetupSummary,
    /// Reference positions, m: the caller's.
    pub vertices: Arc<Vec<[f64; 3]>>,
    /// How vertices are merged.
    pub merging: Option<Merging>,
    /// Number of cells.
    pub cells: usize,
    _claim: Claim,
}

impl Definition {
    /// The hash of the content. The same on every machine.
    pub fn id(&self) -> String {
        let mut hasher = Hasher::new();
        hasher.update(b"moldline panel configuration 1\n");
        count(&mut hasher, self.vertices.len());
        points(&mut hasher, &self.vertices);
        count(&mut hasher, self.cells.len());
        for cell in &self.cells {
            let corners = cell.vertices();
            count(&mut hasher, corners.len());
            indices(&mut hasher, corners);
        }
        for groups in [&self.cell_groups, &self.vertex_groups] {
            count(&mut hasher, groups.len());
            for group in groups {
                name(&mut hasher, &group.name);
                count(&mut hasher, group.indices.len());
                indices(&mut hasher, &group.indices);
            }
        }
        let Options { symmetry, trailing_edges, components, solver, tolerance, on_doubt, memory_limit: _ } =
            &self.options;
        name(&mut hasher, word(*symmetry));
        match trailing_edges {
            TrailingEdges::None => name(&mut hasher, "none"),
            TrailingEdges::Edges(edges) => {
                name(&mut hasher, "edges");
                count(&mut hasher, edges.len());
                indices(&mut hasher, edges.as_flattened());
            }
            TrailingEdges::Groups(groups) => {
                name(&mut hasher, "groups");
                names(&mut hasher, groups);
            }
            TrailingEdges::Angle { degrees } => {
                name(&mut hasher, "angle");
                hasher.update(&degrees.to_le_bytes());
            }
        }
        match components {
            None => name(&mut hasher, "all"),
            Some(components) => {
                name(&mut hasher, "some");
                names(&mut hasher, components);
            }
        }
        name(&mut hasher, &format!("{solver:?}"));
        hasher.update(&tolerance.to_le_bytes());
        if *on_doubt == OnDoubt::Warn {
            name(&mut hasher, "warn");
        }
        if let Some(distance) = self.merge_tolerance {
            name(&mut hasher, "merge");
            hasher.update(&distance.to_le_bytes());
        }
        hasher.finalize().to_hex().to_string()
    }

    /// Approximate size of the configuration, bytes: data of each cell, and the vertices.
    pub fn bytes(&self) -> u64 {
        const OF_CELL: u64 = 2048;
        let grouped: usize =
            self.cell_groups.iter().chain(&self.vertex_groups).map(|g| g.indices.len()).sum();
        OF_CELL * self.cells.len() as u64 + 64 * self.vertices.len() as u64 + 8 * grouped as u64
    }

    /// Validates and prepares it.
    ///
    /// # Errors
    /// `InvalidArgument` naming the invalid field; `ResourceExhausted` if an analysis would need more memory than
    /// `memory_limit`.
    pub fn prepare(
        self,
        id: String,
        limits: &moldline_mesh::Limits,
        memory_limit: u64,
        claim: Claim,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Configuration, ServiceError> {
        let Self { cells, vertices, cell_groups, vertex_groups, mut options, merge_tolerance } = self;
        options.memory_limit = memory_limit;
        let mesh = SurfaceMesh::with_limits(vertices, cells, cell_groups, vertex_groups, limits)
            .map_err(PanelError::from)?;
        let cells = mesh.cells.len();
        let vertices = Arc::new(mesh.vertices.clone());
        let (setup, merging) = match merge_tolerance {
            None => (PanelSetup::monitored(&mesh, options, monitor)?, None),
            Some(tolerance) => {
                let (merging, mesh) = Merging::new(mesh, tolerance)?;
                options.trailing_edges = merging.trailing_edges(options.trailing_edges);
                let setup =
                    PanelSetup::monitored(&mesh, options, monitor).map_err(|error| merging.explain(error))?;
                (setup, Some(merging))
            }
        };
        let summary = setup.summary();
        let summary = match &merging {
            Some(merging) => merging.summary(summary),
            None => summary,
        };
        Ok(Configuration { id, setup, summary, vertices, merging, cells, _claim: claim })
    }
}

fn word(symmetry: Symmetry) -> &'static str {
    match symmetry {
        Symmetry::Automatic => "automatic",
        Symmetry::None => "none",
        Symmetry::Half => "half",
        Symmetry::Mirror => "mirror",
    }
}

fn count(hasher: &mut Hasher, count: usize) {
    hasher.update(&(count as u64).to_le_bytes());
}

fn name(hasher: &mut Hasher, text: &str) {
    count(hasher, text.len());
    hasher.update(text.as_bytes());
}

fn names(hasher: &mut Hasher, names: &[String]) {
    count(hasher, names.len());
    names.iter().for_each(|text| name(hasher, text));
}

fn indices(hasher: &mut Hasher, indices: &[u32]) {
    for index in indices {
        hasher.update(&index.to_le_bytes());
    }
}

/// Hashes coordinates, in bulk on little-endian machines.
pub(crate) fn points(hasher: &mut Hasher, points: &[[f64; 3]]) {
    if cfg!(target_endian = "little") {
        hasher.update(bytemuck::cast_slice(points.as_flattened()));
    } else {
        points.as_flattened().iter().for_each(|number| {
            hasher.update(&number.to_le_bytes());
        });
    }
}
