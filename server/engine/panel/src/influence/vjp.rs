//! The transpose of the change of the residual: gradients of weighted sums of it with respect to the surface.

use std::f64::consts::PI;

use moldline_foundation::simd::widest;
use moldline_mesh::Vector3;
use rayon::prelude::*;

use super::{
    figure::Figure,
    records::{Charges, Influence},
    targets::{self, Target},
    walk::{Block, Near, View, Visitor, fold, product},
};
use crate::{
    Monitor, PanelError, Stage,
    clusters::{PATCH, Patch},
    elements::{MOST, circulation_by_corners},
    lanes::{LANES, Lane},
    progress::Progress,
    surface::{SurfaceChange, area, area_by_corners},
};

/// Sums of seeds that are kept beside each other, each over a part of the targets: so many threads can work, and so much memory is taken.
const SUMS: usize = 32;

/// Weights of the residual: for every unknown, for every onset flow.
pub(crate) type PairSeeds<const B: usize> = [Vec<f64>; B];

/// Seeds of triangles that act: their corners, and their circulations for every onset flow.
struct OfTriangles<const B: usize> {
    corners: Vec<[Vector3; 3]>,
    charges: Vec<[Vector3; B]>,
}

impl<const B: usize> OfTriangles<B> {
    fn new(count: usize) -> Self {
        Self { corners: vec![[Vector3::zeros(); 3]; count], charges: vec![[Vector3::zeros(); B]; count] }
    }

    fn add(&mut self, other: &Self) {
        let of_corners = self.corners.iter_mut().flatten().zip(other.corners.iter().flatten());
        of_corners.for_each(|(a, b)| *a += b);
        let of_charges = self.charges.iter_mut().flatten().zip(other.charges.iter().flatten());
        of_charges.for_each(|(a, b)| *a += b);
    }

    /// Seeds of a triangle's corners, those by its circulations included. `values` are the potentials at its corners.
    fn corner_seeds(&self, triangle: usize, values: impl Fn(usize) -> [f64; 3]) -> [Vector3; 3] {
        let mut seeds = self.corners[triangle];
        for (k, of_charge) in self.charges[triangle].iter().enumerate() {
            let by = circulation_by_corners(of_charge, &values(k));
            (0..3).for_each(|i| seeds[i] += by[i]);
        }
        seeds
    }
}

/// What targets add to one adjoint.
struct Gathered<const B: usize> {
    change: SurfaceChange,
    /// Seeds of the element at every place as it acts from afar, one list for each number: centroid, moments ...
    figures: [Vec<f64>; 9],
    /// ... and circulations, by axis.
    charges: [[Vec<f64>; 3]; B],
    elements: OfTriangles<B>,
    sheets: OfTriangles<B>,
}

impl<const B: usize> Gathered<B> {
    fn new(influence: &Influence<'_>) -> Self {
        let none = || vec![0.0; influence.far.len()];
        Self {
            change: SurfaceChange::zeros(influence.surface),
            figures: std::array::from_fn(|_| none()),
            charges: std::array::from_fn(|_| std::array::from_fn(|_| none())),
            elements: OfTriangles::new(influence.triangles.len()),
            sheets: OfTriangles::new(influence.sheets.len()),
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
        self.elements.add(&other.elements);
        self.sheets.add(&other.sheets);
    }

    /// All as seeds of the surface.
    fn finish(self, influence: &Influence<'_>, charges: &[Charges; B]) -> SurfaceChange {
        let Influence { panels, layout, surface, .. } = influence;
        let Self { mut change, figures, charges: afar, mut elements, sheets } = self;
        for (place, (element, figure)) in layout.order.iter().zip(&influence.far).enumerate() {
            let element = *element as usize;
            let seeds = Figure {
                centroid: Vector3::from_fn(|axis, _| figures[axis][place]),
                moments: std::array::from_fn(|k| figures[3 + k][place]),
            };
            let of_corners = &mut elements.corners[element..=element];
            figure.vjp(&surface.corners[element..=element], &seeds, of_corners);
            for (of_charge, afar) in elements.charges[element].iter_mut().zip(&afar) {
                *of_charge += Vector3::from_fn(|axis, _| afar[axis][place]);
            }
        }
        for element in 0..layout.elements.len() {
            let seeds = elements.corner_seeds(element, |k| layout.element_values(element, &charges[k].nodes));
            change.add_corners(panels, &layout.elements, element, &seeds);
        }
        for (index, sheet) in influence.sheets.iter().enumerate() {
            let values = |k: usize| sheet.circulations.map(|g| charges[k].gamma[g as usize]);
            let seeds = sheets.corner_seeds(index, values);
            for (corner, seed) in layout.sheets.triangles[index].corners.iter().zip(&seeds) {
                change.points[corner.ahead(&surface.points) as usize].x += seed.x;
                change.points[corner.yz as usize].y += seed.y;
                change.points[corner.yz as usize].z += seed.z;
            }
        }
        change
    }
}

/// The circulation of a target's test functions weighted by one adjoint, and the seeds of the target.
struct Weighted<const B: usize> {
    /// Afar: on the whole, and moments in two directions.
    far: [targets::Charges; B],
    parts: [[Vector3; B]; MOST],
    corners: [[Vector3; 3]; MOST],
    centroid: Vector3,
    /// Of what is afar, lane by lane: centroid and moments, and the directions of the slopes.
    figure: [Lane; 9],
    slopes: [[Lane; 3]; 2],
}

/// The sum over lanes.
fn total(lane: &Lane) -> f64 {
    lane.iter().sum()
}

/// Sums over all that acts on one target.
struct Sum<const B: usize> {
    weighted: Vec<Weighted<B>>,
    /// The potential of elements afar with its slopes, and at the parts that of triangles near by.
    far: [[Vector3; 3]; B],
    near: [[Vector3; B]; MOST],
}

/// The sums of a group of targets.
struct Sums<'a, const B: usize> {
    targets: &'a [Target],
    charges: &'a [Charges; B],
    gathered: &'a mut [Gathered<B>],
    sums: Vec<Sum<B>>,
}

impl<const B: usize> Sums<'_, B> {
    /// Adds a triangle near by with its charge; returns for every adjoint the seed of the way between the centroids.
    fn add(
        &mut self,
        target: usize,
        view: &View,
        near: &Near,
        charge: [Vector3; B],
        of: impl Fn(&mut Gathered<B>) -> (&mut [Vector3; 3], &mut [Vector3; B]),
        mut by_way: impl FnMut(&mut Gathered<B>, &Vector3),
    ) {
        let parts = self.targets[target].parts.len();
        let Sum { weighted, near: potential, .. } = &mut self.sums[target];
        let turned = charge.map(|c| view.turned(&c));
        for part in 0..parts {
            (0..B).for_each(|k| potential[part][k] += near.means[part] * turned[k]);
        }
        for (weighted, gathered) in weighted.iter_mut().zip(self.gathered.iter_mut()) {
            let mut way = Vector3::zeros();
            let (corners, charges) = of(gathered);
            for part in 0..parts {
                let tests = &weighted.parts[part];
                let mut weight = 0.0;
                for k in 0..B {
                    weight += tests[k].dot(&turned[k]);
                    charges[k] += near.means[part] * view.turned(&tests[k]);
                }
                for i in 0..3 {
                    corners[i] += weight * near.by_source[part][i];
                    weighted.corners[part][i] += weight * near.by_target[part][i];
                }
                way += weight * near.by_way[part];
            }
            weighted.centroid -= view.place(&way);
            by_way(gathered, &way);
        }
    }
}

impl<const B: usize> Visitor for Sums<'_, B> {
    const GRADIENTS: bool = true;

    fn far(&mut self, target: usize, view: &View, patch: &Patch, block: &Block) {
        let charges = self.charges;
        let range = patch.places.clone();
        let means = &block.means[..block.count];
        let Sum { weighted, far, .. } = &mut self.sums[target];
        widest(
            #[inline(always)]
            || {
                let slopes = view.slopes.each_ref().map(|along| block.slopes(along));
                let tests = [means, &slopes[0][..block.count], &slopes[1][..block.count]];
                for (sums, charge) in far.iter_mut().zip(charges) {
                    for (sum, test) in sums.iter_mut().zip(tests) {
                        let sums = charge.afar.each_ref().map(|list| product(test, &list[range.clone()]));
                        *sum += view.turned(&Vector3::from(sums));
                    }
                }
                for (weighted, gathered) in weighted.iter_mut().zip(self.gathered.iter_mut()) {
                    // Seeds of the means and of the slopes.
                    let mut seeds = [[0.0; PATCH]; 3];
                    for (k, charges_) in weighted.far.iter().enumerate() {
                        let [whole, p, q] = charges_.each_ref().map(|charge| view.turned(charge));
                        for axis in 0..3 {
                            let charges = &charges[k].afar[axis][range.clone()];
                            let of_charges = &mut gathered.charges[k][axis][range.clone()];
                            for l in 0..block.count {
                                seeds[0][l] += whole[axis] * charges[l];
                                seeds[1][l] += p[axis] * charges[l];
                                seeds[2][l] += q[axis] * charges[l];
                                of_charges[l] +=
                                    whole[axis] * means[l] + p[axis] * slopes[0][l] + q[axis] * slopes[1][l];
                            }
                        }
                    }
                    // With W = sum of seeds and directions the slopes are W.d times the cube.
                    let [p, q] = &view.slopes;
                    let mut ways = [[0.0; PATCH]; 3];
                    let mut lengths = [0.0; PATCH];
                    for axis in 0..3 {
                        for l in 0..block.count {
                            let w = seeds[1][l] * p[axis] + seeds[2][l] * q[axis];
                            ways[axis][l] = block.cubes[l] * w;
                            lengths[l] += w * block.ways[axis][l];
                        }
                    }
                    // The target's centroid is at the other end of the ways; its image moves with it.
                    let y = view.y;
                    let signs = [-1.0, -y, -1.0, 1.0, 1.0, 1.0, y, y, 1.0];
                    for (f, figures) in gathered.figures.iter_mut().enumerate() {
                        let figures = &mut figures[range.clone()];
                        let mut of_figure = [0.0; PATCH];
                        for l in 0..block.count {
                            of_figure[l] = seeds[0][l] * block.by[f][l];
                        }
                        if f < 3 {
                            for l in 0..block.count {
                                of_figure[l] += ways[f][l] + lengths[l] * block.cubes_by[f][l];
                            }
                        }
                        for l in 0..block.count {
                            figures[l] += of_figure[l];
                            of_figure[l] *= signs[f];
                        }
                        fold(&of_figure, &mut weighted.figure[f]);
                    }
                    for (seeds, sums) in seeds[1..].iter().zip(&mut weighted.slopes) {
                        for (axis, sums) in sums.iter_mut().enumerate() {
                            let sign = if axis == 1 { y } else { 1.0 };
                            let mut by = [0.0; PATCH];
                            for l in 0..block.count {
                                by[l] = sign * seeds[l] * block.cubes[l] * block.ways[axis][l];
                            }
                            fold(&by, sums);
                        }
                    }
                }
            },
        );
    }

    fn near(&mut self, target: usize, view: &View, element: usize, place: usize, near: &Near) {
        let charge = self.charges.each_ref().map(|charges| charges.elements[element]);
        self.add(
            target,
            view,
            near,
            charge,
            |gathered| (&mut gathered.elements.corners[element], &mut gathered.elements.charges[element]),
            |gathered, way| (0..3).for_each(|axis| gathered.figures[axis][place] += way[axis]),
        );
    }

    fn sheet(&mut self, target: usize, view: &View, sheet: usize, near: &Near) {
        let charge = self.charges.each_ref().map(|charges| charges.sheets[sheet]);
        self.add(
            target,
            view,
            near,
            charge,
            |gathered| (&mut gathered.sheets.corners[sheet], &mut gathered.sheets.charges[sheet]),
            |_, _| {},
        );
    }

    fn done(&mut self, _: usize, _: &Patch) {}
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
        let none = || -> Vec<Gathered<B>> { seeds.iter().map(|_| Gathered::new(self)).collect() };
        // The same division for any number of threads, so that sums have one order.
        let several = (SUMS / seeds.len().max(1)).max(2);
        let parts: Vec<Vec<Gathered<B>>> = groups
            .par_chunks(groups.len().div_ceil(several))
            .map(|groups| {
                let mut gathered = none();
                for group in groups.iter().take_while(|_| !progress.cancelled()) {
                    self.group_vjp(group, charges, seeds, &mut gathered);
                    progress.step();
                }
                gathered
            })
            .collect();
        progress.finish()?;
        let mut total = none();
        for part in &parts {
            total.iter_mut().zip(part).for_each(|(sum, part)| sum.add(part));
        }
        let finish = |(gathered, seeds): (Gathered<B>, &PairSeeds<B>)| {
            let mut change = gathered.finish(self, charges);
            self.right_vjp(seeds, &mut change);
            change
        };
        Ok(total.into_iter().zip(seeds).map(finish).collect())
    }

    fn group_vjp<const B: usize>(
        &self,
        group: &[usize],
        charges: &[Charges; B],
        seeds: &[PairSeeds<B>],
        gathered: &mut [Gathered<B>],
    ) {
        let targets: Vec<Target> = group.iter().map(|index| Target::new(self, *index)).collect();
        let sum = |target: &Target| {
            let weighted = |seeds: &PairSeeds<B>| {
                let circulations = seeds.each_ref().map(|seeds| target.circulations(seeds));
                Weighted {
                    far: circulations.each_ref().map(|of_parts| target.gathered(of_parts)),
                    parts: std::array::from_fn(|part| circulations.map(|parts| parts[part])),
                    corners: [[Vector3::zeros(); 3]; MOST],
                    centroid: Vector3::zeros(),
                    figure: [[0.0; LANES]; 9],
                    slopes: [[[0.0; LANES]; 3]; 2],
                }
            };
            let none = [Vector3::zeros(); B];
            Sum {
                weighted: seeds.iter().map(weighted).collect(),
                far: [[Vector3::zeros(); 3]; B],
                near: [none; MOST],
            }
        };
        let sums = targets.iter().map(sum).collect();
        let mut sums = Sums { targets: &targets, charges, gathered, sums };
        self.walk(&targets, &mut sums);
        let Sums { sums, gathered, .. } = sums;
        for (target, Sum { weighted, far, near }) in targets.iter().zip(sums) {
            for ((weighted, gathered), seeds) in weighted.into_iter().zip(gathered.iter_mut()).zip(seeds) {
                let Weighted { mut corners, centroid, figure, slopes, .. } = weighted;
                let [x, y, z, moments @ ..] = figure.map(|lane| total(&lane));
                let figure = Figure { centroid: centroid + Vector3::new(x, y, z), moments };
                let slopes = slopes.map(|[x, y, z]| Vector3::new(total(&x), total(&y), total(&z)));
                let corners = &mut corners[..target.parts.len()];
                target.figure_vjp(self, &figure, corners, &mut gathered.change);
                target.slopes_vjp(self, &slopes, &mut gathered.change);
                for (part, corners) in corners.iter_mut().enumerate() {
                    for k in 0..B {
                        let potential = target.potential(part, &far[k], &near[part][k]);
                        let by = target.circulation_by_corners(self, part, &seeds[k], &potential);
                        (0..3).for_each(|i| corners[i] += by[i]);
                    }
                }
                target.add_corners(self, corners, &mut gathered.change);
            }
        }
    }

    /// The transpose of the right-hand sides' change.
    fn right_vjp<const B: usize>(&self, seeds: &PairSeeds<B>, change: &mut SurfaceChange) {
        let axes = self.panels.axes();
        for (element, record) in self.layout.elements.list.iter().enumerate() {
            let corners = &self.surface.corners[element];
            let mut of_area = Vector3::zeros();
            for (k, seed) in seeds.iter().enumerate() {
                let tested: f64 = self.tests(record).iter().map(|(row, mean)| mean * seed[*row]).sum();
                let weight = -4.0 * PI * tested;
                of_area += weight * self.surface.onset(axes[k]);
                change.beta += weight * area(corners).dot(&self.surface.onset_by_beta(axes[k]));
            }
            let by_corners = area_by_corners(&of_area, corners);
            change.add_corners(self.panels, &self.layout.elements, element, &by_corners);
        }
    }
}
