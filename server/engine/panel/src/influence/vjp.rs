//! The transpose of the change of the residual: gradients of weighted sums of it with respect to the surface.

use std::f64::consts::PI;

use moldline_mesh::Vector3;
use rayon::prelude::*;

use super::{
    assembly::View,
    far::Moments,
    records::{Charges, Influence, plane_figure_vjp},
    targets::Target,
    walk::{Near, Visitor},
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

/// Seeds of an element as it acts from afar.
#[derive(Clone)]
struct SourceSeeds<const B: usize> {
    centroid: Vector3,
    moments: Moments,
    charges: [Vector3; B],
}

/// What a group of targets adds to one adjoint.
struct Gathered<const B: usize> {
    change: SurfaceChange,
    sources: Vec<SourceSeeds<B>>,
}

impl<const B: usize> Gathered<B> {
    fn new(influence: &Influence<'_>) -> Self {
        let none =
            SourceSeeds { centroid: Vector3::zeros(), moments: [0.0; 6], charges: [Vector3::zeros(); B] };
        Self { change: SurfaceChange::zeros(influence.surface), sources: vec![none; influence.sources.len()] }
    }

    fn add(&mut self, other: &Self) {
        self.change.beta += other.change.beta;
        self.change.points.iter_mut().zip(&other.change.points).for_each(|(a, b)| *a += b);
        for (a, b) in self.sources.iter_mut().zip(&other.sources) {
            a.centroid += b.centroid;
            (0..6).for_each(|k| a.moments[k] += b.moments[k]);
            (0..B).for_each(|k| a.charges[k] += b.charges[k]);
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
fn product<const B: usize>(
    view: &View,
    tests: &[Vector3; B],
    charge: impl Fn(usize) -> Vector3,
) -> (f64, [Vector3; B]) {
    let turned: [Vector3; B] = std::array::from_fn(|k| view.turned(&tests[k]));
    ((0..B).map(|k| turned[k].dot(&charge(k))).sum(), turned)
}

impl<const B: usize> Visitor for Sum<'_, B> {
    fn far(&mut self, view: &View, element: usize, mean: f64, by_way: &Vector3, by_moments: &Moments) {
        let charges = self.charges;
        for k in 0..B {
            self.potential[k] += mean * view.turned(&charges[k].elements[element]);
        }
        let m = by_moments;
        let seen = [m[0], m[1], m[2], view.y * m[3], view.y * m[4], m[5]];
        for ((tests, gathered), moved) in self.tests.iter().zip(self.gathered.iter_mut()).zip(&mut self.moved)
        {
            let (weight, turned) = product(view, tests, |k| charges[k].elements[element]);
            let of_source = &mut gathered.sources[element];
            of_source.centroid += weight * by_way;
            moved.1 -= weight * view.place(by_way);
            for k in 0..6 {
                of_source.moments[k] += weight * m[k];
                moved.2[k] += weight * seen[k];
            }
            (0..B).for_each(|k| of_source.charges[k] += mean * turned[k]);
        }
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
            let (weight, turned) = product(view, tests, |k| charges[k].elements[element]);
            gathered.sources[element].centroid += weight * by_way;
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
            let (weight, turned) = product(view, tests, |k| charges[k].sheets[sheet]);
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
                    if !progress.cancelled() {
                        group
                            .iter()
                            .for_each(|target| self.target_vjp(*target, charges, seeds, &mut gathered));
                        progress.step();
                    }
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
                let Gathered { mut change, sources } = gathered;
                for (element, of) in sources.iter().enumerate() {
                    let corners = &self.surface.corners[element];
                    let afar = (&of.centroid, &of.moments);
                    let mut corner_seeds = plane_figure_vjp(corners, &self.sources[element].centroid, afar);
                    for k in 0..B {
                        let values = self.layout.element_values(element, &charges[k].nodes);
                        let by = circulation_by_corners(&of.charges[k], &values);
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
