//! Paths over bodies: from the end of a trailing edge on a body along edges of the mesh to the body's aft end.

use std::{cmp::Reverse, collections::BinaryHeap};

use moldline_mesh::Vector3;

use super::strips::{Beside, Strip};
use crate::{PanelError, panels::Panels, symmetry::SYMMETRY_TOLERANCE};

/// How an edge at a trailing edge's end points if the body goes on downstream: cosine of its angle to the x axis.
const DOWNSTREAM: f64 = 0.5;

/// The paths from `a` and from `b` of a strip, where it ends on a body; sets [`Strip::beside`] where it does or ends on the plane of symmetry.
pub(super) fn over_bodies(
    panels: &Panels,
    points: &[Vector3],
    trailing: &[bool],
    strip: &mut Strip,
) -> Result<[Option<Vec<u32>>; 2], PanelError> {
    let mut paths = [None, None];
    for (side, point) in [strip.a, strip.b].into_iter().enumerate() {
        if strip.beside[side] != Beside::Tip {
            continue;
        }
        if panels.on_plane[point as usize] {
            strip.beside[side] = Beside::Plane;
        } else if goes_on(panels, points, trailing, point) {
            let path = path(panels, points, trailing, point)?;
            strip.beside[side] = Beside::Body(path[path.len() - 1]);
            paths[side] = Some(path);
        }
    }
    Ok(paths)
}

/// Whether the surface goes on downstream of a trailing edge's end.
fn goes_on(panels: &Panels, points: &[Vector3], trailing: &[bool], point: u32) -> bool {
    panels.point_edges[point as usize].iter().any(|&edge| {
        let along = points[panels.other_end(edge, point) as usize] - points[point as usize];
        !trailing[edge as usize] && along.x > DOWNSTREAM * along.norm()
    })
}

/// The path from a point to the aft end of its body that keeps nearest to the straight line downstream: with the least integral of
/// the squared distance from it.
fn path(panels: &Panels, points: &[Vector3], trailing: &[bool], start: u32) -> Result<Vec<u32>, PanelError> {
    let none = PanelError::NoCarryOver { vertex: panels.vertex_of[start as usize] };
    let mut blocked = vec![false; points.len()];
    for (edge, e) in panels.edges.iter().enumerate() {
        if trailing[edge] {
            [e.a, e.b].iter().for_each(|&p| blocked[p as usize] = p != start);
        }
    }
    let goal = aft_end(panels, points, &blocked, start).ok_or(none.clone())?;
    let from = points[start as usize];
    let deviation = |p: &Vector3| {
        let d = p - from;
        d.y * d.y + d.z * d.z + d.x.min(0.0).powi(2)
    };
    let step = |edge: u32, point: u32, other: u32| {
        if trailing[edge as usize] || blocked[other as usize] {
            return None;
        }
        let (p, q) = (&points[point as usize], &points[other as usize]);
        let length = (q - p).norm();
        // Where the line lies on the body, the shorter way counts.
        Some(length * (0.5 * (deviation(p) + deviation(q)) + 0.01 * length * length))
    };
    least_cost_path(panels, start, goal, step).ok_or(none)
}

/// The aftmost point on the plane of symmetry of a point's body.
fn aft_end(panels: &Panels, points: &[Vector3], blocked: &[bool], start: u32) -> Option<u32> {
    let piece = panels.piece[start as usize];
    let extent = points.iter().fold(0.0_f64, |m, p| m.max(p.amax()));
    let on_plane = |p: &u32| points[*p as usize].y.abs() <= SYMMETRY_TOLERANCE * extent;
    let x = |p: &u32| points[*p as usize].x;
    (0..points.len() as u32)
        .filter(|p| panels.piece[*p as usize] == piece && !blocked[*p as usize])
        .filter(on_plane)
        .max_by(|p, q| x(p).total_cmp(&x(q)))
}

/// Cost of a path, ordered.
#[derive(Clone, Copy, PartialEq)]
struct Cost(f64);

impl Eq for Cost {}
impl PartialOrd for Cost {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Cost {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}

/// Dijkstra's path of least cost. `step` has the cost of an edge from a point to its other end; none if it is closed.
fn least_cost_path(
    panels: &Panels,
    start: u32,
    goal: u32,
    step: impl Fn(u32, u32, u32) -> Option<f64>,
) -> Option<Vec<u32>> {
    let count = panels.point_edges.len();
    let mut cost = vec![f64::INFINITY; count];
    let mut previous = vec![u32::MAX; count];
    let mut queue = BinaryHeap::from([Reverse((Cost(0.0), start))]);
    cost[start as usize] = 0.0;
    while let Some(Reverse((Cost(so_far), point))) = queue.pop() {
        if point == goal {
            break;
        }
        if so_far > cost[point as usize] {
            continue;
        }
        for &edge in &panels.point_edges[point as usize] {
            let other = panels.other_end(edge, point);
            let Some(step) = step(edge, point, other) else { continue };
            let through = so_far + step;
            if through < cost[other as usize] {
                cost[other as usize] = through;
                previous[other as usize] = point;
                queue.push(Reverse((Cost(through), other)));
            }
        }
    }
    if cost[goal as usize].is_infinite() {
        return None;
    }
    let mut path = vec![goal];
    while let Some(&last) = path.last().filter(|p| **p != start) {
        path.push(previous[last as usize]);
    }
    path.reverse();
    Some(path)
}
