//! The transpose of the change of the residual: gradients of weighted sums of it with respect to the surface.

use std::f64::consts::PI;

use moldline_foundation::simd::widest;
use moldline_mesh::Vector3;
use rayon::prelude::*;

use super::{
    assembly::View,
    far::Moments,
    records::{Charges, Influence, plane_figure_vjp},
    targets::Target,
    walk::{BLOCK, Block, Near, Visitor, product},
};
use crate::{
    Monitor, PanelError, Stage,
    elements::circulation_by_corners,
    progress::Progress,
    surface::{SurfaceChange, area, area_by_corners},
};

/// Groups of targets whose seeds are kept at a time.
const GROUPS: usize = 8;

/// Weights of the residual: for every unknown, for every onset flow.
pub(crate) type PairSeeds<const B: usize> = [Vec<f64>; B];

/// What a group of targets adds to one adjoint.
struct Gathered<const B: usize> {
    change: SurfaceChange,
    /// Seeds of the elements as they act from afar, one list for each number: centroid, moments ...
    figures: [Vec<f64>; 9],
    /// ... and circulations, by axis.
    charges: [[Vec<f64>; 3]; B],
}

impl<const B: usize> Gathered<B> {
    fn new(influence: &Influence<'_>) -> Self {
        let none = || vec![0.0; influence.sources.len()];
        Self {
            change: SurfaceChange::zeros(influence.surface),
            figures: std::array::from_fn(|_| none()),
            charges: std::array::from_fn(|_| std::array::from_fn(|_| none())),
        }
    }

    fn add(&mut self, other: &Self) {
        self.change.beta += other.change.beta;
        self.change.points.iter_mut().zip(&other.change.points).for_each(|(a, b)| *a += b);
        let mine = self.figures.iter_mut().chain(self.charges.as_flattened_mut());
        let others = other.figures.iter().chain(other.charges.as_flattened());
        for (mine, other) in mine.zip(others) {
            mine.iter_mut().zip(other).for_each(|(a, b)| *a += b);
        }
    }
}

/// Sums over all that acts on one target.
struct Sum<'a, const B: usize> {
    influence: &'a Influence<'a>,
    charges: &'a [Charges; B],
    /// Circulation of the test functions, for every adjoint.
    tests: Vec<[Vector3; B]>,
    gathered: &'a mut [Gathered<B>],
    /// Seeds of the target: corners, centroid and moments.
    moved: Vec<([Vector3; 3], Vector3, Moments)>,
    potential: [Vector3; B],
}

/// `sum_k test_k . charge_k` as the view turns it, and the turned tests.
fn weight<const B: usize>(
    view: &View,
    tests: &[Vector3; B],
    charge: impl Fn(usize) -> Vector3,
) -> (f64, [Vector3; B]) {
    let turned: [Vector3; B] = std::array::from_fn(|k| view.turned(&tests[k]));
    ((0..B).map(|k| turned[k].dot(&charge(k))).sum(), turned)
}

impl<const B: usize> Visitor for Sum<'_, B> {
    fn far(&mut self, view: &View, first: usize, block: &Block) {
        let charges = self.charges;
        let range = first..first + block.count;
        let means = &block.means[..block.count];
        widest(
            #[inline(always)]
            || {
                for (sum, charge) in self.potential.iter_mut().zip(charges) {
                    let sums = charge.afar.each_ref().map(|list| product(means, &list[range.clone()]));
                    *sum += view.turned(&Vector3::from(sums));
                }
                let each = self.tests.iter().zip(self.gathered.iter_mut()).zip(&mut self.moved);
                for ((tests, gathered), (_, centroid, moments)) in each {
                    let mut weights = [0.0; BLOCK];
                    for (k, test) in tests.iter().enumerate() {
                        let turned = view.turned(test);
                        for axis in 0..3 {
                            let charges = &charges[k].afar[axis][range.clone()];
                            weights.iter_mut().zip(charges).for_each(|(w, c)| *w += turned[axis] * c);
                            let seeds = &mut gathered.charges[k][axis][range.clone()];
                            seeds.iter_mut().zip(means).for_each(|(s, mean)| *s += mean * turned[axis]);
                        }
                    }
                    let weights = &weights[..block.count];
                    let mut sums = [0.0; 9];
                    for ((sum, by), figures) in sums.iter_mut().zip(&block.by).zip(&mut gathered.figures) {
                        *sum = product(weights, &by[..block.count]);
                        let seeds = figures[range.clone()].iter_mut().zip(weights).zip(by);
                        seeds.for_each(|((seed, weight), by)| *seed += weight * by);
                    }
                    let s = sums;
                    *centroid -= view.place(&Vector3::new(s[0], s[1], s[2]));
                    let seen = [s[3], s[4], s[5], view.y * s[6], view.y * s[7], s[8]];
                    (0..6).for_each(|k| moments[k] += seen[k]);
                }
            },
        );
    }

    fn near(&mut self, view: &View, element: usize, near: &Near, by_way: &Vector3) {
        let Influence { panels, layout, .. } = self.influence;
        let charges = self.charges;
        for k in 0..B {
            self.potential[k] += near.mean * view.turned(&charges[k].elements[element]);
        }
        let values: [[f64; 3]; B] =
            std::array::from_fn(|k| layout.element_values(element, &charges[k].nodes));
        for ((tests, gathered), moved) in self.tests.iter().zip(self.gathered.iter_mut()).zip(&mut self.moved)
        {
            let (weight, turned) = weight(view, tests, |k| charges[k].elements[element]);
            (0..3).for_each(|axis| gathered.figures[axis][element] += weight * by_way[axis]);
            moved.1 -= weight * view.place(by_way);
            let mut seeds = near.by_source.map(|g| weight * g);
            for k in 0..B {
                let by = circulation_by_corners(&(near.mean * turned[k]), &values[k]);
                (0..3).for_each(|i| seeds[i] += by[i]);
            }
            (0..3).for_each(|i| moved.0[i] += weight * near.by_target[i]);
            gathered.change.add_corners(panels, &layout.elements, element, &seeds);
        }
    }

    fn sheet(&mut self, view: &View, sheet: usize, near: &Near) {
        let Influence { layout, surface, .. } = self.influence;
        let charges = self.charges;
        for k in 0..B {
            self.potential[k] += near.mean * view.turned(&charges[k].sheets[sheet]);
        }
        let circulations = self.influence.sheets[sheet].circulations;
        let values: [[f64; 3]; B] =
            std::array::from_fn(|k| circulations.map(|g| charges[k].gamma[g as usize]));
        for ((tests, gathered), moved) in self.tests.iter().zip(self.gathered.iter_mut()).zip(&mut self.moved)
        {
            let (weight, turned) = weight(view, tests, |k| charges[k].sheets[sheet]);
            let mut seeds = near.by_source.map(|g| weight * g);
            for k in 0..B {
                let by = circulation_by_corners(&(near.mean * turned[k]), &values[k]);
                (0..3).for_each(|i| seeds[i] += by[i]);
            }
            (0..3).for_each(|i| moved.0[i] += weight * near.by_target[i]);
            for (corner, seed) in layout.sheets.triangles[sheet].corners.iter().zip(&seeds) {
                let points = &mut gathered.change.points;
                points[corner.ahead(&surface.points) as usize].x += seed.x;
                points[corner.yz as usize].y += seed.y;
                points[corner.yz as usize].z += seed.z;
            }
        }
    }
}

impl Influence<'_> {
    /// The gradients of several weighted sums of the residual.
    pub fn vjp<const B: usize>(
        &self,
        charges: &[Charges; B],
        seeds: &[PairSeeds<B>],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<SurfaceChange>, PanelError> {
        let groups = self.groups();
        let progress = Progress::new(monitor, Stage::Derivative, groups.len());
        let mut total: Vec<Gathered<B>> = seeds.iter().map(|_| Gathered::new(self)).collect();
        for wave in groups.chunks(GROUPS) {
            let parts: Vec<Vec<Gathered<B>>> = wave
                .par_iter()
                .map(|group| {
                    let mut gathered: Vec<Gathered<B>> = seeds.iter().map(|_| Gathered::new(self)).collect();
                    for target in group {
                        if progress.cancelled() {
                            return gathered;
                        }
                        self.target_vjp(*target, charges, seeds, &mut gathered);
                    }
                    progress.step();
                    gathered
                })
                .collect();
            for part in &parts {
                total.iter_mut().zip(part).for_each(|(sum, part)| sum.add(part));
            }
        }
        progress.finish()?;
        Ok(total
            .into_iter()
            .zip(seeds)
            .map(|(gathered, seeds)| {
                let Gathered { mut change, figures, charges: of_charges } = gathered;
                for element in 0..self.sources.len() {
                    let corners = &self.surface.corners[element];
                    let by_centroid = Vector3::from_fn(|axis, _| figures[axis][element]);
                    let by_moments: Moments = std::array::from_fn(|k| figures[3 + k][element]);
                    let afar = (&by_centroid, &by_moments);
                    let mut corner_seeds = plane_figure_vjp(corners, &self.sources[element].centroid, afar);
                    for k in 0..B {
                        let values = self.layout.element_values(element, &charges[k].nodes);
                        let of = Vector3::from_fn(|axis, _| of_charges[k][axis][element]);
                        let by = circulation_by_corners(&of, &values);
                        (0..3).for_each(|i| corner_seeds[i] += by[i]);
                    }
                    change.add_corners(self.panels, &self.layout.elements, element, &corner_seeds);
                }
                self.right_vjp(seeds, &mut change);
                change
            })
            .collect())
    }

    fn target_vjp<const B: usize>(
        &self,
        index: usize,
        charges: &[Charges; B],
        seeds: &[PairSeeds<B>],
        gathered: &mut [Gathered<B>],
    ) {
        let target = Target::new(self, index);
        let tests = |seeds: &PairSeeds<B>| std::array::from_fn(|k| target.circulation(&seeds[k]));
        let none = ([Vector3::zeros(); 3], Vector3::zeros(), [0.0; 6]);
        let mut sum = Sum {
            influence: self,
            charges,
            tests: seeds.iter().map(tests).collect(),
            gathered,
            moved: vec![none; seeds.len()],
            potential: [Vector3::zeros(); B],
        };
        self.walk(&target, &mut sum);
        let Sum { moved, potential, gathered, .. } = sum;
        for (((mut corners, centroid, moments), gathered), seeds) in
            moved.into_iter().zip(gathered).zip(seeds)
        {
            let afar = target.afar_vjp(&centroid, &moments);
            (0..3).for_each(|i| corners[i] += afar[i]);
            for k in 0..B {
                let by = target.circulation_by_corners(self, &seeds[k], &potential[k]);
                (0..3).for_each(|i| corners[i] += by[i]);
            }
            target.add_corners(self, &corners, &mut gathered.change);
        }
    }

    /// The transpose of the right-hand sides' change.
    fn right_vjp<const B: usize>(&self, seeds: &PairSeeds<B>, change: &mut SurfaceChange) {
        let axes = self.panels.axes();
        for (element, record) in self.layout.elements.list.iter().enumerate() {
            let corners = &self.surface.corners[element];
            let mut of_area = Vector3::zeros();
            for (k, seed) in seeds.iter().enumerate() {
                let weight = -4.0 * PI / 3.0 * self.tests(record).iter().map(|row| seed[*row]).sum::<f64>();
                of_area += weight * self.surface.onset(axes[k]);
                change.beta += weight * area(corners).dot(&self.surface.onset_by_beta(axes[k]));
            }
            let by_corners = area_by_corners(&of_area, corners);
            change.add_corners(self.panels, &self.layout.elements, element, &by_corners);
        }
    }
}
