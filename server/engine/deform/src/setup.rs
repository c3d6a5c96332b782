//! The set-up: everything that does not change with the design. It is built once and shared by all sessions.

use std::{collections::HashSet, sync::Arc};

use moldline_geometry::{Aabb, Body, Component, Location, SmoothUnion};
use moldline_mesh::{Origin, SurfaceMesh, Topology};
use moldline_parameterisation::Parameterisation;
use moldline_rbf::Factors;
use moldline_spline::Vector3;

use crate::{
    DeformError, Monitor, Options, SetupError, Stage,
    bodies::{Reach, bodies},
    chain::{
        Chain,
        field::{RegionField, setup::FieldBuilder},
        motion::Motions,
        outputs::{Function, OutputDeclaration, Outputs},
        placement::Placement,
        projection::Projection,
        seams::{
            SeamSolver,
            setup::{FoundLine, found_lines, seam_solver},
        },
        smoothing::Smoothing,
    },
    collisions::Collisions,
    constraints::{Constraints, in_groups},
    error::Source,
    fit::misfit,
    inspection::Inspection,
    ownership::{Ownership, OwnershipParts},
    report::{self, Findings, SetupReport},
    soundness,
    symmetry::{InPlane, MeshSymmetry},
};

/// The input of a set-up.
#[derive(Clone, Debug)]
pub struct SetupInput {
    /// The components; their reference control points are the parameterisation's at its baseline.
    pub components: Vec<Component>,
    /// The reference mesh.
    pub mesh: SurfaceMesh,
    /// Where it comes from.
    pub origin: Arc<Origin>,
    /// Design variables to control points.
    pub parameterisation: Parameterisation,
    /// Scalar outputs besides those that every set-up has.
    pub outputs: Vec<OutputDeclaration>,
    /// The user's choices.
    pub options: Options,
}

impl SetupInput {
    /// An estimate of the memory that [`Setup::build`] takes at its peak, bytes: for the systems of the fields, of at most
    /// `training_vertices` centres and, on a half model, their images, the matrix, its factor, and the factor as it is stored;
    /// for the rest a multiple of the mesh.
    pub fn build_memory(&self) -> u64 {
        /// Topology, owners, seams and quality of a vertex or cell.
        const EACH: u64 = 2048;
        let mesh = (self.mesh.vertices.len() + self.mesh.cells.len()) as u64;
        let centres = 2 * self.options.training_vertices.min(self.mesh.vertices.len()) as u64;
        EACH * mesh + 3 * size_of::<f64>() as u64 * centres * centres
    }
}

/// The results of a set-up's searches and factorisations, from which the same set-up is restored without doing them again.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Derived {
    /// The components that every vertex lies on, and where.
    pub ownership: OwnershipParts,
    /// The seams.
    pub seams: FoundSeams,
    /// Where normals are taken for the cells that have no corner in the middle of a surface.
    pub middles: Vec<Location>,
    /// The factorised fields, in their order.
    pub fields: Vec<Factors>,
}

/// The seams of a set-up.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FoundSeams {
    /// The search lines of the vertices on two components.
    pub lines: Vec<FoundLine>,
    /// All seam vertices where the search finds them in the reference state, m.
    pub points: Vec<Vector3>,
    /// Largest distance of such a point to its components, m.
    pub residual: f64,
}

/// Set-up data. Immutable; `Send + Sync`, to be shared.
#[derive(Debug)]
pub struct Setup {
    options: Options,
    pub(crate) mesh: Arc<SurfaceMesh>,
    origin: Arc<Origin>,
    pub(crate) components: Vec<Arc<Component>>,
    /// The components in the reference state.
    reference: Arc<[Body]>,
    /// Reference vertices, on their components, m.
    positions: Arc<[Vector3]>,
    pub(crate) parameterisation: Parameterisation,
    pub(crate) ownership: Arc<Ownership>,
    in_plane: InPlane,
    /// Where control points may lie.
    pub(crate) reach: Reach,
    /// Vertices that stay where they are in space.
    stationary: Vec<bool>,
    /// The steps of a deformation.
    pub(crate) chain: Chain,
    pub(crate) constraints: Constraints,
    pub(crate) inspection: Inspection,
    pub(crate) collisions: Collisions,
    report: SetupReport,
}

impl Setup {
    /// Builds a set-up.
    ///
    /// # Errors
    /// [`SetupError`] if the mesh does not fit the components, an option is out of range, and so on.
    pub fn build(input: SetupInput, monitor: &dyn Monitor<Stage>) -> Result<Self, SetupError> {
        Self::assemble(input, Derived::default(), monitor)
    }

    /// The set-up that [`build`](Self::build) gives, bit for bit, from what an earlier one [`derived`](Self::derived) from the same
    /// input. Parts that do not fit the input are found again; those that fit are not verified.
    ///
    /// # Errors
    /// As `build`.
    pub fn restore(
        input: SetupInput,
        derived: Derived,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Self, SetupError> {
        Self::assemble(input, derived, monitor)
    }

    /// The data to [`restore`](Self::restore) from.
    pub fn derived(&self) -> Derived {
        Derived {
            ownership: self.ownership.parts(),
            seams: FoundSeams {
                lines: found_lines(&self.chain.seams),
                points: self
                    .chain
                    .seams
                    .vertices
                    .iter()
                    .map(|seam| self.positions[seam.vertex as usize])
                    .collect(),
                residual: self.report.seam_residual,
            },
            middles: self.inspection.middles(),
            fields: self.chain.fields.regions().iter().map(|field| field.field.factors()).collect(),
        }
    }

    fn assemble(
        input: SetupInput,
        derived: Derived,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Self, SetupError> {
        let SetupInput { components, mut mesh, origin, parameterisation, outputs, options } = input;
        options.validate()?;
        let names: Vec<String> = components.iter().map(|c| c.name().to_owned()).collect();
        check_names(&names, &options, &mesh)?;
        let components: Vec<Arc<Component>> = components.into_iter().map(Arc::new).collect();
        let bounds = Aabb::around(mesh.vertices.iter().map(|x| Vector3::from(*x)));
        let length = bounds.diagonal();
        let reach = Reach::new(bounds.center(), length);
        let baseline = parameterisation.control_points(&parameterisation.baseline());
        let baseline = baseline.map_err(SetupError::Baseline)?;
        let reference = bodies(&components, &baseline);
        let reference: Arc<[Body]> = reference.map_err(SetupError::ControlPoints)?.into();
        reach.check(&components, &baseline, |_| Source::Setup).map_err(|error| {
            match misfit(&mesh.vertices, &reference) {
                Some(misfit) => SetupError::Misfit { misfit, error },
                None => SetupError::ControlPoints(error),
            }
        })?;

        monitor.progress(Stage::Mesh, 0.0);
        let tolerance = options.surface_tolerance * length;
        let topology = Topology::new(&mesh);
        soundness::refuse_repeated_cells(&mesh, length)?;
        soundness::refuse_branches(&mesh, &topology)?;
        let symmetry = MeshSymmetry::find(&mesh, &topology, tolerance, options.symmetric)?;
        let in_plane = symmetry.in_plane(&mesh);
        let open_edges = symmetry.open_edges(&mesh, &topology);
        if !open_edges.is_empty() && !options.open_mesh {
            return Err(soundness::open_mesh(&mesh, &topology, &symmetry, &open_edges, length));
        }
        let turned_cells = soundness::turn_inward_pieces(&mut mesh, &topology, &symmetry, &open_edges);
        let mesh = Arc::new(mesh);

        let mut ownership = Ownership::new(derived.ownership, &mesh, &reference, tolerance, monitor)?;
        let component_summaries = report::components(&ownership, &components);
        let stationary = in_groups(&mesh, &options.stationary_groups);
        ownership.fix(&in_groups(&mesh, &options.protected_groups));
        let ownership = Arc::new(ownership);

        monitor.progress(Stage::Seams, 0.0);
        let (seams, seam_summaries) = seam_solver(
            &ownership,
            &topology,
            &mesh.vertices,
            &reference,
            options.seam,
            length,
            &derived.seams.lines,
            monitor,
        )?;
        let (seam_points, seam_residual) = reference_seams(&seams, derived.seams, &reference, monitor)?;
        let positions = positions(&ownership, &reference, &seams, &seam_points);

        monitor.progress(Stage::Training, 0.0);
        let fields = FieldBuilder {
            options: &options,
            mesh: &mesh,
            topology: &topology,
            ownership: &ownership,
            seams: &seams,
            reference: &reference,
            positions: &positions,
            mirror: symmetry.mirror.as_deref(),
            half: symmetry.half(),
            names: &names,
            found: &derived.fields,
        }
        .build(monitor)?;

        monitor.progress(Stage::Report, 0.0);
        let apex = if symmetry.half().is_some() { Vector3::zeros() } else { positions[0] };
        let outputs = Outputs::new(&outputs, &components, apex)?;
        let union = SmoothUnion::from_fillet(options.fillet.unwrap_or(5e-4 * length));
        let chain = Chain {
            motions: Motions::new(
                fields.regions(),
                options.propagation,
                &seams,
                reference.clone(),
                &positions,
                length,
            ),
            placement: Placement::new(
                options.propagation,
                &fields,
                &seams,
                &stationary,
                ownership.clone(),
                reference.clone(),
                positions.clone(),
                in_plane.clone(),
            ),
            smoothing: Smoothing::new(
                options.smoothing,
                &topology,
                &stationary,
                ownership.clone(),
                in_plane.clone(),
            ),
            projection: Projection::new(
                &options,
                length,
                union,
                &stationary,
                ownership.clone(),
                in_plane.clone(),
            ),
            seams,
            fields,
            outputs,
            reference: reference.clone(),
            mesh: mesh.clone(),
            ownership: ownership.clone(),
        };
        let constraints = Constraints::new(&stationary, ownership.clone(), options.seam.polish, tolerance);
        let inspection = Inspection::new(&mesh, &ownership, &reference, &derived.middles);
        let collisions = Collisions::new(options.on_event, &mesh, &ownership, symmetry.half(), monitor)?;
        let report = SetupReport::new(Findings {
            mesh: &mesh,
            topology: &topology,
            ownership: &ownership,
            reference: &reference,
            fields: chain.fields.regions(),
            inspection: &inspection,
            symmetry: &symmetry,
            options: &options,
            length,
            open_edges: open_edges.len(),
            turned_cells,
            left_out: origin.left_out,
            in_plane: in_plane.count(),
            stationary: stationary.iter().filter(|s| **s).count(),
            components: component_summaries,
            seams: seam_summaries,
            seam_residual,
            rho: union.rho,
        })?;
        monitor.progress(Stage::Report, 1.0);
        Ok(Self {
            options,
            mesh,
            origin,
            components,
            reference,
            positions,
            parameterisation,
            ownership,
            in_plane,
            reach,
            stationary,
            chain,
            constraints,
            inspection,
            collisions,
            report,
        })
    }

    /// Where the mesh comes from: the numbers of its parts in the user's file.
    pub fn origin(&self) -> &Origin {
        &self.origin
    }

    /// The report of the set-up.
    pub fn report(&self) -> &SetupReport {
        &self.report
    }

    /// Approximate memory, bytes: that of the factors, and a fixed amount for each vertex and cell.
    pub fn bytes(&self) -> usize {
        /// Positions, attachments, adjacency, groups, normals.
        const OF_A_VERTEX: usize = 400;
        const OF_A_CELL: usize = 200;
        let fields: usize = self.fields().iter().map(|field| field.field.bytes()).sum();
        fields + OF_A_VERTEX * self.mesh.vertices.len() + OF_A_CELL * self.mesh.cells.len()
    }

    /// An estimate of the memory that a deformation and its linearisation take at their peak, bytes.
    pub fn deformation_memory(&self) -> u64 {
        /// Feet, bases and derivatives of every step, for each vertex.
        const EACH: u64 = 2048;
        EACH * self.mesh.vertices.len() as u64
    }

    /// The reference mesh, as given.
    pub fn mesh(&self) -> &SurfaceMesh {
        &self.mesh
    }

    /// Design variables to control points.
    pub fn parameterisation(&self) -> &Parameterisation {
        &self.parameterisation
    }

    /// The choices in force.
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The components, in the order in which `cell_owner` counts them.
    pub fn components(&self) -> &[Arc<Component>] {
        &self.components
    }

    /// Component of each cell.
    pub fn cell_owner(&self) -> &[u32] {
        &self.ownership.cell_owner
    }

    /// Vertices on several components.
    pub fn seam_vertices(&self) -> impl ExactSizeIterator<Item = u32> + '_ {
        self.chain.seams.vertices.iter().map(|s| s.vertex)
    }

    /// The scalar outputs, in the order of their values.
    pub fn functions(&self) -> &[Function] {
        self.chain.outputs.functions()
    }

    /// The scalar outputs, with what they are made of.
    pub fn outputs(&self) -> &Outputs {
        &self.chain.outputs
    }

    /// Values of the scalar outputs for the reference mesh.
    pub fn reference_functions(&self) -> Vec<f64> {
        let vertices: Vec<[f64; 3]> = self.positions.iter().map(|&x| x.into()).collect();
        self.chain.outputs.eval(self.chain.measured(&vertices, &self.reference))
    }

    /// The components that every vertex lies on, and where.
    pub fn ownership(&self) -> &Ownership {
        &self.ownership
    }

    /// The components with other control points: per component, the user's, Cartesian.
    ///
    /// # Errors
    /// [`DeformError::ControlPoints`] if counts do not match, a coordinate is not finite, or a point lies farther from the mesh
    /// than 1000 reference lengths.
    pub fn bodies(&self, control_points: &[Vec<[f64; 3]>]) -> Result<Vec<Body>, DeformError> {
        let bodies = bodies(&self.components, control_points)?;
        self.reach.check(&self.components, control_points, |_| Source::Given)?;
        Ok(bodies)
    }

    /// The components in the reference state.
    pub fn reference(&self) -> &[Body] {
        &self.reference
    }

    /// Reference vertices, on their components, m.
    pub fn positions(&self) -> &[Vector3] {
        &self.positions
    }

    /// The seam search.
    pub fn seams(&self) -> &SeamSolver {
        &self.chain.seams
    }

    /// The displacement fields.
    pub fn fields(&self) -> &[RegionField] {
        self.chain.fields.regions()
    }

    /// Whether a vertex stays in the symmetry plane.
    pub fn is_in_plane(&self, vertex: u32) -> bool {
        self.in_plane.contains(vertex)
    }

    /// Whether a vertex stays where it is in space.
    pub fn is_stationary(&self, vertex: u32) -> bool {
        self.stationary[vertex as usize]
    }

    /// Whether the smooth projection moves a vertex: nothing protects or holds it.
    pub fn is_active(&self, vertex: u32) -> bool {
        self.chain.projection.is_active(vertex)
    }

    /// The reference length, m: the diagonal of the mesh's bounding box.
    pub fn length(&self) -> f64 {
        self.report.length
    }

    /// The smooth union that makes the outer mold line.
    pub fn union(&self) -> SmoothUnion {
        self.chain.projection.union()
    }
}

fn check_names(names: &[String], options: &Options, mesh: &SurfaceMesh) -> Result<(), SetupError> {
    if names.is_empty() {
        return Err(SetupError::NoComponents);
    }
    let mut components = HashSet::new();
    if let Some(name) = names.iter().find(|name| !components.insert(name.as_str())) {
        return Err(SetupError::DuplicateComponent { name: name.clone() });
    }
    let groups: HashSet<&str> = mesh.vertex_groups.iter().map(|g| g.name.as_str()).collect();
    let unknown = |field: &str, name: &String, known: Vec<String>| {
        Err(SetupError::UnknownName { field: field.to_owned(), name: name.clone(), known })
    };
    for (name, _) in &options.blend_radius_of {
        if !components.contains(name.as_str()) {
            return unknown("blend_radius_of", name, names.to_vec());
        }
    }
    let of_groups =
        [("protected_groups", &options.protected_groups), ("stationary_groups", &options.stationary_groups)];
    for (field, used) in of_groups {
        if let Some(name) = used.iter().find(|name| !groups.contains(name.as_str())) {
            return unknown(field, name, mesh.vertex_groups.iter().map(|g| g.name.clone()).collect());
        }
    }
    Ok(())
}

/// The seam vertices where the search finds them in the reference state, m, and the largest distance of such a point to its
/// components, m. Both are taken from `found` if it has the same lines.
fn reference_seams(
    seams: &SeamSolver,
    found: FoundSeams,
    reference: &[Body],
    monitor: &dyn Monitor<Stage>,
) -> Result<(Vec<Vector3>, f64), SetupError> {
    if found.points.len() == seams.vertices.len() && found.lines == found_lines(seams) {
        return Ok((found.points, found.residual));
    }
    let points = seams.eval(reference, reference, monitor).map_err(|error| match error {
        DeformError::Cancelled => SetupError::Cancelled,
        other => SetupError::ReferenceSeam(Box::new(other)),
    })?;
    let residual = points.iter().map(|point| point.residual).fold(0.0, f64::max);
    Ok((points.iter().map(|point| point.position).collect(), residual))
}

/// The vertices on their components in the reference state, m: those of seams where the search finds them.
fn positions(
    ownership: &Ownership,
    reference: &[Body],
    seams: &SeamSolver,
    seam_points: &[Vector3],
) -> Arc<[Vector3]> {
    let own = ownership.vertices().map(|v| ownership.first(v));
    let mut positions: Vec<Vector3> =
        own.map(|own| reference[own.component as usize].position(&own.location)).collect();
    for (seam, point) in seams.vertices.iter().zip(seam_points) {
        positions[seam.vertex as usize] = *point;
    }
    positions.into()
}
