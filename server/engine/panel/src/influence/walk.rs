//! The pass over all that acts on targets, which the matrix and both products share: every mean inverse distance, with its gradient where one is asked for.

use moldline_foundation::simd::widest;
use moldline_mesh::Vector3;

use super::{
    far::{FAR_SQUARED, Moments, mean, mean_with_gradient, share},
    near::Triangle,
    records::Influence,
    targets::{Probes, Target},
};
use crate::{
    clusters::{PATCH, Patch},
    elements::MOST,
    lanes::{LANES, Lane},
};

/// A target as it is seen from one side: the surface's, or its image's.
#[derive(Clone, Debug)]
pub(super) struct View {
    /// -1 for the image.
    pub y: f64,
    pub centroid: [f64; 3],
    pub moments: Moments,
    /// The directions along which the potential's slope is tested.
    pub slopes: [Vector3; 2],
}

impl View {
    fn new(target: &Target, y: f64) -> Self {
        let (c, s) = (&target.figure.centroid, &target.figure.moments);
        Self {
            y,
            centroid: [c.x, y * c.y, c.z],
            moments: [s[0], s[1], s[2], y * s[3], y * s[4], s[5]],
            slopes: target.slopes.map(|e| Vector3::new(e.x, y * e.y, e.z)),
        }
    }

    /// The image of a vortex turns the other way but for its part across the plane.
    pub fn turned(&self, charge: &Vector3) -> Vector3 {
        Vector3::new(self.y * charge.x, charge.y, self.y * charge.z)
    }

    /// The place of a point of the target.
    pub fn place(&self, x: &Vector3) -> Vector3 {
        Vector3::new(x.x, self.y * x.y, x.z)
    }
}

/// What is made of the mean inverse distances of targets to all that acts on them.
pub(super) trait Visitor {
    /// Whether gradients are needed.
    const GRADIENTS: bool;

    /// The elements of a patch afar.
    fn far(&mut self, target: usize, view: &View, patch: &Patch, block: &Block);

    /// An element near by and its place.
    fn near(&mut self, target: usize, view: &View, element: usize, place: usize, near: &Near);

    /// A triangle of a wake.
    fn sheet(&mut self, target: usize, view: &View, sheet: usize, near: &Near);

    /// Patch and target are done, seen from all sides.
    fn done(&mut self, target: usize, patch: &Patch);
}

/// Mean inverse distances of the elements of a patch afar.
pub(super) struct Block {
    pub count: usize,
    pub means: [f64; PATCH],
    /// Their gradients with respect to the way from the target's centroid to the element's, and to both moments.
    pub by: [[f64; PATCH]; 9],
    /// The ways, and the factor that makes of a way the gradient of its inverse with respect to the target's centroid.
    pub ways: [[f64; PATCH]; 3],
    pub cubes: [f64; PATCH],
    /// Its gradient with respect to the way.
    pub cubes_by: [[f64; PATCH]; 3],
}

impl Block {
    fn new(count: usize) -> Self {
        let none = [0.0; PATCH];
        Self { count, means: none, by: [none; 9], ways: [none; 3], cubes: none, cubes_by: [none; 3] }
    }

    /// The slopes of the inverse distances along a direction.
    #[inline(always)]
    pub fn slopes(&self, along: &Vector3) -> [f64; PATCH] {
        let [x, y, z] = &self.ways;
        let mut out = [0.0; PATCH];
        for l in 0..PATCH {
            out[l] = self.cubes[l] * (along.x * x[l] + along.y * y[l] + along.z * z[l]);
        }
        out
    }
}

/// The sum over a block, lane by lane.
#[inline(always)]
pub(super) fn fold(list: &[f64; PATCH], sums: &mut Lane) {
    for of_lanes in list.as_chunks::<LANES>().0 {
        for l in 0..LANES {
            sums[l] += of_lanes[l];
        }
    }
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

/// Mean inverse distances between the parts of a target and a triangle near by, as far as it counts as near.
pub(super) struct Near {
    pub means: [f64; MOST],
    /// Their gradients with respect to the parts' corners, the triangle's corners ...
    pub by_target: [[Vector3; 3]; MOST],
    pub by_source: [[Vector3; 3]; MOST],
    /// ... and the way between the centroids.
    pub by_way: [Vector3; MOST],
}

impl Near {
    fn zeros() -> Self {
        let none = [[Vector3::zeros(); 3]; MOST];
        Self { means: [0.0; MOST], by_target: none, by_source: none, by_way: [Vector3::zeros(); MOST] }
    }

    /// Scaled by how much the pair counts as near.
    fn kept(mut self, far: f64, slope: &Vector3, parts: usize) -> Self {
        for part in 0..parts {
            self.by_way[part] = -self.means[part] * slope;
            self.means[part] *= 1.0 - far;
            let gradients = self.by_target[part].iter_mut().chain(&mut self.by_source[part]);
            gradients.for_each(|g| *g *= 1.0 - far);
        }
        self
    }
}

impl Influence<'_> {
    /// Targets that are handled together: a group of panels, or some points of lines.
    pub(super) fn groups(&self) -> Vec<Vec<usize>> {
        let lines: Vec<usize> = (self.panels.len()..Target::count(self)).collect();
        let panels = self.layout.groups.iter().map(|group| group.iter().map(|p| *p as usize).collect());
        panels.chain(lines.chunks(4 * PATCH).map(<[usize]>::to_vec)).collect()
    }

    /// Visits all that acts on targets.
    pub(super) fn walk<V: Visitor>(&self, targets: &[Target], visitor: &mut V) {
        let views: Vec<Vec<View>> = targets
            .iter()
            .map(|target| self.views().iter().map(|y| View::new(target, *y)).collect())
            .collect();
        for patch in &self.layout.patches {
            for (index, target) in targets.iter().enumerate() {
                for view in &views[index] {
                    self.visit_patch((index, target), view, patch, visitor);
                }
                visitor.done(index, patch);
            }
        }
        for (index, target) in targets.iter().enumerate() {
            for view in &views[index] {
                for (s, sheet) in self.sheets.iter().enumerate().filter(|(_, s)| !s.triangle.is_empty()) {
                    let on = if view.y > 0.0 { target.on_sheet(self, s) } else { None };
                    let probes = if target.touches(self, sheet) { &target.fine } else { &target.coarse };
                    let near = near::<V>(probes, view, &sheet.triangle, on);
                    visitor.sheet(index, view, s, &near);
                }
            }
        }
    }

    /// Visits the elements of a patch: those near by one by one.
    fn visit_patch<V: Visitor>(
        &self,
        (index, target): (usize, &Target),
        view: &View,
        patch: &Patch,
        visitor: &mut V,
    ) {
        let count = patch.places.len();
        let mut block = Block::new(count);
        let mut distances = [0.0; PATCH];
        let figures = self.figures.each_ref().map(|list| &list[patch.places.clone()]);
        widest(
            #[inline(always)]
            || {
                for l in 0..count {
                    let d = [0, 1, 2].map(|axis| figures[axis][l] - view.centroid[axis]);
                    let s: Moments = std::array::from_fn(|k| figures[3 + k][l] + view.moments[k]);
                    let squared = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
                    distances[l] = squared;
                    let cube = 1.0 / (squared * squared.sqrt());
                    block.cubes[l] = cube;
                    (0..3).for_each(|axis| block.ways[axis][l] = d[axis]);
                    if V::GRADIENTS {
                        let (mean, by_way, by_moments) = mean_with_gradient(d, &s);
                        block.means[l] = mean;
                        (0..3).for_each(|k| block.by[k][l] = by_way[k]);
                        (0..6).for_each(|k| block.by[3 + k][l] = by_moments[k]);
                        let fall = -3.0 * cube / squared;
                        (0..3).for_each(|axis| block.cubes_by[axis][l] = fall * d[axis]);
                    } else {
                        block.means[l] = mean(d, &s);
                    }
                }
            },
        );
        for l in 0..count {
            let place = patch.places.start + l;
            let reach = self.layout.reach[place] + target.reach;
            if distances[l] >= FAR_SQUARED * reach * reach {
                continue;
            }
            let way = self.far[place].centroid - Vector3::from(view.centroid);
            let (far, slope) = share(&way, reach);
            // At the target itself nothing is finite.
            let scaled = |value: f64| if far > 0.0 { far * value } else { 0.0 };
            let (mean, cube) = (block.means[l], block.cubes[l]);
            for axis in 0..3 {
                let grows = if far > 0.0 { [mean * slope[axis], cube * slope[axis]] } else { [0.0; 2] };
                block.by[axis][l] = scaled(block.by[axis][l]) + grows[0];
                block.cubes_by[axis][l] = scaled(block.cubes_by[axis][l]) + grows[1];
            }
            (3..9).for_each(|k| block.by[k][l] = scaled(block.by[k][l]));
            block.means[l] = scaled(mean);
            block.cubes[l] = scaled(cube);
            let element = self.layout.order[place] as usize;
            let near = self.near::<V>(target, view, element).kept(far, &slope, target.parts.len());
            visitor.near(index, view, element, place, &near);
        }
        visitor.far(index, view, patch, &block);
    }

    /// The means between a target and an element near by.
    fn near<V: Visitor>(&self, target: &Target, view: &View, element: usize) -> Near {
        let triangle = &self.triangles[element];
        let on = if view.y > 0.0 { target.on_side(self, element) } else { None };
        let mut near = near::<V>(&target.fine, view, triangle, on);
        if let Some(own) = target.part_of(self, element).filter(|_| view.y > 0.0) {
            (near.means[own], near.by_target[own]) = triangle.own_mean_with_gradient();
            near.by_source[own] = [Vector3::zeros(); 3];
        }
        near
    }
}

/// The means over the probes of a target's parts.
fn near<V: Visitor>(probes: &[Probes], view: &View, triangle: &Triangle, on: Option<usize>) -> Near {
    let mut near = Near::zeros();
    for Probes { places, parts, corners, weights } in probes {
        let [x, mut y, z] = *places;
        y.iter_mut().for_each(|y| *y *= view.y);
        let places = [x, y, z];
        if !V::GRADIENTS {
            let means = triangle.means(&places, on);
            (0..LANES).for_each(|l| near.means[parts[l] as usize] += weights[l] * means[l]);
            continue;
        }
        let (means, gradients) = triangle.means_with_gradients(&places, on);
        for l in 0..LANES {
            let part = parts[l] as usize;
            near.means[part] += weights[l] * means[l];
            let mut by_point = Vector3::zeros();
            for (k, by_source) in near.by_source[part].iter_mut().enumerate() {
                let [x, y, z] = &gradients[k];
                let gradient = weights[l] * Vector3::new(x[l], y[l], z[l]);
                *by_source += gradient;
                by_point -= gradient;
            }
            let by_point = view.place(&by_point);
            (0..3).for_each(|k| near.by_target[part][k] += corners[k][l] * by_point);
        }
    }
    near
}
