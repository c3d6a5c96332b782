//! What is tested: panels, on whose elements the test functions have a circulation, and points of the cut lines.

use moldline_foundation::quadrature::GAUSS_4;
use moldline_mesh::Vector3;

use super::{
    figure::Figure,
    near::Points,
    records::{Influence, Line, Sheet},
};
use crate::{
    elements::{MOST, circulation_by_corners},
    lanes::{LANES, Lane},
    surface::SurfaceChange,
};

/// A point over which a potential is averaged: weights of the corners of a part, and its weight in the mean over the part.
type Probe = ([f64; 3], f64);

/// Exact on a triangle for polynomials of the fourth degree (Dunavant, Int. J. for Numerical Methods in Engineering 21, 1985).
const FOURTH: [Probe; 6] = {
    const A: f64 = 0.091_576_213_509_770_74;
    const B: f64 = 0.445_948_490_915_964_9;
    const C: f64 = 1.0 - 2.0 * A;
    const D: f64 = 1.0 - 2.0 * B;
    const U: f64 = 0.109_951_743_655_321_87;
    const V: f64 = 1.0 / 3.0 - U;
    [([C, A, A], U), ([A, C, A], U), ([A, A, C], U), ([D, B, B], V), ([B, D, B], V), ([B, B, D], V)]
};

/// Two points beside the centroid of an element at a quadrilateral's side, so far apart that the second moment along the side is right: the eight points of
/// a quadrilateral fill the lanes once.
const PAIR: [Probe; 2] = {
    const THIRD: f64 = 1.0 / 3.0;
    // Half the way between them, as a part of the side: 1 / sqrt 24.
    const S: f64 = 0.204_124_145_231_931_5;
    [([THIRD - S, THIRD + S, THIRD], 0.5), ([THIRD + S, THIRD - S, THIRD], 0.5)]
};

/// Circulations of a target's test functions as they act from afar: on the whole, and moments along p and q.
pub(super) type Charges = [Vector3; 3];

/// Directions of a quadrilateral with the middle m: `m + u p + v q + u v r` with u and v from -1 to 1; linear in the corners.
fn directions(corners: &[Vector3; 4]) -> [Vector3; 2] {
    let [a, b, c, d] = corners;
    [(b + c - a - d) * 0.25, (c + d - a - b) * 0.25]
}

/// The carrier of test functions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Carrier {
    Panel(usize),
    /// A line, and which of Gauss's points on it.
    Line(usize, usize),
}

/// An element of a target's panel, or the whole of a line.
#[derive(Clone, Copy, Debug)]
pub(super) struct Part {
    /// Corners of an element; both ends of a line, and zero.
    pub corners: [Vector3; 3],
    /// Circulations of the test functions in the order of the target's rows.
    pub charges: [Vector3; 4],
    /// The way from the target's centroid to the part's as parts of p and q.
    pub offset: [f64; 2],
}

/// Probes that are handled at once. Lanes without a probe have no weight.
#[derive(Clone, Debug)]
pub(super) struct Probes {
    pub places: Points,
    /// Part of every lane, weights of the part's corners, and the weight in the mean over the part.
    pub parts: [u8; LANES],
    pub corners: [Lane; 3],
    pub weights: Lane,
}

/// A carrier as a target of the vector potential.
#[derive(Clone, Debug)]
pub(super) struct Target {
    pub carrier: Carrier,
    pub parts: Vec<Part>,
    /// The middle, and second moments.
    pub figure: Figure,
    pub reach: f64,
    /// Unknowns of its test functions, and how these act from afar.
    pub rows: Vec<u32>,
    pub charges: Vec<Charges>,
    /// Directions along which the potential of what is afar goes on from the centroid to the parts': p and q of a quadrilateral; else zero.
    pub slopes: [Vector3; 2],
    /// Where the potential of elements near by is averaged, and that of wakes.
    pub fine: Vec<Probes>,
    pub coarse: Vec<Probes>,
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

/// The same probes on every part, in lanes.
fn probes(parts: &[Part], rule: &[Probe]) -> Vec<Probes> {
    let all: Vec<(usize, Probe)> =
        (0..parts.len()).flat_map(|part| rule.iter().map(move |probe| (part, *probe))).collect();
    let group = |lanes: &[(usize, Probe)]| {
        let mut probes = Probes {
            places: [[0.0; LANES]; 3],
            parts: [0; LANES],
            corners: [[0.0; LANES]; 3],
            weights: [0.0; LANES],
        };
        for l in 0..LANES {
            let (part, (corners, weight)) = lanes[l.min(lanes.len() - 1)];
            probes.parts[l] = part as u8;
            probes.weights[l] = if l < lanes.len() { weight } else { 0.0 };
            for k in 0..3 {
                probes.corners[k][l] = corners[k];
                let corner = &parts[part].corners[k];
                (0..3).for_each(|axis| probes.places[axis][l] += corners[k] * corner[axis]);
            }
        }
        probes
    };
    all.chunks(LANES).map(group).collect()
}

/// What the parts have in all, and its moments along p and q.
fn gathered(parts: &[Part], of_part: impl Fn(usize) -> Vector3) -> Charges {
    let mut sums = [Vector3::zeros(); 3];
    for (index, part) in parts.iter().enumerate() {
        let charge = of_part(index);
        let [u, v] = part.offset;
        sums.iter_mut().zip([1.0, u, v]).for_each(|(sum, factor)| *sum += factor * charge);
    }
    sums
}

impl Target {
    pub fn panel(influence: &Influence<'_>, panel: usize) -> Self {
        let Influence { layout, surface, .. } = influence;
        let part = |e: usize| {
            let (corners, charges) = (surface.corners[e], influence.units[e]);
            Part { corners, charges, offset: layout.elements.list[e].offset() }
        };
        let parts: Vec<Part> = layout.elements.of(panel).map(part).collect();
        let fine = probes(&parts, &FOURTH);
        let corners = influence.panels.sides(panel);
        let nodes = &layout.nodes.of_corner[panel][..corners];
        let area = Figure::new(&surface.corners[layout.elements.of(panel)]);
        let figure = Figure { centroid: surface.centres[panel], ..area };
        Self {
            carrier: Carrier::Panel(panel),
            figure,
            reach: layout.panel_reach[panel],
            rows: nodes.iter().map(|node| layout.nodes.row[*node as usize]).collect(),
            charges: (0..corners).map(|k| gathered(&parts, |part| parts[part].charges[k])).collect(),
            slopes: Self::directions(influence, panel, &surface.points),
            coarse: if parts.len() == MOST { probes(&parts, &PAIR) } else { fine.clone() },
            fine,
            parts,
        }
    }

    pub fn line(influence: &Influence<'_>, index: usize, point: usize) -> Self {
        let line = &influence.layout.lines[index];
        let [from, to] = [line.from, line.to].map(|p| influence.surface.points[p as usize]);
        let (t, weight) = gauss(point);
        let along = weight * (to - from);
        let hat = [1.0 - t, t];
        let rows = line_rows(influence, line);
        let part = Part {
            corners: [from, to, Vector3::zeros()],
            charges: rows.map(|(_, sign, end)| sign * hat[end] * along),
            offset: [0.0; 2],
        };
        let probes = probes(&[part], &[([1.0 - t, t, 0.0], 1.0)]);
        Self {
            carrier: Carrier::Line(index, point),
            parts: vec![part],
            figure: Figure { centroid: hat[0] * from + hat[1] * to, moments: [0.0; 6] },
            reach: 0.0,
            rows: rows.map(|(row, _, _)| row).to_vec(),
            charges: part.charges.map(|charge| [charge, Vector3::zeros(), Vector3::zeros()]).to_vec(),
            slopes: [Vector3::zeros(); 2],
            coarse: probes.clone(),
            fine: probes,
        }
    }

    /// p and q of a quadrilateral, or their changes; zero for triangles.
    fn directions(influence: &Influence<'_>, panel: usize, points: &[Vector3]) -> [Vector3; 2] {
        if influence.panels.is_triangle(panel) {
            return [Vector3::zeros(); 2];
        }
        directions(&influence.panels.corners[panel].map(|p| points[p as usize]))
    }

    /// Number of all targets: panels, then points of lines.
    pub fn count(influence: &Influence<'_>) -> usize {
        influence.panels.len() + influence.layout.lines.len() * GAUSS_4.len()
    }

    /// The target with that index.
    pub fn new(influence: &Influence<'_>, index: usize) -> Self {
        match index.checked_sub(influence.panels.len()) {
            None => Self::panel(influence, index),
            Some(point) => Self::line(influence, point / GAUSS_4.len(), point % GAUSS_4.len()),
        }
    }

    /// The circulation of a row's test function, weighted by part.
    pub fn charge(&self, row: usize, weights: &[f64; MOST]) -> Vector3 {
        self.parts.iter().zip(weights).map(|(part, weight)| *weight * part.charges[row]).sum()
    }

    /// What circulations of the parts are from afar.
    pub fn gathered(&self, of_parts: &[Vector3; MOST]) -> Charges {
        gathered(&self.parts, |part| of_parts[part])
    }

    /// The potential at a part: that of what is afar with its slopes, and that of what is near.
    pub fn potential(&self, part: usize, [far, by_p, by_q]: &Charges, near: &Vector3) -> Vector3 {
        let [u, v] = self.parts[part].offset;
        far + u * by_p + v * by_q + near
    }

    /// Changes of the slopes' directions with those of the points.
    pub fn slopes_jvp(&self, influence: &Influence<'_>, change: &SurfaceChange) -> [Vector3; 2] {
        match self.carrier {
            Carrier::Panel(panel) => Self::directions(influence, panel, &change.points),
            Carrier::Line(..) => [Vector3::zeros(); 2],
        }
    }

    /// The transpose of [`slopes_jvp`](Self::slopes_jvp): adds to the seeds of the points.
    pub fn slopes_vjp(&self, influence: &Influence<'_>, [p, q]: &[Vector3; 2], change: &mut SurfaceChange) {
        let Carrier::Panel(panel) = self.carrier else { return };
        if influence.panels.is_triangle(panel) {
            return;
        }
        let seeds = [-p - q, p - q, p + q, q - p];
        for (point, seed) in influence.panels.corners[panel].iter().zip(seeds) {
            change.points[*point as usize] += 0.25 * seed;
        }
    }

    /// The circulation of the test functions of every part for values of the unknowns.
    pub fn circulations(&self, unknowns: &[f64]) -> [Vector3; MOST] {
        let mut sums = [Vector3::zeros(); MOST];
        for (sum, part) in sums.iter_mut().zip(&self.parts) {
            *sum = self.rows.iter().zip(part.charges).map(|(row, c)| unknowns[*row as usize] * c).sum();
        }
        sums
    }

    /// The change of the charges of a part with its corners.
    pub fn charges_jvp(&self, influence: &Influence<'_>, part: usize, change: &[Vector3; 3]) -> [Vector3; 4] {
        match self.carrier {
            Carrier::Panel(panel) => {
                let elements = &influence.layout.elements;
                elements.list[elements.of(panel).start + part].unit_circulations(change)
            }
            Carrier::Line(index, point) => {
                let (t, weight) = gauss(point);
                let along = weight * (change[1] - change[0]);
                let hat = [1.0 - t, t];
                line_rows(influence, &influence.layout.lines[index])
                    .map(|(_, sign, end)| sign * hat[end] * along)
            }
        }
    }

    /// The gradient of `of.circulation(unknowns)` of a part with respect to its corners.
    pub fn circulation_by_corners(
        &self,
        influence: &Influence<'_>,
        part: usize,
        unknowns: &[f64],
        of: &Vector3,
    ) -> [Vector3; 3] {
        let value = |k: usize| self.rows.get(k).map_or(0.0, |row| unknowns[*row as usize]);
        match self.carrier {
            Carrier::Panel(panel) => {
                let elements = &influence.layout.elements;
                let element = &elements.list[elements.of(panel).start + part];
                circulation_by_corners(of, &element.of_corners(&[0, 1, 2, 3].map(value)))
            }
            Carrier::Line(index, point) => {
                let (t, weight) = gauss(point);
                let hat = [1.0 - t, t];
                let rows = line_rows(influence, &influence.layout.lines[index]);
                let factor: f64 = (0..4).map(|k| rows[k].1 * hat[rows[k].2] * value(k)).sum();
                let seed = weight * factor * of;
                [-seed, seed, Vector3::zeros()]
            }
        }
    }

    /// The figure about the centroid of the parts' area.
    fn area_figure(&self) -> Figure {
        Figure::new(&self.part_corners())
    }

    /// Corners of all parts.
    fn part_corners(&self) -> Vec<[Vector3; 3]> {
        self.parts.iter().map(|part| part.corners).collect()
    }

    /// Changes of centroid and moments with the parts' corners, which change by `corners`.
    pub fn figure_jvp(
        &self,
        influence: &Influence<'_>,
        change: &SurfaceChange,
        corners: &[[Vector3; 3]],
    ) -> Figure {
        match self.carrier {
            Carrier::Panel(panel) => Figure {
                centroid: change.centre(influence.panels, panel),
                ..self.area_figure().jvp(&self.part_corners(), corners)
            },
            Carrier::Line(_, point) => {
                let (t, _) = gauss(point);
                Figure { centroid: (1.0 - t) * corners[0][0] + t * corners[0][1], moments: [0.0; 6] }
            }
        }
    }

    /// The transpose of [`figure_jvp`](Self::figure_jvp): adds to the seeds of the parts' corners and of the points.
    pub fn figure_vjp(
        &self,
        influence: &Influence<'_>,
        seeds: &Figure,
        corners: &mut [[Vector3; 3]],
        change: &mut SurfaceChange,
    ) {
        match self.carrier {
            Carrier::Panel(panel) => {
                change.add_centre(influence.panels, panel, &seeds.centroid);
                let of_moments = Figure { centroid: Vector3::zeros(), ..*seeds };
                self.area_figure().vjp(&self.part_corners(), &of_moments, corners);
            }
            Carrier::Line(_, point) => {
                let (t, _) = gauss(point);
                corners[0][0] += (1.0 - t) * seeds.centroid;
                corners[0][1] += t * seeds.centroid;
            }
        }
    }

    /// The changes of the parts' corners with those of the points.
    pub fn corners_jvp(&self, influence: &Influence<'_>, change: &SurfaceChange) -> Vec<[Vector3; 3]> {
        let Influence { panels, layout, .. } = influence;
        match self.carrier {
            Carrier::Panel(panel) => {
                let elements = &layout.elements;
                elements.of(panel).map(|e| change.corners(panels, elements, e)).collect()
            }
            Carrier::Line(index, _) => {
                let line = &layout.lines[index];
                vec![[change.points[line.from as usize], change.points[line.to as usize], Vector3::zeros()]]
            }
        }
    }

    /// Adds seeds of the parts' corners to those of the points.
    pub fn add_corners(&self, influence: &Influence<'_>, seeds: &[[Vector3; 3]], change: &mut SurfaceChange) {
        let Influence { panels, layout, .. } = influence;
        match self.carrier {
            Carrier::Panel(panel) => {
                for (element, seeds) in layout.elements.of(panel).zip(seeds) {
                    change.add_corners(panels, &layout.elements, element, seeds);
                }
            }
            Carrier::Line(index, _) => {
                let line = &layout.lines[index];
                change.points[line.from as usize] += seeds[0][0];
                change.points[line.to as usize] += seeds[0][1];
            }
        }
    }

    /// The part that is an element, if the target is its panel.
    pub fn part_of(&self, influence: &Influence<'_>, element: usize) -> Option<usize> {
        let Carrier::Panel(panel) = self.carrier else { return None };
        let elements = influence.layout.elements.of(panel);
        elements.contains(&element).then(|| element - elements.start)
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
        let count = influence.panels.sides(record.panel as usize);
        let side = (0..count).find(|&k| {
            let ends = [points[k], points[(k + 1) % count]];
            ends == [line.from, line.to] || ends == [line.to, line.from]
        })?;
        record.side_of(side, (side + 1) % count)
    }

    /// Whether a panel has a corner of a wake's triangle.
    pub fn touches(&self, influence: &Influence<'_>, sheet: &Sheet) -> bool {
        let Carrier::Panel(panel) = self.carrier else { return false };
        let corners = &influence.panels.corners[panel];
        sheet.points.iter().flatten().any(|point| corners.contains(point))
    }

    /// The side of a wake's triangle on which the target lies.
    pub fn on_sheet(&self, influence: &Influence<'_>, sheet: usize) -> Option<usize> {
        let Carrier::Line(index, _) = self.carrier else { return None };
        let line = &influence.layout.lines[index];
        let points = &influence.sheets[sheet].points;
        (0..3).find(|&k| {
            let side = [points[k], points[(k + 1) % 3]];
            side == [Some(line.from), Some(line.to)] || side == [Some(line.to), Some(line.from)]
        })
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
            let mean: f64 = FOURTH.iter().map(|(p, w)| w * p[0].powi(i) * p[1].powi(j) * p[2].powi(k)).sum();
            let exact = 2.0 * factorial(i) * factorial(j) * factorial(k) / factorial(i + j + k + 2);
            assert!((mean - exact).abs() < 1e-14, "{i} {j} {k}: {mean} {exact}");
        }
    }

    /// Along the side the second moment is right: the mean of `(lambda_0 - lambda_1)^2` is 1/6.
    #[test]
    fn pairs_have_the_moment_along_their_side() {
        let mean = |of: &dyn Fn(&[f64; 3]) -> f64| PAIR.iter().map(|(p, w)| w * of(p)).sum::<f64>();
        assert!((mean(&|p| (p[0] - p[1]).powi(2)) - 1.0 / 6.0).abs() < 1e-15);
        assert!((0..3).all(|k| (mean(&|p| p[k]) - 1.0 / 3.0).abs() < 1e-15));
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
