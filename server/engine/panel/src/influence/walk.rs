//! The pass over all that acts on a target, which both products share: every mean inverse distance with its gradient.

use moldline_foundation::simd::widest;
use moldline_mesh::Vector3;

use super::{
    assembly::View,
    far::{FAR_SQUARED, Moments, mean_with_gradient, share},
    near::Triangle,
    records::Influence,
    targets::{Carrier, Target},
};
use crate::lanes::LANES;

/// What a product makes of the mean inverse distances of a target to all that acts on it.
pub(super) trait Visitor {
    /// Elements afar, from `first` on.
    fn far(&mut self, view: &View, first: usize, block: &Block);

    /// An element near by: its mean with the gradients with respect to the target's corners, the element's corners, and the way between
    /// their centroids.
    fn near(&mut self, view: &View, element: usize, mean: &Near, by_way: &Vector3);

    /// A triangle of a wake, likewise.
    fn sheet(&mut self, view: &View, sheet: usize, mean: &Near);
}

/// Elements that are handled at once.
pub(super) const BLOCK: usize = 64;

/// Mean inverse distances of elements afar.
pub(super) struct Block {
    pub count: usize,
    pub means: [f64; BLOCK],
    /// Their gradients with respect to the way from the target's centroid to the element's, and to both moments.
    pub by: [[f64; BLOCK]; 9],
}

/// The sum of products, in one fixed order.
#[inline(always)]
pub(super) fn product(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; LANES];
    let (a, rest_a) = a.as_chunks::<LANES>();
    let (b, rest_b) = b.as_chunks::<LANES>();
    for (a, b) in a.iter().zip(b) {
        for l in 0..LANES {
            sums[l] += a[l] * b[l];
        }
    }
    sums.iter().sum::<f64>() + rest_a.iter().zip(rest_b).map(|(a, b)| a * b).sum::<f64>()
}

/// A mean inverse distance near by with its gradients.
pub(super) struct Near {
    pub mean: f64,
    pub by_target: [Vector3; 3],
    pub by_source: [Vector3; 3],
}

impl Near {
    fn scaled(mut self, factor: f64) -> Self {
        self.mean *= factor;
        self.by_target.iter_mut().chain(&mut self.by_source).for_each(|g| *g *= factor);
        self
    }
}

impl Influence<'_> {
    /// Visits all that acts on a target.
    pub(super) fn walk(&self, target: &Target, visitor: &mut impl Visitor) {
        for &y in self.views() {
            let view = View::new(target, y);
            for first in (0..self.sources.len()).step_by(BLOCK) {
                self.visit_block(target, &view, first, visitor);
            }
            for (index, sheet) in
                self.sheets.iter().enumerate().filter(|(_, sheet)| !sheet.triangle.is_empty())
            {
                let on = if y > 0.0 { target.on_sheet(self, index) } else { None };
                visitor.sheet(&view, index, &near(target, &view, &sheet.triangle, on));
            }
        }
    }

    /// Visits a block of elements: those near by one by one.
    fn visit_block(&self, target: &Target, view: &View, first: usize, visitor: &mut impl Visitor) {
        let count = BLOCK.min(self.sources.len() - first);
        let mut block = Block { count, means: [0.0; BLOCK], by: [[0.0; BLOCK]; 9] };
        let mut distances = [0.0; BLOCK];
        let figures = self.figures.each_ref().map(|list| &list[first..first + count]);
        widest(
            #[inline(always)]
            || {
                for l in 0..count {
                    let d = [0, 1, 2].map(|axis| figures[axis][l] - view.centroid[axis]);
                    let s: Moments = std::array::from_fn(|k| figures[3 + k][l] + view.moments[k]);
                    let (mean, by_way, by_moments) = mean_with_gradient(d, &s);
                    block.means[l] = mean;
                    (0..3).for_each(|k| block.by[k][l] = by_way[k]);
                    (0..6).for_each(|k| block.by[3 + k][l] = by_moments[k]);
                    distances[l] = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
                }
            },
        );
        for l in 0..count {
            let element = first + l;
            let reach = self.layout.reach[element] + target.reach;
            if distances[l] >= FAR_SQUARED * reach * reach {
                continue;
            }
            let way = self.sources[element].centroid - Vector3::from(view.centroid);
            let (far, slope) = share(&way, reach);
            let mean = block.means[l];
            for (k, by) in block.by.iter_mut().enumerate() {
                let grows = if k < 3 { mean * slope[k] } else { 0.0 };
                by[l] = if far > 0.0 { far * by[l] + grows } else { 0.0 };
            }
            block.means[l] = if far > 0.0 { far * mean } else { 0.0 };
            let near = if target.carrier == Carrier::Element(element) && view.y > 0.0 {
                let (mean, gradient) = self.triangles[element].own_mean_with_gradient();
                Near { mean, by_target: gradient, by_source: [Vector3::zeros(); 3] }
            } else {
                let on = if view.y > 0.0 { target.on_side(self, element) } else { None };
                near(target, view, &self.triangles[element], on)
            };
            let by_way = -near.mean * slope;
            visitor.near(view, element, &near.scaled(1.0 - far), &by_way);
        }
        visitor.far(view, first, &block);
    }
}

/// The mean over the target's probes.
fn near(target: &Target, view: &View, triangle: &Triangle, on: Option<usize>) -> Near {
    let probes = &target.probes;
    let (means, gradients) = triangle.means_with_gradients(&target.places(view), on);
    let mut near = Near { mean: 0.0, by_target: [Vector3::zeros(); 3], by_source: [Vector3::zeros(); 3] };
    for l in 0..LANES {
        let weight = probes.weights[l];
        near.mean += weight * means[l];
        let mut by_point = Vector3::zeros();
        for (k, by_source) in near.by_source.iter_mut().enumerate() {
            let gradient = weight * Vector3::from_fn(|axis, _| gradients[k][axis][l]);
            *by_source += gradient;
            by_point -= gradient;
        }
        let by_point = view.place(&by_point);
        (0..3).for_each(|k| near.by_target[k] += probes.corners[k][l] * by_point);
    }
    near
}
