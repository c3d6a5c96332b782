//! Coefficients of interpolants.

use crate::{Block, points::Points, sum::Sums};

/// Weights and affine parts of a number of interpolants (columns) over the same centres; or seeds of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Coefficients {
    pub(crate) leading: Part,
    /// What the leading part is rounded by; with the cubic kernel only.
    pub(crate) remainder: Option<Part>,
}

impl Coefficients {
    /// From rows for the affine functions and rows for the centres.
    pub(crate) fn from_rows(affine: Sums, rows: Sums, centres: &Points) -> Self {
        let part = |affine: Block, rows: &Block| Part::from_rows(affine, rows, centres.padded());
        let remainder = affine.remainder.zip(rows.remainder);
        Self {
            leading: part(affine.leading, &rows.leading),
            remainder: remainder.map(|(affine, rows)| part(affine, &rows)),
        }
    }

    /// Number of interpolants.
    pub fn columns(&self) -> usize {
        self.leading.columns()
    }

    /// The weights of one column in double precision, a number for each centre, padded with zeros.
    pub fn weights(&self, column: usize) -> &[f64] {
        self.leading.weights_of(column)
    }
}

/// Numbers for the centres and for the affine functions.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Part {
    /// `w_j`, column after column, each padded to whole lanes with zeros.
    pub weights: Vec<f64>,
    /// Rows 1, x, y, z in scaled coordinates, one number for each column.
    pub affine: Block,
}

impl Part {
    pub fn columns(&self) -> usize {
        self.affine.width()
    }

    pub fn weights_of(&self, column: usize) -> &[f64] {
        let padded = self.weights.len() / self.columns();
        &self.weights[column * padded..(column + 1) * padded]
    }

    /// The largest absolute weight of each column.
    pub fn largest_weights(&self) -> impl Iterator<Item = f64> {
        (0..self.columns()).map(|column| largest(self.weights_of(column)))
    }

    pub fn numbers(&self) -> impl Iterator<Item = &f64> {
        self.weights.iter().chain(self.affine.data())
    }

    pub fn numbers_mut(&mut self) -> impl Iterator<Item = &mut f64> {
        self.weights.iter_mut().chain(self.affine.data_mut())
    }

    /// From rows: a row for each centre.
    pub fn from_rows(affine: Block, rows: &Block, padded: usize) -> Self {
        let columns = rows.width();
        let mut weights = vec![0.0; padded * columns];
        for i in 0..rows.data().len() / columns.max(1) {
            for (column, value) in rows.row(i).iter().enumerate() {
                weights[column * padded + i] = *value;
            }
        }
        Self { weights, affine }
    }

    /// The first `count` weights of each column, a row for each weight.
    pub fn rows(&self, count: usize) -> Block {
        let mut rows = Block::zeros(count, self.columns());
        for column in 0..self.columns() {
            let weights = self.weights_of(column);
            (0..count).for_each(|i| rows.row_mut(i)[column] = weights[i]);
        }
        rows
    }
}

/// The largest absolute value.
pub(crate) fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |largest, x| x.abs().max(largest))
}
