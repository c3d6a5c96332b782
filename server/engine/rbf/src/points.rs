//! Points as a structure of arrays.

use crate::{LANES, Vector3};

/// Scaled points, one array for each coordinate, padded with zeros to whole lanes.
#[derive(Clone, Debug)]
pub(crate) struct Points {
    coordinates: [Vec<f64>; 3],
    count: usize,
}

impl Points {
    pub fn new(points: &[Vector3]) -> Self {
        let padded = points.len().next_multiple_of(LANES);
        let coordinates = std::array::from_fn(|axis| {
            let mut values: Vec<f64> = points.iter().map(|p| p[axis]).collect();
            values.resize(padded, 0.0);
            values
        });
        Self { coordinates, count: points.len() }
    }

    /// Number of points.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Length of each array.
    pub fn padded(&self) -> usize {
        self.coordinates[0].len()
    }

    /// The arrays in whole lanes.
    #[inline(always)]
    pub fn lanes(&self) -> [&[[f64; LANES]]; 3] {
        self.coordinates.each_ref().map(|c| c.as_chunks::<LANES>().0)
    }

    #[inline(always)]
    pub fn get(&self, i: usize) -> Vector3 {
        Vector3::new(self.coordinates[0][i], self.coordinates[1][i], self.coordinates[2][i])
    }

    pub fn to_vectors(&self) -> Vec<Vector3> {
        (0..self.count).map(|i| self.get(i)).collect()
    }
}

/// The bounding box: lowest and highest coordinates.
pub(crate) fn bounds(points: &[Vector3]) -> (Vector3, Vector3) {
    let start = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    points.iter().fold(start, |(low, high), p| (low.inf(p), high.sup(p)))
}

/// Index of the point nearest to point `i`, and their distance.
pub(crate) fn nearest(points: &[Vector3], i: usize) -> (usize, f64) {
    let others = (0..points.len()).filter(|&j| j != i).map(|j| (j, (points[j] - points[i]).norm()));
    others.fold((i, f64::INFINITY), |best, next| if next.1 < best.1 { next } else { best })
}
