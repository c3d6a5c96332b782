//! The triangles of the panels, on which the potential is linear.
//!
//! A triangular panel is one element. A quadrilateral is two, cut along its shorter diagonal at the set-up's positions. If both are equally long, the one
//! through the aftmost corner is taken, or the outermost of two: so the upper and the lower side of a symmetric wing are cut alike, and both halves of
//! an aircraft.

use moldline_mesh::Vector3;

use crate::panels::Panels;

/// Lengths that differ by less than this part are equal.
const EQUAL: f64 = 1e-6;

/// An element.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Element {
    pub panel: u32,
    /// Its corners among those of the panel.
    places: [u8; 3],
}

impl Element {
    /// Its corners among those of the panel.
    pub fn places(&self) -> [usize; 3] {
        self.places.map(usize::from)
    }

    /// What belongs to its corners, from what belongs to the panel's.
    pub fn of_corners<T: Copy>(&self, panel: &[T; 4]) -> [T; 3] {
        self.places().map(|k| panel[k])
    }

    /// The side of the element that is the panel's side from corner `k` to corner `next`, if one is.
    pub fn side_of(&self, k: usize, next: usize) -> Option<usize> {
        let places = self.places();
        (0..3).find(|&side| places[side] == k && places[(side + 1) % 3] == next)
    }
}

/// All elements, panel after panel.
#[derive(Clone, Debug, Default)]
pub(crate) struct Elements {
    pub list: Vec<Element>,
    /// The first element of every panel, and their number.
    first: Vec<u32>,
}

impl Elements {
    /// `points` are the set-up's.
    pub fn new(panels: &Panels, points: &[Vector3]) -> Self {
        let mut elements = Self::default();
        for panel in 0..panels.len() {
            elements.first.push(elements.list.len() as u32);
            let places: &[[u8; 3]] = if panels.is_triangle(panel) {
                &[[0, 1, 2]]
            } else if cut_from_first(&panels.corners[panel].map(|p| points[p as usize])) {
                &[[0, 1, 2], [0, 2, 3]]
            } else {
                &[[1, 2, 3], [1, 3, 0]]
            };
            elements
                .list
                .extend(places.iter().map(|places| Element { panel: panel as u32, places: *places }));
        }
        elements.first.push(elements.list.len() as u32);
        elements
    }

    /// The elements of a panel.
    pub fn of(&self, panel: usize) -> std::ops::Range<usize> {
        self.first[panel] as usize..self.first[panel + 1] as usize
    }

    pub fn len(&self) -> usize {
        self.list.len()
    }
}

/// Whether a quadrilateral is cut from its first corner to its third.
fn cut_from_first(corners: &[Vector3; 4]) -> bool {
    let (one, two) = ((corners[2] - corners[0]).norm(), (corners[3] - corners[1]).norm());
    if (one - two).abs() > EQUAL * one.max(two) {
        return one < two;
    }
    let size = EQUAL * one;
    let before = |a: &Vector3, b: &Vector3| {
        if (a.x - b.x).abs() > size { a.x < b.x } else { a.y.abs() < b.y.abs() - size }
    };
    let mut last = 0;
    for k in 1..4 {
        if before(&corners[last], &corners[k]) {
            last = k;
        }
    }
    last % 2 == 0
}

/// Area times `n x gradient` of values at the corners of a triangle: the integral of the vortex sheet, `-1/2 sum_k value_k (edge opposite to k)`.
pub(crate) fn circulation(corners: &[Vector3; 3], values: &[f64; 3]) -> Vector3 {
    (0..3).map(|k| -0.5 * values[k] * (corners[(k + 2) % 3] - corners[(k + 1) % 3])).sum()
}

/// The gradient of `of.circulation` with respect to the corners.
pub(crate) fn circulation_by_corners(of: &Vector3, values: &[f64; 3]) -> [Vector3; 3] {
    let mut gradient = [Vector3::zeros(); 3];
    for k in 0..3 {
        let g = -0.5 * values[k] * of;
        gradient[(k + 2) % 3] += g;
        gradient[(k + 1) % 3] -= g;
    }
    gradient
}

/// The gradient of `of.circulation` with respect to the values.
pub(crate) fn circulation_by_values(of: &Vector3, corners: &[Vector3; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k: usize| -0.5 * of.dot(&(corners[(k + 2) % 3] - corners[(k + 1) % 3])))
}
