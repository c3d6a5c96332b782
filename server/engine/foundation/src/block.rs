//! Tangents and seeds of several directions at once.

use crate::Vector3;

/// A matrix with a row of `width` numbers for each item, row after row.
///
/// Tangents and seeds of `k` directions are blocks whose rows hold the vectors of direction 0, 1, ..., `k - 1` one after
/// the other, so that a product with a matrix entry runs over contiguous numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    width: usize,
    data: Vec<f64>,
}

impl Block {
    /// `count` rows of `width` zeros.
    pub fn zeros(count: usize, width: usize) -> Self {
        Self { width, data: vec![0.0; count * width] }
    }

    /// Numbers per row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Directions, if every item is a vector in space.
    pub fn directions(&self) -> usize {
        self.width / 3
    }

    /// A row.
    #[inline]
    pub fn row(&self, item: usize) -> &[f64] {
        &self.data[item * self.width..(item + 1) * self.width]
    }

    /// A mutable row.
    #[inline]
    pub fn row_mut(&mut self, item: usize) -> &mut [f64] {
        &mut self.data[item * self.width..(item + 1) * self.width]
    }

    /// All numbers.
    pub fn data(&self) -> &[f64] {
        &self.data
    }

    /// All numbers, mutable.
    pub fn data_mut(&mut self) -> &mut [f64] {
        &mut self.data
    }

    /// The vector of an item in one direction.
    #[inline]
    pub fn vector(&self, item: usize, direction: usize) -> Vector3 {
        vector(self.row(item), direction)
    }

    /// Adds another block of the same shape.
    pub fn add(&mut self, other: &Self) {
        debug_assert_eq!(self.data.len(), other.data.len());
        self.data.iter_mut().zip(&other.data).for_each(|(a, b)| *a += b);
    }
}

/// The vector of one direction in a row.
#[inline]
pub fn vector(row: &[f64], direction: usize) -> Vector3 {
    Vector3::new(row[3 * direction], row[3 * direction + 1], row[3 * direction + 2])
}

/// Adds a vector to that of one direction in a row.
#[inline]
pub fn add_vector(row: &mut [f64], direction: usize, v: &Vector3) {
    for axis in 0..3 {
        row[3 * direction + axis] += v[axis];
    }
}

/// `to += factor * from`.
#[inline]
pub fn add_row(to: &mut [f64], factor: f64, from: &[f64]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += factor * from);
}
