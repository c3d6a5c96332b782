//! One deformation: Algorithm 1 of the paper, step by step.
//!
//! design -> control points -> seam points -> training data -> field -> vertices on their components -> outer mold line.

use moldline_geometry::{Block, Body, Feature, FootPoint, Location, block::add_vector};
use moldline_mesh::{CellQuality, QualityReport, quality};
use moldline_parameterisation::ControlPoints;
use moldline_spline::Vector3;
use rayon::prelude::*;

use crate::{
    DeformError, Monitor, OuterMoldLine, Propagation, Setup, Stage,
    chart::Chart,
    error::{LISTED, VertexDistance},
    outputs::Measured,
    ownership::{Attachment, Freedom},
    projection::{Projected, SmoothProjection, Step},
    seam::SeamPoint,
    setup::RegionField,
};

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
}

/// A vertex on its component.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placed {
    pub position: Vector3,
    pub location: Location,
    /// The point whose foot point it is, where it was projected.
    pub aim: Vector3,
}

/// What a deformation found on its way: its linearisation starts from here.
#[derive(Debug)]
pub(crate) struct State {
    pub bodies: Vec<Body>,
    pub seams: Vec<SeamPoint>,
    /// Field values of all vertices.
    pub displacements: Vec<Vector3>,
    /// All vertices on their components, after the field and after each round of smoothing.
    pub placed: Vec<Vec<Placed>>,
    /// The steps of the smooth projection, for vertices that took any.
    pub steps: Vec<(u32, Vec<Step>)>,
}

impl Setup {
    /// The mesh of a design (one number a variable, in the declared units).
    ///
    /// # Errors
    /// [`DeformError`]: the design is refused, a seam is lost, or the projection does not converge.
    pub fn deform(&self, design: &[f64], monitor: &dyn Monitor<Stage>) -> Result<Deformation, DeformError> {
        self.deform_control_points(&self.design_control_points(design, monitor)?, monitor)
    }

    /// The mesh of components whose control points come from elsewhere: per component, the user's, Cartesian, m.
    ///
    /// # Errors
    /// As [`Setup::deform`], and [`DeformError::ControlPoints`] if they do not fit.
    pub fn deform_control_points(
        &self,
        control_points: &[Vec<[f64; 3]>],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Deformation, DeformError> {
        Ok(self.run(control_points, monitor)?.1)
    }

    pub(crate) fn design_control_points(
        &self,
        design: &[f64],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<ControlPoints, DeformError> {
        monitor.progress(Stage::Geometry, 0.0);
        self.parameterisation.validate(design)?;
        Ok(self.parameterisation.control_points(design)?)
    }

    /// Algorithm 1 after its first step.
    pub(crate) fn run(
        &self,
        control_points: &[Vec<[f64; 3]>],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<(State, Deformation), DeformError> {
        let bodies = self.bodies(control_points)?;
        let go_on = |stage| {
            monitor.progress(stage, 0.0);
            if monitor.cancelled() { Err(DeformError::Cancelled) } else { Ok(()) }
        };
        go_on(Stage::SeamSearch)?;
        let seams = self.seams.eval(&self.reference, &bodies, monitor)?;
        go_on(Stage::Field)?;
        let displacements = self.displacements(&seams, &bodies)?;
        go_on(Stage::Projection)?;
        let placed = self.place(&displacements, &seams, &bodies)?;
        let placed = self.smooth(placed, &bodies)?;
        // There is the one before the first round at least.
        let last = &placed[placed.len() - 1];
        let (positions, residual, steps) = self.onto_outer_mold_line(last, &seams, &bodies, monitor)?;
        go_on(Stage::Quality)?;
        let locations: Vec<Location> = last.iter().map(|p| p.location).collect();
        let vertices: Vec<[f64; 3]> = positions.into_iter().map(Into::into).collect();
        let held_residual = self.held_residual(&vertices, &bodies)?;
        let owners = &self.ownership.cell_owner;
        let normals = self.inspection.normals(&self.mesh.cells, owners, &vertices, &locations, &bodies);
        let cell_quality = quality::evaluate(&vertices, &self.mesh.cells, &normals);
        // A set-up has cells, so that there is a report.
        let summary =
            self.inspection.report(&cell_quality, owners).unwrap_or_else(|| self.report().quality.clone());
        monitor.progress(Stage::Quality, 1.0);
        let measured = Measured { cells: &self.mesh.cells, owners, vertices: &vertices, bodies: &bodies };
        let functions = self.outputs.eval(measured);
        let deformation = Deformation {
            vertices,
            functions,
            locations,
            quality: summary,
            cell_quality,
            seam_residual: seams.iter().map(|p| p.residual).fold(0.0, f64::max),
            held_residual,
            projection_residual: residual,
            projection_steps: steps.iter().map(|(_, steps)| steps.len()).max().unwrap_or(0),
        };
        Ok((State { bodies, seams, displacements, placed, steps }, deformation))
    }

    /// Steps B to E: field values at all vertices. `Surface`: departures in the reference state; `Departure`: in the
    /// deformed state; `Absolute`: displacements.
    fn displacements(&self, seams: &[SeamPoint], bodies: &[Body]) -> Result<Vec<Vector3>, DeformError> {
        let mut displacements = vec![Vector3::zeros(); self.positions.len()];
        for region in &self.fields {
            let motion = self.seam_motion(region, seams, bodies)?;
            let follow = |v: u32, factor: f64, row: &mut [f64]| {
                if region.component.is_none() {
                    let own = &self.ownership.of(v)[0];
                    let now = bodies[own.component as usize].position(&own.location);
                    add_vector(row, 0, &((now - self.positions[v as usize]) * factor));
                }
            };
            let values = region.field.eval(&motion, follow, &region.points);
            for (i, &v) in region.vertices.iter().enumerate() {
                displacements[v as usize].as_mut_slice()[..region.columns()].copy_from_slice(values.row(i));
            }
        }
        Ok(displacements)
    }

    /// What each seam vertex does in the terms of one field, a row each; zero for those outside its region.
    fn seam_motion(
        &self,
        region: &RegionField,
        seams: &[SeamPoint],
        bodies: &[Body],
    ) -> Result<Block, DeformError> {
        let tolerance = 1e-12 * self.length;
        let mut lost = Vec::new();
        let mut motion = Block::zeros(seams.len(), region.columns());
        for (i, (seam, point)) in self.seams.vertices.iter().zip(seams).enumerate() {
            let start = self.positions[seam.vertex as usize];
            let row = motion.row_mut(i);
            let Some(component) = region.component else {
                add_vector(row, 0, &(point.position - start));
                continue;
            };
            let Some(k) = seam.owners.iter().position(|&o| o == component) else { continue };
            let reference = &self.reference[component as usize];
            let (from, to) = (&seam.locations[k], &point.locations[k]);
            match (&region.chart, self.options.propagation) {
                (Some(chart), _) => match chart.unroll(reference, from, to, tolerance) {
                    Some(departure) => row.copy_from_slice(&departure),
                    None => {
                        let distance = (reference.position(to) - start).norm();
                        lost.push(VertexDistance { vertex: seam.vertex, distance });
                    }
                },
                (None, Propagation::Surface) => add_vector(row, 0, &(reference.position(to) - start)),
                (None, _) => {
                    add_vector(row, 0, &(point.position - bodies[component as usize].position(from)));
                }
            }
        }
        match (region.component, lost.is_empty()) {
            (Some(component), false) => Err(DeformError::FootPoint {
                component: self.components[component as usize].name().to_owned(),
                count: lost.len(),
                worst: lost.into_iter().take(LISTED).collect(),
            }),
            _ => Ok(motion),
        }
    }

    /// Every vertex onto its component (eq. 17 and the constraints): seam vertices where the search found them.
    fn place(
        &self,
        displacements: &[Vector3],
        seams: &[SeamPoint],
        bodies: &[Body],
    ) -> Result<Vec<Placed>, DeformError> {
        let results: Vec<Result<Placed, f64>> = (0..self.positions.len() as u32)
            .into_par_iter()
            .map(|v| {
                let own = &self.ownership.of(v)[0];
                if self.stationary[v as usize] {
                    return Ok(Placed::at(self.positions[v as usize], own.location));
                }
                let placed = self.place_vertex(v, own, &displacements[v as usize], bodies)?;
                Ok(Placed { position: self.in_plane(v, placed.position), ..placed })
            })
            .collect();
        let mut placed = self.all_found(results)?;
        for (seam, point) in self.seams.vertices.iter().zip(seams) {
            if !self.stationary[seam.vertex as usize] {
                let position = self.in_plane(seam.vertex, point.position);
                placed[seam.vertex as usize] = Placed::at(position, point.locations[0]);
            }
        }
        Ok(placed)
    }

    fn place_vertex(
        &self,
        v: u32,
        own: &Attachment,
        displacement: &Vector3,
        bodies: &[Body],
    ) -> Result<Placed, f64> {
        let body = &bodies[own.component as usize];
        let at = |location: Location| Placed::at(body.position(&location), location);
        let start = self.positions[v as usize];
        match self.rule(v) {
            Rule::Follow => Ok(at(own.location)),
            Rule::Slide { chart, free } => {
                let departure = [0, 1].map(|k| if free[k] { displacement[k] } else { 0.0 });
                Ok(at(chart.walk(&self.reference[own.component as usize], &own.location, departure)))
            }
            Rule::Undeformed => {
                let aim = start + displacement;
                let foot = onto(&self.reference[own.component as usize], own, &aim)?;
                Ok(Placed { aim, ..at(foot.location) })
            }
            Rule::Deformed { follow } => {
                let from = if follow { body.position(&own.location) } else { start };
                let aim = from + displacement;
                let foot = onto(body, own, &aim)?;
                Ok(Placed { position: foot.position, location: foot.location, aim })
            }
        }
    }

    /// How the field value of a vertex becomes its place.
    pub(crate) fn rule(&self, v: u32) -> Rule<'_> {
        let own = &self.ownership.of(v)[0];
        if own.freedom == Freedom::Fixed || self.ownership.is_seam(v) {
            return Rule::Follow;
        }
        match self.options.propagation {
            Propagation::Surface => {
                let region = self.fields.iter().find(|f| f.component == Some(own.component));
                match region.map(|r| &r.chart) {
                    None => Rule::Follow,
                    Some(None) => Rule::Undeformed,
                    Some(Some(chart)) => Rule::Slide { chart, free: self.free_coordinates(chart, own) },
                }
            }
            Propagation::Departure => Rule::Deformed { follow: true },
            Propagation::Absolute => Rule::Deformed { follow: false },
        }
    }

    /// The coordinates of a departure that a vertex's freedom admits.
    fn free_coordinates(&self, chart: &Chart, own: &Attachment) -> [bool; 2] {
        let Freedom::Edge(edge) = own.freedom else { return [true; 2] };
        let sides = &self.components[own.component as usize].edges()[edge as usize].sides;
        match sides.iter().find(|s| s.patch == own.location.patch) {
            Some(side) => chart.along_edge(&own.location, side),
            None => [false; 2],
        }
    }

    /// Rounds of Laplacian smoothing, each followed by a projection onto the components: the vertices before the first and
    /// after each.
    fn smooth(&self, vertices: Vec<Placed>, bodies: &[Body]) -> Result<Vec<Vec<Placed>>, DeformError> {
        let options = &self.options.smoothing;
        let mut all = vec![vertices];
        let Some(laplacian) = &self.laplacian else { return Ok(all) };
        let mut smoothed = vec![[0.0; 3]; self.positions.len()];
        for round in 0..options.rounds {
            let vertices = &all[round];
            let current: Vec<[f64; 3]> = vertices.iter().map(|p| p.position.into()).collect();
            laplacian.smooth(options.relaxation, &current, &mut smoothed);
            let results: Vec<Result<Placed, f64>> = vertices
                .par_iter()
                .zip(&smoothed)
                .enumerate()
                .map(|(v, (before, x))| {
                    let v = v as u32;
                    if !self.may_smooth(v) {
                        return Ok(*before);
                    }
                    let own = Attachment { location: before.location, ..self.ownership.of(v)[0] };
                    let aim = Vector3::from(*x);
                    let foot = onto(&bodies[own.component as usize], &own, &aim)?;
                    let position = self.in_plane(v, foot.position);
                    Ok(Placed { position, location: foot.location, aim })
                })
                .collect();
            all.push(self.all_found(results)?);
        }
        Ok(all)
    }

    /// Whether smoothing moves a vertex.
    pub(crate) fn may_smooth(&self, v: u32) -> bool {
        !self.stationary[v as usize] && self.ownership.is_free(v)
    }

    /// Step F for the smooth outer mold line: vertices that nothing protects onto the zero set of `Phi`. The second value
    /// is the largest `|Phi|` left, the third the steps of the vertices that took any.
    #[allow(clippy::type_complexity)]
    fn onto_outer_mold_line(
        &self,
        placed: &[Placed],
        seams: &[SeamPoint],
        bodies: &[Body],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<(Vec<Vector3>, f64, Vec<(u32, Vec<Step>)>), DeformError> {
        if self.options.outer_mold_line == OuterMoldLine::Sharp {
            return Ok((placed.iter().map(|p| p.position).collect(), 0.0, Vec::new()));
        }
        let projection = self.projection(bodies);
        let mut known: Vec<Vec<(u32, Location)>> = (0u32..)
            .zip(placed)
            .map(|(v, p)| vec![(self.ownership.of(v)[0].component, p.location)])
            .collect();
        for (seam, point) in self.seams.vertices.iter().zip(seams) {
            known[seam.vertex as usize] =
                seam.owners.iter().copied().zip(point.locations.iter().copied()).collect();
        }
        let projected: Vec<Projected> = placed
            .par_iter()
            .zip(&known)
            .enumerate()
            .map(|(v, (p, known))| {
                if !self.is_active(v as u32) || monitor.cancelled() {
                    return Projected { position: p.position, value: 0.0, steps: Vec::new() };
                }
                projection.eval(p.position, known, |x| self.in_plane(v as u32, x))
            })
            .collect();
        if monitor.cancelled() {
            return Err(DeformError::Cancelled);
        }
        let off: Vec<VertexDistance> = (0u32..)
            .zip(&projected)
            .filter(|(_, p)| p.value.is_nan() || p.value.abs() > projection.tolerance)
            .map(|(vertex, p)| VertexDistance { vertex, distance: p.value.abs() })
            .collect();
        if !off.is_empty() {
            let count = off.len();
            let worst = off.into_iter().take(LISTED).collect();
            return Err(DeformError::NotProjected { count, steps: projection.steps, worst });
        }
        let residual = projected.iter().map(|p| p.value.abs()).fold(0.0, f64::max);
        let positions = projected.iter().map(|p| p.position).collect();
        let steps = (0u32..).zip(projected).filter(|(_, p)| !p.steps.is_empty());
        Ok((positions, residual, steps.map(|(v, p)| (v, p.steps)).collect()))
    }

    /// The smooth projection in one state of the components.
    pub(crate) fn projection<'a>(&self, bodies: &'a [Body]) -> SmoothProjection<'a> {
        SmoothProjection {
            bodies,
            union: self.union,
            steps: self.options.projection_steps,
            tolerance: self.options.projection_tolerance * self.length,
        }
    }

    /// Whether the smooth projection moves a vertex: nothing protects or holds it.
    pub fn is_active(&self, v: u32) -> bool {
        !self.stationary[v as usize] && self.ownership.of(v).iter().all(|a| a.freedom == Freedom::Surface)
    }

    /// Vertices of the symmetry plane stay in it.
    pub(crate) fn in_plane(&self, v: u32, x: Vector3) -> Vector3 {
        if self.in_plane[v as usize] { Vector3::new(x.x, 0.0, x.z) } else { x }
    }

    fn all_found(&self, results: Vec<Result<Placed, f64>>) -> Result<Vec<Placed>, DeformError> {
        let lost: Vec<VertexDistance> = (0u32..)
            .zip(&results)
            .filter_map(|(vertex, r)| r.as_ref().err().map(|&distance| VertexDistance { vertex, distance }))
            .collect();
        match lost.first() {
            None => Ok(results.into_iter().flatten().collect()),
            Some(first) => {
                let component = self.ownership.of(first.vertex)[0].component as usize;
                Err(DeformError::FootPoint {
                    component: self.components[component].name().to_owned(),
                    count: lost.len(),
                    worst: lost.iter().take(LISTED).copied().collect(),
                })
            }
        }
    }
}

impl Placed {
    fn at(position: Vector3, location: Location) -> Self {
        Self { position, location, aim: position }
    }
}

/// How the field value `d` of a vertex becomes its place.
pub(crate) enum Rule<'a> {
    /// It stays at its parameters.
    Follow,
    /// Its parameters are those of the end of a walk of `d` in the chart, as far as coordinates are free.
    Slide { chart: &'a Chart, free: [bool; 2] },
    /// Its parameters are those of the foot point of its reference position plus `d` on the undeformed component.
    Undeformed,
    /// It is the foot point on the deformed component of `d` plus where it was, or (`follow`) where its parameters are now.
    Deformed { follow: bool },
}

/// The foot point of `x` on the part of a component that its vertex may move over: its own sheet, or its sharp edge. On
/// failure, the distance of `x` from the component.
fn onto(body: &Body, own: &Attachment, x: &Vector3) -> Result<FootPoint, f64> {
    let foot = match own.freedom {
        Freedom::Edge(edge) => Some(body.closest_point_on_edge(x, edge, &own.location)),
        _ => body.closest_point_near(x, &own.location),
    };
    match foot {
        Some(foot) if foot.position.iter().all(|p| p.is_finite()) => Ok(foot),
        _ => {
            // The global search, if it comes out on the same side.
            let foot = body.closest_point(x);
            let same_side = foot.normal.dot(&body.normal(&own.location)) > 0.0;
            let usable = same_side && foot.feature == Feature::Face;
            if usable { Ok(foot) } else { Err(foot.distance.abs()) }
        }
    }
}
