//! Points hashed by the cube they lie in, to find neighbours within a small radius.

use std::collections::HashMap;

/// Finds the points within a radius of at most the cubes' size.
pub(crate) struct HashGrid {
    size: f64,
    cubes: HashMap<[i64; 3], Vec<u32>>,
}

impl HashGrid {
    /// An empty grid for queries up to `radius`, for coordinates up to `extent`.
    pub(crate) fn new(radius: f64, extent: f64) -> Self {
        // Cubes far smaller than the coordinates' rounding would overflow the integers that number them.
        Self { size: radius.max(1e-15 * extent).max(f64::MIN_POSITIVE), cubes: HashMap::new() }
    }

    pub(crate) fn insert(&mut self, x: &[f64; 3], index: u32) {
        self.cubes.entry(self.cube(x)).or_default().push(index);
    }

    /// The inserted point nearest to `x` within `radius`, the smallest index of equally near ones.
    pub(crate) fn nearest(&self, x: &[f64; 3], radius: f64, positions: &[[f64; 3]]) -> Option<u32> {
        let [i, j, k] = self.cube(x);
        let mut best: Option<(f64, u32)> = None;
        let around = |i: i64| i.saturating_sub(1)..=i.saturating_add(1);
        for cube in around(i).flat_map(|i| around(j).flat_map(move |j| around(k).map(move |k| [i, j, k]))) {
            for &index in self.cubes.get(&cube).into_iter().flatten() {
                let y = &positions[index as usize];
                let distance = (0..3).map(|axis| (x[axis] - y[axis]).powi(2)).sum::<f64>().sqrt();
                let candidate = (distance, index);
                if distance <= radius && best.is_none_or(|best| candidate < best) {
                    best = Some(candidate);
                }
            }
        }
        best.map(|(_, index)| index)
    }

    fn cube(&self, x: &[f64; 3]) -> [i64; 3] {
        x.map(|x| (x / self.size).floor() as i64)
    }
}
