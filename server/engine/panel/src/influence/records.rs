//! What acts: elements, from afar and from near by, and the triangles of the wakes.

use moldline_mesh::Vector3;

use super::{
    far::{Moments, moments, moments_gradient},
    near::Triangle,
};
use crate::{
    clusters::Patch,
    elements::{Elements, circulation},
    nodes::{Nodes, Smooth},
    panels::Panels,
    surface::Surface,
    wake::{Sheets, Wakes},
};

/// What the equations need of a set-up besides the positions.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    pub nodes: Nodes,
    pub smooth: Smooth,
    pub sheets: Sheets,
    pub elements: Elements,
    pub patches: Vec<Patch>,
    /// Cuts on whose sides the test functions differ.
    pub lines: Vec<Line>,
    /// Connected piece of every unknown.
    pub pieces: Vec<u32>,
    /// Largest distance of a corner of each element from its centroid, at the set-up's positions.
    pub reach: Vec<f64>,
}

/// An edge that is cut, as the upper panel runs through it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Line {
    pub from: u32,
    pub to: u32,
    pub upper: u32,
    pub lower: u32,
}

impl Layout {
    /// `points` are the set-up's.
    pub fn new(panels: &Panels, wakes: &Wakes, nodes: Nodes, points: &[Vector3]) -> Self {
        let elements = Elements::new(panels, points);
        let at = |panel: usize| panels.corners[panel].map(|v| points[v as usize]);
        let reach = |corners: &[Vector3]| {
            let centre = corners.iter().sum::<Vector3>() / corners.len() as f64;
            corners.iter().map(|c| (c - centre).norm()).fold(0.0, f64::max)
        };
        let of_element = |element: usize| {
            let element = &elements.list[element];
            reach(&element.of_corners(&at(element.panel as usize)))
        };
        let (low, high) = points
            .iter()
            .fold((Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)), |(low, high), p| {
                (low.inf(p), high.sup(p))
            });
        let centres: Vec<Vector3> = (0..panels.len()).map(|p| at(p).iter().sum::<Vector3>() / 4.0).collect();
        Self {
            smooth: Smooth::new(panels, wakes, points),
            sheets: Sheets::new(wakes, &nodes, (high - low).norm()),
            patches: Patch::cut(&centres, &nodes.of_corner),
            lines: lines(panels, wakes, &nodes),
            pieces: nodes.row_point.iter().map(|p| panels.piece[*p as usize]).collect(),
            reach: (0..elements.len()).map(of_element).collect(),
            elements,
            nodes,
        }
    }

    /// Node values of unknowns.
    pub fn node_values(&self, unknowns: &[f64]) -> Vec<f64> {
        let value = |terms: &Vec<(u32, f64)>| terms.iter().map(|(u, f)| f * unknowns[*u as usize]).sum();
        self.nodes.value.iter().map(value).collect()
    }

    /// The transpose of [`node_values`](Self::node_values): adds to the seeds of the unknowns.
    pub fn add_node_values(&self, seeds: &[f64], unknowns: &mut [f64]) {
        for (terms, seed) in self.nodes.value.iter().zip(seeds) {
            terms.iter().for_each(|(u, f)| unknowns[*u as usize] += f * seed);
        }
    }

    /// Values at the corners of an element, from those of the nodes.
    pub fn element_values(&self, element: usize, nodes: &[f64]) -> [f64; 3] {
        let element = &self.elements.list[element];
        element.of_corners(&self.nodes.of_corner[element.panel as usize]).map(|n| nodes[n as usize])
    }

    /// Circulations of the wakes' corners.
    pub fn circulations(&self, unknowns: &[f64]) -> Vec<f64> {
        let value = |terms: &Vec<(u32, f64)>| terms.iter().map(|(u, f)| f * unknowns[*u as usize]).sum();
        self.sheets.circulations.iter().map(value).collect()
    }
}

fn lines(panels: &Panels, wakes: &Wakes, nodes: &Nodes) -> Vec<Line> {
    let mut lines = Vec::new();
    for (strip, paths) in wakes.strips.iter().zip(&wakes.paths) {
        lines.push(Line { from: strip.a, to: strip.b, upper: strip.upper, lower: strip.lower });
        for (side, path) in paths.iter().enumerate() {
            for pair in path.iter().flat_map(|path| path.windows(2)) {
                let Some(edge) = panels.edge_between(pair[0], pair[1]) else { continue };
                let (from, to) = if side == 0 { (pair[1], pair[0]) } else { (pair[0], pair[1]) };
                let e = &panels.edges[edge as usize];
                let Some(right) = e.right else { continue };
                let (upper, lower) = if e.a == from { (e.left, right) } else { (right, e.left) };
                lines.push(Line { from, to, upper, lower });
            }
        }
    }
    let differs = |line: &Line| {
        [line.from, line.to].iter().any(|point| {
            let [up, low] =
                [line.upper, line.lower].map(|panel| nodes.row[nodes.at(panels, panel, *point) as usize]);
            up != low
        })
    };
    lines.retain(differs);
    lines
}

/// The surface and its wakes as they act on points.
pub(crate) struct Influence<'a> {
    pub panels: &'a Panels,
    pub layout: &'a Layout,
    pub surface: &'a Surface,
    pub(super) sources: Vec<Source>,
    pub(super) triangles: Vec<Triangle>,
    pub(super) sheets: Vec<Sheet>,
}

/// An element as it acts from afar.
#[derive(Clone, Debug)]
pub(super) struct Source {
    pub centroid: Vector3,
    pub moments: Moments,
}

/// A triangle of a wake.
#[derive(Clone, Debug)]
pub(super) struct Sheet {
    pub triangle: Triangle,
    pub circulations: [u32; 3],
    /// Points at the ends of its sides, where they are points of the surface.
    pub sides: [Option<[u32; 2]>; 3],
}

impl<'a> Influence<'a> {
    pub fn new(panels: &'a Panels, layout: &'a Layout, surface: &'a Surface) -> Self {
        let triangles: Vec<Triangle> = surface.corners.iter().map(|c| Triangle::new(*c)).collect();
        let source = |corners: &[Vector3; 3]| {
            let (centroid, moments) = plane_figure(corners);
            Source { centroid, moments }
        };
        let sources = surface.corners.iter().map(source).collect();
        let sheets = layout
            .sheets
            .triangles
            .iter()
            .map(|sheet| {
                let point = |k: usize| {
                    let corner = sheet.corners[k];
                    (!corner.far && corner.x == corner.yz).then_some(corner.yz)
                };
                Sheet {
                    triangle: Triangle::new([0, 1, 2].map(|k| layout.corner(&surface.points, k, sheet))),
                    circulations: sheet.circulations,
                    sides: [0, 1, 2].map(|k| Some([point(k)?, point((k + 1) % 3)?])),
                }
            })
            .collect();
        Self { panels, layout, surface, sources, triangles, sheets }
    }

    /// Points of view: the surface itself, and the factor of y in its image.
    pub fn views(&self) -> &'static [f64] {
        if self.panels.symmetric { &[1.0, -1.0] } else { &[1.0] }
    }

    /// Circulations of elements and wakes for values of the unknowns.
    pub fn charges(&self, unknowns: &[f64]) -> Charges {
        let nodes = self.layout.node_values(unknowns);
        let elements: Vec<Vector3> = (0..self.layout.elements.len())
            .map(|e| circulation(&self.surface.corners[e], &self.layout.element_values(e, &nodes)))
            .collect();
        let gamma = self.layout.circulations(unknowns);
        Charges {
            sheets: self
                .sheets
                .iter()
                .map(|s| circulation(&s.triangle.corners, &s.circulations.map(|g| gamma[g as usize])))
                .collect(),
            nodes,
            gamma,
            elements,
        }
    }
}

/// Circulations for values of the unknowns.
#[derive(Clone, Debug)]
pub(crate) struct Charges {
    /// Values of the nodes and of the wakes' corners.
    pub nodes: Vec<f64>,
    pub gamma: Vec<f64>,
    pub elements: Vec<Vector3>,
    pub sheets: Vec<Vector3>,
}

impl Layout {
    /// The position of a corner of a wake.
    pub fn corner(&self, points: &[Vector3], k: usize, sheet: &crate::wake::SheetTriangle) -> Vector3 {
        let corner = &sheet.corners[k];
        let far = if corner.far { self.sheets.length } else { 0.0 };
        corner.position(points) + far * Vector3::x()
    }
}

/// Centroid of a triangle, and second moments about it.
pub(super) fn plane_figure(corners: &[Vector3; 3]) -> (Vector3, Moments) {
    let centroid = corners.iter().sum::<Vector3>() / 3.0;
    let mut sum = [0.0; 6];
    for corner in corners {
        let part = moments(&(corner - centroid), 1.0 / 12.0);
        sum.iter_mut().zip(part).for_each(|(s, p)| *s += p);
    }
    (centroid, sum)
}

/// The change of [`plane_figure`] with the corners.
pub(super) fn plane_figure_jvp(
    corners: &[Vector3; 3],
    centroid: &Vector3,
    change: &[Vector3; 3],
) -> (Vector3, Moments) {
    let mut sum = [0.0; 6];
    for (corner, d) in corners.iter().zip(change) {
        let x = corner - centroid;
        let part = [
            2.0 * x.x * d.x,
            2.0 * x.y * d.y,
            2.0 * x.z * d.z,
            x.x * d.y + x.y * d.x,
            x.y * d.z + x.z * d.y,
            x.z * d.x + x.x * d.z,
        ];
        (0..6).for_each(|k| sum[k] += part[k] / 12.0);
    }
    (change.iter().sum::<Vector3>() / 3.0, sum)
}

/// The transpose: seeds of the corners from those of centroid and moments.
pub(super) fn plane_figure_vjp(
    corners: &[Vector3; 3],
    centroid: &Vector3,
    (by_centroid, by_moments): (&Vector3, &Moments),
) -> [Vector3; 3] {
    std::array::from_fn(|k| by_centroid / 3.0 + moments_gradient(by_moments, &(corners[k] - centroid)) / 12.0)
}
