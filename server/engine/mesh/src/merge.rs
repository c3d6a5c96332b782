//! Merging of vertices that are near one another.

use crate::{Cell, area_vector, grid::HashGrid};

/// Largest share of a mesh's area that may vanish with the cells that collapse.
pub const LARGEST_LOSS: f64 = 1e-3;

/// For each vertex the one that it becomes: the nearest earlier one that stays within `tolerance` (m), or itself.
pub fn near(vertices: &[[f64; 3]], tolerance: f64) -> Vec<u32> {
    let extent = vertices.iter().flatten().fold(0.0, |extent: f64, x| extent.max(x.abs()));
    let mut grid = HashGrid::new(tolerance, extent);
    let target = |(vertex, x): (u32, &[f64; 3])| {
        grid.nearest(x, vertices).unwrap_or_else(|| {
            grid.insert(x, vertex);
            vertex
        })
    };
    (0..).zip(vertices).map(target).collect()
}

/// A cell whose vertices may have become equal: a quadrilateral with one side gone is a triangle; `None` if no area is left.
pub fn collapse(cell: &Cell) -> Option<Cell> {
    let mut corners = cell.vertices().to_vec();
    corners.dedup();
    if corners.len() > 1 && corners.first() == corners.last() {
        corners.pop();
    }
    match corners[..] {
        [a, b, c] if a != c => Some(Cell::triangle(a, b, c)),
        [a, b, c, d] if a != c && b != d => Some(Cell::quad(a, b, c, d)),
        _ => None,
    }
}

/// The share of the cells' area that those have which collapse; 0 for a surface without area.
pub fn loss(vertices: &[[f64; 3]], cells: &[Cell], collapses: impl Iterator<Item = bool>) -> f64 {
    let (mut lost, mut all) = (0.0, 0.0);
    for (cell, collapses) in cells.iter().zip(collapses) {
        let area = area_vector(vertices, cell).norm();
        all += area;
        if collapses {
            lost += area;
        }
    }
    if lost > 0.0 { lost / all } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quadrilaterals_become_triangles_or_nothing() {
        let quad = |a, b, c, d| collapse(&Cell::quad(a, b, c, d));
        assert_eq!(quad(0, 1, 2, 3), Some(Cell::quad(0, 1, 2, 3)));
        assert_eq!(quad(0, 0, 2, 3), Some(Cell::triangle(0, 2, 3)));
        assert_eq!(quad(0, 1, 2, 0), Some(Cell::triangle(0, 1, 2)));
        assert_eq!([quad(0, 1, 0, 3), quad(0, 1, 2, 1), quad(0, 0, 1, 1), quad(0, 1, 1, 0)], [None; 4]);
        assert_eq!(collapse(&Cell::triangle(0, 1, 0)), None);
        assert_eq!(collapse(&Cell::triangle(0, 1, 2)), Some(Cell::triangle(0, 1, 2)));
    }
}
