//! The triangles of the panels, on which the potential is linear.
//!
//! A triangular panel is one element. A quadrilateral is four, around the mean of its corners, where the potential is the mean of theirs: no
//! diagonal is preferred, and a warped one is a continuous surface.

use moldline_mesh::Vector3;

use crate::panels::Panels;

/// Weights of a panel's corners at the three corners of an element.
pub(crate) type Weights = [[f64; 4]; 3];

/// An element.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Element {
    pub panel: u32,
    /// The side of a quadrilateral from which it reaches to the middle; 4 for a triangular panel.
    side: u8,
}

impl Element {
    /// The corners of the element, as weights of the panel's.
    pub fn weights(&self) -> Weights {
        let corner = |k: usize| std::array::from_fn(|i| if i == k { 1.0 } else { 0.0 });
        match self.side {
            4 => [corner(0), corner(1), corner(2)],
            side => [corner(usize::from(side)), corner((usize::from(side) + 1) % 4), [0.25; 4]],
        }
    }

    /// Its corners as those of the panel; none for a quadrilateral's middle.
    pub fn places(&self) -> [Option<usize>; 3] {
        match usize::from(self.side) {
            4 => [Some(0), Some(1), Some(2)],
            side => [Some(side), Some((side + 1) % 4), None],
        }
    }

    /// Values at the element's corners, from those at the panel's.
    pub fn at_corners(&self, values: &[f64; 4]) -> [f64; 3] {
        self.weights().map(|w| (0..4).map(|i| w[i] * values[i]).sum())
    }

    /// The side of the element that is the panel's side from corner `k` on, if one is.
    pub fn side_of(&self, k: usize) -> Option<usize> {
        match self.side {
            4 => Some(k),
            side => (usize::from(side) == k).then_some(0),
        }
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
    pub fn new(panels: &Panels) -> Self {
        let mut elements = Self::default();
        for panel in 0..panels.len() {
            elements.first.push(elements.list.len() as u32);
            let sides = if panels.is_triangle(panel) { 4..5 } else { 0..4 };
            elements.list.extend(sides.map(|side| Element { panel: panel as u32, side }));
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
