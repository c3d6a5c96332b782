//! The displacement field (sec. III.E of the paper, eq. 16 and 17): training data from the seams, radial basis functions
//! through them, values at all vertices of a region.

use moldline_mesh::Plane;
use moldline_spline::Vector3;

use crate::{
    rbf::{Kernel, RadialBasis, RbfError},
    training::TrainingVertex,
};

/// The mirror that completes a half model.
#[derive(Clone, Copy, Debug)]
pub struct Mirror<'a> {
    /// The symmetry plane.
    pub plane: &'a Plane,
    /// Distance within which a vertex lies in it, m.
    pub tolerance: f64,
    /// What it does to a datum, component by component.
    pub signs: Vector3,
}

/// A field over one region of the mesh.
#[derive(Clone, Debug)]
pub struct Field {
    training: Vec<TrainingVertex>,
    /// Training vertices whose mirror images are centres too: those of a half model that are off its plane.
    images: Vec<u32>,
    /// What the mirror does to a datum, component by component.
    mirror_signs: Vector3,
    basis: RadialBasis,
}

impl Field {
    /// Factorises the system of a training set. `reference` are the positions of all vertices of the mesh, m. With a
    /// `mirror` the field is that of the whole configuration, of which the mesh is one half.
    ///
    /// # Errors
    /// [`RbfError`] if the training vertices coincide or lie in one plane.
    pub fn new(
        training: Vec<TrainingVertex>,
        reference: &[Vector3],
        kernel: Kernel,
        regularisation: f64,
        mirror: Option<Mirror<'_>>,
    ) -> Result<Self, RbfError> {
        let at = |t: &TrainingVertex| reference[t.vertex as usize];
        let mut centres: Vec<Vector3> = training.iter().map(at).collect();
        let mut images = Vec::new();
        if let Some(Mirror { plane, tolerance, .. }) = mirror {
            for (i, t) in (0u32..).zip(&training) {
                let x: [f64; 3] = at(t).into();
                if plane.signed_distance(&x).abs() > tolerance {
                    images.push(i);
                    centres.push(Vector3::from(plane.mirror(&x)));
                }
            }
        }
        let mirror_signs = mirror.map_or(Vector3::zeros(), |m| m.signs);
        Ok(Self {
            basis: RadialBasis::new(kernel, &centres, regularisation)?,
            training,
            images,
            mirror_signs,
        })
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
    pub fn mirror_signs(&self) -> Vector3 {
        self.mirror_signs
    }

    /// Bytes held by the factorisation.
    pub fn bytes(&self) -> usize {
        self.basis.bytes()
    }

    /// Field values at `points`. The datum of training vertex `i` is (eq. 15)
    /// `(1 - alpha_i) component_motion(vertex_i) + sum_k weight_ik seam_motion[k]`, in metres.
    pub fn eval(
        &self,
        seam_motion: &[Vector3],
        component_motion: impl Fn(u32) -> Vector3,
        points: &[Vector3],
        out: &mut [Vector3],
    ) {
        let mut data: Vec<Vector3> = self
            .training
            .iter()
            .map(|t| {
                let seams: Vector3 =
                    t.seams.iter().map(|&(k, weight)| seam_motion[k as usize] * weight).sum();
                let alpha = t.alpha();
                if alpha == 1.0 { seams } else { component_motion(t.vertex) * (1.0 - alpha) + seams }
            })
            .collect();
        for &i in &self.images {
            data.push(data[i as usize].component_mul(&self.mirror_signs));
        }
        self.basis.evaluate(&self.basis.fit(&data), points, out);
    }
}
