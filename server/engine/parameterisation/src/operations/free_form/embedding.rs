//! The B-spline weights by which the targets take the lattice's displacement.

use moldline_foundation::Vector3;
use nalgebra::convert;

use super::lattice::{Place, SectionLattice};
use crate::scalar::{Scalar, shift};

/// The linear map from displacements of the lattice to those of the targets.
#[derive(Clone, Debug)]
pub(super) struct Embedding {
    targets: Vec<usize>,
    /// Whether each target is on the plane of symmetry, which it does not leave, not even by rounding.
    on_plane: Vec<bool>,
    /// Coordinate index of the span axis.
    span: usize,
    /// The weights of target m are `weights[offsets[m]..offsets[m + 1]]`: lattice index and value.
    offsets: Vec<usize>,
    weights: Vec<(u32, f64)>,
}

impl Embedding {
    /// The weights of `targets`, which are at `points` and have the coordinates `places` in the block.
    pub(super) fn new(
        lattice: &SectionLattice,
        targets: Vec<usize>,
        points: &[Vector3],
        places: &[Place],
    ) -> Self {
        let per_target: usize = lattice.volume.knots().iter().map(|knots| knots.degree() + 1).product();
        let mut offsets = vec![0];
        let mut weights = Vec::with_capacity(per_target * targets.len());
        for (point, place) in points.iter().zip(places) {
            let entries = lattice.volume.weights(lattice.xi(place), 0);
            let mirrored = lattice.sections.is_image(point);
            for (index, weight) in entries.entries().filter(|&(_, weight)| weight != 0.0) {
                let index = if mirrored { lattice.mirror(index) } else { index };
                weights.push((index as u32, weight));
            }
            offsets.push(weights.len());
        }
        let on_plane = points.iter().map(|point| lattice.sections.is_on_plane(point)).collect();
        Self { targets, on_plane, span: lattice.sections.axes.span, offsets, weights }
    }

    pub(super) fn eval<T: Scalar>(
        &self,
        lattice: &[nalgebra::Vector3<T>],
        points: &mut [nalgebra::Vector3<T>],
    ) {
        for (step, &target) in self.interpolate(lattice).zip(&self.targets) {
            shift(&mut points[target], step);
        }
    }

    pub(super) fn jvp(&self, lattice: &[Vector3], tangents: &mut [Vector3]) {
        for (step, &target) in self.interpolate(lattice).zip(&self.targets) {
            tangents[target] += step;
        }
    }

    /// Seeds on the `count` lattice points.
    pub(super) fn vjp(&self, count: usize, seeds: &[Vector3]) -> Vec<Vector3> {
        let mut lattice = vec![Vector3::zeros(); count];
        for (m, &target) in self.targets.iter().enumerate() {
            for &(index, weight) in &self.weights[self.offsets[m]..self.offsets[m + 1]] {
                lattice[index as usize] += seeds[target] * weight;
            }
        }
        lattice
    }

    /// The lattice's field at each target.
    fn interpolate<'a, T: Scalar>(
        &'a self,
        lattice: &'a [nalgebra::Vector3<T>],
    ) -> impl Iterator<Item = nalgebra::Vector3<T>> + 'a {
        self.offsets.windows(2).zip(&self.on_plane).map(move |(w, &on_plane)| {
            let mut sum = nalgebra::Vector3::zeros();
            for &(index, weight) in &self.weights[w[0]..w[1]] {
                sum += lattice[index as usize] * convert::<f64, T>(weight);
            }
            if on_plane {
                sum[self.span] = T::zero();
            }
            sum
        })
    }
}
