//! Assembly: the matrix, and the right-hand sides of unit onset flows.

use moldline_foundation::simd::widest;
use rayon::prelude::*;

use super::{
    records::Influence,
    targets::Target,
    walk::{Block, Near, View, Visitor},
};
use crate::{
    Monitor, PanelError, Stage,
    clusters::{PATCH, Patch},
    elements::Element,
    linear_system::Matrix,
    progress::Progress,
    surface::area,
};

/// Groups of targets that are assembled before they are added to the matrix.
const GROUPS: usize = 16;

/// What a row tests, for the elements of a patch, by axis.
type Tested = [[f64; PATCH]; 3];

/// The rows to which a group of targets adds.
struct Rows<'a> {
    influence: &'a Influence<'a>,
    targets: &'a [Target],
    /// Unknowns of the test functions.
    rows: Vec<u32>,
    /// Where every target adds: indices of `rows`.
    indices: Vec<[usize; 4]>,
    /// Entries of all rows for the nodes, and for the circulations at the wakes' corners.
    nodes: Vec<f64>,
    gamma: Vec<f64>,
    /// The sum over the views, for every row of a target.
    tested: [Tested; 4],
}

impl<'a> Rows<'a> {
    fn new(influence: &'a Influence<'a>, targets: &'a [Target]) -> Self {
        let mut rows: Vec<u32> = targets.iter().flat_map(|t| t.rows.iter().copied()).collect();
        rows.sort_unstable();
        rows.dedup();
        let index = |row: &u32| rows.partition_point(|r| r < row);
        let of_target = |target: &Target| {
            let mut indices = [0; 4];
            indices.iter_mut().zip(&target.rows).for_each(|(i, row)| *i = index(row));
            indices
        };
        let indices = targets.iter().map(of_target).collect();
        let nodes = vec![0.0; rows.len() * influence.layout.nodes.value.len()];
        let gamma = vec![0.0; rows.len() * influence.layout.sheets.circulations.len()];
        Self { influence, targets, rows, indices, nodes, gamma, tested: [[[0.0; PATCH]; 3]; 4] }
    }

    /// The rows with their entries for all unknowns.
    fn finish(self) -> (Vec<u32>, Vec<f64>) {
        let layout = self.influence.layout;
        let n = layout.nodes.rows();
        let mut out = vec![0.0; self.rows.len() * n];
        for (row, out) in out.chunks_mut(n).enumerate() {
            for (values, combinations) in
                [(&self.nodes, &layout.nodes.value), (&self.gamma, &layout.sheets.circulations)]
            {
                let of_row = &values[row * combinations.len()..][..combinations.len()];
                for (value, terms) in of_row.iter().zip(combinations) {
                    terms.iter().for_each(|(unknown, factor)| out[*unknown as usize] += factor * value);
                }
            }
        }
        (self.rows, out)
    }
}

impl Visitor for Rows<'_> {
    const GRADIENTS: bool = false;

    fn far(&mut self, target: usize, view: &View, _: &Patch, block: &Block) {
        let charges = &self.targets[target].charges;
        let tested = &mut self.tested;
        widest(
            #[inline(always)]
            || {
                let [along_p, along_q] = view.slopes.each_ref().map(|along| block.slopes(along));
                for (charges, out) in charges.iter().zip(tested.iter_mut()) {
                    let [whole, p, q] = charges.each_ref().map(|charge| view.turned(charge));
                    for (axis, out) in out.iter_mut().enumerate() {
                        for l in 0..PATCH {
                            out[l] +=
                                whole[axis] * block.means[l] + p[axis] * along_p[l] + q[axis] * along_q[l];
                        }
                    }
                }
            },
        );
    }

    fn near(&mut self, target: usize, view: &View, element: usize, _: usize, near: &Near) {
        let Self { influence, targets, .. } = *self;
        let layout = influence.layout;
        let nodes = &layout.nodes.of_corner[layout.elements.list[element].panel as usize];
        let units = influence.units[element].map(|unit| view.turned(&unit));
        let width = layout.nodes.value.len();
        let (indices, target) = (&self.indices[target], &targets[target]);
        for (k, index) in indices.iter().enumerate().take(target.rows.len()) {
            let charge = target.charge(k, &near.means);
            let out = &mut self.nodes[index * width..][..width];
            nodes.iter().zip(&units).for_each(|(node, unit)| out[*node as usize] += charge.dot(unit));
        }
    }

    fn sheet(&mut self, target: usize, view: &View, sheet: usize, near: &Near) {
        let Self { influence, targets, .. } = *self;
        let sheet = &influence.sheets[sheet];
        let units = sheet.units.map(|unit| view.turned(&unit));
        let width = influence.layout.sheets.circulations.len();
        let (indices, target) = (&self.indices[target], &targets[target]);
        for (k, index) in indices.iter().enumerate().take(target.rows.len()) {
            let charge = target.charge(k, &near.means);
            let out = &mut self.gamma[index * width..][..width];
            sheet.circulations.iter().zip(&units).for_each(|(g, unit)| out[*g as usize] += charge.dot(unit));
        }
    }

    fn done(&mut self, target: usize, patch: &Patch) {
        let influence = self.influence;
        let count = patch.places.len();
        let width = influence.layout.nodes.value.len();
        let units = influence.unit_charges.each_ref().map(|u| u.each_ref().map(|u| &u[patch.places.clone()]));
        for ((index, _), [x, y, z]) in
            self.indices[target].iter().zip(&self.targets[target].rows).zip(&mut self.tested)
        {
            let mut values = [[0.0; PATCH]; 4];
            widest(
                #[inline(always)]
                || {
                    for (values, units) in values.iter_mut().zip(&units) {
                        for l in 0..count {
                            values[l] = x[l] * units[0][l] + y[l] * units[1][l] + z[l] * units[2][l];
                        }
                    }
                },
            );
            let out = &mut self.nodes[index * width..][..width];
            for (l, columns) in patch.corners.iter().enumerate() {
                let columns = columns.map(|column| patch.nodes[column as usize] as usize);
                columns.iter().zip(&values).for_each(|(column, values)| out[*column] += values[l]);
            }
            [x, y, z].iter_mut().for_each(|list| list.fill(0.0));
        }
    }
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
        let groups = self.groups();
        let progress = Progress::new(monitor, Stage::Influence, groups.len());
        for wave in groups.chunks(GROUPS) {
            let blocks: Vec<(Vec<u32>, Vec<f64>)> = wave
                .par_iter()
                .map(|group| {
                    if progress.cancelled() {
                        return (Vec::new(), Vec::new());
                    }
                    let targets: Vec<Target> = group.iter().map(|index| Target::new(self, *index)).collect();
                    let mut rows = Rows::new(self, &targets);
                    self.walk(&targets, &mut rows);
                    progress.step();
                    rows.finish()
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

    /// `4 pi integral w n.V' dS` for every unit onset flow.
    fn right<const B: usize>(&self) -> [Vec<f64>; B] {
        let axes = self.panels.axes();
        let mut right: [Vec<f64>; B] = std::array::from_fn(|_| vec![0.0; self.layout.nodes.rows()]);
        for (element, record) in self.layout.elements.list.iter().enumerate() {
            let vector = area(&self.surface.corners[element]);
            for (k, b) in right.iter_mut().enumerate() {
                let flux = 4.0 * std::f64::consts::PI * vector.dot(&self.surface.onset(axes[k]));
                self.tests(record).iter().for_each(|(row, mean)| b[*row] += mean * flux);
            }
        }
        right
    }

    /// The unknowns of a panel, and the means of their test functions over an element.
    pub(super) fn tests(&self, element: &Element) -> [(usize, f64); 4] {
        let nodes = &self.layout.nodes;
        let means = element.corner_seeds(&[1.0 / 3.0; 3]);
        std::array::from_fn(|k| {
            (nodes.row[nodes.of_corner[element.panel as usize][k] as usize] as usize, means[k])
        })
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
