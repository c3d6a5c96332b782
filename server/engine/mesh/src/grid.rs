//! A spatial hash: points by the cube that contains them, to find neighbours within a small radius.

use std::collections::HashMap;

/// Side of the cubes in radii: large enough that a ball seldom meets several, small enough that few points share one.
const SIDE: f64 = 4.0;

/// Finds the points within a radius.
pub(crate) struct HashGrid {
    radius: f64,
    size: f64,
    cubes: HashMap<[i64; 3], Vec<u32>>,
}

impl HashGrid {
    /// An empty grid for queries within `radius`, for coordinates up to `extent`.
    pub(crate) fn new(radius: f64, extent: f64) -> Self {
        // Numbers of cubes far smaller than the coordinates' rounding would overflow.
        let size = SIDE * radius.max(1e-15 * extent).max(f64::MIN_POSITIVE);
        Self { radius, size, cubes: HashMap::new() }
    }

    pub(crate) fn insert(&mut self, x: &[f64; 3], index: u32) {
        self.cubes.entry(x.map(|x| self.cube(x))).or_default().push(index);
    }

    /// The inserted point nearest to `x` within the radius, the smallest index of equally near ones.
    pub(crate) fn nearest(&self, x: &[f64; 3], positions: &[[f64; 3]]) -> Option<u32> {
        // Slightly more than the radius, for the rounding of distances.
        let reach = 1.0001 * self.radius;
        // Less than the side of a cube, so at most two cubes in each direction.
        let [i, j, k] = x.map(|x| {
            let first = self.cube(x - reach);
            first..=self.cube(x + reach).clamp(first, first.saturating_add(1))
        });
        let mut best: Option<(f64, u32)> = None;
        let cubes = i.flat_map(|i| {
            let k = k.clone();
            j.clone().flat_map(move |j| k.clone().map(move |k| [i, j, k]))
        });
        for cube in cubes {
            for &index in self.cubes.get(&cube).into_iter().flatten() {
                let y = &positions[index as usize];
                let distance = (0..3).map(|axis| (x[axis] - y[axis]).powi(2)).sum::<f64>().sqrt();
                let candidate = (distance, index);
                if distance <= self.radius && best.is_none_or(|best| candidate < best) {
                    best = Some(candidate);
                }
            }
        }
        best.map(|(_, index)| index)
    }

    fn cube(&self, x: f64) -> i64 {
        (x / self.size).floor() as i64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_what_a_search_through_all_points_finds() {
        // Points on a lattice of half a radius, so that many lie at equal distances and on the cubes' borders.
        for (scale, radius) in
            [(1.0, 1.0), (1e-100, 1e-100), (1e8, 3e8), (0.25 * f64::MAX, 0.2 * f64::MAX), (1.0, 0.0)]
        {
            let at = |k: i32| f64::from(k - 3) * 0.5 * scale;
            let positions: Vec<[f64; 3]> = (0..343).map(|i| [at(i % 7), at(i / 7 % 7), at(i / 49)]).collect();
            let extent = 1.5 * scale;
            let mut grid = HashGrid::new(radius, extent);
            for (index, x) in (0..).zip(&positions).filter(|(index, _)| index % 3 != 1) {
                grid.insert(x, index);
            }
            for x in positions.iter().map(|x| x.map(|x| 1.01 * x)).chain(positions.iter().copied()) {
                let distance = |y: &[f64; 3]| {
                    let squares: f64 = (0..3).map(|axis| (x[axis] - y[axis]).powi(2)).sum();
                    squares.sqrt()
                };
                let all = (0u32..).zip(&positions).filter(|(index, _)| index % 3 != 1);
                let near =
                    all.map(|(index, y)| (distance(y), index)).filter(|(distance, _)| *distance <= radius);
                let expected = near.min_by(|a, b| a.partial_cmp(b).unwrap()).map(|(_, index)| index);
                assert_eq!(grid.nearest(&x, &positions), expected, "{x:?} within {radius}");
            }
        }
    }
}
