//! The set-up of a mesh: all decisions that hold for any positions of its vertices.

use moldline_mesh::{SurfaceMesh, Vector3};

use crate::{
    EdgeLine, LeftOut, Monitor, NoMonitor, Options, PanelError, Solver, Stage, TrailingEdges, Warning,
    bounds::within,
    doubt,
    influence::Layout,
    nodes::Nodes,
    panels::Panels,
    progress::poll,
    thin,
    trefftz::Trace,
    wake::{Beside, Wakes},
};

/// A named part of the surface.
#[derive(Clone, Debug)]
pub(crate) struct Component {
    pub name: String,
    /// Its panels, and the panels whose images belong to it.
    pub own: Vec<u32>,
    pub mirrored: Vec<u32>,
}

/// A mesh whose panels, trailing edges, wakes and stencils are known. Immutable; serves any positions of its vertices.
#[derive(Clone, Debug)]
pub struct PanelSetup {
    pub(crate) panels: Panels,
    pub(crate) wakes: Wakes,
    pub(crate) layout: Layout,
    pub(crate) trace: Trace,
    pub(crate) components: Vec<Component>,
    pub(crate) options: Options,
    /// Cells at each mesh vertex, over which its pressure is averaged.
    pub(crate) vertex_cells: moldline_mesh::Csr,
    /// Lines of trailing edges, and warnings, for the report.
    lines: Vec<EdgeLine>,
    warnings: Vec<Warning>,
}

/// The decisions of a set-up.
#[derive(Clone, Debug, PartialEq)]
pub struct SetupSummary {
    /// Number of unknowns.
    pub unknowns: usize,
    /// Whether one half is solved for both.
    pub symmetric: bool,
    /// Trailing edges, as mesh vertices, along each line; of the solved half.
    pub trailing_edges: Vec<[u32; 2]>,
    /// Lines of trailing edges, the longest first; of the solved half.
    pub lines: Vec<EdgeLine>,
    /// Lines that look like trailing edges but were not taken as such, and why; the longest of each reason first.
    pub left_out: Vec<LeftOut>,
    /// Reasons to doubt the set-up.
    pub warnings: Vec<Warning>,
    /// Vertices where a trailing edge ends on a body, over which its circulation goes on.
    pub roots: Vec<u32>,
    /// For each of them the vertex at the body's aft end where that circulation leaves it.
    pub aft_ends: Vec<u32>,
    /// How the system is solved.
    pub solver: Solver,
    /// Bytes that a solution needs.
    pub memory: u64,
}

impl PanelSetup {
    /// Checks the mesh, picks the half that is solved, and finds trailing edges and wakes.
    ///
    /// # Errors
    /// [`PanelError`] for meshes that are open, not oriented, without trailing edges, too large for the memory allowed, ...
    pub fn new(mesh: &SurfaceMesh, options: Options) -> Result<Self, PanelError> {
        Self::monitored(mesh, options, &NoMonitor)
    }

    /// As [`new`](Self::new), and ends early if `monitor` says so.
    ///
    /// # Errors
    /// As [`new`](Self::new); [`PanelError::Cancelled`].
    pub fn monitored(
        mesh: &SurfaceMesh,
        options: Options,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Self, PanelError> {
        within("options.tolerance", options.tolerance, 1e-14, 1e-4)?;
        let panels = Panels::new(mesh, options.symmetry)?;
        // Trailing edges add an unknown for each of their vertices.
        let needed = memory(panels.vertex_of.len(), panels.len(), options.solver);
        if needed > options.memory_limit {
            return Err(PanelError::Memory {
                unknowns: panels.vertex_of.len(),
                needed,
                limit: options.memory_limit,
                advice: "send a coarser mesh, one half of a symmetric one, or raise the limit",
            });
        }
        let points = panels.gather(&mesh.vertices);
        let wakes = Wakes::new(mesh, &panels, &options.trailing_edges, monitor)?;
        poll(monitor)?;
        let layout = Layout::new(&panels, &wakes, Nodes::new(&panels, &wakes)?, &points);
        poll(monitor)?;
        let trace = Trace::new(&panels, &wakes);
        let components = components(mesh, &panels, &options)?;
        let vertex_cells = moldline_mesh::Topology::new(mesh).vertex_cells;
        let lines = wakes.lines(&panels, &points);
        let mut warnings = Vec::new();
        if options.trailing_edges != TrailingEdges::None {
            warnings.extend(thin::without_wake(&panels, &points, &wakes.trailing));
            let [low, high] = mesh.bounds();
            warnings.extend(doubt::suspicious(
                &wakes.left_out,
                (Vector3::from(high) - Vector3::from(low)).norm(),
            ));
        }
        Ok(Self { panels, wakes, layout, trace, components, options, vertex_cells, lines, warnings })
    }

    /// The decisions of the set-up.
    pub fn summary(&self) -> SetupSummary {
        let vertex = |point: u32| self.panels.vertex_of[point as usize];
        let carried = self.wakes.strips.iter().flat_map(|s| {
            [s.a, s.b].into_iter().zip(s.beside).filter_map(|(root, beside)| match beside {
                Beside::Body(end) => Some((vertex(root), vertex(end))),
                _ => None,
            })
        });
        let (roots, aft_ends) = carried.unzip();
        SetupSummary {
            unknowns: self.layout.nodes.rows(),
            symmetric: self.panels.symmetric,
            trailing_edges: self.wakes.strips.iter().map(|s| [vertex(s.a), vertex(s.b)]).collect(),
            lines: self.lines.clone(),
            left_out: self.wakes.left_out.clone(),
            warnings: self.warnings.clone(),
            roots,
            aft_ends,
            solver: self.options.solver.resolve(self.layout.nodes.rows()),
            memory: memory(self.layout.nodes.rows(), self.panels.len(), self.options.solver),
        }
    }

    /// Names of the components whose forces are reported.
    pub fn component_names(&self) -> impl Iterator<Item = &str> {
        self.components.iter().map(|c| c.name.as_str())
    }
}

/// Bytes that a solution needs at its peak: matrix and factors, blocks of the assembly, and what adjoints gather from the pairs.
fn memory(unknowns: usize, panels: usize, solver: Solver) -> u64 {
    solver.bytes(unknowns) + 8 * (unknowns as u64 * 1000 + panels as u64 * 2400)
}

/// An estimate of the bytes that a solution of so many unknowns needs at its peak.
pub fn memory_estimate(unknowns: usize, solver: Solver) -> u64 {
    memory(unknowns, unknowns, solver)
}

fn components(mesh: &SurfaceMesh, panels: &Panels, options: &Options) -> Result<Vec<Component>, PanelError> {
    let names: Vec<String> = match &options.components {
        Some(names) => names.clone(),
        None => mesh.cell_groups.iter().map(|g| g.name.clone()).collect(),
    };
    let mut components = Vec::with_capacity(names.len());
    for (index, name) in names.into_iter().enumerate() {
        let group = mesh.cell_group(&name).ok_or_else(|| PanelError::UnknownGroup {
            field: format!("components[{index}]"),
            name: name.clone(),
            known: mesh.cell_groups.iter().map(|g| g.name.clone()).collect(),
        })?;
        let (mut own, mut mirrored) = (Vec::new(), Vec::new());
        for &cell in &group.indices {
            let (panel, image) = panels.panel_of[cell as usize];
            if image { mirrored.push(panel) } else { own.push(panel) }
        }
        // A half model stands for both halves.
        if panels.symmetric && panels.partner.is_none() {
            mirrored.clone_from(&own);
        }
        components.push(Component { name, own, mirrored });
    }
    Ok(components)
}
