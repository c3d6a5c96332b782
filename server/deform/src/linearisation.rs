//! Products with the derivative of a deformation: `J V` for blocks of directions, `J^T W` for blocks of seeds.
//!
//! The chain is that of [`crate::Setup::deform`], operation by operation: control points, seams, what seams do in the terms
//! of each field, fields, vertices on their components, smoothing, projection. What a product needs is kept when the
//! deformation is linearised; applying it iterates and searches nothing.

use std::sync::Arc;

use moldline_geometry::{
    Block, Body, FootChange, Location, SignedDistance,
    block::{add_vector, vector},
};
use moldline_parameterisation::ControlPoints;
use moldline_spline::Vector3;
use rayon::prelude::*;

use crate::{
    DeformError, Deformation, Monitor, Propagation, Setup, Stage,
    outputs::{Measured, OutputsDerivative},
    pipeline::{Placed, Rule, State},
    projection::Step,
    seam_derivative::{SeamChange, SeamDerivative},
    setup::RegionField,
};

/// Directions and seeds that are handled at once.
const BLOCK: usize = 48;
/// Parts of the mesh that gather seeds of the control points on their own. Fixed, so that sums do not depend on threads.
const PARTS: usize = 8;

/// A change of the outputs in one direction, or the seed of one adjoint.
#[derive(Clone, Debug, PartialEq)]
pub struct Tangent {
    /// Of the mesh's vertices, m (seeds: per m).
    pub vertices: Vec<[f64; 3]>,
    /// Of the scalar outputs, in their units, in the order of [`Setup::functions`].
    pub functions: Vec<f64>,
}

/// The gradient of one seed's product with the outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradient {
    /// By the design variables, per declared unit; empty if the control points did not come from a design.
    pub design: Vec<f64>,
    /// By the user's Cartesian control points, per component, 1/m.
    pub control_points: ControlPoints,
}

/// Tangents of everything between control points and vertices, in one direction.
#[derive(Clone, Debug)]
pub struct Stages {
    /// Of the seam vertices.
    pub seam_positions: Vec<Vector3>,
    /// Of their parameters `(u, v)`, per owner.
    pub seam_parameters: Vec<Vec<[f64; 2]>>,
    /// Of what each seam vertex does in the terms of each field.
    pub motions: Vec<Vec<Vector3>>,
    /// Of the field value of every vertex.
    pub displacements: Vec<Vector3>,
    /// Of every vertex on its component, after smoothing.
    pub placed: Vec<Vector3>,
    /// Of every vertex.
    pub vertices: Vec<Vector3>,
    /// The scalar outputs, each in its unit.
    pub functions: Vec<f64>,
}

/// A deformation with its derivative.
#[derive(Debug)]
pub struct Linearisation {
    setup: Arc<Setup>,
    /// `None`: the control points were given.
    design: Option<Vec<f64>>,
    deformation: Deformation,
    bodies: Vec<Body>,
    seams: SeamDerivative,
    /// What each seam vertex does in the terms of each field.
    motions: Vec<Vec<Motion>>,
    placements: Vec<Placement>,
    rounds: Vec<Vec<Projection>>,
    steps: Vec<(u32, Vec<Step>)>,
    outputs: OutputsDerivative,
}

/// The derivative of one seam vertex's motion in the terms of a field.
#[derive(Clone, Debug)]
enum Motion {
    /// It is not in the field's region.
    None,
    /// By its parameters on the component: `departure = by * (u, v)`.
    Parameters { row: usize, by: [[f64; 2]; 2] },
    /// By its parameters, as a vector in space.
    Tangent { row: usize, j: [Vector3; 2] },
    /// As it moves in space.
    Position,
    /// As it moves away from the point of a component that it was.
    Gap { component: u32, from: Location },
}

/// A foot point: of which point, and where.
#[derive(Clone, Copy, Debug)]
struct Projection {
    aim: Vector3,
    location: Location,
}

/// The derivative of one vertex's place by its field value `d` and by the control points.
#[derive(Clone, Debug)]
enum Placement {
    /// It stays.
    Still,
    /// `dx = dS + sum_c by_c d_c`.
    Surface { location: Location, by: [Vector3; 3] },
    /// The foot point of something that moves by `d`, and (`follow`) with the component.
    Foot { projection: Projection, follow: bool },
    /// That of a seam vertex.
    Seam(usize),
}

/// Field values of the vertices: a block for each field, and the row of each vertex.
struct FieldValues {
    blocks: Vec<Block>,
    /// `(field, row)`.
    rows: Vec<Option<(u32, u32)>>,
}

impl Setup {
    /// The mesh of a design with its derivative.
    ///
    /// # Errors
    /// As [`Setup::deform`].
    pub fn linearise(
        self: &Arc<Self>,
        design: &[f64],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Linearisation, DeformError> {
        let control_points = self.design_control_points(design, monitor)?;
        let linearisation = self.linearise_control_points(&control_points, monitor)?;
        Ok(Linearisation { design: Some(design.to_vec()), ..linearisation })
    }

    /// The mesh of components whose control points come from elsewhere, with its derivative.
    ///
    /// # Errors
    /// As [`Setup::deform_control_points`].
    pub fn linearise_control_points(
        self: &Arc<Self>,
        control_points: &[Vec<[f64; 3]>],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Linearisation, DeformError> {
        let (state, deformation) = self.run(control_points, monitor)?;
        let seams = self.seams.linearise(&state.seams, &self.reference, &state.bodies);
        let motions = self.fields.iter().map(|region| self.motions(region, &state, &seams)).collect();
        let placements = self.placements(&state);
        let projection = |p: &Placed| Projection { aim: p.aim, location: p.location };
        let rounds = state.placed[1..].iter().map(|round| round.iter().map(projection).collect()).collect();
        // The searches' trees are not needed any more.
        let bodies: Vec<Body> = state
            .bodies
            .iter()
            .map(|b| Body::new(b.component().clone(), b.control_points().to_vec()))
            .collect();
        let outputs = self.outputs.linearise(Measured {
            cells: &self.mesh.cells,
            owners: &self.ownership.cell_owner,
            vertices: &deformation.vertices,
            bodies: &bodies,
        });
        Ok(Linearisation {
            setup: self.clone(),
            design: None,
            deformation,
            bodies,
            seams,
            motions,
            placements,
            rounds,
            steps: state.steps,
            outputs,
        })
    }

    fn motions(&self, region: &RegionField, state: &State, seams: &SeamDerivative) -> Vec<Motion> {
        let of_vertex = |i: usize| {
            let Some(component) = region.component else { return Motion::Position };
            let (seam, point) = (&self.seams.vertices[i], &state.seams[i]);
            let Some(k) = seam.owners.iter().position(|&o| o == component) else { return Motion::None };
            let reference = &self.reference[component as usize];
            let (from, to) = (&seam.locations[k], &point.locations[k]);
            let row = seams.first_row(i) + k;
            match (&region.chart, self.options.propagation) {
                (Some(chart), _) => {
                    // It was found when the mesh was deformed.
                    let departure =
                        chart.unroll(reference, from, to, 1e-12 * self.length).unwrap_or([0.0; 2]);
                    Motion::Parameters { row, by: chart.unroll_derivative(reference, from, to, departure) }
                }
                (None, Propagation::Surface) => {
                    let point = reference.point(to);
                    Motion::Tangent { row, j: [point.d_u, point.d_v] }
                }
                (None, _) => Motion::Gap { component, from: *from },
            }
        };
        (0..state.seams.len()).into_par_iter().map(of_vertex).collect()
    }

    fn placements(&self, state: &State) -> Vec<Placement> {
        let mut placements: Vec<Placement> = state.placed[0]
            .par_iter()
            .enumerate()
            .map(|(v, placed)| {
                let own = &self.ownership.of(v as u32)[0];
                let location = placed.location;
                let surface = |by| Placement::Surface { location, by };
                if self.stationary[v] {
                    return Placement::Still;
                }
                let component = own.component as usize;
                let (body, reference) = (&state.bodies[component], &self.reference[component]);
                match self.rule(v as u32) {
                    Rule::Follow => surface([Vector3::zeros(); 3]),
                    Rule::Slide { chart, free } => {
                        let d = &state.displacements[v];
                        let departure = [0, 1].map(|k| if free[k] { d[k] } else { 0.0 });
                        let (_, walk) = chart.walk_derivative(reference, &own.location, departure);
                        let point = body.point(&location);
                        let by = |k: usize| match free.get(k) {
                            Some(true) => point.d_u * walk[0][k] + point.d_v * walk[1][k],
                            _ => Vector3::zeros(),
                        };
                        surface([by(0), by(1), by(2)])
                    }
                    Rule::Undeformed => {
                        let foot = reference.foot_point(&placed.aim, &location);
                        let by_point = SignedDistance::new(reference)
                            .derivative(&placed.aim, &foot)
                            .parameters_by_point();
                        let point = body.point(&location);
                        surface(
                            [0, 1, 2]
                                .map(|axis| point.d_u * by_point[0][axis] + point.d_v * by_point[1][axis]),
                        )
                    }
                    Rule::Deformed { follow } => {
                        Placement::Foot { projection: Projection { aim: placed.aim, location }, follow }
                    }
                }
            })
            .collect();
        for (i, seam) in self.seams.vertices.iter().enumerate() {
            if !self.stationary[seam.vertex as usize] {
                placements[seam.vertex as usize] = Placement::Seam(i);
            }
        }
        placements
    }
}

impl Linearisation {
    /// The deformed mesh.
    pub fn deformation(&self) -> &Deformation {
        &self.deformation
    }

    /// The set-up.
    pub fn setup(&self) -> &Arc<Setup> {
        &self.setup
    }

    /// The design, if the control points came from one.
    pub fn design(&self) -> Option<&[f64]> {
        self.design.as_deref()
    }

    /// Bytes held besides the set-up.
    pub fn bytes(&self) -> usize {
        let control_points: usize = self.bodies.iter().map(|b| 32 * b.control_points().len()).sum();
        let motions: usize = self.motions.iter().map(|m| m.len() * size_of::<Motion>()).sum();
        let rounds: usize = self.rounds.iter().map(|r| r.len() * size_of::<Projection>()).sum();
        let step = |s: &Step| size_of::<Step>() + s.feet.len() * size_of::<(u32, Location)>();
        let steps: usize = self.steps.iter().flat_map(|(_, steps)| steps).map(step).sum();
        let deformation = self.deformation.vertices.len() * (24 + size_of::<Location>())
            + size_of_val(&self.deformation.cell_quality[..]);
        control_points
            + self.seams.bytes()
            + motions
            + self.placements.len() * size_of::<Placement>()
            + rounds
            + steps
            + self.outputs.bytes()
            + deformation
    }

    /// `J v` for each of the `directions` in design space, in the declared units.
    ///
    /// # Errors
    /// [`DeformError::NoDesign`] if the control points were given directly; [`DeformError::Design`] for a direction of
    /// the wrong length.
    pub fn jvp<V: AsRef<[f64]>>(&self, directions: &[V]) -> Result<Vec<Tangent>, DeformError> {
        let design = self.design.as_ref().ok_or(DeformError::NoDesign)?;
        let parameterisation = self.setup.parameterisation.linearise(design)?;
        let mut all = Vec::with_capacity(directions.len());
        for directions in directions.chunks(BLOCK) {
            all.extend(self.jvp_block(&parameterisation.jvp(directions)?));
        }
        Ok(all)
    }

    /// `J v` for each of the `directions` of the user's control points, m.
    ///
    /// # Errors
    /// [`DeformError::ControlPoints`] if a direction does not have the set-up's control points.
    pub fn jvp_control_points(&self, directions: &[ControlPoints]) -> Result<Vec<Tangent>, DeformError> {
        directions.iter().try_for_each(|direction| self.check(direction))?;
        Ok(directions.chunks(BLOCK).flat_map(|directions| self.jvp_block(directions)).collect())
    }

    /// `J^T w` for each of the `seeds`.
    ///
    /// # Errors
    /// [`DeformError::SeedSize`] if a seed does not have the mesh's vertices and the set-up's functions.
    pub fn vjp(&self, seeds: &[Tangent]) -> Result<Vec<Gradient>, DeformError> {
        let refuse = |index, what, found, expected| DeformError::SeedSize { index, what, found, expected };
        let (vertices, functions) = (self.placements.len(), self.deformation.functions.len());
        for (index, seed) in seeds.iter().enumerate() {
            if seed.vertices.len() != vertices {
                return Err(refuse(index, "vertices", seed.vertices.len(), vertices));
            }
            if seed.functions.len() != functions {
                return Err(refuse(index, "functions", seed.functions.len(), functions));
            }
        }
        let parameterisation =
            self.design.as_ref().map(|d| self.setup.parameterisation.linearise(d)).transpose()?;
        let mut all = Vec::with_capacity(seeds.len());
        for seeds in seeds.chunks(BLOCK) {
            let by_control_points = self.vjp_block(seeds);
            let design = match &parameterisation {
                Some(parameterisation) => parameterisation.vjp(&by_control_points)?,
                None => vec![Vec::new(); seeds.len()],
            };
            let both = design.into_iter().zip(by_control_points);
            all.extend(both.map(|(design, control_points)| Gradient { design, control_points }));
        }
        Ok(all)
    }

    /// All tangents between control points and vertices for one direction of the user's control points.
    ///
    /// # Errors
    /// As [`Linearisation::jvp_control_points`].
    pub fn stages(&self, direction: &ControlPoints) -> Result<Stages, DeformError> {
        self.check(direction)?;
        let control_points = self.internal(std::slice::from_ref(direction));
        let seams = self.seams.jvp(&self.bodies, &control_points);
        let motions: Vec<Block> =
            (0..self.motions.len()).map(|field| self.motions_jvp(field, &seams, &control_points)).collect();
        let values = self.fields_jvp(&motions, &control_points);
        let placed = self.place_jvp(&values, &seams, &control_points);
        let placed = self.smooth_jvp(placed, &control_points);
        let mut vertices = placed.clone();
        self.project_jvp(&mut vertices, &control_points);
        let functions = self.outputs.jvp(&vertices, &control_points);
        let wide = |row: &[f64]| Vector3::from_fn(|axis, _| row.get(axis).copied().unwrap_or(0.0));
        let vectors = |block: &Block| (0..self.placements.len()).map(|v| block.vector(v, 0)).collect();
        Ok(Stages {
            seam_positions: (0..self.setup.seams.vertices.len())
                .map(|i| seams.positions.vector(i, 0))
                .collect(),
            seam_parameters: self
                .setup
                .seams
                .vertices
                .iter()
                .enumerate()
                .map(|(i, seam)| {
                    let rows = self.seams.first_row(i)..self.seams.first_row(i) + seam.owners.len();
                    rows.map(|row| [seams.parameters.row(row)[0], seams.parameters.row(row)[1]]).collect()
                })
                .collect(),
            motions: motions
                .iter()
                .map(|block| (0..self.setup.seams.vertices.len()).map(|i| wide(block.row(i))).collect())
                .collect(),
            displacements: values
                .rows
                .iter()
                .map(|row| match *row {
                    Some((field, row)) => wide(values.blocks[field as usize].row(row as usize)),
                    None => Vector3::zeros(),
                })
                .collect(),
            placed: vectors(&placed),
            vertices: vectors(&vertices),
            functions: functions.data().to_vec(),
        })
    }

    fn check(&self, direction: &ControlPoints) -> Result<(), DeformError> {
        // Refuses what does not fit, as a deformation does.
        self.setup.bodies(direction).map(|_| ())
    }

    /// Blocks of the internal control points for directions of the user's.
    fn internal(&self, directions: &[ControlPoints]) -> Vec<Block> {
        (0..self.bodies.len())
            .into_par_iter()
            .map(|c| {
                let component = self.bodies[c].component();
                let mut user = Block::zeros(component.user_control_point_count(), 3 * directions.len());
                for (d, direction) in directions.iter().enumerate() {
                    for (i, point) in direction[c].iter().enumerate() {
                        user.row_mut(i)[3 * d..3 * d + 3].copy_from_slice(point);
                    }
                }
                component.internal_jvp(&user)
            })
            .collect()
    }

    fn jvp_block(&self, directions: &[ControlPoints]) -> Vec<Tangent> {
        let control_points = self.internal(directions);
        let seams = self.seams.jvp(&self.bodies, &control_points);
        let motions: Vec<Block> =
            (0..self.motions.len()).map(|field| self.motions_jvp(field, &seams, &control_points)).collect();
        let values = self.fields_jvp(&motions, &control_points);
        let placed = self.place_jvp(&values, &seams, &control_points);
        let mut vertices = self.smooth_jvp(placed, &control_points);
        self.project_jvp(&mut vertices, &control_points);
        let functions = self.outputs.jvp(&vertices, &control_points);
        (0..directions.len())
            .into_par_iter()
            .map(|d| Tangent {
                vertices: (0..self.placements.len()).map(|v| vertices.vector(v, d).into()).collect(),
                functions: (0..self.deformation.functions.len()).map(|f| functions.row(f)[d]).collect(),
            })
            .collect()
    }

    fn vjp_block(&self, seeds: &[Tangent]) -> Vec<ControlPoints> {
        let k = seeds.len();
        let mut vertices = Block::zeros(self.placements.len(), 3 * k);
        for (d, seed) in seeds.iter().enumerate() {
            for (v, x) in seed.vertices.iter().enumerate() {
                vertices.row_mut(v)[3 * d..3 * d + 3].copy_from_slice(x);
            }
        }
        let mut control_points = self.no_control_points(k);
        let mut functions = Block::zeros(self.deformation.functions.len(), k);
        for (d, seed) in seeds.iter().enumerate() {
            seed.functions.iter().enumerate().for_each(|(f, s)| functions.row_mut(f)[d] = *s);
        }
        self.outputs.vjp(&functions, &mut vertices, &mut control_points);
        self.project_vjp(&mut vertices, &mut control_points);
        let vertices = self.smooth_vjp(vertices, &mut control_points);
        let mut seams = self.seams.zeros(k);
        let values = self.place_vjp(vertices, &mut seams, &mut control_points);
        for (field, motions) in self.fields_vjp(&values, &mut control_points).into_iter().enumerate() {
            self.motions_vjp(field, &motions, &mut seams, &mut control_points);
        }
        self.seams.vjp(&self.bodies, &mut seams, &mut control_points);
        let user: Vec<Block> = control_points
            .par_iter()
            .zip(&self.bodies)
            .map(|(block, body)| body.component().internal_vjp(block))
            .collect();
        (0..k)
            .map(|d| {
                let points = |block: &Block| {
                    (0..block.data().len() / (3 * k)).map(|i| block.vector(i, d).into()).collect()
                };
                user.iter().map(points).collect()
            })
            .collect()
    }

    fn no_control_points(&self, k: usize) -> Vec<Block> {
        self.bodies.iter().map(|b| Block::zeros(b.control_points().len(), 3 * k)).collect()
    }

    /// Runs `part` on consecutive ranges of `count` items, each with its own seeds of the control points, and adds
    /// these up in order.
    fn gather<R: Send>(
        &self,
        count: usize,
        control_points: &mut [Block],
        part: impl Fn(std::ops::Range<usize>, &mut [Block]) -> R + Sync,
    ) -> Vec<R> {
        let k = control_points.first().map_or(0, Block::directions);
        let parts: Vec<(R, Vec<Block>)> = (0..PARTS)
            .into_par_iter()
            .map(|p| {
                let mut own = self.no_control_points(k);
                let result = part(p * count / PARTS..(p + 1) * count / PARTS, &mut own);
                (result, own)
            })
            .collect();
        let mut results = Vec::with_capacity(PARTS);
        for (result, own) in parts {
            results.push(result);
            control_points.iter_mut().zip(&own).for_each(|(sum, part)| sum.add(part));
        }
        results
    }

    // What seams do in the terms of the fields.

    fn motions_jvp(&self, field: usize, seams: &SeamChange, control_points: &[Block]) -> Block {
        let width = seams.positions.width();
        let (k, columns) = (width / 3, self.setup.fields[field].columns());
        let mut out = Block::zeros(self.motions[field].len(), columns * k);
        for (i, motion) in self.motions[field].iter().enumerate() {
            let row = out.row_mut(i);
            match motion {
                Motion::None => {}
                Motion::Parameters { row: from, by } => {
                    let mu = seams.parameters.row(*from);
                    for d in 0..k {
                        for a in 0..2 {
                            row[2 * d + a] = by[a][0] * mu[2 * d] + by[a][1] * mu[2 * d + 1];
                        }
                    }
                }
                Motion::Tangent { row: from, j } => {
                    let mu = seams.parameters.row(*from);
                    (0..k).for_each(|d| add_vector(row, d, &(j[0] * mu[2 * d] + j[1] * mu[2 * d + 1])));
                }
                Motion::Position => row.copy_from_slice(seams.positions.row(i)),
                Motion::Gap { component, from } => {
                    let c = *component as usize;
                    self.bodies[c].basis(from).position_jvp(&control_points[c], row);
                    row.iter_mut().zip(seams.positions.row(i)).for_each(|(s, x)| *s = x - *s);
                }
            }
        }
        out
    }

    fn motions_vjp(&self, field: usize, seeds: &Block, seams: &mut SeamChange, control_points: &mut [Block]) {
        let k = seams.positions.directions();
        for (i, motion) in self.motions[field].iter().enumerate() {
            let seed = seeds.row(i);
            match motion {
                Motion::None => {}
                Motion::Parameters { row, by } => {
                    let mu = seams.parameters.row_mut(*row);
                    for d in 0..k {
                        for a in 0..2 {
                            mu[2 * d + a] += by[0][a] * seed[2 * d] + by[1][a] * seed[2 * d + 1];
                        }
                    }
                }
                Motion::Tangent { row, j } => {
                    let mu = seams.parameters.row_mut(*row);
                    for d in 0..k {
                        (0..2).for_each(|a| mu[2 * d + a] += j[a].dot(&vector(seed, d)));
                    }
                }
                Motion::Position | Motion::Gap { .. } => {
                    let position = seams.positions.row_mut(i);
                    position.iter_mut().zip(seed).for_each(|(x, s)| *x += s);
                    if let Motion::Gap { component, from } = motion {
                        let negative: Vec<f64> = seed.iter().map(|s| -s).collect();
                        let c = *component as usize;
                        self.bodies[c].basis(from).position_vjp(&negative, &mut control_points[c]);
                    }
                }
            }
        }
    }

    // Fields.

    fn fields_jvp(&self, motions: &[Block], control_points: &[Block]) -> FieldValues {
        let blocks: Vec<Block> = self
            .setup
            .fields
            .iter()
            .zip(motions)
            .map(|(region, motion)| {
                let follow = |v: u32, factor: f64, row: &mut [f64]| {
                    if region.component.is_none() {
                        let own = &self.setup.ownership.of(v)[0];
                        let c = own.component as usize;
                        let mut s = vec![0.0; row.len()];
                        self.bodies[c].basis(&own.location).position_jvp(&control_points[c], &mut s);
                        row.iter_mut().zip(&s).for_each(|(row, s)| *row += factor * s);
                    }
                };
                region.field.eval(motion, follow, &region.points)
            })
            .collect();
        FieldValues { blocks, rows: self.field_rows() }
    }

    fn field_rows(&self) -> Vec<Option<(u32, u32)>> {
        let mut rows = vec![None; self.placements.len()];
        for (field, region) in (0u32..).zip(&self.setup.fields) {
            for (row, &v) in (0u32..).zip(&region.vertices) {
                rows[v as usize] = Some((field, row));
            }
        }
        rows
    }

    /// Seeds of the seams' motions, field by field.
    fn fields_vjp(&self, seeds: &FieldValues, control_points: &mut [Block]) -> Vec<Block> {
        let seams = self.setup.seams.vertices.len();
        self.setup
            .fields
            .iter()
            .zip(&seeds.blocks)
            .map(|(region, seeds)| {
                let mut motions = Block::zeros(seams, seeds.width());
                let follow = |v: u32, factor: f64, seed: &[f64]| {
                    if region.component.is_none() {
                        let own = &self.setup.ownership.of(v)[0];
                        let c = own.component as usize;
                        let scaled: Vec<f64> = seed.iter().map(|s| factor * s).collect();
                        self.bodies[c].basis(&own.location).position_vjp(&scaled, &mut control_points[c]);
                    }
                };
                region.field.vjp(&region.points, seeds, &mut motions, follow);
                motions
            })
            .collect()
    }

    // Vertices on their components.

    fn place_jvp(&self, values: &FieldValues, seams: &SeamChange, control_points: &[Block]) -> Block {
        let width = seams.positions.width();
        let k = width / 3;
        let mut out = Block::zeros(self.placements.len(), width);
        out.data_mut().par_chunks_mut(width).enumerate().for_each(|(v, row)| {
            let component = self.setup.ownership.of(v as u32)[0].component as usize;
            let body = &self.bodies[component];
            let (value, columns) = match values.rows[v] {
                Some((field, row)) => {
                    let block = &values.blocks[field as usize];
                    (block.row(row as usize), block.width() / k)
                }
                None => (&[][..], 0),
            };
            match &self.placements[v] {
                Placement::Still => return,
                Placement::Seam(i) => row.copy_from_slice(seams.positions.row(*i)),
                Placement::Surface { location, by } => {
                    body.basis(location).position_jvp(&control_points[component], row);
                    for d in 0..k {
                        for c in 0..columns {
                            add_vector(row, d, &(by[c] * value[columns * d + c]));
                        }
                    }
                }
                Placement::Foot { projection, follow } => {
                    let mut aim = vec![0.0; width];
                    if *follow {
                        let own = &self.setup.ownership.of(v as u32)[0].location;
                        body.basis(own).position_jvp(&control_points[component], &mut aim);
                    }
                    (0..columns * k).for_each(|c| aim[c] += value[c]);
                    self.foot_jvp(component, projection, &aim, control_points, row);
                }
            }
            self.mask(v, row);
        });
        out
    }

    /// The tangent of a foot point for that of its aim.
    fn foot_jvp(
        &self,
        component: usize,
        projection: &Projection,
        aim: &[f64],
        control_points: &[Block],
        row: &mut [f64],
    ) {
        let body = &self.bodies[component];
        let foot = body.foot_point(&projection.aim, &projection.location);
        let derivative = SignedDistance::new(body).derivative(&projection.aim, &foot);
        let mut surface = Block::zeros(3, row.len());
        body.basis(&projection.location).point_jvp(&control_points[component], &mut surface);
        for d in 0..row.len() / 3 {
            let change = FootChange {
                x: vector(aim, d),
                s: surface.vector(0, d),
                s_uv: [surface.vector(1, d), surface.vector(2, d)],
            };
            row[3 * d..3 * d + 3].copy_from_slice(derivative.foot_jvp(&change).as_slice());
        }
    }

    /// The transpose of [`foot_jvp`](Self::foot_jvp): the seed of the foot point becomes that of its aim.
    fn foot_vjp(
        &self,
        component: usize,
        projection: &Projection,
        seed: &mut [f64],
        control_points: &mut [Block],
    ) {
        let body = &self.bodies[component];
        let foot = body.foot_point(&projection.aim, &projection.location);
        let derivative = SignedDistance::new(body).derivative(&projection.aim, &foot);
        let mut surface = Block::zeros(3, seed.len());
        for d in 0..seed.len() / 3 {
            let change = derivative.foot_vjp(&vector(seed, d));
            seed[3 * d..3 * d + 3].copy_from_slice(change.x.as_slice());
            add_vector(surface.row_mut(0), d, &change.s);
            add_vector(surface.row_mut(1), d, &change.s_uv[0]);
            add_vector(surface.row_mut(2), d, &change.s_uv[1]);
        }
        body.basis(&projection.location).point_vjp(&surface, &mut control_points[component]);
    }

    /// Seeds of the field values; those of seam vertices go to `seams`.
    fn place_vjp(
        &self,
        mut vertices: Block,
        seams: &mut SeamChange,
        control_points: &mut [Block],
    ) -> FieldValues {
        let k = vertices.directions();
        let rows = self.field_rows();
        for (v, placement) in self.placements.iter().enumerate() {
            self.mask(v, vertices.row_mut(v));
            if let Placement::Seam(i) = placement {
                let position = seams.positions.row_mut(*i);
                position.iter_mut().zip(vertices.row(v)).for_each(|(x, s)| *x += s);
            }
        }
        let mut blocks: Vec<Block> = self
            .setup
            .fields
            .iter()
            .map(|region| Block::zeros(region.vertices.len(), region.columns() * k))
            .collect();
        let values = self.gather(self.placements.len(), control_points, |range, control_points| {
            let mut values: Vec<(usize, Vec<f64>)> = Vec::with_capacity(range.len());
            for v in range {
                let component = self.setup.ownership.of(v as u32)[0].component as usize;
                let body = &self.bodies[component];
                let seed = vertices.row(v);
                match &self.placements[v] {
                    Placement::Still | Placement::Seam(_) => {}
                    Placement::Surface { location, by } => {
                        body.basis(location).position_vjp(seed, &mut control_points[component]);
                        if let Some((field, _)) = rows[v] {
                            let columns = self.setup.fields[field as usize].columns();
                            let value = (0..k).flat_map(|d| (0..columns).map(move |c| (d, c)));
                            let value = value.map(|(d, c)| by[c].dot(&vector(seed, d))).collect();
                            values.push((v, value));
                        }
                    }
                    Placement::Foot { projection, follow } => {
                        let mut aim = seed.to_vec();
                        self.foot_vjp(component, projection, &mut aim, control_points);
                        if *follow {
                            let own = &self.setup.ownership.of(v as u32)[0].location;
                            body.basis(own).position_vjp(&aim, &mut control_points[component]);
                        }
                        values.push((v, aim));
                    }
                }
            }
            values
        });
        for (v, value) in values.iter().flatten() {
            if let Some((field, row)) = rows[*v] {
                blocks[field as usize].row_mut(row as usize).copy_from_slice(value);
            }
        }
        FieldValues { blocks, rows }
    }

    /// Vertices of the symmetry plane move within it.
    fn mask(&self, v: usize, row: &mut [f64]) {
        if self.setup.in_plane[v] {
            row.iter_mut().skip(1).step_by(3).for_each(|y| *y = 0.0);
        }
    }

    // Smoothing.

    fn smooth_jvp(&self, mut vertices: Block, control_points: &[Block]) -> Block {
        let Some(laplacian) = &self.setup.laplacian else { return vertices };
        let relaxation = self.setup.options.smoothing.relaxation;
        for round in &self.rounds {
            let aims = by_direction(&vertices, |x, out| laplacian.smooth(relaxation, x, out));
            let width = vertices.width();
            vertices.data_mut().par_chunks_mut(width).enumerate().for_each(|(v, row)| {
                if self.setup.may_smooth(v as u32) {
                    let component = self.setup.ownership.of(v as u32)[0].component as usize;
                    self.foot_jvp(component, &round[v], aims.row(v), control_points, row);
                    self.mask(v, row);
                }
            });
        }
        vertices
    }

    fn smooth_vjp(&self, mut vertices: Block, control_points: &mut [Block]) -> Block {
        let Some(laplacian) = &self.setup.laplacian else { return vertices };
        let relaxation = self.setup.options.smoothing.relaxation;
        for round in self.rounds.iter().rev() {
            let aims = self.gather(self.placements.len(), control_points, |range, control_points| {
                range
                    .map(|v| {
                        let mut seed = vertices.row(v).to_vec();
                        if self.setup.may_smooth(v as u32) {
                            self.mask(v, &mut seed);
                            let component = self.setup.ownership.of(v as u32)[0].component as usize;
                            self.foot_vjp(component, &round[v], &mut seed, control_points);
                        }
                        seed
                    })
                    .collect::<Vec<_>>()
            });
            for (v, seed) in aims.iter().flatten().enumerate() {
                vertices.row_mut(v).copy_from_slice(seed);
            }
            vertices = by_direction(&vertices, |x, out| laplacian.smooth_transposed(relaxation, x, out));
        }
        vertices
    }

    // The smooth outer mold line.

    fn project_jvp(&self, vertices: &mut Block, control_points: &[Block]) {
        let projection = self.setup.projection(&self.bodies);
        let moved: Vec<Vec<f64>> = self
            .steps
            .par_iter()
            .map(|(v, steps)| {
                let mut row = vertices.row(*v as usize).to_vec();
                projection.jvp(steps, control_points, &mut row, |x| self.setup.in_plane(*v, x));
                row
            })
            .collect();
        for ((v, _), row) in self.steps.iter().zip(moved) {
            vertices.row_mut(*v as usize).copy_from_slice(&row);
        }
    }

    fn project_vjp(&self, vertices: &mut Block, control_points: &mut [Block]) {
        let projection = self.setup.projection(&self.bodies);
        let moved = self.gather(self.steps.len(), control_points, |range, control_points| {
            self.steps[range]
                .iter()
                .map(|(v, steps)| {
                    let mut seed = vertices.row(*v as usize).to_vec();
                    projection.vjp(steps, &mut seed, control_points, |x| self.setup.in_plane(*v, x));
                    seed
                })
                .collect::<Vec<_>>()
        });
        for ((v, _), seed) in self.steps.iter().zip(moved.iter().flatten()) {
            vertices.row_mut(*v as usize).copy_from_slice(seed);
        }
    }
}

/// Applies a map of vectors to each direction of a block.
fn by_direction(block: &Block, map: impl Fn(&[[f64; 3]], &mut [[f64; 3]])) -> Block {
    let count = block.data().len() / block.width().max(1);
    let mut out = Block::zeros(count, block.width());
    let mut mapped = vec![[0.0; 3]; count];
    for d in 0..block.directions() {
        let x: Vec<[f64; 3]> = (0..count).map(|v| block.vector(v, d).into()).collect();
        map(&x, &mut mapped);
        for (v, x) in mapped.iter().enumerate() {
            out.row_mut(v)[3 * d..3 * d + 3].copy_from_slice(x);
        }
    }
    out
}
