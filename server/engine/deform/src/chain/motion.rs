//! Motions of the seam vertices in the terms of each field, which the field interpolates.
//!
//! A field over a component measures how far a seam vertex departs from the motion of that component: as a departure in a chart
//! of the undeformed component, as a vector on the undeformed component, or as a vector from the vertex's old parameters on
//! the deformed component. A field over the whole mesh takes displacements in space.

use std::sync::Arc;

use moldline_geometry::{Block, Body, Location, block::add_vector};
use moldline_spline::Vector3;
use rayon::prelude::*;

use super::{
    field::RegionField,
    seams::{SeamPoint, SeamSolver, SeamTangents},
};
use crate::{
    DeformError, Monitor, Propagation, Stage,
    chart::Chart,
    error::{LISTED, VertexDistance},
};

/// Distance within which a chart finds a point again, relative to the reference length.
const TOLERANCE: f64 = 1e-12;

/// The motions for every field of a set-up.
#[derive(Clone, Debug)]
pub(crate) struct Motions {
    fields: Vec<Motion>,
    reference: Arc<[Body]>,
    /// Seam vertices in all.
    seams: usize,
    /// Distance within which a chart finds a point again, m.
    tolerance: f64,
}

/// The motions for one field.
#[derive(Clone, Debug)]
struct Motion {
    measure: Measure,
    /// The seam vertices in the field's region; the others do not move in its terms.
    members: Vec<Member>,
}

/// How a field measures motions.
#[derive(Clone, Debug)]
enum Measure {
    /// As the displacement in space.
    Displacement,
    /// As the departure in the chart of the undeformed component: two numbers.
    Chart { component: usize, chart: Arc<Chart> },
    /// As the vector between two points of the undeformed component.
    Undeformed { component: usize },
    /// As the vector from the vertex's old parameters on the deformed component.
    Deformed { component: usize },
}

/// A seam vertex in a region.
#[derive(Clone, Debug)]
struct Member {
    /// Index into the mesh.
    vertex: u32,
    /// Index among the seam vertices.
    seam: usize,
    /// Place of the field's component among its owners.
    owner: usize,
    /// Row among the parameters of all seam vertices.
    row: usize,
    /// Parameters in the reference state, and position there, m.
    from: Location,
    start: Vector3,
}

/// Derivatives of the motions with respect to the parameters of the seam vertices, field by field and member by member: row
/// `a` is that of number `a`. Empty for fields that measure positions.
#[derive(Clone, Debug)]
pub(crate) struct MotionsDerivative(Vec<Vec<[[f64; 2]; 3]>>);

impl Motions {
    /// Decides how each of the `fields` measures the motions of its seam vertices.
    pub fn new(
        fields: &[RegionField],
        propagation: Propagation,
        seams: &SeamSolver,
        reference: Arc<[Body]>,
        positions: &[Vector3],
        length: f64,
    ) -> Self {
        let rows = seams.first_rows();
        let motion = |field: &RegionField| {
            let component = field.component.map(|c| c as usize);
            let measure = match (component, &field.chart, propagation) {
                (None, ..) => Measure::Displacement,
                (Some(component), Some(chart), _) => Measure::Chart { component, chart: chart.clone() },
                (Some(component), None, Propagation::Surface) => Measure::Undeformed { component },
                (Some(component), None, _) => Measure::Deformed { component },
            };
            let member = |(seam, (vertex, row)): (usize, (&super::seams::SeamVertex, &usize))| {
                let owner = match field.component {
                    None => 0,
                    Some(component) => vertex.owners.iter().position(|&o| o == component)?,
                };
                Some(Member {
                    vertex: vertex.vertex,
                    seam,
                    owner,
                    row: row + owner,
                    from: vertex.locations[owner],
                    start: positions[vertex.vertex as usize],
                })
            };
            let members = seams.vertices.iter().zip(&rows).enumerate().filter_map(member).collect();
            Motion { measure, members }
        };
        Self {
            fields: fields.iter().map(motion).collect(),
            reference,
            seams: seams.vertices.len(),
            tolerance: TOLERANCE * length,
        }
    }

    /// The motions, a block a field, a row a seam vertex.
    ///
    /// # Errors
    /// [`DeformError::FootPoint`] for vertices that a chart does not find again.
    pub fn eval(
        &self,
        points: &[SeamPoint],
        bodies: &[Body],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<Block>, DeformError> {
        self.fields.iter().map(|field| self.eval_field(field, points, bodies, monitor)).collect()
    }

    fn eval_field(
        &self,
        field: &Motion,
        points: &[SeamPoint],
        bodies: &[Body],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Block, DeformError> {
        let mut motion = Block::zeros(self.seams, field.measure.columns());
        let mut lost = Vec::new();
        for Member { vertex, seam, owner, from, start, .. } in &field.members {
            if monitor.cancelled() {
                return Err(DeformError::Cancelled);
            }
            let (row, point) = (motion.row_mut(*seam), &points[*seam]);
            let to = &point.locations[*owner];
            match &field.measure {
                Measure::Displacement => add_vector(row, 0, &(point.position - start)),
                Measure::Chart { component, chart } => {
                    let reference = &self.reference[*component];
                    match chart.unroll(reference, from, to, self.tolerance) {
                        Some(departure) => row.copy_from_slice(&departure),
                        None => {
                            let distance = (reference.position(to) - start).norm();
                            lost.push((*component, VertexDistance { vertex: *vertex, distance }));
                        }
                    }
                }
                Measure::Undeformed { component } => {
                    add_vector(row, 0, &(self.reference[*component].position(to) - start));
                }
                Measure::Deformed { component } => {
                    add_vector(row, 0, &(point.position - bodies[*component].position(from)));
                }
            }
        }
        match lost.first() {
            None => Ok(motion),
            Some((component, _)) => Err(DeformError::FootPoint {
                component: self.reference[*component].component().name().to_owned(),
                count: lost.len(),
                worst: lost.iter().take(LISTED).map(|(_, vertex)| *vertex).collect(),
            }),
        }
    }

    /// The derivative at motions that [`eval`](Self::eval) found.
    pub fn linearise(&self, points: &[SeamPoint], motions: &[Block]) -> MotionsDerivative {
        let of_field = |(field, motion): (&Motion, &Block)| {
            let of_member = |member: &Member| {
                let to = &points[member.seam].locations[member.owner];
                match &field.measure {
                    Measure::Displacement | Measure::Deformed { .. } => None,
                    Measure::Chart { component, chart } => {
                        let departure = [motion.row(member.seam)[0], motion.row(member.seam)[1]];
                        let reference = &self.reference[*component];
                        let [a, b] = chart.unroll_derivative(reference, &member.from, to, departure);
                        Some([a, b, [0.0; 2]])
                    }
                    Measure::Undeformed { component } => {
                        let point = self.reference[*component].point(to);
                        Some([0, 1, 2].map(|axis| [point.d_u[axis], point.d_v[axis]]))
                    }
                }
            };
            field.members.par_iter().filter_map(of_member).collect()
        };
        MotionsDerivative(self.fields.iter().zip(motions).map(of_field).collect())
    }

    /// Tangents of the motions for those of the seam vertices and of the internal control points.
    pub fn jvp(
        &self,
        derivative: &MotionsDerivative,
        bodies: &[Body],
        seams: &SeamTangents,
        control_points: &[Block],
    ) -> Vec<Block> {
        let k = seams.positions.directions();
        let of_field = |(field, derivative): (&Motion, &Vec<[[f64; 2]; 3]>)| {
            let columns = field.measure.columns();
            let mut out = Block::zeros(self.seams, columns * k);
            for (i, member) in field.members.iter().enumerate() {
                let row = out.row_mut(member.seam);
                match &field.measure {
                    Measure::Chart { .. } | Measure::Undeformed { .. } => {
                        let (by, mu) = (&derivative[i], seams.parameters.row(member.row));
                        for d in 0..k {
                            for a in 0..columns {
                                row[columns * d + a] = by[a][0] * mu[2 * d] + by[a][1] * mu[2 * d + 1];
                            }
                        }
                    }
                    Measure::Displacement => row.copy_from_slice(seams.positions.row(member.seam)),
                    Measure::Deformed { component } => {
                        let basis = bodies[*component].basis(&member.from);
                        basis.position_jvp(&control_points[*component], row);
                        let position = seams.positions.row(member.seam);
                        row.iter_mut().zip(position).for_each(|(s, x)| *s = x - *s);
                    }
                }
            }
            out
        };
        self.fields.iter().zip(&derivative.0).map(of_field).collect()
    }

    /// The transpose of [`jvp`](Self::jvp): adds to the seeds of the seam vertices and of the internal control points.
    pub fn vjp(
        &self,
        derivative: &MotionsDerivative,
        bodies: &[Body],
        seeds: &[Block],
        seams: &mut SeamTangents,
        control_points: &mut [Block],
    ) {
        let k = seams.positions.directions();
        for ((field, derivative), seeds) in self.fields.iter().zip(&derivative.0).zip(seeds) {
            let columns = field.measure.columns();
            for (i, member) in field.members.iter().enumerate() {
                let seed = seeds.row(member.seam);
                match &field.measure {
                    Measure::Chart { .. } | Measure::Undeformed { .. } => {
                        let (by, mu) = (&derivative[i], seams.parameters.row_mut(member.row));
                        for d in 0..k {
                            for b in 0..2 {
                                let terms = (1..columns).map(|a| by[a][b] * seed[columns * d + a]);
                                mu[2 * d + b] += terms.fold(by[0][b] * seed[columns * d], |sum, x| sum + x);
                            }
                        }
                    }
                    Measure::Displacement => add(seams.positions.row_mut(member.seam), seed),
                    Measure::Deformed { component } => {
                        add(seams.positions.row_mut(member.seam), seed);
                        let negative: Vec<f64> = seed.iter().map(|s| -s).collect();
                        let basis = bodies[*component].basis(&member.from);
                        basis.position_vjp(&negative, &mut control_points[*component]);
                    }
                }
            }
        }
    }
}

impl Measure {
    /// Numbers of a motion.
    fn columns(&self) -> usize {
        match self {
            Self::Chart { .. } => 2,
            _ => 3,
        }
    }
}

impl MotionsDerivative {
    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.0.iter().map(|field| size_of_val(&field[..])).sum()
    }
}

fn add(to: &mut [f64], from: &[f64]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
}
