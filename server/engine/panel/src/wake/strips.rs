//! Strips of constant doublet strength behind trailing edges, in the order along each line of them.

use moldline_mesh::Vector3;

use crate::{PanelError, panels::Panels};

/// One strip.
#[derive(Clone, Debug)]
pub(crate) struct Strip {
    /// From here, as the upper panel runs through it ...
    pub a: u32,
    /// ... to here.
    pub b: u32,
    pub upper: u32,
    pub lower: u32,
    /// The neighbours at `a` and at `b`.
    pub beside: [Beside; 2],
}

/// The neighbour of a strip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Beside {
    /// Another strip.
    Strip(u32),
    /// None: the wake ends there.
    Tip,
    /// The strip's own mirror image in the plane of symmetry.
    Plane,
    /// A body, over which the circulation goes on to the point.
    Body(u32),
}

/// A trailing edge as a line of them runs through it.
#[derive(Clone, Copy)]
struct Step {
    edge: u32,
    from: u32,
    to: u32,
}

impl Step {
    /// The panels on its left and on its right.
    fn sides(&self, panels: &Panels) -> (u32, u32) {
        let e = &panels.edges[self.edge as usize];
        let (left, right) = (e.left, e.right.unwrap_or(e.left));
        if e.a == self.from { (left, right) } else { (right, left) }
    }
}

/// The strips of trailing edges, oriented alike along each line; a line's ends are tips.
pub(super) fn along_lines(
    panels: &Panels,
    points: &[Vector3],
    edges: &[u32],
) -> Result<Vec<Strip>, PanelError> {
    let mut at = vec![Vec::new(); points.len()];
    for &edge in edges {
        let e = &panels.edges[edge as usize];
        at[e.a as usize].push(edge);
        at[e.b as usize].push(edge);
    }
    if let Some(point) = at.iter().position(|edges| edges.len() > 2) {
        let ends = |edge: &u32| {
            let e = &panels.edges[*edge as usize];
            [panels.vertex_of[e.a as usize], panels.vertex_of[e.b as usize]]
        };
        let edges = at[point].iter().map(ends).collect();
        return Err(PanelError::BranchedTrailingEdge { vertex: panels.vertex_of[point], edges });
    }
    let mut strips = Vec::with_capacity(edges.len());
    for mut line in lines(panels, edges, &at) {
        orient(panels, points, &mut line);
        add_line(panels, &line, &mut strips);
    }
    Ok(strips)
}

/// Lines of connected edges: those with ends first, then closed ones. `at` has the edges at every point.
fn lines(panels: &Panels, edges: &[u32], at: &[Vec<u32>]) -> Vec<Vec<Step>> {
    let is_end = |edge: u32, point: u32| at[point as usize] == [edge];
    let has_end = |edge: &&u32| {
        let e = &panels.edges[**edge as usize];
        is_end(**edge, e.a) || is_end(**edge, e.b)
    };
    let mut seen = vec![false; panels.edges.len()];
    let mut lines = Vec::new();
    for &start in edges.iter().filter(has_end).chain(edges) {
        if seen[start as usize] {
            continue;
        }
        let e = &panels.edges[start as usize];
        let mut from = if is_end(start, e.b) { e.b } else { e.a };
        let mut line = Vec::new();
        let mut edge = start;
        loop {
            seen[edge as usize] = true;
            let e = &panels.edges[edge as usize];
            let to = if e.a == from { e.b } else { e.a };
            line.push(Step { edge, from, to });
            let next = at[to as usize].iter().find(|next| !seen[**next as usize]);
            let Some(&next) = next else { break };
            (edge, from) = (next, to);
        }
        lines.push(line);
    }
    lines
}

/// Turns a line so that the side on its left looks up more than the other: that is the upper one.
fn orient(panels: &Panels, points: &[Vector3], line: &mut [Step]) {
    let area = |panel: u32| {
        let [a, b, c, d] = panels.corners[panel as usize].map(|v| points[v as usize]);
        (c - a).cross(&(d - b)).z
    };
    let up: f64 =
        line.iter().map(|step| step.sides(panels)).map(|(along, against)| area(along) - area(against)).sum();
    if up < 0.0 {
        line.reverse();
        line.iter_mut().for_each(|step| std::mem::swap(&mut step.from, &mut step.to));
    }
}

/// Adds the strips of a line.
fn add_line(panels: &Panels, line: &[Step], strips: &mut Vec<Strip>) {
    let first = strips.len();
    let count = line.len();
    let closed = line[0].from == line[count - 1].to;
    for (k, step) in line.iter().enumerate() {
        let (upper, lower) = step.sides(panels);
        let beside = |k: usize| Beside::Strip((first + k) as u32);
        let before = match k {
            0 if closed => beside(count - 1),
            0 => Beside::Tip,
            _ => beside(k - 1),
        };
        let after = match k + 1 {
            next if next < count => beside(next),
            _ if closed => beside(0),
            _ => Beside::Tip,
        };
        strips.push(Strip { a: step.from, b: step.to, upper, lower, beside: [before, after] });
    }
}
