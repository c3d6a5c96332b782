//! Paths over bodies: from the end of a trailing edge on a body along edges of the mesh to that body's aft end.
//!
//! The body is what the flow runs onto behind the trailing edge: the part of the surface that grooves bound, such as its junctions with wings.
//! Its aft ends are where no way leads on downstream. A path never turns back upstream, and never touches a trailing edge.

use std::{cmp::Reverse, collections::BinaryHeap};

use moldline_mesh::Vector3;

use super::{
    sight::Sight,
    strips::{Beside, Strip},
};
use crate::{PanelError, panels::Panels};

/// How the surface behind a trailing edge's end lies if the body goes on downstream: cosine of its angle to the x axis.
const DOWNSTREAM: f64 = 0.5;
/// Largest turn of a ridge, degrees: what is sharper is the edge of a wing.
const SHARP: f64 = 60.0;
/// A groove turns inwards by at least so much, degrees.
const GROOVE: f64 = 30.0;
/// How far upstream a step of a path may lead: cosine.
const UPSTREAM: f64 = 0.2;
/// Distance along x, as a fraction of the surface's extent, within which points end a body together.
const TOGETHER: f64 = 1e-6;

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
            continue;
        }
        let onto = onto(panels, points, trailing, point);
        if !onto.is_empty() {
            let path = path(panels, points, trailing, point, &onto)?;
            strip.beside[side] = Beside::Body(path[path.len() - 1]);
            paths[side] = Some(path);
        }
    }
    Ok(paths)
}

/// The panels onto which the flow runs behind a trailing edge's end: those whose sectors at the point have the flow's direction in them. At a tip it
/// leaves the surface between two sectors, whatever the sweep. Over a ridge, which is no wing's edge, the sectors on both sides count together.
fn onto(panels: &Panels, points: &[Vector3], trailing: &[bool], point: u32) -> Vec<u32> {
    let at = points[point as usize];
    let mut onto = Vec::new();
    for &edge in &panels.point_edges[point as usize] {
        let e = &panels.edges[edge as usize];
        let along = points[panels.other_end(edge, point) as usize] - at;
        let sectors: Vec<(u32, Sector)> = [Some(e.left), e.right]
            .into_iter()
            .flatten()
            .map(|p| (p, Sector::new(panels, points, p, point)))
            .collect();
        for (panel, sector) in &sectors {
            if sector.has_flow(&sector.normal) {
                onto.push(*panel);
            }
        }
        let [(one, first), (two, second)] = &sectors[..] else { continue };
        let smooth = Sight::new(panels, points, edge).is_none_or(|s| s.turn < SHARP);
        if trailing[edge as usize] || !smooth || along.x <= DOWNSTREAM * along.norm() {
            continue;
        }
        let normal = (first.normal + second.normal).normalize();
        if first.has_flow(&normal) || second.has_flow(&normal) {
            onto.extend([*one, *two]);
        }
    }
    onto.sort_unstable();
    onto.dedup();
    onto
}

/// A panel as seen from one of its corners.
struct Sector {
    /// To the next corner, and to the one before.
    sides: [Vector3; 2],
    normal: Vector3,
}

impl Sector {
    fn new(panels: &Panels, points: &[Vector3], panel: u32, point: u32) -> Self {
        let corners =
            &panels.corners[panel as usize][..if panels.is_triangle(panel as usize) { 3 } else { 4 }];
        let (count, own) = (corners.len(), corners.iter().position(|c| *c == point).unwrap_or(0));
        let to = |k: usize| points[corners[k % count] as usize] - points[point as usize];
        let sides = [to(own + 1), to(own + count - 1)];
        Self { normal: sides[0].cross(&sides[1]).normalize(), sides }
    }

    /// Whether the flow's direction lies between the sides as seen along a normal, and not too far from their plane.
    fn has_flow(&self, normal: &Vector3) -> bool {
        let flow = Vector3::x() - normal * normal.x;
        let turns = |a: &Vector3, b: &Vector3| normal.dot(&a.cross(b)) >= -TOGETHER * a.norm();
        flow.norm() > DOWNSTREAM && turns(&self.sides[0], &flow) && turns(&flow, &self.sides[1])
    }
}

/// The path from a point to an aft end of its body that keeps nearest to the straight line downstream: with the least integral of
/// the squared distance from it. If the body has none, that of the whole connected surface counts.
fn path(
    panels: &Panels,
    points: &[Vector3],
    trailing: &[bool],
    start: u32,
    onto: &[u32],
) -> Result<Vec<u32>, PanelError> {
    let mut blocked = vec![false; points.len()];
    for (edge, e) in panels.edges.iter().enumerate() {
        if trailing[edge] {
            [e.a, e.b].iter().for_each(|&p| blocked[p as usize] = p != start);
        }
    }
    let is_end = aft_ends(panels, points, &blocked);
    let body = body(panels, points, onto);
    let from = points[start as usize];
    let deviation = |p: &Vector3| {
        let d = p - from;
        d.y * d.y + d.z * d.z + d.x.min(0.0).powi(2)
    };
    let step = |on_body: bool| {
        let (blocked, body) = (&blocked, &body);
        move |edge: u32, point: u32, other: u32| {
            let e = &panels.edges[edge as usize];
            let inside = !on_body || [Some(e.left), e.right].iter().flatten().any(|p| body[*p as usize]);
            if trailing[edge as usize] || blocked[other as usize] || !inside {
                return None;
            }
            let (p, q) = (&points[point as usize], &points[other as usize]);
            let length = (q - p).norm();
            if q.x - p.x < -UPSTREAM * length {
                return None;
            }
            // Where the line lies on the body, the shorter way counts.
            Some(length * (0.5 * (deviation(p) + deviation(q)) + 0.01 * length * length))
        }
    };
    least_cost_path(panels, start, &is_end, step(true))
        .or_else(|| least_cost_path(panels, start, &is_end, step(false)))
        .ok_or(PanelError::NoCarryOver { vertex: panels.vertex_of[start as usize] })
}

/// The panels that are connected with the first ones without a groove between them.
fn body(panels: &Panels, points: &[Vector3], onto: &[u32]) -> Vec<bool> {
    let mut at = vec![[u32::MAX; 4]; panels.len()];
    for (index, e) in (0..).zip(&panels.edges) {
        for panel in [Some(e.left), e.right].into_iter().flatten() {
            if let Some(free) = at[panel as usize].iter_mut().find(|edge| **edge == u32::MAX) {
                *free = index;
            }
        }
    }
    let mut inside = vec![false; panels.len()];
    let mut queue = onto.to_vec();
    queue.iter().for_each(|&panel| inside[panel as usize] = true);
    while let Some(panel) = queue.pop() {
        for &edge in at[panel as usize].iter().filter(|edge| **edge != u32::MAX) {
            let e = &panels.edges[edge as usize];
            let other = if e.left == panel { e.right } else { Some(e.left) };
            let Some(other) = other.filter(|p| !inside[*p as usize]) else { continue };
            if Sight::new(panels, points, edge).is_some_and(|s| s.turn > -GROOVE) {
                inside[other as usize] = true;
                queue.push(other);
            }
        }
    }
    inside
}

/// Whether a body ends at a point: no edge leads on downstream. Of points that end it together the one in their middle counts, on the plane of
/// symmetry if they reach it.
fn aft_ends(panels: &Panels, points: &[Vector3], blocked: &[bool]) -> Vec<bool> {
    let extent = points.iter().fold(0.0_f64, |m, p| m.max(p.amax()));
    let tolerance = TOGETHER * extent;
    let x = |p: u32| points[p as usize].x;
    let mut is_end = vec![false; points.len()];
    let mut seen = vec![false; points.len()];
    for point in 0..points.len() as u32 {
        if seen[point as usize] {
            continue;
        }
        seen[point as usize] = true;
        let (mut together, mut next, mut goes_on) = (vec![point], 0, false);
        while let Some(&p) = together.get(next) {
            next += 1;
            for &edge in &panels.point_edges[p as usize] {
                let other = panels.other_end(edge, p);
                if x(other) > x(p) + tolerance {
                    goes_on = true;
                } else if x(other) >= x(p) - tolerance && !seen[other as usize] {
                    seen[other as usize] = true;
                    together.push(other);
                }
            }
        }
        if goes_on {
            continue;
        }
        let middle = together.iter().map(|p| points[*p as usize]).sum::<Vector3>() / together.len() as f64;
        let on_plane = |p: &u32| panels.on_plane[*p as usize];
        let reaches = together.iter().any(|p| on_plane(p) && !blocked[*p as usize]);
        let end = together.into_iter().filter(|p| !blocked[*p as usize] && (on_plane(p) || !reaches)).min_by(
            |p, q| (points[*p as usize] - middle).norm().total_cmp(&(points[*q as usize] - middle).norm()),
        );
        if let Some(end) = end {
            is_end[end as usize] = true;
        }
    }
    is_end
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

/// Dijkstra's path of least cost to any goal. `step` has the cost of an edge from a point to its other end; none if it is closed.
fn least_cost_path(
    panels: &Panels,
    start: u32,
    is_goal: &[bool],
    step: impl Fn(u32, u32, u32) -> Option<f64>,
) -> Option<Vec<u32>> {
    let count = panels.point_edges.len();
    let mut cost = vec![f64::INFINITY; count];
    let mut previous = vec![u32::MAX; count];
    let mut queue = BinaryHeap::from([Reverse((Cost(0.0), start))]);
    cost[start as usize] = 0.0;
    let mut goal = None;
    while let Some(Reverse((Cost(so_far), point))) = queue.pop() {
        if is_goal[point as usize] {
            goal = Some(point);
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
    let mut path = vec![goal?];
    while let Some(&last) = path.last().filter(|p| **p != start) {
        path.push(previous[last as usize]);
    }
    path.reverse();
    Some(path)
}
