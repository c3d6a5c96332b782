//! One deformation: Algorithm 1 of the paper, step by step.
//!
//! design -> control points -> seam points -> training data -> field -> vertices on their components -> outer mold line.

use moldline_geometry::{Body, Feature, FootPoint, Location};
use moldline_mesh::{CellQuality, QualityReport, quality};
use moldline_spline::Vector3;
use rayon::prelude::*;

use crate::{
    DeformError, Monitor, OuterMoldLine, Propagation, Setup, Stage,
    chart::Chart,
    error::{LISTED, VertexDistance},
    ownership::{Attachment, Freedom},
    projection::{Projected, SmoothProjection},
    seam::SeamPoint,
    setup::RegionField,
};

/// A deformed mesh.
#[derive(Clone, Debug)]
pub struct Deformation {
    /// All vertices, m, in the order of the set-up's mesh.
    pub vertices: Vec<[f64; 3]>,
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
#[derive(Clone, Copy)]
struct Placed {
    position: Vector3,
    location: Location,
}

impl Setup {
    /// The mesh of a design (one number a variable, in the declared units).
    ///
    /// # Errors
    /// [`DeformError`]: the design is refused, a seam is lost, or the projection does not converge.
    pub fn deform(&self, design: &[f64], monitor: &dyn Monitor) -> Result<Deformation, DeformError> {
        monitor.progress(Stage::Geometry, 0.0);
        self.parameterisation.validate(design)?;
        let control_points = self.parameterisation.control_points(design)?;
        self.deform_control_points(&control_points, monitor)
    }

    /// The mesh of components whose control points come from elsewhere: per component, the user's, Cartesian, m.
    ///
    /// # Errors
    /// As [`Setup::deform`], and [`DeformError::ControlPoints`] if they do not fit.
    pub fn deform_control_points(
        &self,
        control_points: &[Vec<[f64; 3]>],
        monitor: &dyn Monitor,
    ) -> Result<Deformation, DeformError> {
        let bodies = self.bodies(control_points)?;
        let go_on = |stage| {
            monitor.progress(stage, 0.0);
            if monitor.cancelled() { Err(DeformError::Cancelled) } else { Ok(()) }
        };
        go_on(Stage::SeamSearch)?;
        let seams = self.seams.eval(&bodies, monitor)?;
        go_on(Stage::Field)?;
        let displacements = self.displacements(&seams, &bodies)?;
        go_on(Stage::Projection)?;
        let mut placed = self.place(&displacements, &seams, &bodies)?;
        self.smooth(&mut placed, &bodies)?;
        let locations: Vec<Location> = placed.iter().map(|p| p.location).collect();
        let (positions, residual, steps) = self.onto_outer_mold_line(placed, &seams, &bodies, monitor)?;
        go_on(Stage::Quality)?;
        let vertices: Vec<[f64; 3]> = positions.into_iter().map(Into::into).collect();
        let held_residual = self.held_residual(&vertices, &bodies)?;
        let owners = &self.ownership.cell_owner;
        let normals = self.inspection.normals(&self.mesh.cells, owners, &vertices, &locations, &bodies);
        let cell_quality = quality::evaluate(&vertices, &self.mesh.cells, &normals);
        // A set-up has cells, so that there is a report.
        let summary =
            self.inspection.report(&cell_quality, owners).unwrap_or_else(|| self.report().quality.clone());
        monitor.progress(Stage::Quality, 1.0);
        Ok(Deformation {
            vertices,
            locations,
            quality: summary,
            cell_quality,
            seam_residual: seams.iter().map(|p| p.residual).fold(0.0, f64::max),
            held_residual,
            projection_residual: residual,
            projection_steps: steps,
        })
    }

    /// Steps B to E: field values at all vertices. `Surface`: departures in the reference state; `Departure`: in the
    /// deformed state; `Absolute`: displacements.
    fn displacements(&self, seams: &[SeamPoint], bodies: &[Body]) -> Result<Vec<Vector3>, DeformError> {
        let mut displacements = vec![Vector3::zeros(); self.positions.len()];
        for region in &self.fields {
            let motion = self.seam_motion(region, seams, bodies)?;
            let follow = |v: u32| {
                let own = &self.ownership.of(v)[0];
                bodies[own.component as usize].position(&own.location) - self.positions[v as usize]
            };
            let mut values = vec![Vector3::zeros(); region.vertices.len()];
            match region.component {
                None => region.field.eval(&motion, follow, &region.points, &mut values),
                Some(_) => region.field.eval(&motion, |_| Vector3::zeros(), &region.points, &mut values),
            }
            for (&v, value) in region.vertices.iter().zip(values) {
                displacements[v as usize] = value;
            }
        }
        Ok(displacements)
    }

    /// What each seam vertex does in the terms of one field; zero for those outside its region.
    fn seam_motion(
        &self,
        region: &RegionField,
        seams: &[SeamPoint],
        bodies: &[Body],
    ) -> Result<Vec<Vector3>, DeformError> {
        let tolerance = 1e-12 * self.length;
        let mut lost = Vec::new();
        let mut motion = Vec::with_capacity(seams.len());
        for (seam, point) in self.seams.vertices.iter().zip(seams) {
            let start = self.positions[seam.vertex as usize];
            let Some(component) = region.component else {
                motion.push(point.position - start);
                continue;
            };
            let Some(k) = seam.owners.iter().position(|&o| o == component) else {
                motion.push(Vector3::zeros());
                continue;
            };
            let reference = &self.reference[component as usize];
            let (from, to) = (&seam.locations[k], &point.locations[k]);
            motion.push(match (&region.chart, self.options.propagation) {
                (Some(chart), _) => match chart.unroll(reference, from, to, tolerance) {
                    Some([a, b]) => Vector3::new(a, b, 0.0),
                    None => {
                        let distance = (reference.position(to) - start).norm();
                        lost.push(VertexDistance { vertex: seam.vertex, distance });
                        Vector3::zeros()
                    }
                },
                (None, Propagation::Surface) => reference.position(to) - start,
                (None, _) => point.position - bodies[component as usize].position(from),
            });
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
                    return Ok(Placed { position: self.positions[v as usize], location: own.location });
                }
                let placed = self.place_vertex(v, own, &displacements[v as usize], bodies)?;
                Ok(Placed { position: self.in_plane(v, placed.position), ..placed })
            })
            .collect();
        let mut placed = self.all_found(results)?;
        for (seam, point) in self.seams.vertices.iter().zip(seams) {
            if !self.stationary[seam.vertex as usize] {
                let position = self.in_plane(seam.vertex, point.position);
                placed[seam.vertex as usize] = Placed { position, location: point.locations[0] };
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
        let at = |location: Location| Placed { position: body.position(&location), location };
        if own.freedom == Freedom::Fixed || self.ownership.is_seam(v) {
            return Ok(at(own.location));
        }
        let start = self.positions[v as usize];
        match self.options.propagation {
            Propagation::Surface => {
                let reference = &self.reference[own.component as usize];
                let region = self.fields.iter().find(|f| f.component == Some(own.component));
                match region.map(|r| &r.chart) {
                    None => Ok(at(own.location)),
                    Some(None) => Ok(at(onto(reference, own, &(start + displacement))?.location)),
                    Some(Some(chart)) => {
                        let departure = free_departure(chart, body, own, displacement);
                        Ok(at(chart.walk(reference, &own.location, departure)))
                    }
                }
            }
            Propagation::Departure => {
                Ok(placed(onto(body, own, &(body.position(&own.location) + displacement))?))
            }
            Propagation::Absolute => Ok(placed(onto(body, own, &(start + displacement))?)),
        }
    }

    /// Rounds of Laplacian smoothing, each followed by a projection onto the components.
    fn smooth(&self, vertices: &mut [Placed], bodies: &[Body]) -> Result<(), DeformError> {
        let options = &self.options.smoothing;
        let Some(laplacian) = &self.laplacian else { return Ok(()) };
        let mut smoothed = vec![[0.0; 3]; vertices.len()];
        for _ in 0..options.rounds {
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
                    let foot = onto(&bodies[own.component as usize], &own, &Vector3::from(*x))?;
                    let position = self.in_plane(v, foot.position);
                    Ok(Placed { position, location: foot.location })
                })
                .collect();
            vertices.copy_from_slice(&self.all_found(results)?);
        }
        Ok(())
    }

    fn may_smooth(&self, v: u32) -> bool {
        !self.stationary[v as usize] && self.ownership.is_free(v)
    }

    /// Step F for the smooth outer mold line: vertices that nothing protects onto the zero set of `Phi`. The second and
    /// third values are the largest `|Phi|` left and the most steps taken.
    fn onto_outer_mold_line(
        &self,
        placed: Vec<Placed>,
        seams: &[SeamPoint],
        bodies: &[Body],
        monitor: &dyn Monitor,
    ) -> Result<(Vec<Vector3>, f64, usize), DeformError> {
        if self.options.outer_mold_line == OuterMoldLine::Sharp {
            return Ok((placed.into_iter().map(|p| p.position).collect(), 0.0, 0));
        }
        let projection = SmoothProjection {
            bodies,
            union: self.union,
            steps: self.options.projection_steps,
            tolerance: self.options.projection_tolerance * self.length,
        };
        let mut known: Vec<Vec<(u32, Location)>> = (0u32..)
            .zip(&placed)
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
                    return Projected { position: p.position, value: 0.0, steps: 0 };
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
        let steps = projected.iter().map(|p| p.steps).max().unwrap_or(0);
        Ok((projected.into_iter().map(|p| p.position).collect(), residual, steps))
    }

    /// Whether the smooth projection moves a vertex: nothing protects or holds it.
    pub fn is_active(&self, v: u32) -> bool {
        !self.stationary[v as usize] && self.ownership.of(v).iter().all(|a| a.freedom == Freedom::Surface)
    }

    /// Vertices of the symmetry plane stay in it.
    fn in_plane(&self, v: u32, x: Vector3) -> Vector3 {
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

/// The departure that a vertex's freedom admits.
fn free_departure(chart: &Chart, body: &Body, own: &Attachment, displacement: &Vector3) -> [f64; 2] {
    let departure = [displacement.x, displacement.y];
    let Freedom::Edge(edge) = own.freedom else { return departure };
    let sides = &body.component().edges()[edge as usize].sides;
    match sides.iter().find(|s| s.patch == own.location.patch) {
        Some(side) => chart.along_edge(&own.location, side, departure),
        None => [0.0; 2],
    }
}

fn placed(foot: FootPoint) -> Placed {
    Placed { position: foot.position, location: foot.location }
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
