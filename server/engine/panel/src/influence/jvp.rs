//! The change of the residual `4 pi (A mu - b)` at fixed unknowns, for changes of the surface.

use std::f64::consts::PI;

use moldline_foundation::simd::widest;
use moldline_mesh::Vector3;
use rayon::prelude::*;

use super::{
    assembly::View,
    far::Moments,
    records::{Charges, Influence, by_axis, plane_figure_jvp},
    targets::Target,
    walk::{BLOCK, Block, Near, Visitor, product},
};
use crate::{
    Monitor, PanelError, Stage,
    elements::circulation,
    progress::Progress,
    surface::{SurfaceChange, area, area_jvp},
};

/// A change of the surface in one direction, and of all that acts with it.
pub(crate) struct PairChange {
    corners: Vec<[Vector3; 3]>,
    centroids: Vec<Vector3>,
    /// Changes of centroids and moments, one list for each number.
    figures: [Vec<f64>; 9],
    sheets: Vec<[Vector3; 3]>,
}

/// Changes of the circulations for every onset flow.
struct ChargeChange {
    elements: Vec<Vector3>,
    /// The same by axis.
    afar: [Vec<f64>; 3],
    sheets: Vec<Vector3>,
}

impl PairChange {
    fn new(influence: &Influence<'_>, change: &SurfaceChange) -> Self {
        let Influence { panels, layout, surface, sources, .. } = influence;
        let corners: Vec<[Vector3; 3]> =
            (0..layout.elements.len()).map(|e| change.corners(panels, &layout.elements, e)).collect();
        let (centroids, of_moments): (Vec<Vector3>, Vec<Moments>) = (0..layout.elements.len())
            .map(|e| plane_figure_jvp(&surface.corners[e], &sources[e].centroid, &corners[e]))
            .unzip();
        let figures = std::array::from_fn(|f| {
            if f < 3 {
                centroids.iter().map(|c| c[f]).collect()
            } else {
                of_moments.iter().map(|m| m[f - 3]).collect()
            }
        });
        let sheet = |sheet: &crate::wake::SheetTriangle| {
            [0, 1, 2].map(|k: usize| {
                let corner = &sheet.corners[k];
                let at = &change.points[corner.yz as usize];
                Vector3::new(change.points[corner.ahead(&surface.points) as usize].x, at.y, at.z)
            })
        };
        Self { corners, centroids, figures, sheets: layout.sheets.triangles.iter().map(sheet).collect() }
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
            afar: by_axis(&elements),
            elements,
        }
    }
}

/// Sums over all that acts on one target: the potential, and its changes.
struct Sum<'a, const B: usize> {
    charges: &'a [Charges; B],
    changes: &'a [(PairChange, [ChargeChange; B])],
    /// Changes of the target: corners, centroid and moments.
    moved: Vec<([Vector3; 3], Vector3, Moments)>,
    potential: [Vector3; B],
    d_potential: Vec<[Vector3; B]>,
}

impl<const B: usize> Sum<'_, B> {
    fn add(&mut self, view: &View, mean: f64, charge: impl Fn(usize) -> Vector3) {
        for k in 0..B {
            self.potential[k] += mean * view.turned(&charge(k));
        }
    }
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
                let each = self.moved.iter().zip(self.changes).zip(&mut self.d_potential);
                for (((_, centroid, m), (change, d_charges)), out) in each {
                    let c = view.place(centroid);
                    // What of the target's change adds to that of the ways and of the moments.
                    let of_target = [-c.x, -c.y, -c.z, m[0], m[1], m[2], view.y * m[3], view.y * m[4], m[5]];
                    let mut d_means = [0.0; BLOCK];
                    for ((by, figures), of_target) in block.by.iter().zip(&change.figures).zip(of_target) {
                        let each = d_means.iter_mut().zip(by).zip(&figures[range.clone()]);
                        each.for_each(|((d, by), figure)| *d += by * (figure + of_target));
                    }
                    let d_means = &d_means[..block.count];
                    for k in 0..B {
                        let sums: [f64; 3] = std::array::from_fn(|axis| {
                            product(d_means, &charges[k].afar[axis][range.clone()])
                                + product(means, &d_charges[k].afar[axis][range.clone()])
                        });
                        out[k] += view.turned(&Vector3::from(sums));
                    }
                }
            },
        );
    }

    fn near(&mut self, view: &View, element: usize, near: &Near, by_way: &Vector3) {
        let charges = self.charges;
        self.add(view, near.mean, |k| charges[k].elements[element]);
        for ((moved, (change, d_charges)), out) in
            self.moved.iter().zip(self.changes).zip(&mut self.d_potential)
        {
            let (corners, centroid, _) = moved;
            let mut d_mean = by_way.dot(&(change.centroids[element] - view.place(centroid)));
            for k in 0..3 {
                d_mean +=
                    near.by_target[k].dot(&corners[k]) + near.by_source[k].dot(&change.corners[element][k]);
            }
            for k in 0..B {
                let d = d_mean * charges[k].elements[element] + near.mean * d_charges[k].elements[element];
                out[k] += view.turned(&d);
            }
        }
    }

    fn sheet(&mut self, view: &View, sheet: usize, near: &Near) {
        let charges = self.charges;
        self.add(view, near.mean, |k| charges[k].sheets[sheet]);
        for ((moved, (change, d_charges)), out) in
            self.moved.iter().zip(self.changes).zip(&mut self.d_potential)
        {
            let mut d_mean = 0.0;
            for k in 0..3 {
                d_mean +=
                    near.by_target[k].dot(&moved.0[k]) + near.by_source[k].dot(&change.sheets[sheet][k]);
            }
            for k in 0..B {
                let d = d_mean * charges[k].sheets[sheet] + near.mean * d_charges[k].sheets[sheet];
                out[k] += view.turned(&d);
            }
        }
    }
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
                let mut rows = Vec::new();
                for target in group {
                    if progress.cancelled() {
                        return Vec::new();
                    }
                    rows.extend(self.target_jvp(*target, charges, changes, &moved));
                }
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

    /// The rows of a target with their changes in all directions.
    fn target_jvp<const B: usize>(
        &self,
        index: usize,
        charges: &[Charges; B],
        changes: &[SurfaceChange],
        moved: &[(PairChange, [ChargeChange; B])],
    ) -> Vec<(u32, Vec<[f64; B]>)> {
        let target = Target::new(self, index);
        let corners: Vec<[Vector3; 3]> =
            changes.iter().map(|change| target.corners_jvp(self, change)).collect();
        let of_target = |corners: &[Vector3; 3]| {
            let (centroid, moments) = target.afar_jvp(corners);
            (*corners, centroid, moments)
        };
        let mut sum = Sum {
            charges,
            changes: moved,
            moved: corners.iter().map(of_target).collect(),
            potential: [Vector3::zeros(); B],
            d_potential: vec![[Vector3::zeros(); B]; changes.len()],
        };
        self.walk(&target, &mut sum);
        let d_rows: Vec<Vec<(u32, Vector3)>> = corners.iter().map(|c| target.rows_jvp(self, c)).collect();
        let row = |(place, (row, charge)): (usize, &(u32, Vector3))| {
            let value = |direction: usize| {
                let d_charge = &d_rows[direction][place].1;
                std::array::from_fn(|k| {
                    charge.dot(&sum.d_potential[direction][k]) + d_charge.dot(&sum.potential[k])
                })
            };
            (*row, (0..changes.len()).map(value).collect())
        };
        target.rows.iter().enumerate().map(row).collect()
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
                let flux = 4.0 * PI / 3.0 * (d_area.dot(&onset) + area(corners).dot(&d_onset));
                self.tests(record).iter().for_each(|row| out[*row] -= flux);
            }
        }
    }
}
