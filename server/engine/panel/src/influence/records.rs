//! What acts: elements, from afar and from near by, and the triangles of the wakes.

use moldline_mesh::Vector3;

use super::{figure::Figure, near::Triangle};
use crate::{
    clusters::{PATCH, Patch, bisect},
    elements::{Element, Elements, circulation},
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
    /// The element at every place, patch after patch.
    pub order: Vec<u32>,
    /// Panels that are tested together.
    pub groups: Vec<Vec<u32>>,
    /// Cuts on whose sides the test functions differ.
    pub lines: Vec<Line>,
    /// Connected piece of every unknown.
    pub pieces: Vec<u32>,
    /// Largest distance of a corner from the corners' mean, at the set-up's positions: of the element at every place, and of every panel.
    pub reach: Vec<f64>,
    pub panel_reach: Vec<f64>,
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
        let of_element = |element: &Element| element.of_corners(&at(element.panel as usize));
        let of_panel = |panel: usize| reach(&at(panel)[..panels.sides(panel)]);
        let (low, high) = points
            .iter()
            .fold((Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)), |(low, high), p| {
                (low.inf(p), high.sup(p))
            });
        let centres: Vec<Vector3> =
            elements.list.iter().map(|e| of_element(e).iter().sum::<Vector3>() / 3.0).collect();
        let corners: Vec<[u32; 4]> =
            elements.list.iter().map(|e| nodes.of_corner[e.panel as usize]).collect();
        let (order, patches) = Patch::cut(&centres, &corners);
        let middles: Vec<Vector3> = (0..panels.len()).map(|p| at(p).iter().sum::<Vector3>() / 4.0).collect();
        let mut groups = Vec::new();
        bisect((0..panels.len() as u32).collect(), &middles, PATCH, &mut groups);
        Self {
            smooth: Smooth::new(panels, wakes, points),
            sheets: Sheets::new(wakes, &nodes, (high - low).norm()),
            patches,
            lines: lines(panels, wakes, &nodes),
            pieces: nodes.row_point.iter().map(|p| panels.piece[*p as usize]).collect(),
            reach: order.iter().map(|e| reach(&of_element(&elements.list[*e as usize]))).collect(),
            panel_reach: (0..panels.len()).map(of_panel).collect(),
            order,
            groups,
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
        element.of_corners(&self.nodes.of_corner[element.panel as usize].map(|n| nodes[n as usize]))
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
    /// The element at every place as it acts from afar ...
    pub(super) far: Vec<Figure>,
    /// ... and the same with one list for each number, as loops over many read them.
    pub(super) figures: [Vec<f64>; 9],
    pub(super) triangles: Vec<Triangle>,
    /// Circulations of every element for unit values at the corners of its panel.
    pub(super) units: Vec<[Vector3; 4]>,
    /// The same of the element at every place: by corner and axis.
    pub(super) unit_charges: [[Vec<f64>; 3]; 4],
    pub(super) sheets: Vec<Sheet>,
}

/// A triangle of a wake.
#[derive(Clone, Debug)]
pub(super) struct Sheet {
    pub triangle: Triangle,
    pub circulations: [u32; 3],
    /// Circulations of the triangle for unit values at its corners.
    pub units: [Vector3; 3],
    /// Those of its corners that are points of the surface.
    pub points: [Option<u32>; 3],
}

impl<'a> Influence<'a> {
    pub fn new(panels: &'a Panels, layout: &'a Layout, surface: &'a Surface) -> Self {
        let triangles: Vec<Triangle> = surface.corners.iter().map(|c| Triangle::new(*c)).collect();
        let far: Vec<Figure> = layout
            .order
            .iter()
            .map(|element| Figure::new(&surface.corners[*element as usize..][..1]))
            .collect();
        let units = layout.elements.list.iter().zip(&surface.corners);
        let units: Vec<[Vector3; 4]> =
            units.map(|(element, corners)| element.unit_circulations(corners)).collect();
        let unit_charges = std::array::from_fn(|corner| {
            layout.afar(&units.iter().map(|unit| unit[corner]).collect::<Vec<Vector3>>())
        });
        let figures = by_number(&far);
        let sheets = layout
            .sheets
            .triangles
            .iter()
            .map(|sheet| {
                let point = |k: usize| {
                    let corner = sheet.corners[k];
                    (!corner.far && corner.x == corner.yz).then_some(corner.yz)
                };
                let corners = [0, 1, 2].map(|k| layout.corner(&surface.points, k, sheet));
                Sheet {
                    triangle: Triangle::new(corners),
                    units: [0, 1, 2].map(|k: usize| -0.5 * (corners[(k + 2) % 3] - corners[(k + 1) % 3])),
                    circulations: sheet.circulations,
                    points: [0, 1, 2].map(point),
                }
            })
            .collect();
        Self { panels, layout, surface, far, figures, triangles, units, unit_charges, sheets }
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
            afar: self.layout.afar(&elements),
            elements,
        }
    }
}

/// Figures with one list for each number.
pub(super) fn by_number(figures: &[Figure]) -> [Vec<f64>; 9] {
    std::array::from_fn(|f| {
        figures.iter().map(|x| if f < 3 { x.centroid[f] } else { x.moments[f - 3] }).collect()
    })
}

/// Circulations for values of the unknowns.
#[derive(Clone, Debug)]
pub(crate) struct Charges {
    /// Values of the nodes and of the wakes' corners.
    pub nodes: Vec<f64>,
    pub gamma: Vec<f64>,
    pub elements: Vec<Vector3>,
    /// The same of the element at every place, by axis.
    pub(super) afar: [Vec<f64>; 3],
    pub sheets: Vec<Vector3>,
}

impl Layout {
    /// What elements have, of the one at every place, by axis.
    pub(super) fn afar(&self, elements: &[Vector3]) -> [Vec<f64>; 3] {
        [0, 1, 2].map(|axis| self.order.iter().map(|e| elements[*e as usize][axis]).collect())
    }

    /// The position of a corner of a wake.
    pub fn corner(&self, points: &[Vector3], k: usize, sheet: &crate::wake::SheetTriangle) -> Vector3 {
        let corner = &sheet.corners[k];
        let far = if corner.far { self.sheets.length } else { 0.0 };
        corner.position(points) + far * Vector3::x()
    }
}
