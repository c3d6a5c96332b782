//! Displacement fields (sec. III.E of the paper, eq. 16 and 17): training data from the seams, radial basis functions
//! through them, values at all vertices of a region. Everything is linear, so that a field is its own derivative.

pub(crate) mod setup;
pub mod training;

use std::sync::Arc;

use moldline_geometry::{
    Block, Body, Location,
    block::{add_row, add_vector},
};
use moldline_mesh::Plane;
use moldline_rbf::{Factors, Kernel, RadialBasis, RbfError};
use moldline_spline::Vector3;

use crate::chart::Chart;
use training::TrainingVertex;

/// The mirror that completes a half model.
#[derive(Clone, Debug)]
pub struct Mirror<'a> {
    /// The symmetry plane.
    pub plane: &'a Plane,
    /// Distance within which a vertex lies in it, m.
    pub tolerance: f64,
    /// Signs of the mirror image of a datum, component by component.
    pub signs: Vec<f64>,
}

/// A field over one region of the mesh.
#[derive(Clone, Debug)]
pub struct Field {
    training: Vec<TrainingVertex>,
    /// Training vertices whose mirror images are centres too: those of a half model that are off its plane.
    images: Vec<u32>,
    /// Signs of the mirror image of a datum, component by component.
    mirror_signs: Vec<f64>,
    basis: RadialBasis,
}

impl Field {
    /// Factorises the system of a training set. `reference` are the positions of all vertices of the mesh, m. With a
    /// `mirror` the field is that of the whole configuration, of which the mesh is one half.
    ///
    /// Factors in `found` are taken if they are those of this system.
    ///
    /// # Errors
    /// [`RbfError`] if the system of the training vertices cannot be factorised.
    pub fn new(
        training: Vec<TrainingVertex>,
        reference: &[Vector3],
        kernel: Kernel,
        regularisation: f64,
        mirror: Option<Mirror<'_>>,
        found: Option<&Factors>,
    ) -> Result<Self, RbfError> {
        let at = |t: &TrainingVertex| reference[t.vertex as usize];
        let mut centres: Vec<Vector3> = training.iter().map(at).collect();
        let mut images = Vec::new();
        if let Some(Mirror { plane, tolerance, .. }) = &mirror {
            for (i, t) in (0u32..).zip(&training) {
                let x: [f64; 3] = at(t).into();
                if plane.signed_distance(&x).abs() > *tolerance {
                    images.push(i);
                    centres.push(Vector3::from(plane.mirror(&x)));
                }
            }
        }
        let mirror_signs = mirror.map_or_else(Vec::new, |m| m.signs);
        let restored = match found {
            Some(factors) => RadialBasis::restore(kernel, &centres, factors)?,
            None => None,
        };
        let basis = match restored {
            Some(basis) => basis,
            None => RadialBasis::new(kernel, &centres, regularisation)?,
        };
        Ok(Self { basis, training, images, mirror_signs })
    }

    /// The factors of the system, to be kept between set-ups.
    pub fn factors(&self) -> Factors {
        self.basis.factors()
    }

    /// The training vertices.
    pub fn training(&self) -> &[TrainingVertex] {
        &self.training
    }

    /// Training vertices, by place among them, whose mirror images are centres too, after all the others.
    pub fn images(&self) -> &[u32] {
        &self.images
    }

    /// Signs of the mirror image of a datum, component by component.
    pub fn mirror_signs(&self) -> &[f64] {
        &self.mirror_signs
    }

    /// c^2 of the multiquadric, in units of the squared extent of the centres.
    pub fn shape_squared(&self) -> f64 {
        self.basis.shape_squared()
    }

    /// Bytes held by the factorisation.
    pub fn bytes(&self) -> usize {
        self.basis.bytes()
    }

    /// Field values at `points`, a row each. `seam_motion`: the motion of each seam vertex in the field's terms, a row each. The
    /// datum of training vertex `i` is (eq. 15) `(1 - alpha_i) component_motion(i) + sum_k weight_ik seam_motion[k]`;
    /// `component_motion` adds a multiple of the motion of a training vertex with its component to a row.
    pub fn eval(
        &self,
        seam_motion: &Block,
        component_motion: impl Fn(usize, f64, &mut [f64]),
        points: &[Vector3],
    ) -> Block {
        let mut data = Block::zeros(self.training.len() + self.images.len(), seam_motion.width());
        for (i, t) in self.training.iter().enumerate() {
            let row = data.row_mut(i);
            for &(k, weight) in &t.seams {
                add_row(row, weight, seam_motion.row(k as usize));
            }
            if t.alpha() != 1.0 {
                component_motion(i, 1.0 - t.alpha(), row);
            }
        }
        for (image, &i) in (self.training.len()..).zip(&self.images) {
            let mirrored = self.mirrored(data.row(i as usize));
            data.row_mut(image).copy_from_slice(&mirrored);
        }
        self.basis.evaluate(&self.basis.fit(&data), points)
    }

    /// The transpose of [`eval`](Self::eval): adds the seeds of the seam motions to `seam_motion`, and hands those of the
    /// component motions, with the factor that belongs to them, to `component_motion`.
    pub fn vjp(
        &self,
        points: &[Vector3],
        seeds: &Block,
        seam_motion: &mut Block,
        mut component_motion: impl FnMut(usize, f64, &[f64]),
    ) {
        let mut data = self.basis.fit_vjp(&self.basis.evaluate_vjp(points, seeds));
        for (image, &i) in (self.training.len()..).zip(&self.images) {
            let mirrored = self.mirrored(data.row(image));
            add_row(data.row_mut(i as usize), 1.0, &mirrored);
        }
        for (i, t) in self.training.iter().enumerate() {
            for &(k, weight) in &t.seams {
                add_row(seam_motion.row_mut(k as usize), weight, data.row(i));
            }
            if t.alpha() != 1.0 {
                component_motion(i, 1.0 - t.alpha(), data.row(i));
            }
        }
    }

    fn mirrored(&self, row: &[f64]) -> Vec<f64> {
        row.iter().zip(self.mirror_signs.iter().cycle()).map(|(x, sign)| sign * x).collect()
    }
}

/// A field and the vertices that it moves.
#[derive(Clone, Debug)]
pub struct RegionField {
    /// The component that the field moves; `None`: all of them.
    pub component: Option<u32>,
    /// Surface coordinates in which departures are measured; `None`: they are vectors in space.
    pub chart: Option<Arc<Chart>>,
    /// The factorised system.
    pub field: Field,
    /// The vertices that the field moves: all of the region that are neither on a seam nor fixed.
    pub vertices: Vec<u32>,
    /// Their reference positions, m.
    pub points: Vec<Vector3>,
    /// Places of the training vertices on their components. `None` for a field of departures, which are zero away from the
    /// seams.
    anchors: Option<Vec<Anchor>>,
}

/// A training vertex that moves with its component.
#[derive(Clone, Debug)]
struct Anchor {
    component: usize,
    location: Location,
    /// Its reference position, m.
    start: Vector3,
}

impl RegionField {
    /// Numbers that a value has.
    pub fn columns(&self) -> usize {
        if self.chart.is_some() { 2 } else { 3 }
    }

    fn eval(&self, motion: &Block, bodies: &[Body]) -> Block {
        let follow = |i: usize, factor: f64, row: &mut [f64]| {
            let Some(anchors) = &self.anchors else { return };
            let Anchor { component, location, start } = &anchors[i];
            add_vector(row, 0, &((bodies[*component].position(location) - start) * factor));
        };
        self.field.eval(motion, follow, &self.points)
    }

    fn jvp(&self, bodies: &[Body], motion: &Block, control_points: &[Block]) -> Block {
        let follow = |i: usize, factor: f64, row: &mut [f64]| {
            let Some(anchors) = &self.anchors else { return };
            let Anchor { component, location, .. } = &anchors[i];
            let mut s = vec![0.0; row.len()];
            bodies[*component].basis(location).position_jvp(&control_points[*component], &mut s);
            add_row(row, factor, &s);
        };
        self.field.eval(motion, follow, &self.points)
    }

    fn vjp(&self, bodies: &[Body], seeds: &Block, motion: &mut Block, control_points: &mut [Block]) {
        let follow = |i: usize, factor: f64, seed: &[f64]| {
            let Some(anchors) = &self.anchors else { return };
            let Anchor { component, location, .. } = &anchors[i];
            let scaled: Vec<f64> = seed.iter().map(|s| factor * s).collect();
            bodies[*component].basis(location).position_vjp(&scaled, &mut control_points[*component]);
        };
        self.field.vjp(&self.points, seeds, motion, follow);
    }
}

/// The fields of a set-up, over disjoint sets of vertices.
#[derive(Clone, Debug)]
pub(crate) struct Fields {
    regions: Vec<RegionField>,
    /// Field and row there of every vertex that a field moves.
    rows: Vec<Option<(u32, u32)>>,
    /// Seam vertices in all.
    seams: usize,
}

impl Fields {
    fn new(regions: Vec<RegionField>, vertices: usize, seams: usize) -> Self {
        let mut rows = vec![None; vertices];
        for (field, region) in (0u32..).zip(&regions) {
            for (row, &v) in (0u32..).zip(&region.vertices) {
                rows[v as usize] = Some((field, row));
            }
        }
        Self { regions, rows, seams }
    }

    /// The fields with their regions.
    pub fn regions(&self) -> &[RegionField] {
        &self.regions
    }

    /// The field that moves a vertex.
    pub fn of(&self, vertex: u32) -> Option<&RegionField> {
        self.rows[vertex as usize].map(|(field, _)| &self.regions[field as usize])
    }

    /// Values at the vertices of each field, a block a field, from the motions of the seam vertices.
    pub fn eval(&self, motions: &[Block], bodies: &[Body]) -> Vec<Block> {
        self.regions.iter().zip(motions).map(|(region, motion)| region.eval(motion, bodies)).collect()
    }

    /// Tangents of the values for those of the motions and of the internal control points.
    pub fn jvp(&self, bodies: &[Body], motions: &[Block], control_points: &[Block]) -> Vec<Block> {
        let regions = self.regions.iter().zip(motions);
        regions.map(|(region, motion)| region.jvp(bodies, motion, control_points)).collect()
    }

    /// The transpose of [`jvp`](Self::jvp): seeds of the motions; adds to those of the internal control points.
    pub fn vjp(&self, bodies: &[Body], seeds: &[Block], control_points: &mut [Block]) -> Vec<Block> {
        let of_region = |(region, seeds): (&RegionField, &Block)| {
            let mut motions = Block::zeros(self.seams, seeds.width());
            region.vjp(bodies, seeds, &mut motions, control_points);
            motions
        };
        self.regions.iter().zip(seeds).map(of_region).collect()
    }

    /// Values of zero in `k` directions.
    pub fn zeros(&self, k: usize) -> Vec<Block> {
        self.regions.iter().map(|region| Block::zeros(region.vertices.len(), region.columns() * k)).collect()
    }

    /// The row of a vertex among the values; empty if no field moves it.
    pub fn value<'v>(&self, values: &'v [Block], vertex: u32) -> &'v [f64] {
        match self.rows[vertex as usize] {
            Some((field, row)) => values[field as usize].row(row as usize),
            None => &[],
        }
    }

    /// [`value`](Self::value), to be changed.
    pub fn value_mut<'v>(&self, values: &'v mut [Block], vertex: u32) -> &'v mut [f64] {
        match self.rows[vertex as usize] {
            Some((field, row)) => values[field as usize].row_mut(row as usize),
            None => &mut [],
        }
    }
}
