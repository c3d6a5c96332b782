//! The set-up: everything that does not change with the design, found once and shared by all sessions.

use std::sync::Arc;

use moldline_geometry::{Aabb, Body, Component, Location, SmoothUnion};
use moldline_mesh::{
    Laplacian, MeshError, Plane, SurfaceMesh, Topology, area_vector, quality, symmetry::pair_vertices,
    topology::enclosed_volume,
};
use moldline_parameterisation::Parameterisation;
use moldline_rbf::Factors;
use moldline_spline::Vector3;
use rayon::prelude::*;

use crate::{
    DeformError, Monitor, Options, Propagation, SetupError, Stage,
    chart::Chart,
    field::{Field, Mirror},
    inspection::Inspection,
    outputs::{Function, Measured, OutputDeclaration, Outputs},
    ownership::{Freedom, Ownership, OwnershipParts},
    report::{ComponentSummary, FieldSummary, ProtectedSummary, SetupReport, Symmetry},
    seam::SeamSolver,
    seam_setup::{FoundLine, found_lines, seam_solver},
    training::Region,
};

/// What a set-up is built from.
#[derive(Clone, Debug)]
pub struct SetupInput {
    /// The components; their reference control points are the parameterisation's at its baseline.
    pub components: Vec<Component>,
    /// The reference mesh.
    pub mesh: SurfaceMesh,
    /// Design variables to control points.
    pub parameterisation: Parameterisation,
    /// Scalar outputs besides those that every set-up has.
    pub outputs: Vec<OutputDeclaration>,
    /// Choices.
    pub options: Options,
}

/// What a set-up finds that takes time: enough to have the same set-up again without looking for it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Derived {
    /// Where every vertex lies.
    pub ownership: OwnershipParts,
    /// The seams.
    pub seams: FoundSeams,
    /// Where the normals are taken of cells that have no corner in the middle of a surface.
    pub middles: Vec<Location>,
    /// The factorised fields, in their order.
    pub fields: Vec<Factors>,
}

/// The seams of a set-up.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FoundSeams {
    /// Of the vertices on two components.
    pub lines: Vec<FoundLine>,
    /// Where the search finds all seam vertices in the reference state, m.
    pub points: Vec<Vector3>,
    /// Largest distance of such a point to its components, m.
    pub residual: f64,
}

/// A field and the vertices that it moves.
#[derive(Clone, Debug)]
pub struct RegionField {
    /// The component moved; `None`: all of them.
    pub component: Option<u32>,
    /// Surface coordinates in which departures are measured; `None`: they are vectors in space.
    pub chart: Option<Chart>,
    /// The factorised system.
    pub field: Field,
    /// Vertices moved: all of the region that are neither on a seam nor fixed.
    pub vertices: Vec<u32>,
    /// Their reference positions, m.
    pub points: Vec<Vector3>,
}

impl RegionField {
    /// Numbers that a departure has.
    pub fn columns(&self) -> usize {
        if self.chart.is_some() { 2 } else { 3 }
    }

    fn summary(&self, names: &[String]) -> FieldSummary {
        let training = self.field.training();
        FieldSummary {
            region: self.component.map_or_else(|| "all".to_owned(), |c| names[c as usize].clone()),
            training_vertices: training.len(),
            seam_vertices: training.iter().filter(|t| t.alpha() == 1.0).count(),
            coordinates: if self.chart.is_some() { "surface parameters" } else { "space" },
            bytes: self.field.bytes(),
        }
    }
}

/// Set-up data. Immutable; `Send + Sync`, to be shared.
#[derive(Debug)]
pub struct Setup {
    pub(crate) options: Options,
    pub(crate) mesh: SurfaceMesh,
    pub(crate) components: Vec<Arc<Component>>,
    /// The components in the reference state.
    pub(crate) reference: Vec<Body>,
    /// Reference vertices, on their components, m.
    pub(crate) positions: Vec<Vector3>,
    pub(crate) parameterisation: Parameterisation,
    pub(crate) ownership: Ownership,
    pub(crate) seams: SeamSolver,
    pub(crate) fields: Vec<RegionField>,
    /// Vertices of the symmetry plane.
    pub(crate) in_plane: Vec<bool>,
    /// Vertices that stay where they are in space.
    pub(crate) stationary: Vec<bool>,
    /// Of the vertices that smoothing moves; `None` without smoothing.
    pub(crate) laplacian: Option<Laplacian>,
    pub(crate) inspection: Inspection,
    pub(crate) length: f64,
    pub(crate) union: SmoothUnion,
    pub(crate) outputs: Outputs,
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

    /// The set-up that [`build`](Self::build) gives, bit for bit, from what that [`derived`](Self::derived) from the same
    /// input. What does not fit the input is found again; what fits is believed.
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

    /// What took time to find.
    pub fn derived(&self) -> Derived {
        Derived {
            ownership: self.ownership.parts(),
            seams: FoundSeams {
                lines: found_lines(&self.seams),
                points: self.seams.vertices.iter().map(|seam| self.positions[seam.vertex as usize]).collect(),
                residual: self.report.seam_residual,
            },
            middles: self.inspection.middles(),
            fields: self.fields.iter().map(|field| field.field.factors()).collect(),
        }
    }

    fn assemble(
        input: SetupInput,
        derived: Derived,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Self, SetupError> {
        let SetupInput { components, mesh, parameterisation, outputs, options } = input;
        options.validate()?;
        let names: Vec<String> = components.iter().map(|c| c.name().to_owned()).collect();
        check_names(&names, &options, &mesh)?;
        let components: Vec<Arc<Component>> = components.into_iter().map(Arc::new).collect();
        let baseline = parameterisation.control_points(&parameterisation.baseline());
        let baseline = baseline.map_err(|error| SetupError::Components(error.to_string()))?;
        let reference = bodies(&components, &baseline).map_err(SetupError::Components)?;

        monitor.progress(Stage::Mesh, 0.0);
        let length = Aabb::around(mesh.vertices.iter().map(|x| Vector3::from(*x))).diagonal();
        let tolerance = options.surface_tolerance * length;
        let topology = Topology::new(&mesh);
        let plane = Plane::y_zero();
        let (symmetry, mirror) = symmetry(&mesh, &topology, &plane, tolerance, options.symmetric)?;
        let in_plane: Vec<bool> = mesh
            .vertices
            .iter()
            .map(|x| symmetry != Symmetry::None && plane.signed_distance(x).abs() <= tolerance)
            .collect();
        let half_plane = (symmetry == Symmetry::Half).then_some((&plane, tolerance));
        let open_edges = topology.open_edges(&mesh.vertices, half_plane);
        refuse_holes(&mesh, &topology, &open_edges, options.open_mesh)?;

        let (vertices, cells) = (mesh.vertices.len(), mesh.cells.len());
        let mut ownership = match Ownership::restore(derived.ownership, vertices, cells, &reference) {
            Some(found) => found,
            None => Ownership::find(&mesh.vertices, &mesh.cells, &reference, tolerance, monitor)?,
        };
        let components_summary = component_summaries(&ownership, &components);
        let stationary = group_mask(&mesh, &options.stationary_groups);
        for (v, protected) in (0u32..).zip(group_mask(&mesh, &options.protected_groups)) {
            if protected {
                ownership.fix(v);
            }
        }

        monitor.progress(Stage::Seams, 0.0);
        let found = derived.seams;
        let (seams, seam_summaries) = seam_solver(
            &ownership,
            &topology,
            &mesh.vertices,
            &reference,
            options.seam,
            length,
            &found.lines,
            monitor,
        )?;
        let fits = found.points.len() == seams.vertices.len() && found.lines == found_lines(&seams);
        let (seam_points, seam_residual) =
            if fits { (found.points, found.residual) } else { find_seams(&seams, &reference, monitor)? };
        let mut positions: Vec<Vector3> = (0..mesh.vertices.len() as u32)
            .map(|v| {
                let own = &ownership.of(v)[0];
                reference[own.component as usize].position(&own.location)
            })
            .collect();
        for (seam, point) in seams.vertices.iter().zip(&seam_points) {
            positions[seam.vertex as usize] = *point;
        }

        monitor.progress(Stage::Training, 0.0);
        let fields = Fields {
            options: &options,
            mesh: &mesh,
            topology: &topology,
            ownership: &ownership,
            seams: &seams,
            reference: &reference,
            positions: &positions,
            mirror: mirror.as_deref(),
            half: half_plane,
            names: &names,
            found: &derived.fields,
        }
        .build(monitor)?;

        monitor.progress(Stage::Report, 0.0);
        let origin = if half_plane.is_some() { Vector3::zeros() } else { positions[0] };
        let outputs = Outputs::new(&outputs, &components, origin)?;
        let inspection = Inspection::new(&mesh, &ownership, &reference, &derived.middles);
        let union = SmoothUnion::from_fillet(options.fillet.unwrap_or(5e-4 * length));
        let locations: Vec<Location> =
            (0..mesh.vertices.len() as u32).map(|v| ownership.of(v)[0].location).collect();
        let owners = &ownership.cell_owner;
        let normals = inspection.normals(&mesh.cells, owners, &mesh.vertices, &locations, &reference);
        let cells = quality::evaluate(&mesh.vertices, &mesh.cells, &normals);
        let summary = inspection.report(&cells, owners).ok_or(MeshError::Empty { what: "cells" })?;
        let (against_normal, least_normal_agreement) =
            mesh.cells.iter().zip(&normals).fold((0, 1.0_f64), |(against, least), (cell, normal)| {
                let area = area_vector(&mesh.vertices, cell);
                let cosine = area.dot(normal) / area.norm().max(f64::MIN_POSITIVE);
                (against + usize::from(cosine < 0.0), least.min(cosine))
            });
        let count = |freedom: fn(&Freedom) -> bool| {
            let vertices = 0..ownership.vertex_count() as u32;
            vertices.filter(|&v| ownership.of(v).iter().any(|a| freedom(&a.freedom))).count()
        };
        let report = SetupReport {
            vertices: mesh.vertices.len(),
            quadrilaterals: mesh.cells.iter().filter(|c| !c.is_triangle()).count(),
            triangles: mesh.cells.iter().filter(|c| c.is_triangle()).count(),
            length,
            surface_tolerance: tolerance,
            components: components_summary,
            seams: seam_summaries,
            seam_residual,
            watertight: open_edges.is_empty(),
            open_edges: open_edges.len(),
            euler: topology.euler(),
            pieces: topology.pieces,
            volume: enclosed_volume(&mesh.vertices, &mesh.cells, half_plane.map(|(plane, _)| plane)),
            symmetry,
            against_normal,
            least_normal_agreement,
            protected: ProtectedSummary {
                on_edges: count(|f| matches!(f, Freedom::Edge(_))),
                fixed: count(|f| matches!(f, Freedom::Fixed)),
                in_plane: in_plane.iter().filter(|p| **p).count(),
                stationary: stationary.iter().filter(|s| **s).count(),
            },
            fields: fields.iter().map(|f| f.summary(&names)).collect(),
            rho: union.rho,
            options: options.clone(),
            quality: summary,
        };
        monitor.progress(Stage::Report, 1.0);
        let laplacian = (options.smoothing.rounds > 0)
            .then(|| Laplacian::uniform(&topology, |v| stationary[v as usize] || !ownership.is_free(v)));
        Ok(Self {
            options,
            mesh,
            components,
            reference,
            positions,
            parameterisation,
            ownership,
            seams,
            fields,
            in_plane,
            stationary,
            laplacian,
            inspection,
            length,
            union,
            outputs,
            report,
        })
    }

    /// What was found.
    pub fn report(&self) -> &SetupReport {
        &self.report
    }

    /// Bytes that it holds, about: the factors, and what there is of each vertex and cell.
    pub fn bytes(&self) -> usize {
        /// Positions, attachments, adjacency, groups, normals.
        const OF_A_VERTEX: usize = 400;
        const OF_A_CELL: usize = 200;
        let fields: usize = self.fields.iter().map(|field| field.field.bytes()).sum();
        fields + OF_A_VERTEX * self.mesh.vertices.len() + OF_A_CELL * self.mesh.cells.len()
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
        self.seams.vertices.iter().map(|s| s.vertex)
    }

    /// The scalar outputs, in the order of their values.
    pub fn functions(&self) -> &[Function] {
        self.outputs.functions()
    }

    /// What they are made of.
    pub fn outputs(&self) -> &Outputs {
        &self.outputs
    }

    /// Values of the scalar outputs for the reference mesh.
    pub fn reference_functions(&self) -> Vec<f64> {
        let vertices: Vec<[f64; 3]> = self.positions.iter().map(|&x| x.into()).collect();
        self.outputs.eval(Measured {
            cells: &self.mesh.cells,
            owners: &self.ownership.cell_owner,
            vertices: &vertices,
            bodies: &self.reference,
        })
    }

    /// Where every vertex lies.
    pub fn ownership(&self) -> &Ownership {
        &self.ownership
    }

    /// The components with other control points: per component, the user's, Cartesian.
    ///
    /// # Errors
    /// [`DeformError::ControlPoints`] if counts do not match or a coordinate is not finite.
    pub fn bodies(&self, control_points: &[Vec<[f64; 3]>]) -> Result<Vec<Body>, DeformError> {
        bodies(&self.components, control_points).map_err(DeformError::ControlPoints)
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
        &self.seams
    }

    /// The displacement fields.
    pub fn fields(&self) -> &[RegionField] {
        &self.fields
    }

    /// Whether a vertex stays in the symmetry plane.
    pub fn is_in_plane(&self, vertex: u32) -> bool {
        self.in_plane[vertex as usize]
    }

    /// Whether a vertex stays where it is in space.
    pub fn is_stationary(&self, vertex: u32) -> bool {
        self.stationary[vertex as usize]
    }

    /// The reference length, m: the diagonal of the mesh's bounding box.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// The smooth union that makes the outer mold line.
    pub fn union(&self) -> SmoothUnion {
        self.union
    }
}

fn bodies(components: &[Arc<Component>], control_points: &[Vec<[f64; 3]>]) -> Result<Vec<Body>, String> {
    if components.len() != control_points.len() {
        return Err(format!(
            "control_points has {} components, the set-up has {}",
            control_points.len(),
            components.len()
        ));
    }
    for (c, (component, points)) in components.iter().zip(control_points).enumerate() {
        if points.len() != component.user_control_point_count() {
            return Err(format!(
                "control_points[{c}] (`{}`) has {} points, its patches have {}",
                component.name(),
                points.len(),
                component.user_control_point_count()
            ));
        }
        for (i, point) in points.iter().enumerate() {
            if let Some(axis) = point.iter().position(|x| !x.is_finite()) {
                return Err(format!("control_points[{c}][{i}][{axis}] = {} is not finite", point[axis]));
            }
        }
    }
    Ok(components
        .par_iter()
        .zip(control_points)
        .map(|(component, points)| Body::new(component.clone(), component.internal_control_points(points)))
        .collect())
}

fn check_names(names: &[String], options: &Options, mesh: &SurfaceMesh) -> Result<(), SetupError> {
    if names.is_empty() {
        return Err(SetupError::Components("there are none".into()));
    }
    if let Some(i) = (1..names.len()).find(|&i| names[..i].contains(&names[i])) {
        return Err(SetupError::Components(format!("the name `{}` is used twice", names[i])));
    }
    let known = |field: &str, name: &String, known: Vec<String>| {
        if known.contains(name) {
            Ok(())
        } else {
            Err(SetupError::UnknownName { field: field.to_owned(), name: name.clone(), known })
        }
    };
    for (name, _) in &options.blend_radius_of {
        known("blend_radius_of", name, names.to_vec())?;
    }
    let groups = || mesh.vertex_groups.iter().map(|g| g.name.clone()).collect::<Vec<_>>();
    for name in &options.protected_groups {
        known("protected_groups", name, groups())?;
    }
    for name in &options.stationary_groups {
        known("stationary_groups", name, groups())?;
    }
    Ok(())
}

/// The symmetry asked for or found, and the mirror images of a mesh with both halves.
fn symmetry(
    mesh: &SurfaceMesh,
    topology: &Topology,
    plane: &Plane,
    tolerance: f64,
    wanted: Option<bool>,
) -> Result<(Symmetry, Option<Vec<u32>>), SetupError> {
    if wanted == Some(false) {
        return Ok((Symmetry::None, None));
    }
    let side = |sign: f64| mesh.vertices.iter().all(|x| sign * plane.signed_distance(x) >= -tolerance);
    let border_in_plane = !topology.boundary_edges.is_empty()
        && topology.open_edges(&mesh.vertices, Some((plane, tolerance))).len()
            < topology.boundary_edges.len();
    if border_in_plane && (side(1.0) || side(-1.0)) {
        return Ok((Symmetry::Half, None));
    }
    match pair_vertices(&mesh.vertices, plane, tolerance) {
        Ok(mirror) => Ok((Symmetry::Full, Some(mirror))),
        Err(error) if wanted == Some(true) => Err(SetupError::NotSymmetric(error.to_string())),
        Err(_) => Ok((Symmetry::None, None)),
    }
}

fn refuse_holes(
    mesh: &SurfaceMesh,
    topology: &Topology,
    open_edges: &[u32],
    accepted: bool,
) -> Result<(), SetupError> {
    if let Some(&first) = topology.non_manifold_edges.first() {
        return Err(SetupError::NonManifold {
            count: topology.non_manifold_edges.len(),
            first: topology.edges[first as usize],
        });
    }
    match open_edges.first() {
        Some(&first) if !accepted => {
            let first = topology.edges[first as usize];
            let position = mesh.vertices[first[0] as usize];
            Err(SetupError::OpenMesh { count: open_edges.len(), first, position })
        }
        _ => Ok(()),
    }
}

/// Where the search finds the seam vertices in the reference state, and the largest distance of such a point to its components.
fn find_seams(
    seams: &SeamSolver,
    reference: &[Body],
    monitor: &dyn Monitor<Stage>,
) -> Result<(Vec<Vector3>, f64), SetupError> {
    let points = seams.eval(reference, reference, monitor).map_err(|error| match error {
        DeformError::Cancelled => SetupError::Cancelled,
        other => SetupError::ReferenceSeam(Box::new(other)),
    })?;
    let residual = points.iter().map(|point| point.residual).fold(0.0, f64::max);
    Ok((points.iter().map(|point| point.position).collect(), residual))
}

fn group_mask(mesh: &SurfaceMesh, names: &[String]) -> Vec<bool> {
    let mut mask = vec![false; mesh.vertices.len()];
    let groups = mesh.vertex_groups.iter().filter(|g| names.contains(&g.name));
    groups.flat_map(|g| &g.indices).for_each(|&v| mask[v as usize] = true);
    mask
}

fn component_summaries(ownership: &Ownership, components: &[Arc<Component>]) -> Vec<ComponentSummary> {
    (0u32..)
        .zip(components)
        .map(|(index, component)| {
            let distances: Vec<f64> = (0..ownership.vertex_count() as u32)
                .filter_map(|v| ownership.on(v, index))
                .map(|a| a.distance)
                .collect();
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

/// What the fields are built from.
struct Fields<'a> {
    options: &'a Options,
    mesh: &'a SurfaceMesh,
    topology: &'a Topology,
    ownership: &'a Ownership,
    seams: &'a SeamSolver,
    reference: &'a [Body],
    positions: &'a [Vector3],
    mirror: Option<&'a [u32]>,
    half: Option<(&'a Plane, f64)>,
    names: &'a [String],
    /// Factors known already, in the order of the fields.
    found: &'a [Factors],
}

impl Fields<'_> {
    /// Chooses the training vertices and factorises, region by region.
    fn build(&self, monitor: &dyn Monitor<Stage>) -> Result<Vec<RegionField>, SetupError> {
        let regions: Vec<Option<u32>> = match self.options.propagation {
            Propagation::Absolute => vec![None],
            Propagation::Departure | Propagation::Surface => (0..self.names.len() as u32).map(Some).collect(),
        };
        let seam_vertices: Vec<u32> = self.seams.vertices.iter().map(|s| s.vertex).collect();
        let held: Vec<u32> = (0..self.positions.len() as u32)
            .filter(|&v| self.ownership.of(v).iter().any(|a| a.freedom == Freedom::Fixed))
            .collect();
        let mut fields = Vec::new();
        for (done, &component) in regions.iter().enumerate() {
            if monitor.cancelled() {
                return Err(SetupError::Cancelled);
            }
            let contains = |v: u32| component.is_none_or(|c| self.ownership.on(v, c).is_some());
            let members = (0..self.positions.len() as u32).filter(|&v| contains(v));
            let share = members.clone().count() as f64 / self.positions.len() as f64;
            let region = Region {
                topology: self.topology,
                vertices: &self.mesh.vertices,
                contains: &contains,
                mirror: self.mirror,
                seam_vertices: &seam_vertices,
                held: &held,
                blend_radius: self.blend_radius(component),
            };
            let count = (share * self.options.training_vertices as f64).ceil() as usize;
            let training = match component {
                None => region.absolute_set(count),
                Some(_) => region.departure_set(count),
            };
            if training.is_empty() {
                continue;
            }
            let chart = component
                .filter(|_| self.options.propagation == Propagation::Surface)
                .and_then(|c| self.chart(c));
            let mirror = self.mirror_of(component, chart.as_ref());
            let kernel = self.options.kernel();
            let regularisation = self.options.regularisation;
            let found = self.found.get(fields.len());
            let field = Field::new(training, self.positions, kernel, regularisation, mirror, found).map_err(
                |error| SetupError::Factorisation {
                    field: component.map_or("the whole mesh".into(), |c| self.names[c as usize].clone()),
                    reason: error.to_string(),
                },
            )?;
            let moved =
                members.filter(|&v| matches!(self.ownership.of(v), [only] if only.freedom != Freedom::Fixed));
            let vertices: Vec<u32> = moved.collect();
            let points = vertices.iter().map(|&v| self.positions[v as usize]).collect();
            fields.push(RegionField { component, chart, field, vertices, points });
            monitor.progress(Stage::Factorisation, (done + 1) as f64 / regions.len() as f64);
        }
        monitor.progress(Stage::Factorisation, 1.0);
        Ok(fields)
    }

    /// Surface coordinates over at least the patches that carry seams.
    fn chart(&self, component: u32) -> Option<Chart> {
        let body = &self.reference[component as usize];
        let mut required = vec![false; body.component().patches().len()];
        for own in self.seams.vertices.iter().filter_map(|s| self.ownership.on(s.vertex, component)) {
            required[own.location.patch as usize] = true;
        }
        Chart::new(body, &required)
    }

    /// The mirror of a half model, for regions that reach its plane.
    fn mirror_of(&self, component: Option<u32>, chart: Option<&Chart>) -> Option<Mirror<'_>> {
        let (plane, tolerance) = self.half?;
        let on = |v: u32| component.is_none_or(|c| self.ownership.on(v, c).is_some());
        let in_plane = |v: u32| plane.signed_distance(&self.mesh.vertices[v as usize]).abs() <= tolerance;
        if !(0..self.positions.len() as u32).any(|v| on(v) && in_plane(v)) {
            return None;
        }
        let signs = match (chart, component) {
            (Some(chart), Some(c)) => {
                let seam = self.seams.vertices.iter().find_map(|s| self.ownership.on(s.vertex, c));
                let location = seam.map(|a| a.location)?;
                chart.mirror_signs(&self.reference[c as usize], &location, plane)?.to_vec()
            }
            _ => vec![1.0, -1.0, 1.0],
        };
        Some(Mirror { plane, tolerance, signs })
    }

    fn blend_radius(&self, component: Option<u32>) -> f64 {
        let of_name = component.and_then(|c| {
            let name = &self.names[c as usize];
            self.options.blend_radius_of.iter().find(|(n, _)| n == name)
        });
        of_name.map_or(self.options.blend_radius, |(_, radius)| *radius)
    }
}
