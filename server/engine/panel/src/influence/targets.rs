//! What is tested: elements, on which the test functions have a circulation, and points of the cut lines.

use moldline_foundation::quadrature::GAUSS_4;
use moldline_mesh::Vector3;

use super::{
    assembly::View,
    far::Moments,
    near::Points,
    records::{Influence, Line, plane_figure, plane_figure_jvp, plane_figure_vjp},
};
use crate::{
    elements::circulation_by_corners,
    lanes::{LANES, Lane},
    surface::SurfaceChange,
};

/// Points of an element over which the potential of near ones is averaged, as weights of its corners, and their weights: exact for polynomials of the
/// fourth degree (Dunavant, Int. J. for Numerical Methods in Engineering 21, 1985).
const PROBES: [([f64; 3], f64); 6] = {
    const A: f64 = 0.091_576_213_509_770_74;
    const B: f64 = 0.445_948_490_915_964_9;
    const C: f64 = 1.0 - 2.0 * A;
    const D: f64 = 1.0 - 2.0 * B;
    const U: f64 = 0.109_951_743_655_321_87;
    const V: f64 = 1.0 / 3.0 - U;
    [([C, A, A], U), ([A, C, A], U), ([A, A, C], U), ([D, B, B], V), ([B, D, B], V), ([B, B, D], V)]
};

/// The carrier of test functions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Carrier {
    Element(usize),
    /// A line, and which of Gauss's points on it.
    Line(usize, usize),
}

/// Points of a target over which the potential of near triangles is averaged: weights of its corners, and weights in the mean. Lanes without a point
/// have no weight.
#[derive(Clone, Debug)]
pub(super) struct Probes {
    pub corners: [Lane; 3],
    pub weights: Lane,
}

impl Probes {
    fn new(carrier: Carrier) -> Self {
        let mut probes = Probes { corners: [[0.0; LANES]; 3], weights: [0.0; LANES] };
        match carrier {
            Carrier::Element(_) => {
                for l in 0..LANES {
                    let (corners, weight) = PROBES[l.min(PROBES.len() - 1)];
                    (0..3).for_each(|k| probes.corners[k][l] = corners[k]);
                    probes.weights[l] = if l < PROBES.len() { weight } else { 0.0 };
                }
            }
            Carrier::Line(_, point) => {
                let (t, _) = gauss(point);
                probes.corners = [[1.0 - t; LANES], [t; LANES], [0.0; LANES]];
                probes.weights[0] = 1.0;
            }
        }
        probes
    }
}

/// A carrier as a target of the vector potential: its corners and, from afar, its centroid and moments.
#[derive(Clone, Debug)]
pub(super) struct Target {
    pub carrier: Carrier,
    /// Corners of an element; both ends of a line, and zero.
    pub corners: [Vector3; 3],
    pub centroid: Vector3,
    pub moments: Moments,
    pub reach: f64,
    pub probes: Probes,
    /// Unknowns and the circulation of their test functions.
    pub rows: Vec<(u32, Vector3)>,
}

/// Place and weight of Gauss's points on a line from 0 to 1.
fn gauss(point: usize) -> (f64, f64) {
    let (node, weight) = GAUSS_4[point];
    (0.5 * (1.0 + node), 0.5 * weight)
}

/// Unknowns at the ends of a line with the sign of their test functions: upper ones by the line's direction.
fn line_rows(influence: &Influence<'_>, line: &Line) -> [(u32, f64, usize); 4] {
    let Influence { panels, layout, .. } = influence;
    let row = |panel: u32, point: u32| layout.nodes.row[layout.nodes.at(panels, panel, point) as usize];
    [
        (row(line.upper, line.from), -1.0, 0),
        (row(line.upper, line.to), -1.0, 1),
        (row(line.lower, line.from), 1.0, 0),
        (row(line.lower, line.to), 1.0, 1),
    ]
}

impl Target {
    pub fn element(influence: &Influence<'_>, element: usize) -> Self {
        let layout = influence.layout;
        let corners = influence.surface.corners[element];
        let (centroid, moments) = plane_figure(&corners);
        let record = &layout.elements.list[element];
        let nodes = record.of_corners(&layout.nodes.of_corner[record.panel as usize]);
        let row = |k: usize| {
            (layout.nodes.row[nodes[k] as usize], -0.5 * (corners[(k + 2) % 3] - corners[(k + 1) % 3]))
        };
        let rows = [0, 1, 2].map(row).to_vec();
        let reach = layout.reach[element];
        let carrier = Carrier::Element(element);
        Self { carrier, corners, centroid, moments, reach, probes: Probes::new(carrier), rows }
    }

    pub fn line(influence: &Influence<'_>, index: usize, point: usize) -> Self {
        let line = &influence.layout.lines[index];
        let [from, to] = [line.from, line.to].map(|p| influence.surface.points[p as usize]);
        let (t, weight) = gauss(point);
        let along = weight * (to - from);
        let hat = [1.0 - t, t];
        Self {
            carrier: Carrier::Line(index, point),
            probes: Probes::new(Carrier::Line(index, point)),
            corners: [from, to, Vector3::zeros()],
            centroid: hat[0] * from + hat[1] * to,
            moments: [0.0; 6],
            reach: 0.0,
            rows: line_rows(influence, line)
                .iter()
                .map(|&(row, sign, end)| (row, sign * hat[end] * along))
                .collect(),
        }
    }

    /// All targets, elements first.
    pub fn count(influence: &Influence<'_>) -> usize {
        influence.layout.elements.len() + influence.layout.lines.len() * GAUSS_4.len()
    }

    /// The target with that index.
    pub fn new(influence: &Influence<'_>, index: usize) -> Self {
        let elements = influence.layout.elements.len();
        if index < elements {
            Self::element(influence, index)
        } else {
            let index = index - elements;
            Self::line(influence, index / GAUSS_4.len(), index % GAUSS_4.len())
        }
    }

    /// The places of probes as a view has them.
    pub fn places(&self, view: &View) -> Points {
        let mut places = [[0.0; LANES]; 3];
        for (k, corner) in self.corners.iter().enumerate() {
            let corner = view.place(corner);
            for axis in 0..3 {
                for l in 0..LANES {
                    places[axis][l] += self.probes.corners[k][l] * corner[axis];
                }
            }
        }
        places
    }

    /// The circulation of the test functions for values of the unknowns.
    pub fn circulation(&self, unknowns: &[f64]) -> Vector3 {
        self.rows.iter().map(|(row, charge)| unknowns[*row as usize] * charge).sum()
    }

    /// The change of [`circulation`](Self::circulation) of the test functions with the corners: of every unknown in `rows`.
    pub fn rows_jvp(&self, influence: &Influence<'_>, change: &[Vector3; 3]) -> Vec<(u32, Vector3)> {
        match self.carrier {
            Carrier::Element(_) => {
                let of = |(k, (row, _)): (usize, &(u32, Vector3))| {
                    (*row, -0.5 * (change[(k + 2) % 3] - change[(k + 1) % 3]))
                };
                self.rows.iter().enumerate().map(of).collect()
            }
            Carrier::Line(index, point) => {
                let (t, weight) = gauss(point);
                let along = weight * (change[1] - change[0]);
                let hat = [1.0 - t, t];
                let of = |&(row, sign, end): &(u32, f64, usize)| (row, sign * hat[end] * along);
                line_rows(influence, &influence.layout.lines[index]).iter().map(of).collect()
            }
        }
    }

    /// The gradient of `of.circulation(unknowns)` with respect to the corners.
    pub fn circulation_by_corners(
        &self,
        influence: &Influence<'_>,
        unknowns: &[f64],
        of: &Vector3,
    ) -> [Vector3; 3] {
        match self.carrier {
            Carrier::Element(_) => {
                let values = [0, 1, 2].map(|k| unknowns[self.rows[k].0 as usize]);
                circulation_by_corners(of, &values)
            }
            Carrier::Line(index, point) => {
                let (t, weight) = gauss(point);
                let hat = [1.0 - t, t];
                let factor: f64 = line_rows(influence, &influence.layout.lines[index])
                    .iter()
                    .map(|&(row, sign, end)| sign * hat[end] * unknowns[row as usize])
                    .sum();
                let seed = weight * factor * of;
                [-seed, seed, Vector3::zeros()]
            }
        }
    }

    /// Seeds of the corners from those of centroid and moments.
    pub fn afar_vjp(&self, by_centroid: &Vector3, by_moments: &Moments) -> [Vector3; 3] {
        match self.carrier {
            Carrier::Element(_) => plane_figure_vjp(&self.corners, &self.centroid, (by_centroid, by_moments)),
            Carrier::Line(_, point) => {
                let (t, _) = gauss(point);
                [(1.0 - t) * by_centroid, t * by_centroid, Vector3::zeros()]
            }
        }
    }

    /// Changes of centroid and moments with the corners.
    pub fn afar_jvp(&self, change: &[Vector3; 3]) -> (Vector3, Moments) {
        match self.carrier {
            Carrier::Element(_) => plane_figure_jvp(&self.corners, &self.centroid, change),
            Carrier::Line(_, point) => {
                let (t, _) = gauss(point);
                ((1.0 - t) * change[0] + t * change[1], [0.0; 6])
            }
        }
    }

    /// The changes of the corners with those of the points.
    pub fn corners_jvp(&self, influence: &Influence<'_>, change: &SurfaceChange) -> [Vector3; 3] {
        match self.carrier {
            Carrier::Element(element) => {
                change.corners(influence.panels, &influence.layout.elements, element)
            }
            Carrier::Line(index, _) => {
                let line = &influence.layout.lines[index];
                [change.points[line.from as usize], change.points[line.to as usize], Vector3::zeros()]
            }
        }
    }

    /// Adds seeds of the corners to those of the points.
    pub fn add_corners(&self, influence: &Influence<'_>, seeds: &[Vector3; 3], change: &mut SurfaceChange) {
        match self.carrier {
            Carrier::Element(element) => {
                change.add_corners(influence.panels, &influence.layout.elements, element, seeds);
            }
            Carrier::Line(index, _) => {
                let line = &influence.layout.lines[index];
                change.points[line.from as usize] += seeds[0];
                change.points[line.to as usize] += seeds[1];
            }
        }
    }

    /// The side of a panel's element on which the target lies, if it is a point of that line.
    pub fn on_side(&self, influence: &Influence<'_>, element: usize) -> Option<usize> {
        let Carrier::Line(index, _) = self.carrier else { return None };
        let line = &influence.layout.lines[index];
        let record = &influence.layout.elements.list[element];
        if record.panel != line.upper && record.panel != line.lower {
            return None;
        }
        let points = influence.panels.corners[record.panel as usize];
        let count = if influence.panels.is_triangle(record.panel as usize) { 3 } else { 4 };
        let side = (0..count).find(|&k| {
            let ends = [points[k], points[(k + 1) % count]];
            ends == [line.from, line.to] || ends == [line.to, line.from]
        })?;
        record.side_of(side, (side + 1) % count)
    }

    /// The side of a wake's triangle on which the target lies.
    pub fn on_sheet(&self, influence: &Influence<'_>, sheet: usize) -> Option<usize> {
        let Carrier::Line(index, _) = self.carrier else { return None };
        let line = &influence.layout.lines[index];
        influence.sheets[sheet]
            .sides
            .iter()
            .position(|side| *side == Some([line.from, line.to]) || *side == Some([line.to, line.from]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::elements::{circulation, circulation_by_values};

    /// The mean of a product of powers of barycentric coordinates is `2 i! j! k! / (i + j + k + 2)!`.
    #[test]
    fn probes_are_exact_to_the_fourth_degree() {
        let factorial = |n: i32| (1..=n).map(f64::from).product::<f64>();
        for (i, j, k) in
            (0..=4).flat_map(|i| (0..=4 - i).flat_map(move |j| (0..=4 - i - j).map(move |k| (i, j, k))))
        {
            let mean: f64 = PROBES.iter().map(|(p, w)| w * p[0].powi(i) * p[1].powi(j) * p[2].powi(k)).sum();
            let exact = 2.0 * factorial(i) * factorial(j) * factorial(k) / factorial(i + j + k + 2);
            assert!((mean - exact).abs() < 1e-14, "{i} {j} {k}: {mean} {exact}");
        }
    }

    #[test]
    fn circulation_is_linear() {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.2, 0.1], [0.3, 0.9, -0.2]].map(Vector3::from);
        let of = Vector3::new(0.3, -0.4, 0.5);
        let values = [0.2, -0.7, 1.1];
        let by = circulation_by_values(&of, &corners);
        let sum: f64 = (0..3).map(|k| by[k] * values[k]).sum();
        assert!((sum - of.dot(&circulation(&corners, &values))).abs() < 1e-15);
    }
}
