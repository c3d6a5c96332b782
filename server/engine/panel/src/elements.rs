//! The triangles of the panels, on which the potential is linear.
//!
//! A triangular panel is one element. A quadrilateral is two, cut along its shorter diagonal at the set-up's positions. If both are equally long, it is
//! four round its middle, the mean of its corners in place and in potential: so no diagonal is preferred where none is better, and what is symmetric
//! stays so.

use std::ops::{Add, Mul};

use moldline_mesh::Vector3;

use crate::{panels::Panels, surface::area};

/// Elements of a panel at most.
pub(crate) const MOST: usize = 4;

/// Diagonals whose lengths differ by less than this part are equal.
const EQUAL: f64 = 1e-6;

/// An element.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Element {
    pub panel: u32,
    /// Its corners as means of the panel's corners: weights.
    weights: [[f64; 4]; 3],
}

/// The weights of the panel's corners themselves.
const CORNERS: [[f64; 4]; 4] = {
    let mut weights = [[0.0; 4]; 4];
    let mut k = 0;
    while k < 4 {
        weights[k][k] = 1.0;
        k += 1;
    }
    weights
};

/// The weights of the middle of a quadrilateral.
const MIDDLE: [f64; 4] = [0.25; 4];

impl Element {
    /// What belongs to its corners, from what belongs to the panel's.
    pub fn of_corners<T>(&self, panel: &[T; 4]) -> [T; 3]
    where
        T: Copy + Add<Output = T> + Mul<f64, Output = T>,
    {
        self.weights.map(|[a, b, c, d]| panel[0] * a + panel[1] * b + panel[2] * c + panel[3] * d)
    }

    /// The transpose of [`of_corners`](Self::of_corners): what the seeds of its corners are to the panel's.
    pub fn corner_seeds<T>(&self, seeds: &[T; 3]) -> [T; 4]
    where
        T: Copy + Add<Output = T> + Mul<f64, Output = T>,
    {
        std::array::from_fn(|corner| {
            let [a, b, c] = self.weights.map(|weights| weights[corner]);
            seeds[0] * a + seeds[1] * b + seeds[2] * c
        })
    }

    /// The side of the element that is the panel's side from corner `k` to corner `next`, if one is.
    pub fn side_of(&self, k: usize, next: usize) -> Option<usize> {
        let is = |side: usize, corner: usize| self.weights[side % 3] == CORNERS[corner];
        (0..3).find(|&side| is(side, k) && is(side + 1, next))
    }

    /// Where its centroid is in a quadrilateral: parts of the ways from the middle to the middles of the second side and of the third.
    pub fn offset(&self) -> [f64; 2] {
        let means = self.corner_seeds(&[1.0 / 3.0; 3]);
        [[-1.0, 1.0, 1.0, -1.0], [-1.0, -1.0, 1.0, 1.0]]
            .map(|signs: [f64; 4]| means.iter().zip(signs).map(|(mean, sign)| mean * sign).sum())
    }

    /// The circulations for unit values at the panel's corners. `corners` are the element's.
    pub fn unit_circulations(&self, corners: &[Vector3; 3]) -> [Vector3; 4] {
        self.corner_seeds(&[0, 1, 2].map(|k: usize| -0.5 * (corners[(k + 2) % 3] - corners[(k + 1) % 3])))
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
            let at = panels.corners[panel].map(|p| points[p as usize]);
            let element = |weights: [[f64; 4]; 3]| Element { panel: panel as u32, weights };
            let [a, b, c, d] = CORNERS;
            if panels.is_triangle(panel) {
                elements.list.push(element([a, b, c]));
                continue;
            }
            let cuts = [[[a, b, c], [a, c, d]], [[b, c, d], [b, d, a]]].map(|cut| cut.map(element));
            let diagonals = [at[2] - at[0], at[3] - at[1]].map(|diagonal| diagonal.norm());
            if (diagonals[0] - diagonals[1]).abs() <= EQUAL * diagonals[0].max(diagonals[1]) {
                let round = [[a, b, MIDDLE], [b, c, MIDDLE], [c, d, MIDDLE], [d, a, MIDDLE]];
                elements.list.extend(round.map(element));
                continue;
            }
            // The shorter diagonal, unless it runs outside of a dented panel.
            let shorter = usize::from(diagonals[1] < diagonals[0]);
            let inside = |cut: &[Element; 2]| cut.iter().all(|part| faces_out(part, &at));
            let cut =
                if inside(&cuts[shorter]) || !inside(&cuts[1 - shorter]) { shorter } else { 1 - shorter };
            elements.list.extend(cuts[cut]);
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

/// Whether an element looks to the same side as its panel.
fn faces_out(element: &Element, panel: &[Vector3; 4]) -> bool {
    let of_panel = (panel[2] - panel[0]).cross(&(panel[3] - panel[1]));
    area(&element.of_corners(panel)).dot(&of_panel) > 0.0
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
