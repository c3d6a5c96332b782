//! The change of the residual `4 pi (A mu - b)` at fixed unknowns, for changes of the surface.

use std::f64::consts::PI;

use moldline_foundation::simd::widest;
use moldline_mesh::Vector3;
use rayon::prelude::*;

use super::{
    figure::Figure,
    records::{Charges, Influence, by_number},
    targets::Target,
    walk::{Block, Near, View, Visitor, product},
};
use crate::{
    Monitor, PanelError, Stage,
    clusters::{PATCH, Patch},
    elements::{MOST, circulation},
    progress::Progress,
    surface::{SurfaceChange, area, area_jvp},
};

/// A change of the surface in one direction, and of all that acts with it.
pub(crate) struct PairChange {
    corners: Vec<[Vector3; 3]>,
    /// Changes of the figure of the element at every place, also with one list for each number.
    far: Vec<Figure>,
    figures: [Vec<f64>; 9],
    sheets: Vec<[Vector3; 3]>,
}

/// Changes of the circulations for every onset flow.
struct ChargeChange {
    elements: Vec<Vector3>,
    /// The same of the element at every place, by axis.
    afar: [Vec<f64>; 3],
    sheets: Vec<Vector3>,
}

impl PairChange {
    fn new(influence: &Influence<'_>, change: &SurfaceChange) -> Self {
        let Influence { panels, layout, surface, .. } = influence;
        let corners: Vec<[Vector3; 3]> =
            (0..layout.elements.len()).map(|e| change.corners(panels, &layout.elements, e)).collect();
        let figure = |(element, figure): (&u32, &Figure)| {
            let element = *element as usize;
            figure.jvp(&surface.corners[element..=element], &corners[element..=element])
        };
        let far: Vec<Figure> = layout.order.iter().zip(&influence.far).map(figure).collect();
        let figures = by_number(&far);
        let sheet = |sheet: &crate::wake::SheetTriangle| {
            [0, 1, 2].map(|k: usize| {
                let corner = &sheet.corners[k];
                let at = &change.points[corner.yz as usize];
                Vector3::new(change.points[corner.ahead(&surface.points) as usize].x, at.y, at.z)
            })
        };
        Self { corners, far, figures, sheets: layout.sheets.triangles.iter().map(sheet).collect() }
    }

    fn charges(&self, influence: &Influence<'_>, charges: &Charges) -> ChargeChange {
        let layout = influence.layout;
        let elements: Vec<Vector3> = (0..layout.elements.len())
            .map(|e| circulation(&self.corners[e], &layout.element_values(e, &charges.nodes)))
            .collect();
        let sheet = |(corners, sheet): (&[Vector3; 3], &super::records::Sheet)| {
            circulation(corners, &sheet.circulations.map(|g| charges.gamma[g as usize]))
        };
        ChargeChange {
            sheets: self.sheets.iter().zip(&influence.sheets).map(sheet).collect(),
            afar: layout.afar(&elements),
            elements,
        }
    }
}

/// Sums over all that acts on one target: the potential, and its changes.
struct Sum<const B: usize> {
    /// Of elements afar, which is the same for all parts, and its slopes in two directions ...
    far: [[Vector3; B]; 3],
    d_far: Vec<[[Vector3; B]; 3]>,
    /// ... and of triangles near by.
    near: [[Vector3; B]; MOST],
    d_near: Vec<[[Vector3; B]; MOST]>,
    /// Changes of the target in all directions.
    moved: Vec<Moved>,
}

/// A change of a target: corners of the parts, figure, and directions of the slopes.
struct Moved {
    corners: Vec<[Vector3; 3]>,
    figure: Figure,
    slopes: [Vector3; 2],
}

/// The sums of a group of targets.
struct Sums<'a, const B: usize> {
    targets: &'a [Target],
    charges: &'a [Charges; B],
    changes: &'a [(PairChange, [ChargeChange; B])],
    sums: Vec<Sum<B>>,
}

impl<const B: usize> Sums<'_, B> {
    /// Adds a triangle near by. `charge`, and `changes` of every direction: of the triangle's corners, the way between the centroids, and the charge.
    fn add(
        &mut self,
        target: usize,
        view: &View,
        near: &Near,
        charge: impl Fn(usize) -> Vector3,
        changes: impl Fn(usize, &Figure) -> ([Vector3; 3], Vector3, [Vector3; B]),
    ) {
        let parts = self.targets[target].parts.len();
        let sum = &mut self.sums[target];
        let charge: [Vector3; B] = std::array::from_fn(|k| view.turned(&charge(k)));
        for part in 0..parts {
            (0..B).for_each(|k| sum.near[part][k] += near.means[part] * charge[k]);
        }
        for (direction, (Moved { corners, figure, .. }, out)) in
            sum.moved.iter().zip(&mut sum.d_near).enumerate()
        {
            let (of_source, way, d_charge) = changes(direction, figure);
            let d_charge = d_charge.map(|d| view.turned(&d));
            for part in 0..parts {
                let mut d_mean = near.by_way[part].dot(&way);
                for k in 0..3 {
                    d_mean += near.by_target[part][k].dot(&corners[part][k]);
                    d_mean += near.by_source[part][k].dot(&of_source[k]);
                }
                for k in 0..B {
                    out[part][k] += d_mean * charge[k] + near.means[part] * d_charge[k];
                }
            }
        }
    }
}

impl<const B: usize> Visitor for Sums<'_, B> {
    const GRADIENTS: bool = true;

    fn far(&mut self, target: usize, view: &View, patch: &Patch, block: &Block) {
        let charges = self.charges;
        let range = patch.places.clone();
        let means = &block.means[..block.count];
        let Sum { far, d_far, moved, .. } = &mut self.sums[target];
        widest(
            #[inline(always)]
            || {
                let slopes = view.slopes.each_ref().map(|along| block.slopes(along));
                let tests = [means, &slopes[0][..block.count], &slopes[1][..block.count]];
                let product_with = |of: &[f64], lists: &[Vec<f64>; 3]| {
                    let sums = lists.each_ref().map(|list| product(of, &list[range.clone()]));
                    view.turned(&Vector3::from(sums))
                };
                for (sums, test) in far.iter_mut().zip(tests) {
                    sums.iter_mut().zip(charges).for_each(|(sum, c)| *sum += product_with(test, &c.afar));
                }
                for ((moved, (change, d_charges)), out) in
                    moved.iter().zip(self.changes).zip(d_far.iter_mut())
                {
                    let (c, m) = (view.place(&moved.figure.centroid), &moved.figure.moments);
                    // What of the target's change adds to that of the ways and of the moments.
                    let of_target = [-c.x, -c.y, -c.z, m[0], m[1], m[2], view.y * m[3], view.y * m[4], m[5]];
                    let mut d_means = [0.0; PATCH];
                    let mut d_ways = [[0.0; PATCH]; 3];
                    for (f, figures) in change.figures.iter().enumerate() {
                        let figures = &figures[range.clone()];
                        for l in 0..block.count {
                            let d = figures[l] + of_target[f];
                            d_means[l] += block.by[f][l] * d;
                            if f < 3 {
                                d_ways[f][l] = d;
                            }
                        }
                    }
                    let d_slopes: [[f64; PATCH]; 2] = std::array::from_fn(|e| {
                        let (along, d_along) = (&view.slopes[e], view.place(&moved.slopes[e]));
                        let mut d_slopes = block.slopes(&d_along);
                        for l in 0..block.count {
                            let dot = |x: &[[f64; PATCH]; 3], y: &Vector3| {
                                x[0][l] * y.x + x[1][l] * y.y + x[2][l] * y.z
                            };
                            let d_cube = (0..3).map(|k| block.cubes_by[k][l] * d_ways[k][l]).sum::<f64>();
                            d_slopes[l] +=
                                d_cube * dot(&block.ways, along) + block.cubes[l] * dot(&d_ways, along);
                        }
                        d_slopes
                    });
                    let d_tests = [&d_means, &d_slopes[0], &d_slopes[1]].map(|list| &list[..block.count]);
                    for ((out, test), d_test) in out.iter_mut().zip(tests).zip(d_tests) {
                        for k in 0..B {
                            out[k] += product_with(d_test, &charges[k].afar)
                                + product_with(test, &d_charges[k].afar);
                        }
                    }
                }
            },
        );
    }

    fn near(&mut self, target: usize, view: &View, element: usize, place: usize, near: &Near) {
        let (charges, changes) = (self.charges, self.changes);
        let change = |direction: usize, figure: &Figure| {
            let (pairs, d_charges): &(PairChange, [ChargeChange; B]) = &changes[direction];
            let way = pairs.far[place].centroid - view.place(&figure.centroid);
            (pairs.corners[element], way, std::array::from_fn(|k| d_charges[k].elements[element]))
        };
        self.add(target, view, near, |k| charges[k].elements[element], change);
    }

    fn sheet(&mut self, target: usize, view: &View, sheet: usize, near: &Near) {
        let (charges, changes) = (self.charges, self.changes);
        let change = |direction: usize, _: &Figure| {
            let (pairs, d_charges): &(PairChange, [ChargeChange; B]) = &changes[direction];
            (pairs.sheets[sheet], Vector3::zeros(), std::array::from_fn(|k| d_charges[k].sheets[sheet]))
        };
        self.add(target, view, near, |k| charges[k].sheets[sheet], change);
    }

    fn done(&mut self, _: usize, _: &Patch) {}
}

impl Influence<'_> {
    /// The changes of the residual in several directions.
    pub fn jvp<const B: usize>(
        &self,
        charges: &[Charges; B],
        changes: &[SurfaceChange],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<[Vec<f64>; B]>, PanelError> {
        let n = self.layout.nodes.rows();
        let moved: Vec<(PairChange, [ChargeChange; B])> = changes
            .iter()
            .map(|change| {
                let pairs = PairChange::new(self, change);
                let of_charges = std::array::from_fn(|k| pairs.charges(self, &charges[k]));
                (pairs, of_charges)
            })
            .collect();
        let groups = self.groups();
        let progress = Progress::new(monitor, Stage::Derivative, groups.len());
        let parts: Vec<Vec<(u32, Vec<[f64; B]>)>> = groups
            .par_iter()
            .map(|group| {
                if progress.cancelled() {
                    return Vec::new();
                }
                let rows = self.group_jvp(group, charges, changes, &moved);
                progress.step();
                rows
            })
            .collect();
        progress.finish()?;
        let mut out: Vec<[Vec<f64>; B]> =
            changes.iter().map(|_| std::array::from_fn(|_| vec![0.0; n])).collect();
        for (row, values) in parts.iter().flatten() {
            for (out, value) in out.iter_mut().zip(values) {
                (0..B).for_each(|k| out[k][*row as usize] += value[k]);
            }
        }
        for (change, out) in changes.iter().zip(&mut out) {
            self.right_jvp(change, out);
        }
        Ok(out)
    }

    /// The rows of a group of targets with their changes in all directions.
    fn group_jvp<const B: usize>(
        &self,
        group: &[usize],
        charges: &[Charges; B],
        changes: &[SurfaceChange],
        moved: &[(PairChange, [ChargeChange; B])],
    ) -> Vec<(u32, Vec<[f64; B]>)> {
        let targets: Vec<Target> = group.iter().map(|index| Target::new(self, *index)).collect();
        let sum = |target: &Target| {
            let of_target = |change: &SurfaceChange| {
                let corners = target.corners_jvp(self, change);
                let figure = target.figure_jvp(self, change, &corners);
                Moved { corners, figure, slopes: target.slopes_jvp(self, change) }
            };
            let none = [Vector3::zeros(); B];
            Sum {
                far: [none; 3],
                d_far: vec![[none; 3]; changes.len()],
                near: [none; MOST],
                d_near: vec![[none; MOST]; changes.len()],
                moved: changes.iter().map(of_target).collect(),
            }
        };
        let mut sums =
            Sums { targets: &targets, charges, changes: moved, sums: targets.iter().map(sum).collect() };
        self.walk(&targets, &mut sums);
        let mut rows = Vec::new();
        for (target, sum) in targets.iter().zip(&sums.sums) {
            let mut values = vec![vec![[0.0; B]; changes.len()]; target.rows.len()];
            for direction in 0..changes.len() {
                let moved = &sum.moved[direction];
                for (part, of_part) in target.parts.iter().enumerate() {
                    let d_charges = target.charges_jvp(self, part, &moved.corners[part]);
                    for (row, values) in values.iter_mut().enumerate() {
                        for k in 0..B {
                            let potential =
                                target.potential(part, &sum.far.map(|f| f[k]), &sum.near[part][k]);
                            let d_far = sum.d_far[direction].map(|f| f[k]);
                            let d_potential = target.potential(part, &d_far, &sum.d_near[direction][part][k]);
                            values[direction][k] +=
                                of_part.charges[row].dot(&d_potential) + d_charges[row].dot(&potential);
                        }
                    }
                }
            }
            rows.extend(target.rows.iter().copied().zip(values));
        }
        rows
    }

    /// Subtracts the change of the right-hand sides.
    fn right_jvp<const B: usize>(&self, change: &SurfaceChange, out: &mut [Vec<f64>; B]) {
        let axes = self.panels.axes();
        let elements = &self.layout.elements;
        for (element, record) in elements.list.iter().enumerate() {
            let corners = &self.surface.corners[element];
            let d = change.corners(self.panels, elements, element);
            let d_area = area_jvp(corners, &d);
            for (k, out) in out.iter_mut().enumerate() {
                let onset = self.surface.onset(axes[k]);
                let d_onset = change.beta * self.surface.onset_by_beta(axes[k]);
                let flux = 4.0 * PI * (d_area.dot(&onset) + area(corners).dot(&d_onset));
                self.tests(record).iter().for_each(|(row, mean)| out[*row] -= mean * flux);
            }
        }
    }
}
