//! The displacement field (sec. III.E of the paper, eq. 16 and 17): training data from the seams, radial basis functions
//! through them, values at all vertices of a region.

use moldline_geometry::{Block, block::add_row};
use moldline_mesh::Plane;
use moldline_rbf::{Factors, Kernel, RadialBasis, RbfError};
use moldline_spline::Vector3;

use crate::training::TrainingVertex;

/// The mirror that completes a half model.
#[derive(Clone, Debug)]
pub struct Mirror<'a> {
    /// The symmetry plane.
    pub plane: &'a Plane,
    /// Distance within which a vertex lies in it, m.
    pub tolerance: f64,
    /// What it does to a datum, component by component.
    pub signs: Vec<f64>,
}

/// A field over one region of the mesh.
#[derive(Clone, Debug)]
pub struct Field {
    training: Vec<TrainingVertex>,
    /// Training vertices whose mirror images are centres too: those of a half model that are off its plane.
    images: Vec<u32>,
    /// What the mirror does to a datum, component by component.
    mirror_signs: Vec<f64>,
    basis: RadialBasis,
}

impl Field {
    /// Factorises the system of a training set. `reference` are the positions of all vertices of the mesh, m. With a
    /// `mirror` the field is that of the whole configuration, of which the mesh is one half.
    ///
    /// Where `found` has the factors of this system, they are taken.
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

    /// What took time to find.
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

    /// What the mirror does to a datum, component by component.
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

    /// Field values at `points`, a row each. `seam_motion`: what each seam vertex does, a row each. The datum of training
    /// vertex `i` is (eq. 15) `(1 - alpha_i) component_motion(vertex_i) + sum_k weight_ik seam_motion[k]`;
    /// `component_motion` adds a multiple of it to a row. Linear in both, so that this is its own derivative.
    pub fn eval(
        &self,
        seam_motion: &Block,
        component_motion: impl Fn(u32, f64, &mut [f64]),
        points: &[Vector3],
    ) -> Block {
        let mut data = Block::zeros(self.training.len() + self.images.len(), seam_motion.width());
        for (i, t) in self.training.iter().enumerate() {
            let row = data.row_mut(i);
            for &(k, weight) in &t.seams {
                add_row(row, weight, seam_motion.row(k as usize));
            }
            if t.alpha() != 1.0 {
                component_motion(t.vertex, 1.0 - t.alpha(), row);
            }
        }
        for (image, &i) in (self.training.len()..).zip(&self.images) {
            let signs = &self.mirror_signs;
            let mirrored: Vec<f64> =
                data.row(i as usize).iter().zip(signs.iter().cycle()).map(|(x, sign)| sign * x).collect();
            data.row_mut(image).copy_from_slice(&mirrored);
        }
        self.basis.evaluate(&self.basis.fit(&data), points)
    }

    /// The transpose of [`eval`](Self::eval): adds the seeds of the seam motions to `seam_motion`, and hands
    /// those of the component motions, with the factor that belongs to them, to `component_motion`.
    pub fn vjp(
        &self,
        points: &[Vector3],
        seeds: &Block,
        seam_motion: &mut Block,
        mut component_motion: impl FnMut(u32, f64, &[f64]),
    ) {
        let mut data = self.basis.fit_vjp(&self.basis.evaluate_vjp(points, seeds));
        for (image, &i) in (self.training.len()..).zip(&self.images) {
            let signs = &self.mirror_signs;
            let mirrored: Vec<f64> =
                data.row(image).iter().zip(signs.iter().cycle()).map(|(x, sign)| sign * x).collect();
            add_row(data.row_mut(i as usize), 1.0, &mirrored);
        }
        for (i, t) in self.training.iter().enumerate() {
            for &(k, weight) in &t.seams {
                add_row(seam_motion.row_mut(k as usize), weight, data.row(i));
            }
            if t.alpha() != 1.0 {
                component_motion(t.vertex, 1.0 - t.alpha(), data.row(i));
            }
        }
    }
}
