//! Placement of the vertices on their components (eq. 17 and the constraints): seam vertices where the search found them, the
//! others by their field value `d`.

use std::sync::Arc;

use moldline_geometry::{
    Block, Body,
    block::{add_vector, vector},
};
use moldline_spline::Vector3;
use rayon::prelude::*;

use super::{
    field::Fields,
    foot::{self, Foot, Placed},
    parallel::gather,
    seams::{SeamPoint, SeamSolver, SeamTangents},
};
use crate::{
    DeformError, Monitor, Propagation, Stage,
    chart::Chart,
    ownership::{Attachment, Freedom, Ownership},
    symmetry::InPlane,
};

/// The placement of every vertex.
#[derive(Clone, Debug)]
pub(crate) struct Placement {
    /// Of every vertex.
    rules: Vec<Rule>,
    ownership: Arc<Ownership>,
    reference: Arc<[Body]>,
    /// Reference vertices, m.
    positions: Arc<[Vector3]>,
    in_plane: InPlane,
}

/// How the field value `d` of a vertex becomes its place.
#[derive(Clone, Debug)]
enum Rule {
    /// It stays where it is in space.
    Stationary,
    /// It is on a seam: its index among the seam vertices.
    Seam(usize),
    /// It stays at its parameters.
    Follow,
    /// Its parameters are those a departure `d` away in a chart, as far as coordinates are free.
    Slide { chart: Arc<Chart>, free: [bool; 2] },
    /// Its parameters are those of the foot point of its reference position plus `d` on the undeformed component.
    Undeformed,
    /// It is the foot point on the deformed component of `d` plus where it was, or (`follow`) where its parameters are now.
    Deformed { follow: bool },
}

/// The placement in one state, ready for products.
#[derive(Clone, Debug)]
pub(crate) struct PlacementDerivative {
    /// Parameters of every vertex, and what it is the foot point of.
    feet: Vec<Foot>,
    /// For `Slide` and `Undeformed`, `dx = dS + sum_c by_c d_c`; empty if no vertex has these rules.
    by_value: Vec<[Vector3; 3]>,
}

impl Rule {
    fn of(own: &Attachment, fields: &Fields, vertex: u32, propagation: Propagation, body: &Body) -> Self {
        if own.freedom == Freedom::Fixed {
            return Self::Follow;
        }
        match propagation {
            Propagation::Surface => match fields.of(vertex).map(|field| &field.chart) {
                None => Self::Follow,
                Some(None) => Self::Undeformed,
                Some(Some(chart)) => {
                    Self::Slide { chart: chart.clone(), free: free_coordinates(chart, own, body) }
                }
            },
            Propagation::Departure => Self::Deformed { follow: true },
            Propagation::Absolute => Self::Deformed { follow: false },
        }
    }
}

/// The coordinates of a departure that a vertex's freedom admits.
fn free_coordinates(chart: &Chart, own: &Attachment, body: &Body) -> [bool; 2] {
    let Freedom::Edge(edge) = own.freedom else { return [true; 2] };
    let sides = &body.component().edges()[edge as usize].sides;
    match sides.iter().find(|s| s.patch == own.location.patch) {
        Some(side) => chart.along_edge(&own.location, side),
        None => [false; 2],
    }
}

impl Placement {
    /// Decides how every vertex is placed. `stationary`: the vertices that stay where they are in space.
    pub fn new(
        propagation: Propagation,
        fields: &Fields,
        seams: &SeamSolver,
        stationary: &[bool],
        ownership: Arc<Ownership>,
        reference: Arc<[Body]>,
        positions: Arc<[Vector3]>,
        in_plane: InPlane,
    ) -> Self {
        let rule = |vertex: u32| {
            let own = ownership.first(vertex);
            Rule::of(own, fields, vertex, propagation, &reference[own.component as usize])
        };
        let mut rules: Vec<Rule> = ownership.vertices().map(rule).collect();
        for (i, seam) in seams.vertices.iter().enumerate() {
            rules[seam.vertex as usize] = Rule::Seam(i);
        }
        for (rule, _) in rules.iter_mut().zip(stationary).filter(|(_, stationary)| **stationary) {
            *rule = Rule::Stationary;
        }
        Self { rules, ownership, reference, positions, in_plane }
    }

    /// All vertices on their components.
    ///
    /// # Errors
    /// [`DeformError::FootPoint`] naming vertices that have no foot point on their sheet.
    pub fn eval(
        &self,
        fields: &Fields,
        values: &[Block],
        seams: &[SeamPoint],
        bodies: &[Body],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<Placed>, DeformError> {
        let results: Vec<Result<Placed, f64>> = self
            .ownership
            .vertices()
            .into_par_iter()
            .zip(&self.rules)
            .map(|(v, rule)| {
                if monitor.cancelled() {
                    return Err(f64::NAN);
                }
                let value = fields.value(values, v);
                let placed = self.eval_vertex(v, rule, value, seams, bodies)?;
                match rule {
                    Rule::Stationary => Ok(placed),
                    _ => Ok(Placed { position: self.in_plane.project(v, placed.position), ..placed }),
                }
            })
            .collect();
        if monitor.cancelled() {
            return Err(DeformError::Cancelled);
        }
        foot::all_found(results, &self.ownership, bodies)
    }

    fn eval_vertex(
        &self,
        v: u32,
        rule: &Rule,
        value: &[f64],
        seams: &[SeamPoint],
        bodies: &[Body],
    ) -> Result<Placed, f64> {
        let own = self.ownership.first(v);
        let (body, reference) = (&bodies[own.component as usize], &self.reference[own.component as usize]);
        let at = |location| Placed::at(body.position(&location), location);
        let start = self.positions[v as usize];
        // Where no field is, nothing departs.
        let displacement = || Vector3::from_fn(|axis, _| value.get(axis).copied().unwrap_or(0.0));
        match rule {
            Rule::Stationary => Ok(Placed::at(start, own.location)),
            Rule::Seam(i) => Ok(Placed::at(seams[*i].position, seams[*i].locations[0])),
            Rule::Follow => Ok(at(own.location)),
            Rule::Slide { chart, free } => {
                Ok(at(chart.walk(reference, &own.location, departure(*free, value))))
            }
            Rule::Undeformed => {
                let aim = start + displacement();
                let foot = foot::eval(reference, own.freedom, &own.location, &aim)?;
                Ok(Placed { aim, ..at(foot.location) })
            }
            Rule::Deformed { follow } => {
                let from = if *follow { body.position(&own.location) } else { start };
                let aim = from + displacement();
                let foot = foot::eval(body, own.freedom, &own.location, &aim)?;
                Ok(Placed { position: foot.position, location: foot.location, aim })
            }
        }
    }

    /// The derivative at places that [`eval`](Self::eval) found.
    pub fn linearise(
        &self,
        fields: &Fields,
        values: &[Block],
        placed: &[Placed],
        bodies: &[Body],
    ) -> PlacementDerivative {
        let by_value = |((v, rule), placed): ((u32, &Rule), &Placed)| {
            let own = self.ownership.first(v);
            let component = own.component as usize;
            let point = bodies[component].point(&placed.location);
            let by = |column: [f64; 2]| point.d_u * column[0] + point.d_v * column[1];
            match rule {
                Rule::Slide { chart, free } => {
                    let departure = departure(*free, fields.value(values, v));
                    let reference = &self.reference[component];
                    let (_, walk) = chart.walk_derivative(reference, &own.location, departure);
                    let column =
                        |k: usize| if free[k] { by([walk[0][k], walk[1][k]]) } else { Vector3::zeros() };
                    [column(0), column(1), Vector3::zeros()]
                }
                Rule::Undeformed => {
                    let by_aim = placed.foot().parameters_by_aim(&self.reference[component]);
                    [0, 1, 2].map(|axis| by([by_aim[0][axis], by_aim[1][axis]]))
                }
                _ => [Vector3::zeros(); 3],
            }
        };
        let on_surface = |rule: &Rule| matches!(rule, Rule::Slide { .. } | Rule::Undeformed);
        let by_value = if self.rules.iter().any(on_surface) {
            let vertices = self.ownership.vertices().into_par_iter().zip(&self.rules).zip(placed);
            vertices.map(by_value).collect()
        } else {
            Vec::new()
        };
        PlacementDerivative { feet: placed.iter().map(Placed::foot).collect(), by_value }
    }

    /// Tangents of the vertices for those of the field values, the seam vertices and the internal control points.
    pub fn jvp(
        &self,
        derivative: &PlacementDerivative,
        bodies: &[Body],
        fields: &Fields,
        values: &[Block],
        seams: &SeamTangents,
        control_points: &[Block],
    ) -> Block {
        let width = seams.positions.width();
        let k = width / 3;
        let mut out = Block::zeros(self.rules.len(), width);
        let rows = out.data_mut().par_chunks_mut(width);
        self.ownership.vertices().into_par_iter().zip(&self.rules).zip(rows).for_each(|((v, rule), row)| {
            let own = self.ownership.first(v);
            let component = own.component as usize;
            let (body, control_points) = (&bodies[component], &control_points[component]);
            let (foot, value) = (&derivative.feet[v as usize], fields.value(values, v));
            match rule {
                Rule::Stationary => return,
                Rule::Seam(i) => row.copy_from_slice(seams.positions.row(*i)),
                Rule::Follow | Rule::Slide { .. } | Rule::Undeformed => {
                    body.basis(&foot.location).position_jvp(control_points, row);
                    let columns = value.len() / k;
                    for d in 0..k {
                        for c in 0..columns {
                            let by = &derivative.by_value[v as usize][c];
                            add_vector(row, d, &(by * value[columns * d + c]));
                        }
                    }
                }
                Rule::Deformed { follow } => {
                    let mut aim = vec![0.0; width];
                    if *follow {
                        body.basis(&own.location).position_jvp(control_points, &mut aim);
                    }
                    aim.iter_mut().zip(value).for_each(|(aim, value)| *aim += value);
                    foot.jvp(body, &aim, control_points, row);
                }
            }
            self.in_plane.project_row(v, row);
        });
        out
    }

    /// The transpose of [`jvp`](Self::jvp): seeds of the field values; adds to those of the seam vertices and of the internal
    /// control points.
    pub fn vjp(
        &self,
        derivative: &PlacementDerivative,
        bodies: &[Body],
        fields: &Fields,
        mut vertices: Block,
        seams: &mut SeamTangents,
        control_points: &mut [Block],
    ) -> Vec<Block> {
        let k = vertices.directions();
        for (v, rule) in (0u32..).zip(&self.rules) {
            let row = vertices.row_mut(v as usize);
            self.in_plane.project_row(v, row);
            if let Rule::Seam(i) = rule {
                let position = seams.positions.row_mut(*i);
                position.iter_mut().zip(row).for_each(|(x, s)| *x += *s);
            }
        }
        let seeds = gather(self.rules.len(), control_points, |range, control_points| {
            let mut seeds: Vec<(u32, Vec<f64>)> = Vec::with_capacity(range.len());
            for (v, rule) in (0u32..).zip(&self.rules).take(range.end).skip(range.start) {
                let own = self.ownership.first(v);
                let component = own.component as usize;
                let (body, control_points) = (&bodies[component], &mut control_points[component]);
                let (foot, seed) = (&derivative.feet[v as usize], vertices.row(v as usize));
                match rule {
                    Rule::Stationary | Rule::Seam(_) => {}
                    Rule::Follow | Rule::Slide { .. } | Rule::Undeformed => {
                        body.basis(&foot.location).position_vjp(seed, control_points);
                        if let Some(field) = fields.of(v) {
                            let by = &derivative.by_value[v as usize][..field.columns()];
                            let directions = (0..k).map(|d| vector(seed, d));
                            seeds.push((
                                v,
                                directions.flat_map(|seed| by.iter().map(move |by| by.dot(&seed))).collect(),
                            ));
                        }
                    }
                    Rule::Deformed { follow } => {
                        let mut aim = seed.to_vec();
                        foot.vjp(body, &mut aim, control_points);
                        if *follow {
                            body.basis(&own.location).position_vjp(&aim, control_points);
                        }
                        seeds.push((v, aim));
                    }
                }
            }
            seeds
        });
        let mut values = fields.zeros(k);
        for (v, seed) in seeds.iter().flatten() {
            let row = fields.value_mut(&mut values, *v);
            row.iter_mut().zip(seed).for_each(|(row, seed)| *row = *seed);
        }
        values
    }
}

impl PlacementDerivative {
    /// Bytes held.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.feet[..]) + size_of_val(&self.by_value[..])
    }
}

/// The departure of a vertex: its field value, as far as its coordinates are free.
fn departure(free: [bool; 2], value: &[f64]) -> [f64; 2] {
    [0, 1].map(|k| if free[k] { value[k] } else { 0.0 })
}
