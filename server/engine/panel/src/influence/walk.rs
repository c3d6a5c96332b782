//! The pass over all that acts on a target, which both products share: every mean inverse distance with its gradient.

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
    /// An element afar: its mean with the gradients with respect to the way from the target's centroid to the element's, and to both moments.
    fn far(&mut self, view: &View, element: usize, mean: f64, by_way: &Vector3, by_moments: &Moments);

    /// An element near by: its mean with the gradients with respect to the target's corners, the element's corners, and the way between
    /// their centroids.
    fn near(&mut self, view: &View, element: usize, mean: &Near, by_way: &Vector3);

    /// A triangle of a wake, likewise.
    fn sheet(&mut self, view: &View, sheet: usize, mean: &Near);
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
            for (element, source) in self.sources.iter().enumerate() {
                let way = source.centroid - Vector3::from(view.centroid);
                let reach = self.layout.reach[element] + target.reach;
                let moments: Moments = std::array::from_fn(|k| source.moments[k] + view.moments[k]);
                if way.norm_squared() >= FAR_SQUARED * reach * reach {
                    let (mean, by_way, by_moments) = mean_with_gradient(way.into(), &moments);
                    visitor.far(&view, element, mean, &by_way.into(), &by_moments);
                    continue;
                }
                let (far, slope) = share(&way, reach);
                if far > 0.0 {
                    let (mean, by_way, by_moments) = mean_with_gradient(way.into(), &moments);
                    let by_way = far * Vector3::from(by_way) + mean * slope;
                    visitor.far(&view, element, far * mean, &by_way, &by_moments.map(|m| far * m));
                }
                let near = if target.carrier == Carrier::Element(element) && y > 0.0 {
                    let (mean, gradient) = self.triangles[element].own_mean_with_gradient();
                    Near { mean, by_target: gradient, by_source: [Vector3::zeros(); 3] }
                } else {
                    let on = if y > 0.0 { target.on_side(self, element) } else { None };
                    near(target, &view, &self.triangles[element], on)
                };
                let by_way = -near.mean * slope;
                visitor.near(&view, element, &near.scaled(1.0 - far), &by_way);
            }
            for (index, sheet) in
                self.sheets.iter().enumerate().filter(|(_, sheet)| !sheet.triangle.is_empty())
            {
                let on = if y > 0.0 { target.on_sheet(self, index) } else { None };
                visitor.sheet(&view, index, &near(target, &view, &sheet.triangle, on));
            }
        }
    }
}

/// The mean over the target's probes.
fn near(target: &Target, view: &View, triangle: &Triangle, on: Option<usize>) -> Near {
    let probes = target.probes();
    let (means, gradients) = triangle.means_with_gradients(&target.places(&probes, view), on);
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
