//! Assembly: the matrix, and the right-hand sides of unit onset flows.

use moldline_foundation::simd::widest;
use moldline_mesh::Vector3;
use rayon::prelude::*;

use super::{
    far::{FAR_SQUARED, Moments, mean, share},
    records::Influence,
    targets::{Carrier, Probes, Target},
};
use crate::{
    Monitor, PanelError, Stage,
    clusters::{PATCH, Patch},
    elements::{Element, circulation},
    lanes::Lane,
    linear_system::Matrix,
    progress::Progress,
    surface::area,
};

/// Groups of targets that are assembled before they are added to the matrix.
const GROUPS: usize = 16;

/// What of a patch's elements the loop over pairs reads, one list for each number.
struct Lanes {
    elements: Vec<usize>,
    centroid: [Vec<f64>; 3],
    moments: [Vec<f64>; 6],
    reach: Vec<f64>,
    /// Circulations for unit values at the corners of the elements.
    charges: Vec<[[f64; 3]; 3]>,
    /// Their nodes, as places among the patch's.
    columns: Vec<[u32; 3]>,
}

impl Lanes {
    fn new(influence: &Influence<'_>, patch: &Patch) -> Self {
        let list = &influence.layout.elements;
        let elements: Vec<usize> = patch.panels.iter().flat_map(|p| list.of(*p as usize)).collect();
        let source = |e: &usize| &influence.sources[*e];
        let columns = patch
            .panels
            .iter()
            .zip(&patch.places)
            .flat_map(|(panel, places)| list.of(*panel as usize).map(|e| list.list[e].of_corners(places)))
            .collect();
        let charges = |e: &usize| {
            let corners = &influence.surface.corners[*e];
            [0, 1, 2].map(|k| {
                circulation(corners, &std::array::from_fn(|j| if j == k { 1.0 } else { 0.0 })).into()
            })
        };
        Self {
            centroid: [0, 1, 2].map(|k| elements.iter().map(|e| source(e).centroid[k]).collect()),
            moments: [0, 1, 2, 3, 4, 5].map(|k| elements.iter().map(|e| source(e).moments[k]).collect()),
            reach: elements.iter().map(|e| influence.layout.reach[*e]).collect(),
            charges: elements.iter().map(charges).collect(),
            elements,
            columns,
        }
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
        Self { y, centroid: [c.x, y * c.y, c.z], moments: [s[0], s[1], s[2], y * s[3], y * s[4], s[5]] }
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

/// The mean over probes.
fn mean_over(probes: &Probes, means: &Lane) -> f64 {
    means.iter().zip(&probes.weights).map(|(mean, weight)| mean * weight).sum()
}

impl Influence<'_> {
    /// The matrix and the right-hand sides, both times `4 pi`.
    ///
    /// # Errors
    /// [`PanelError::Singular`] if an influence is not finite; cancelled.
    pub fn assemble<const B: usize>(
        &self,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<(Matrix, [Vec<f64>; B]), PanelError> {
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
                    let block = self.block(targets, &lanes, &progress);
                    if !progress.cancelled() {
                        progress.step();
                    }
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
        let elements =
            |patch: &Patch| patch.panels.iter().flat_map(|p| layout.elements.of(*p as usize)).collect();
        let lines: Vec<usize> = (layout.elements.len()..Target::count(self)).collect();
        layout.patches.iter().map(elements).chain(lines.chunks(4 * PATCH).map(<[usize]>::to_vec)).collect()
    }

    /// The rows that a group of targets adds to; nothing once it is cancelled.
    fn block(&self, targets: &[usize], lanes: &[Lanes], progress: &Progress<'_>) -> (Vec<u32>, Vec<f64>) {
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
                if progress.cancelled() {
                    return (Vec::new(), Vec::new());
                }
                sums.clear();
                sums.resize(3 * columns, 0.0);
                self.potential(target, lanes, columns, &mut sums);
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

    /// Adds the mean vector potential at a target, times `4 pi`, for unit values at the columns of a patch: x, then y, then z of all.
    fn potential(&self, target: &Target, lanes: &Lanes, columns: usize, sums: &mut [f64]) {
        let count = lanes.elements.len();
        let mut means = [0.0; 2 * PATCH];
        let mut distances = [0.0; 2 * PATCH];
        for &y in self.views() {
            let view = View::new(target, y);
            let [cx, cy, cz] = lanes.centroid.each_ref().map(|c| &c[..count]);
            let moments = lanes.moments.each_ref().map(|m| &m[..count]);
            widest(
                #[inline(always)]
                || {
                    let (means, distances) = (&mut means[..count], &mut distances[..count]);
                    for l in 0..count {
                        let d =
                            [cx[l] - view.centroid[0], cy[l] - view.centroid[1], cz[l] - view.centroid[2]];
                        let s: Moments = std::array::from_fn(|k| moments[k][l] + view.moments[k]);
                        means[l] = mean(d, &s);
                        distances[l] = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
                    }
                },
            );
            for l in 0..count {
                let reach = lanes.reach[l] + target.reach;
                if distances[l] < FAR_SQUARED * reach * reach {
                    let d = Vector3::from_fn(|k, _| lanes.centroid[k][l] - view.centroid[k]);
                    let (far, _) = share(&d, reach);
                    let afar = if far > 0.0 { far * means[l] } else { 0.0 };
                    means[l] = afar + (1.0 - far) * self.near_mean(target, &view, lanes.elements[l]);
                }
            }
            let (x, rest) = sums.split_at_mut(columns);
            let (of_y, z) = rest.split_at_mut(columns);
            for ((mean, charges), places) in means.iter().zip(&lanes.charges).zip(&lanes.columns) {
                for (charge, place) in charges.iter().zip(places) {
                    let place = *place as usize;
                    x[place] += y * mean * charge[0];
                    of_y[place] += mean * charge[1];
                    z[place] += y * mean * charge[2];
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
        mean_over(&target.probes, &triangle.means(&target.places(view), on))
    }

    /// The mean vector potential at a target, times `4 pi`, for unit circulations at the corners of the wakes.
    fn wake_potential(&self, target: &Target, gamma: &mut [Vector3]) {
        gamma.fill(Vector3::zeros());
        for &y in self.views() {
            let view = View::new(target, y);
            let places = target.places(&view);
            for (index, sheet) in
                self.sheets.iter().enumerate().filter(|(_, sheet)| !sheet.triangle.is_empty())
            {
                let on = if y > 0.0 { target.on_sheet(self, index) } else { None };
                let mean = mean_over(&target.probes, &sheet.triangle.means(&places, on));
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
                self.tests(record).iter().for_each(|row| b[*row] += flux);
            }
        }
        right
    }

    /// The unknowns whose test functions are 1 at the corners of an element.
    pub(super) fn tests(&self, element: &Element) -> [usize; 3] {
        let nodes = &self.layout.nodes;
        element.of_corners(&nodes.of_corner[element.panel as usize]).map(|n| nodes.row[n as usize] as usize)
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
