//! Assembly: the matrix, and the right-hand sides of unit onset flows.

use moldline_foundation::simd::widest;
use moldline_mesh::Vector3;
use rayon::prelude::*;

use super::{
    far::{FAR_SQUARED, Moments, mean, share},
    records::Influence,
    targets::{Carrier, Target},
};
use crate::{
    Monitor, PanelError, Stage,
    clusters::{PATCH, Patch},
    elements::{Weights, circulation},
    linear_system::Matrix,
    progress::Progress,
    surface::area,
};

/// Groups of targets that are assembled before they are added to the matrix.
const GROUPS: usize = 16;

/// What of a patch's panels the loop over pairs reads, in lanes.
struct Lanes {
    centroid: [[f64; PATCH]; 3],
    moments: [[f64; PATCH]; 6],
    reach: [f64; PATCH],
    /// Charges of the corners.
    charges: Vec<[[f64; 3]; 4]>,
}

impl Lanes {
    fn new(influence: &Influence<'_>, patch: &Patch) -> Self {
        let mut lanes = Self {
            centroid: [[f64::MAX.sqrt() * 1e-3; PATCH]; 3],
            moments: [[0.0; PATCH]; 6],
            reach: [0.0; PATCH],
            charges: Vec::with_capacity(patch.panels.len()),
        };
        for (l, &panel) in patch.panels.iter().enumerate() {
            let source = &influence.sources[panel as usize];
            (0..3).for_each(|k| lanes.centroid[k][l] = source.centroid[k]);
            (0..6).for_each(|k| lanes.moments[k][l] = source.moments[k]);
            lanes.reach[l] = influence.layout.reach[panel as usize];
            lanes.charges.push(source.charges.map(Into::into));
        }
        lanes
    }
}

/// A target as it is seen from one side: the surface's, or its image's.
pub(super) struct View {
    /// -1 for the image.
    pub y: f64,
    pub centroid: [f64; 3],
    pub moments: Moments,
}

impl View {
    pub fn new(target: &Target, y: f64) -> Self {
        let (c, s) = (&target.centroid, &target.moments);
        Self {
            y,
            centroid: [c.x, y * c.y, c.z],
            moments: [s[0], s[1], s[2], y * s[3], y * s[4], s[5]],
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

impl Influence<'_> {
    /// The matrix and the right-hand sides, both times `4 pi`.
    ///
    /// # Errors
    /// [`PanelError::Singular`] if an influence is not finite; cancelled.
    pub fn assemble<const B: usize>(&self, monitor: &dyn Monitor<Stage>) -> Result<(Matrix, [Vec<f64>; B]), PanelError> {
        let n = self.layout.nodes.rows();
        let mut matrix = Matrix::zeros(n);
        let lanes: Vec<Lanes> = self.layout.patches.iter().map(|patch| Lanes::new(self, patch)).collect();
        let groups = self.groups();
        let progress = Progress::new(monitor, Stage::Influence, groups.len());
        for wave in groups.chunks(GROUPS) {
            let blocks: Vec<(Vec<u32>, Vec<f64>)> = wave
                .par_iter()
                .map(|targets| {
                    if progress.cancelled() {
                        return (Vec::new(), Vec::new());
                    }
                    let block = self.block(targets, &lanes);
                    progress.step();
                    block
                })
                .collect();
            for (rows, block) in &blocks {
                for (row, values) in rows.iter().zip(block.chunks(n)) {
                    matrix.row_mut(*row as usize).iter_mut().zip(values).for_each(|(m, v)| *m += v);
                }
            }
        }
        progress.finish()?;
        let right = self.right();
        if let Some(row) = (0..n).find(|row| !matrix.row_mut(*row).iter().sum::<f64>().is_finite()) {
            let point = self.layout.nodes.row_point[row];
            let panel = self.panels.corners.iter().position(|corners| corners.contains(&point)).unwrap_or(0);
            return Err(PanelError::Singular { cell: self.panels.cell_of[panel] });
        }
        self.fix_constants(&mut matrix);
        Ok((matrix, right))
    }

    /// Targets that are handled together: the elements of a patch, or some points of lines.
    pub(super) fn groups(&self) -> Vec<Vec<usize>> {
        let layout = self.layout;
        let elements = |patch: &Patch| patch.panels.iter().flat_map(|p| layout.elements.of(*p as usize)).collect();
        let lines: Vec<usize> = (layout.elements.len()..Target::count(self)).collect();
        layout.patches.iter().map(elements).chain(lines.chunks(4 * PATCH).map(<[usize]>::to_vec)).collect()
    }

    /// The rows that a group of targets adds to.
    fn block(&self, targets: &[usize], lanes: &[Lanes]) -> (Vec<u32>, Vec<f64>) {
        let n = self.layout.nodes.rows();
        let targets: Vec<Target> = targets.iter().map(|t| Target::new(self, *t)).collect();
        let mut rows: Vec<u32> = targets.iter().flat_map(|t| t.rows.iter().map(|(row, _)| *row)).collect();
        rows.sort_unstable();
        rows.dedup();
        let place = |row: u32| rows.partition_point(|r| *r < row);
        let mut block = vec![0.0; rows.len() * n];
        let mut part = Vec::new();
        let mut sums = Vec::new();
        for (patch, lanes) in self.layout.patches.iter().zip(lanes) {
            let columns = patch.nodes.len();
            part.clear();
            part.resize(rows.len() * columns, 0.0);
            for target in &targets {
                sums.clear();
                sums.resize(3 * columns, 0.0);
                self.potential(target, patch, lanes, &mut sums);
                for (row, charge) in &target.rows {
                    let first = place(*row) * columns;
                    let out = &mut part[first..first + columns];
                    let (x, rest) = sums.split_at(columns);
                    let (y, z) = rest.split_at(columns);
                    widest(
                        #[inline(always)]
                        || {
                            for (((out, x), y), z) in out.iter_mut().zip(x).zip(y).zip(z) {
                                *out += charge.x * x + charge.y * y + charge.z * z;
                            }
                        },
                    );
                }
            }
            for (values, out) in part.chunks(columns).zip(block.chunks_mut(n)) {
                for (value, node) in values.iter().zip(&patch.nodes) {
                    for (unknown, factor) in &self.layout.nodes.value[*node as usize] {
                        out[*unknown as usize] += factor * value;
                    }
                }
            }
        }
        let mut gamma = vec![Vector3::zeros(); self.layout.sheets.circulations.len()];
        for target in &targets {
            self.wake_potential(target, &mut gamma);
            for (row, charge) in &target.rows {
                let first = place(*row) * n;
                let out = &mut block[first..first + n];
                for (potential, terms) in gamma.iter().zip(&self.layout.sheets.circulations) {
                    let value = charge.dot(potential);
                    terms.iter().for_each(|(unknown, factor)| out[*unknown as usize] += factor * value);
                }
            }
        }
        (rows, block)
    }

    /// Adds the mean vector potential at a target, times `4 pi`, for unit values at the nodes of a patch: x, then y, then z of all.
    fn potential(&self, target: &Target, patch: &Patch, lanes: &Lanes, sums: &mut [f64]) {
        let columns = patch.nodes.len();
        for &y in self.views() {
            let view = View::new(target, y);
            let mut means = [0.0; PATCH];
            let mut distances = [0.0; PATCH];
            widest(
                #[inline(always)]
                || {
                    for l in 0..PATCH {
                        let d: [f64; 3] = std::array::from_fn(|k| lanes.centroid[k][l] - view.centroid[k]);
                        let s: Moments = std::array::from_fn(|k| lanes.moments[k][l] + view.moments[k]);
                        means[l] = mean(d, &s);
                        distances[l] = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
                    }
                },
            );
            let turned = [y, 1.0, y];
            for (l, charges) in lanes.charges.iter().enumerate() {
                let reach = lanes.reach[l] + target.reach;
                let places = &patch.places[l];
                if distances[l] < FAR_SQUARED * reach * reach {
                    let panel = patch.panels[l] as usize;
                    let d = Vector3::from_fn(|k, _| lanes.centroid[k][l] - view.centroid[k]);
                    let (far, _) = share(&d, reach);
                    if far > 0.0 { means[l] *= far } else { means[l] = 0.0 }
                    self.near_potential(target, &view, panel, places, 1.0 - far, columns, sums);
                }
                for (charge, place) in charges.iter().zip(places) {
                    for k in 0..3 {
                        sums[k * columns + *place as usize] += turned[k] * means[l] * charge[k];
                    }
                }
            }
        }
    }

    /// Adds what the elements of a panel near by add.
    fn near_potential(
        &self,
        target: &Target,
        view: &View,
        panel: usize,
        places: &[u32; 4],
        factor: f64,
        columns: usize,
        sums: &mut [f64],
    ) {
        for element in self.layout.elements.of(panel) {
            let mean = factor * self.near_mean(target, view, element);
            let weights: Weights = self.layout.elements.list[element].weights();
            let corners = &self.surface.corners[element];
            for k in 0..3 {
                let unit: [f64; 3] = std::array::from_fn(|j| if j == k { 1.0 } else { 0.0 });
                let charge = mean * view.turned(&circulation(corners, &unit));
                for (place, weight) in places.iter().zip(weights[k]) {
                    for axis in 0..3 {
                        sums[axis * columns + *place as usize] += weight * charge[axis];
                    }
                }
            }
        }
    }

    /// The mean inverse distance between a target and an element near by.
    fn near_mean(&self, target: &Target, view: &View, element: usize) -> f64 {
        let triangle = &self.triangles[element];
        if target.carrier == Carrier::Element(element) && view.y > 0.0 {
            return triangle.own_mean_with_gradient().0;
        }
        let on = if view.y > 0.0 { target.on_side(self, element) } else { None };
        let (probes, count) = target.probes();
        let at = |weights: &[f64; 3]| -> Vector3 { (0..3).map(|k| weights[k] * target.corners[k]).sum() };
        probes[..count].iter().map(|w| triangle.mean(&view.place(&at(w)), on)).sum::<f64>() / count as f64
    }

    /// The mean vector potential at a target, times `4 pi`, for unit circulations at the corners of the wakes.
    fn wake_potential(&self, target: &Target, gamma: &mut [Vector3]) {
        gamma.fill(Vector3::zeros());
        let (probes, count) = target.probes();
        for (index, sheet) in self.sheets.iter().enumerate() {
            for &y in self.views() {
                let view = View::new(target, y);
                let on = if y > 0.0 { target.on_sheet(self, index) } else { None };
                let mut mean = 0.0;
                for weights in &probes[..count] {
                    let x = (0..3).map(|k| weights[k] * target.corners[k]).sum();
                    mean += sheet.triangle.mean(&view.place(&x), on) / count as f64;
                }
                for k in 0..3 {
                    let unit: [f64; 3] = std::array::from_fn(|j| if j == k { 1.0 } else { 0.0 });
                    let charge = view.turned(&circulation(&sheet.triangle.corners, &unit));
                    gamma[sheet.circulations[k] as usize] += mean * charge;
                }
            }
        }
    }

    /// `4 pi integral w n.V' dS` for every unit onset flow.
    fn right<const B: usize>(&self) -> [Vec<f64>; B] {
        let axes = self.panels.axes();
        let mut right: [Vec<f64>; B] = std::array::from_fn(|_| vec![0.0; self.layout.nodes.rows()]);
        for (element, record) in self.layout.elements.list.iter().enumerate() {
            let vector = area(&self.surface.corners[element]);
            for (k, b) in right.iter_mut().enumerate() {
                let flux = 4.0 * std::f64::consts::PI / 3.0 * vector.dot(&self.surface.onset(axes[k]));
                self.each_test(record, |row, weight| b[row] += weight * flux);
            }
        }
        right
    }

    /// Calls back with the unknowns of an element's panel and the sum of their test functions at its corners.
    pub(super) fn each_test(&self, element: &crate::elements::Element, mut each: impl FnMut(usize, f64)) {
        let nodes = self.layout.nodes.of_corner[element.panel as usize];
        let weights = element.weights();
        for (i, node) in nodes.iter().enumerate() {
            let weight = weights[0][i] + weights[1][i] + weights[2][i];
            if weight > 0.0 {
                each(self.layout.nodes.row[*node as usize] as usize, weight);
            }
        }
    }

    /// Adds what fixes the mean of the potential of every connected piece, which nothing else depends on: `s 1 1^T` over its unknowns, s being the
    /// mean of the diagonal over their number.
    fn fix_constants(&self, matrix: &mut Matrix) {
        let pieces = &self.layout.pieces;
        let count = pieces.iter().max().map_or(0, |p| *p as usize + 1);
        let mut members = vec![Vec::new(); count];
        for (row, piece) in pieces.iter().enumerate() {
            members[*piece as usize].push(row);
        }
        for members in members {
            let size = members.len() as f64;
            let diagonal: f64 = members.iter().map(|row| matrix.row_mut(*row)[*row]).sum();
            let s = diagonal / (size * size);
            for row in &members {
                let entries = matrix.row_mut(*row);
                members.iter().for_each(|column| entries[*column] += s);
            }
        }
    }
}
