//! Rounds of graph-Laplacian smoothing, each followed by a projection of the vertices onto their components.

use std::sync::Arc;

use moldline_geometry::{Block, Body};
use moldline_mesh::{Laplacian, Topology};
use moldline_spline::Vector3;
use rayon::prelude::*;

use super::{
    foot::{self, Foot, Placed},
    parallel::{by_direction, gather},
};
use crate::{DeformError, Monitor, SmoothingOptions, Stage, ownership::Ownership, symmetry::InPlane};

/// The smoothing of a set-up.
#[derive(Clone, Debug)]
pub(crate) struct Smoothing {
    /// Of the vertices that smoothing moves; `None` without smoothing.
    laplacian: Option<Laplacian>,
    options: SmoothingOptions,
    /// Whether smoothing moves a vertex.
    free: Vec<bool>,
    ownership: Arc<Ownership>,
    in_plane: InPlane,
}

/// The foot points of every round.
#[derive(Clone, Debug)]
pub(crate) struct SmoothingDerivative(Vec<Vec<Foot>>);

impl Smoothing {
    /// Smoothing of the vertices that are free on one component and not `stationary`.
    pub fn new(
        options: SmoothingOptions,
        topology: &Topology,
        stationary: &[bool],
        ownership: Arc<Ownership>,
        in_plane: InPlane,
    ) -> Self {
        let vertices = ownership.vertices().zip(stationary);
        let free: Vec<bool> = vertices.map(|(v, stationary)| !stationary && ownership.is_free(v)).collect();
        let laplacian = (options.rounds > 0).then(|| Laplacian::uniform(topology, |v| !free[v as usize]));
        Self { laplacian, options, free, ownership, in_plane }
    }

    /// The vertices after each round.
    ///
    /// # Errors
    /// [`DeformError::FootPoint`] naming vertices that have no foot point on their sheet.
    pub fn eval(
        &self,
        placed: &[Placed],
        bodies: &[Body],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<Vec<Placed>>, DeformError> {
        let mut rounds: Vec<Vec<Placed>> = Vec::with_capacity(self.options.rounds);
        let Some(laplacian) = &self.laplacian else { return Ok(rounds) };
        let mut smoothed = vec![[0.0; 3]; self.free.len()];
        for _ in 0..self.options.rounds {
            let vertices = rounds.last().map_or(placed, Vec::as_slice);
            let current: Vec<[f64; 3]> = vertices.iter().map(|p| p.position.into()).collect();
            laplacian.smooth(self.options.relaxation, &current, &mut smoothed);
            let results: Vec<Result<Placed, f64>> = self
                .ownership
                .vertices()
                .into_par_iter()
                .zip(vertices.par_iter().zip(&smoothed))
                .map(|(v, (before, x))| {
                    if !self.free[v as usize] || monitor.cancelled() {
                        return Ok(*before);
                    }
                    let own = self.ownership.first(v);
                    let aim = Vector3::from(*x);
                    let foot =
                        foot::eval(&bodies[own.component as usize], own.freedom, &before.location, &aim)?;
                    let position = self.in_plane.project(v, foot.position);
                    Ok(Placed { position, location: foot.location, aim })
                })
                .collect();
            if monitor.cancelled() {
                return Err(DeformError::Cancelled);
            }
            rounds.push(foot::all_found(results, &self.ownership, bodies)?);
        }
        Ok(rounds)
    }

    /// The derivative at vertices that [`eval`](Self::eval) found.
    pub fn linearise(&self, rounds: &[Vec<Placed>]) -> SmoothingDerivative {
        SmoothingDerivative(rounds.iter().map(|round| round.iter().map(Placed::foot).collect()).collect())
    }

    /// Tangents of the vertices after the last round for those before the first and of the internal control points.
    pub fn jvp(
        &self,
        derivative: &SmoothingDerivative,
        bodies: &[Body],
        mut vertices: Block,
        control_points: &[Block],
    ) -> Block {
        let Some(laplacian) = &self.laplacian else { return vertices };
        for round in &derivative.0 {
            let aims = by_direction(&vertices, |x, out| laplacian.smooth(self.options.relaxation, x, out));
            let width = vertices.width();
            let rows = vertices.data_mut().par_chunks_mut(width);
            self.ownership.vertices().into_par_iter().zip(round).zip(rows).for_each(|((v, foot), row)| {
                if self.free[v as usize] {
                    let component = self.ownership.first(v).component as usize;
                    foot.jvp(&bodies[component], aims.row(v as usize), &control_points[component], row);
                    self.in_plane.project_row(v, row);
                }
            });
        }
        vertices
    }

    /// The transpose of [`jvp`](Self::jvp): seeds of the vertices before the first round; adds to those of the internal control
    /// points.
    pub fn vjp(
        &self,
        derivative: &SmoothingDerivative,
        bodies: &[Body],
        mut vertices: Block,
        control_points: &mut [Block],
    ) -> Block {
        let Some(laplacian) = &self.laplacian else { return vertices };
        for round in derivative.0.iter().rev() {
            let aims = gather(self.free.len(), control_points, |range, control_points| {
                let feet = (0u32..).zip(round).take(range.end).skip(range.start);
                feet.map(|(v, foot)| {
                    let mut seed = vertices.row(v as usize).to_vec();
                    if self.free[v as usize] {
                        self.in_plane.project_row(v, &mut seed);
                        let component = self.ownership.first(v).component as usize;
                        foot.vjp(&bodies[component], &mut seed, &mut control_points[component]);
                    }
                    seed
                })
                .collect::<Vec<_>>()
            });
            for (v, seed) in aims.iter().flatten().enumerate() {
                vertices.row_mut(v).copy_from_slice(seed);
            }
            vertices = by_direction(&vertices, |x, out| {
                laplacian.smooth_transposed(self.options.relaxation, x, out)
            });
        }
        vertices
    }
}

impl SmoothingDerivative {
    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.0.iter().map(|round| size_of_val(&round[..])).sum()
    }
}
