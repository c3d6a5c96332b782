//! The sheets of the wakes as triangles: long ones along x, and beside bodies those between a path and the ray from the strip's other end.

use moldline_mesh::Vector3;

use super::{Wakes, strips::Strip};
use crate::nodes::{Combination, Nodes};

/// Length of a wake over the extent of the surface. Vortices end there, which is felt at the surface as the square of its inverse.
const LENGTH: f64 = 1000.0;

/// A corner of a wake: `x` of one point (not ahead of the other), `y` and `z` of another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Corner {
    pub x: u32,
    pub yz: u32,
    /// At the wake's downstream end.
    pub far: bool,
}

impl Corner {
    fn of(point: u32) -> Self {
        Self { x: point, yz: point, far: false }
    }

    fn downstream(self) -> Self {
        Self { far: true, ..self }
    }

    /// The point that gives x.
    pub fn ahead(&self, points: &[Vector3]) -> u32 {
        if points[self.x as usize].x > points[self.yz as usize].x { self.x } else { self.yz }
    }

    /// The position of a corner that is not far.
    pub fn position(&self, points: &[Vector3]) -> Vector3 {
        let at = &points[self.yz as usize];
        Vector3::new(points[self.ahead(points) as usize].x, at.y, at.z)
    }
}

/// A triangle of a wake, counter-clockwise as seen from its upper side.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SheetTriangle {
    pub corners: [Corner; 3],
    /// Circulations at its corners, as places in [`Sheets::circulations`].
    pub circulations: [u32; 3],
}

/// The sheets of all wakes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sheets {
    pub triangles: Vec<SheetTriangle>,
    /// Circulations of their corners.
    pub circulations: Vec<Combination>,
    /// How far downstream wakes end, m.
    pub length: f64,
}

impl Sheets {
    /// `extent` is the surface's, m.
    pub fn new(wakes: &Wakes, nodes: &Nodes, extent: f64) -> Self {
        let mut sheets = Self { length: LENGTH * extent, ..Self::default() };
        for (index, strip) in wakes.strips.iter().enumerate() {
            let [a, b] = nodes.ends[index].clone().map(|gamma| sheets.circulation(gamma));
            let (at_a, at_b) = (Corner::of(strip.a), Corner::of(strip.b));
            let side = wakes.paths[index].iter().position(Option::is_some);
            let Some((side, path)) = side.and_then(|s| Some((s, wakes.paths[index][s].as_ref()?))) else {
                sheets.quadrilateral([(at_b, b), (at_a, a), (at_a.downstream(), a), (at_b.downstream(), b)]);
                continue;
            };
            let (outer, of_outer) = if side == 0 { (strip.b, b) } else { (strip.a, a) };
            let along: Vec<u32> =
                nodes.along[index][side].clone().into_iter().map(|gamma| sheets.circulation(gamma)).collect();
            // The sheet begins with the whole trailing edge, also if that runs upstream from the body on.
            let beside =
                |step: usize| Corner { x: if step == 0 { outer } else { path[step] }, yz: outer, far: false };
            for step in 0..path.len() {
                let inner = (Corner::of(path[step]), along[step]);
                let out = (beside(step), of_outer);
                let (inner_next, out_next) = match path.get(step + 1) {
                    Some(next) => ((Corner::of(*next), along[step + 1]), (beside(step + 1), of_outer)),
                    None => ((inner.0.downstream(), inner.1), (out.0.downstream(), out.1)),
                };
                sheets.quadrilateral(if side == 0 {
                    [out, inner, inner_next, out_next]
                } else {
                    [inner, out, out_next, inner_next]
                });
            }
        }
        sheets
    }

    fn circulation(&mut self, gamma: Combination) -> u32 {
        self.circulations.push(gamma);
        self.circulations.len() as u32 - 1
    }

    /// Adds two triangles.
    fn quadrilateral(&mut self, corners: [(Corner, u32); 4]) {
        for picked in [[0, 1, 2], [0, 2, 3]] {
            let [p, q, r] = picked.map(|k: usize| corners[k]);
            // A quadrilateral with two corners in one place is a triangle.
            if p.0 != q.0 && q.0 != r.0 && r.0 != p.0 {
                let triangle = SheetTriangle { corners: [p.0, q.0, r.0], circulations: [p.1, q.1, r.1] };
                self.triangles.push(triangle);
            }
        }
    }
}

/// Where the infinite part of a strip begins.
pub(super) fn rest(strip: &Strip, paths: &[Option<Vec<u32>>; 2]) -> [Corner; 2] {
    let end = |path: &Option<Vec<u32>>| path.as_ref().and_then(|path| path.last().copied());
    let border = |outer: u32, last: u32| Corner { x: last, yz: outer, far: false };
    match [&paths[0], &paths[1]].map(end) {
        [Some(last), _] => [border(strip.b, last), Corner::of(last)],
        [None, Some(last)] => [Corner::of(last), border(strip.a, last)],
        [None, None] => [Corner::of(strip.b), Corner::of(strip.a)],
    }
}
