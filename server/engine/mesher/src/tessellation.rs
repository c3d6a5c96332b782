//! Triangles on one component: a grid on each patch, joined to the samples of its edges, which both patches share.

use std::collections::HashMap;

use moldline_foundation::Vector3;
use moldline_geometry::{Body, EdgeSide, Location, Side};

/// Most samples of a knot interval.
const MAX_PER_INTERVAL: usize = 64;
/// Lines across a patch on which lengths and angles are measured.
const PROBES: usize = 5;
/// Chords of a knot interval by which its length and turning are measured.
const CHORDS: usize = 8;

/// The closed tessellation of one component.
pub(crate) struct Tessellation {
    /// Positions, metres.
    pub positions: Vec<Vector3>,
    /// Vertices of the triangles, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Location of each triangle's corners, on one patch.
    pub locations: Vec<[Location; 3]>,
    /// The component's edge that an edge of the tessellation lies on, for sharp ones; by increasing vertices.
    pub sharp: HashMap<[u32; 2], u32>,
    /// Number of vertices that are vertices of the component; they come first.
    pub corners: usize,
}

/// Length and turning angle that one step of the tessellation may have.
#[derive(Clone, Copy)]
pub(crate) struct Step {
    /// Metres.
    pub length: f64,
    /// Radians.
    pub angle: f64,
}

impl Step {
    /// Number of steps along a curve, from chords of it.
    fn count(&self, curve: impl Fn(f64) -> Vector3) -> usize {
        let points: Vec<Vector3> = (0..=CHORDS).map(|k| curve(k as f64 / CHORDS as f64)).collect();
        let chords: Vec<Vector3> = points.windows(2).map(|p| p[1] - p[0]).collect();
        let length: f64 = chords.iter().map(|c| c.norm()).sum();
        let turning: f64 = chords.windows(2).map(|c| c[0].angle(&c[1])).filter(|a| a.is_finite()).sum();
        let turning = if length > 1e-3 * self.length { turning } else { 0.0 };
        let count = (length / self.length).max(turning / self.angle).ceil();
        (count as usize).clamp(1, MAX_PER_INTERVAL)
    }
}

/// The location at parameter `t` of a patch's side.
pub(crate) fn on_side(body: &Body, patch: u32, side: Side, t: f64) -> Location {
    let [u, v] = body.component().patches()[patch as usize].surface.domain();
    match side {
        Side::UMin => Location { patch, u: u.0, v: t },
        Side::UMax => Location { patch, u: u.1, v: t },
        Side::VMin => Location { patch, u: t, v: v.0 },
        Side::VMax => Location { patch, u: t, v: v.1 },
    }
}

/// A piece of a side's polygon: parameters and vertices, in increasing order of the parameter.
type Polyline = Vec<(f64, u32)>;

/// Tessellates a component.
pub(crate) fn tessellate(body: &Body, step: Step) -> Tessellation {
    let component = body.component();
    let mut out = Tessellation {
        positions: vec![Vector3::zeros(); component.vertices().len()],
        triangles: Vec::new(),
        locations: Vec::new(),
        sharp: HashMap::new(),
        corners: component.vertices().len(),
    };
    // By patch and side.
    let mut pieces: Vec<[Vec<Polyline>; 4]> =
        component.patches().iter().map(|_| Default::default()).collect();
    for (index, edge) in (0u32..).zip(component.edges()) {
        let first = edge.sides[0];
        let ends = edge.vertices.map(|v| v as usize);
        out.positions[ends[0]] = body.position(&on_side(body, first.patch, first.side, first.range.0));
        if edge.collapsed {
            for s in &edge.sides {
                let (low, high) = (s.range.0.min(s.range.1), s.range.0.max(s.range.1));
                let line = vec![(low, edge.vertices[0]), (high, edge.vertices[0])];
                pieces[s.patch as usize][s.side as usize].push(line);
            }
            continue;
        }
        out.positions[ends[1]] = body.position(&on_side(body, first.patch, first.side, first.range.1));
        let parameters = edge_parameters(body, &first, step);
        let mut vertices = vec![edge.vertices[0]];
        for &t in &parameters[1..parameters.len() - 1] {
            vertices.push(out.positions.len() as u32);
            out.positions.push(body.position(&on_side(body, first.patch, first.side, t)));
        }
        vertices.push(edge.vertices[1]);
        if edge.sharp {
            out.sharp.extend(vertices.windows(2).map(|v| (ordered(v[0], v[1]), index)));
        }
        for s in &edge.sides {
            let fraction = |t: f64| (t - first.range.0) / (first.range.1 - first.range.0);
            let last = parameters.len() - 1;
            let mut line: Polyline = parameters
                .iter()
                .enumerate()
                .map(|(k, &t)| {
                    let guess = s.range.0 + fraction(t) * (s.range.1 - s.range.0);
                    let t = match k {
                        0 => s.range.0,
                        _ if k == last => s.range.1,
                        _ if *s == first => t,
                        _ if edge.is_affine() => guess,
                        _ => {
                            let hint = on_side(body, s.patch, s.side, guess);
                            let x = out.positions[vertices[k] as usize];
                            let foot = body.closest_point_on_edge(&x, index, &hint).location;
                            if s.side.holds_u() { foot.v } else { foot.u }
                        }
                    };
                    (t, vertices[k])
                })
                .collect();
            if s.range.1 < s.range.0 {
                line.reverse();
            }
            pieces[s.patch as usize][s.side as usize].push(line);
        }
    }
    for (patch, sides) in (0u32..).zip(pieces) {
        tessellate_patch(body, patch, sides, step, &mut out);
    }
    out
}

/// The two in increasing order.
pub(crate) fn ordered(a: u32, b: u32) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// Parameters along an edge's side, from its first vertex to its last.
fn edge_parameters(body: &Body, side: &EdgeSide, step: Step) -> Vec<f64> {
    let surface = &body.component().patches()[side.patch as usize].surface;
    let knots = if side.side.holds_u() { surface.knots_v() } else { surface.knots_u() };
    let (low, high) = (side.range.0.min(side.range.1), side.range.0.max(side.range.1));
    let margin = 1e-9 * (high - low);
    let inner = knots.breaks().iter().copied().filter(|&t| t > low + margin && t < high - margin);
    let breaks: Vec<f64> = std::iter::once(low).chain(inner).chain([high]).collect();
    let mut parameters = subdivide(&breaks, step, |t| vec![on_side(body, side.patch, side.side, t)], body);
    if side.range.1 < side.range.0 {
        parameters.reverse();
    }
    parameters
}

/// Breaks with steps between; `probes` gives the locations at a parameter whose curves are measured.
fn subdivide(breaks: &[f64], step: Step, probes: impl Fn(f64) -> Vec<Location>, body: &Body) -> Vec<f64> {
    let mut out = vec![breaks[0]];
    for pair in breaks.windows(2) {
        let at = |f: f64| pair[0] + f * (pair[1] - pair[0]);
        let curves = probes(pair[0]).len();
        let count = (0..curves).map(|k| step.count(|f| body.position(&probes(at(f))[k]))).max().unwrap_or(1);
        out.extend((1..count).map(|k| at(k as f64 / count as f64)));
        out.push(pair[1]);
    }
    out
}

/// Inner grid lines of one direction: at least one.
fn grid_lines(body: &Body, patch: u32, along_u: bool, step: Step) -> Vec<f64> {
    let surface = &body.component().patches()[patch as usize].surface;
    let [u, v] = surface.domain();
    let (knots, across) = if along_u { (surface.knots_u(), v) } else { (surface.knots_v(), u) };
    let probes = |t: f64| -> Vec<Location> {
        (0..PROBES)
            .map(|k| {
                let s = across.0 + k as f64 / (PROBES - 1) as f64 * (across.1 - across.0);
                if along_u { Location { patch, u: t, v: s } } else { Location { patch, u: s, v: t } }
            })
            .collect()
    };
    let lines = subdivide(knots.breaks(), step, probes, body);
    if lines.len() > 2 { lines[1..lines.len() - 1].to_vec() } else { vec![0.5 * (lines[0] + lines[1])] }
}

fn tessellate_patch(
    body: &Body,
    patch: u32,
    mut sides: [Vec<Polyline>; 4],
    step: Step,
    out: &mut Tessellation,
) {
    let flipped = body.component().patches()[patch as usize].flipped;
    let us = grid_lines(body, patch, true, step);
    let vs = grid_lines(body, patch, false, step);
    let base = out.positions.len() as u32;
    for &u in &us {
        for &v in &vs {
            out.positions.push(body.position(&Location { patch, u, v }));
        }
    }
    let columns = vs.len();
    let grid = |i: usize, j: usize| (base + (i * columns + j) as u32, Location { patch, u: us[i], v: vs[j] });
    let mut emit = |corners: [(u32, Location); 3]| {
        let [a, b, c] = if flipped { [corners[0], corners[2], corners[1]] } else { corners };
        if a.0 != b.0 && b.0 != c.0 && c.0 != a.0 {
            out.triangles.push([a.0, b.0, c.0]);
            out.locations.push([a.1, b.1, c.1]);
        }
    };
    for i in 1..us.len() {
        for j in 1..columns {
            let [a, b, c, d] = [grid(i - 1, j - 1), grid(i, j - 1), grid(i, j), grid(i - 1, j)];
            emit([a, b, c]);
            emit([a, c, d]);
        }
    }
    for side in Side::ALL {
        let pieces = &mut sides[side as usize];
        pieces.sort_by(|a, b| a[0].0.total_cmp(&b[0].0));
        let mut outer: Vec<(f64, (u32, Location))> = Vec::new();
        for &(t, vertex) in pieces.iter().flatten() {
            if outer.last().is_none_or(|&(_, (last, _))| last != vertex) || pieces.len() == 1 {
                outer.push((t, (vertex, on_side(body, patch, side, t))));
            }
        }
        let lines = if side.holds_u() { &vs } else { &us };
        let at = |k: usize| match side {
            Side::UMin => grid(0, k),
            Side::UMax => grid(us.len() - 1, k),
            Side::VMin => grid(k, 0),
            Side::VMax => grid(k, columns - 1),
        };
        let forward = matches!(side, Side::VMin | Side::UMax);
        let (mut i, mut j) = (0, 0);
        while i + 1 < outer.len() || j + 1 < lines.len() {
            let middle = |a: f64, b: f64| 0.5 * (a + b);
            let advance_outer = j + 1 == lines.len()
                || (i + 1 < outer.len()
                    && middle(outer[i].0, outer[i + 1].0) <= middle(lines[j], lines[j + 1]));
            let [a, b, c] = if advance_outer {
                i += 1;
                [outer[i - 1].1, outer[i].1, at(j)]
            } else {
                j += 1;
                [outer[i].1, at(j), at(j - 1)]
            };
            emit(if forward { [a, b, c] } else { [b, a, c] });
        }
    }
}
