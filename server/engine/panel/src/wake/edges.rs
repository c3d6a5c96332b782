//! Trailing edges: found by the shape of the surface or in vertex groups, or given.
//!
//! A trailing edge is where the surface turns sharply outwards and the flow runs off both sides ([`super::sight`]). What is just below the
//! angle asked for belongs to a line if it continues one (hysteresis); a short gap between two ends is closed.

use moldline_mesh::{SurfaceMesh, Vector3};

use super::sight::Sight;
use crate::{EdgeLine, LeftOut, PanelError, Reason, TrailingEdges, bounds::within, panels::Panels};

/// Least angle between the normals at a trailing edge that is given, degrees.
const GIVEN: f64 = 30.0;
/// The same for edges between vertices of a group, for edges that close a gap, and for edges that are told of if they are left out.
const SHARP: f64 = 60.0;
/// Bounds of the angle by which edges are found, degrees.
const FOUND: [f64; 2] = [60.0, 180.0];
/// How far below the angle asked for an edge may be that continues a line, degrees.
const HYSTERESIS: f64 = 30.0;
/// From this angle on a surface is not smooth, whatever its cells, degrees.
const NEVER_SMOOTH: f64 = 120.0;
/// How much more than the surface beside it an edge below that angle has to turn.
const PROMINENCE: f64 = 2.0;
/// Sweep from which on it need not, degrees: edges along the flow are nearly parallel to it, and aft ends of bodies lie across the flow.
const STEEP: f64 = 60.0;
/// The same, where the streamwise angle is large enough. The ridges of a box that tapers aft turn by 90 degrees.
const SWEPT: f64 = 100.0;
/// Largest sweep of a trailing edge, degrees: beyond, an edge runs along the flow, as those of tips do.
const LARGEST_SWEEP: f64 = 80.0;
/// Least cosine between the flow and the way in which a panel ends at a trailing edge.
const RUNS_OFF: f64 = 0.2;
/// The same where the streamlines decide how sharp a swept edge is.
const RUNS_ALONG: f64 = 0.3;
/// Largest width of a tip's line, over that of the trailing edge, as seen along the flow.
const TIP: f64 = 0.5;
/// Least sweep of a tip's edge, degrees.
const TIP_SWEEP: f64 = 50.0;
/// Largest cosine between a tip's edge and the trailing edge as seen along the flow.
const CROSSES: f64 = 0.7;
/// Most edges of a line at the end of a body, and its largest length as a fraction of the surface's extent across the flow.
const BODY_END: (usize, f64) = (4, 0.3);
/// Least turn of an edge into which such a line fades, degrees.
const FADES: f64 = 20.0;
/// Most edges of a gap that is closed.
const GAP: usize = 3;
/// Least cosine between neighbouring edges of a line.
const STRAIGHT_ON: f64 = 0.5;

/// Trailing edges and what looks like one but is none.
pub(super) struct Found {
    /// The trailing edges, as edges of the panels.
    pub edges: Vec<u32>,
    /// Lines that were left out.
    pub left_out: Vec<LeftOut>,
}

/// Finds the trailing edges by a rule.
pub(super) fn find(
    mesh: &SurfaceMesh,
    panels: &Panels,
    points: &[Vector3],
    rule: &TrailingEdges,
) -> Result<Found, PanelError> {
    if *rule == TrailingEdges::None {
        return Ok(Found { edges: Vec::new(), left_out: Vec::new() });
    }
    let sights: Vec<Option<Sight>> =
        (0..panels.edges.len() as u32).map(|edge| Sight::new(panels, points, edge)).collect();
    let edges = match rule {
        TrailingEdges::None => Vec::new(),
        TrailingEdges::Angle { degrees } => {
            within("options.trailing_edges.degrees", *degrees, FOUND[0], FOUND[1])?;
            by_shape(panels, points, &sights, *degrees)
        }
        TrailingEdges::Groups(names) => grouped(mesh, panels, &sights, names)?,
        TrailingEdges::Edges(list) => given(panels, &sights, list)?,
    };
    let angle = if let TrailingEdges::Angle { degrees } = rule { Some(*degrees) } else { None };
    let left_out = left_out(panels, points, &sights, &edges, angle);
    if edges.is_empty() {
        return Err(PanelError::NoTrailingEdge { rule: rule.clone(), left_out });
    }
    Ok(Found { edges, left_out })
}

/// Edges where the surface turns by an angle and the flow runs off both sides, with what continues their lines.
fn by_shape(panels: &Panels, points: &[Vector3], sights: &[Option<Sight>], degrees: f64) -> Vec<u32> {
    let beside = beside(panels, sights);
    let shaped = |edge: usize, least: f64| {
        sights[edge].is_some_and(|s| {
            let swept = s.turn >= SWEPT && s.streamwise_turn >= least && s.least_off() >= RUNS_ALONG;
            let sharp = s.turn >= least || swept;
            sharp
                && s.sweep() <= LARGEST_SWEEP
                && s.least_off() >= RUNS_OFF
                && (s.turn >= NEVER_SMOOTH || s.sweep() > STEEP || s.turn >= PROMINENCE * beside[edge])
        })
    };
    let count = panels.edges.len();
    let mut chosen: Vec<bool> = (0..count).map(|edge| shaped(edge, degrees)).collect();
    let least = (degrees - HYSTERESIS).max(SHARP);
    let weak: Vec<bool> = (0..count).map(|edge| shaped(edge, least)).collect();
    continue_lines(panels, sights, &weak, &mut chosen);
    let gap: Vec<bool> = (0..count)
        .map(|edge| sights[edge].is_some_and(|s| s.turn >= SHARP && s.least_off() > 0.0 && s.sweep() <= 60.0))
        .collect();
    close_gaps(panels, sights, &gap, &mut chosen);
    drop_edges_of_tips(panels, sights, &mut chosen);
    drop_ends_of_bodies(panels, points, sights, &mut chosen);
    (0..count as u32).filter(|edge| chosen[*edge as usize]).collect()
}

/// For every edge, the lesser over its two panels of the largest angle at which their other edges along it turn, degrees: what a smooth
/// surface has on both sides.
fn beside(panels: &Panels, sights: &[Option<Sight>]) -> Vec<f64> {
    let mut of_panel = vec![[u32::MAX; 4]; panels.len()];
    for (index, e) in (0..).zip(&panels.edges) {
        for panel in [Some(e.left), e.right].into_iter().flatten() {
            if let Some(free) = of_panel[panel as usize].iter_mut().find(|edge| **edge == u32::MAX) {
                *free = index;
            }
        }
    }
    let at = |edge: usize, panel: u32, along: &Vector3| {
        let others =
            of_panel[panel as usize].iter().filter(|other| **other != u32::MAX && **other as usize != edge);
        let turns = others.filter_map(|other| sights[*other as usize].as_ref());
        let parallel = turns.filter(|s| s.along.dot(along).abs() > 0.7).map(|s| s.turn.abs());
        parallel.fold(0.0_f64, f64::max)
    };
    let of_edge = |(edge, e): (usize, &crate::panels::Edge)| match (sights[edge].as_ref(), e.right) {
        (Some(s), Some(right)) => at(edge, e.left, &s.along).min(at(edge, right, &s.along)),
        _ => 0.0,
    };
    panels.edges.iter().enumerate().map(of_edge).collect()
}

/// Whether two edges at a point go on as one line.
fn straight_on(panels: &Panels, sights: &[Option<Sight>], point: u32, one: u32, two: u32) -> bool {
    let away = |edge: u32| {
        let along = sights[edge as usize].as_ref().map_or_else(Vector3::zeros, |s| s.along);
        if panels.edges[edge as usize].a == point { along } else { -along }
    };
    away(one).dot(&away(two)) <= -STRAIGHT_ON
}

/// Adds candidates that continue a line of chosen edges at its end, again and again.
fn continue_lines(panels: &Panels, sights: &[Option<Sight>], candidate: &[bool], chosen: &mut [bool]) {
    let mut ends: Vec<u32> = ends(panels, chosen);
    while let Some(point) = ends.pop() {
        let at = &panels.point_edges[point as usize];
        let line: Vec<u32> = at.iter().copied().filter(|e| chosen[*e as usize]).collect();
        let [last] = line[..] else { continue };
        let next = at.iter().copied().filter(|e| candidate[*e as usize] && !chosen[*e as usize]);
        let mut next = next.filter(|e| straight_on(panels, sights, point, last, *e));
        if let (Some(edge), None) = (next.next(), next.next()) {
            chosen[edge as usize] = true;
            ends.push(panels.other_end(edge, point));
        }
    }
}

/// Closes gaps of few candidates between two ends of lines of chosen edges.
fn close_gaps(panels: &Panels, sights: &[Option<Sight>], candidate: &[bool], chosen: &mut [bool]) {
    for start in ends(panels, chosen) {
        let at = |point: u32| panels.point_edges[point as usize].iter().copied();
        let count = |point: u32, chosen: &[bool]| at(point).filter(|e| chosen[*e as usize]).count();
        let mut gap: Vec<u32> = Vec::new();
        let (mut point, mut last) = (start, at(start).find(|e| chosen[*e as usize]));
        while let Some(edge) = last.filter(|_| gap.len() <= GAP) {
            if !gap.is_empty() && count(point, chosen) == 1 {
                gap.iter().for_each(|e| chosen[*e as usize] = true);
                break;
            }
            let mut next =
                at(point).filter(|e| candidate[*e as usize] && !chosen[*e as usize] && !gap.contains(e));
            last = next.find(|e| straight_on(panels, sights, point, edge, *e));
            if let Some(edge) = last {
                gap.push(edge);
                point = panels.other_end(edge, point);
            }
        }
    }
}

/// Drops rear parts of tips. Beside a swept trailing edge they are as sharp as that, and the flow runs off both sides of them, too. But they lie on
/// a sharp line that leads from the corner of a wider trailing edge upstream, across it as seen along the flow, and at its end the flow no longer
/// runs off it.
fn drop_edges_of_tips(panels: &Panels, sights: &[Option<Sight>], chosen: &mut [bool]) {
    let at = |point: u32| panels.point_edges[point as usize].iter().copied();
    let is_sharp = |edge: u32| sights[edge as usize].is_some_and(|s| s.turn >= SHARP);
    let next = |point: u32, edge: u32, among: &dyn Fn(u32) -> bool| {
        at(point).find(|e| *e != edge && among(*e) && straight_on(panels, sights, point, edge, *e))
    };
    let leads_upstream = |point: u32, edge: u32| {
        let along = sights[edge as usize].map_or(0.0, |s| s.along.x);
        if panels.edges[edge as usize].a == point { along < 0.0 } else { along > 0.0 }
    };
    // From a point along an edge straight on, as far as it is so.
    let line =
        |mut point: u32, mut edge: u32, among: &dyn Fn(u32) -> bool, goes_on: &dyn Fn(u32, u32) -> bool| {
            let mut line = vec![edge];
            loop {
                point = panels.other_end(edge, point);
                match next(point, edge, among).filter(|next| goes_on(point, *next) && !line.contains(next)) {
                    Some(next) => edge = next,
                    None => return line,
                }
                line.push(edge);
            }
        };
    let width = |edges: &[u32]| -> f64 {
        edges.iter().filter_map(|e| sights[*e as usize]).map(|s| s.length * s.across).sum()
    };
    let crosses = |one: u32, two: u32| {
        let [one, two] = [one, two].map(|e| sights[e as usize].map_or_else(Vector3::zeros, |s| s.along));
        (one.y * two.y + one.z * two.z).abs() < CROSSES * one.yz().norm() * two.yz().norm()
    };
    let mut drop = Vec::new();
    for corner in 0..panels.point_edges.len() as u32 {
        for edge in at(corner).filter(|e| chosen[*e as usize]) {
            let widest = width(&line(corner, edge, &|e| chosen[e as usize], &|_, _| true));
            for side in at(corner).filter(|e| *e != edge && is_sharp(*e)) {
                if !crosses(edge, side) || !leads_upstream(corner, side) {
                    continue;
                }
                let tip = line(corner, side, &is_sharp, &leads_upstream);
                let ends_on = tip.last().is_some_and(|last| chosen[*last as usize]);
                let along: Vec<u32> = tip.into_iter().filter(|e| chosen[*e as usize]).collect();
                let swept = |e: &u32| sights[*e as usize].is_some_and(|s| s.sweep() >= TIP_SWEEP);
                if !ends_on && along.iter().all(swept) && width(&along) < TIP * widest {
                    drop.extend(along);
                }
            }
        }
    }
    drop.into_iter().for_each(|edge| chosen[edge as usize] = false);
}

/// Drops short lines that fade at both ends: where cells are coarse, the end of a body looks like a trailing edge.
fn drop_ends_of_bodies(panels: &Panels, points: &[Vector3], sights: &[Option<Sight>], chosen: &mut [bool]) {
    let across = |axis: usize| {
        let (low, high) = points
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p[axis]), h.max(p[axis])));
        high - low
    };
    let longest = BODY_END.1 * across(1).hypot(across(2));
    for start in ends(panels, chosen) {
        let at = |point: u32| panels.point_edges[point as usize].iter().copied();
        let fades = |point: u32, last: u32| {
            at(point).filter(|e| *e != last).any(|e| {
                sights[e as usize].is_some_and(|s| s.turn >= FADES)
                    && straight_on(panels, sights, point, last, e)
            })
        };
        let (mut line, mut point, mut length): (Vec<u32>, u32, f64) = (Vec::new(), start, 0.0);
        while let Some(edge) = at(point).find(|e| chosen[*e as usize] && !line.contains(e)) {
            let other = panels.other_end(edge, point);
            length += (points[other as usize] - points[point as usize]).norm();
            point = other;
            line.push(edge);
            if line.len() > BODY_END.0 {
                break;
            }
        }
        let (Some(&first), Some(&last)) = (line.first(), line.last()) else { continue };
        if line.len() <= BODY_END.0 && length <= longest && fades(start, first) && fades(point, last) {
            line.iter().for_each(|edge| chosen[*edge as usize] = false);
        }
    }
}

/// Points at which one chosen edge ends, in order.
fn ends(panels: &Panels, chosen: &[bool]) -> Vec<u32> {
    let is_end = |at: &[u32]| at.iter().filter(|e| chosen[**e as usize]).count() == 1;
    (0..).zip(&panels.point_edges).filter(|(_, at)| is_end(at)).map(|(point, _)| point).collect()
}

/// Edges between vertices of a group.
fn grouped(
    mesh: &SurfaceMesh,
    panels: &Panels,
    sights: &[Option<Sight>],
    names: &[String],
) -> Result<Vec<u32>, PanelError> {
    let all = 0..panels.edges.len() as u32;
    let mut inside = vec![false; panels.vertex_of.len()];
    let mut found = vec![false; panels.edges.len()];
    for (index, name) in names.iter().enumerate() {
        let group = mesh.vertex_group(name).ok_or_else(|| PanelError::UnknownGroup {
            field: format!("trailing_edges[{index}]"),
            name: name.clone(),
            known: mesh.vertex_groups.iter().map(|g| g.name.clone()).collect(),
        })?;
        inside.fill(false);
        for vertex in &group.indices {
            if let Some(point) = panels.point_of(*vertex) {
                inside[point as usize] = true;
            }
        }
        for edge in all.clone() {
            let e = &panels.edges[edge as usize];
            found[edge as usize] |= inside[e.a as usize]
                && inside[e.b as usize]
                && sights[edge as usize].is_some_and(|s| s.turn >= SHARP);
        }
    }
    Ok(all.filter(|e| found[*e as usize]).collect())
}

/// Edges given by their mesh vertices. Edges of the half that is not solved stand for their images.
fn given(panels: &Panels, sights: &[Option<Sight>], list: &[[u32; 2]]) -> Result<Vec<u32>, PanelError> {
    let mut edges = Vec::with_capacity(list.len());
    for (index, &edge) in list.iter().enumerate() {
        if edge.iter().any(|&v| v as usize >= panels.vertices) {
            return Err(PanelError::NotAnEdge { index, edge });
        }
        let image = |v: u32| panels.partner.as_ref()?.iter().position(|p| *p == v).map(|point| point as u32);
        let ends =
            [panels.point_of(edge[0]).zip(panels.point_of(edge[1])), image(edge[0]).zip(image(edge[1]))];
        let (a, b) = ends.into_iter().flatten().next().ok_or(PanelError::NotAnEdge { index, edge })?;
        let found = panels.edge_between(a, b).ok_or(PanelError::NotAnEdge { index, edge })?;
        let sight = sights[found as usize].ok_or(PanelError::NotAnEdge { index, edge })?;
        if sight.turn < GIVEN {
            return Err(PanelError::BluntTrailingEdge { edge, angle: sight.turn, least: GIVEN });
        }
        edges.push(found);
    }
    edges.sort_unstable();
    edges.dedup();
    Ok(edges)
}

/// Lines of edges that are sharp and point downstream, but were not chosen, and why. `angle` is that by which they were looked for, if at all.
fn left_out(
    panels: &Panels,
    points: &[Vector3],
    sights: &[Option<Sight>],
    chosen: &[u32],
    angle: Option<f64>,
) -> Vec<LeftOut> {
    let (by_angle, least) = (angle.is_some(), angle.unwrap_or(NEVER_SMOOTH));
    let beside = beside(panels, sights);
    let reason = |edge: u32| {
        let s = sights[edge as usize].filter(|s| s.turn >= SHARP && chosen.binary_search(&edge).is_err())?;
        let base = (0..2).any(|k| s.off[k] >= 0.7 && s.aft[1 - k] >= 0.7);
        Some(if s.sweep() > LARGEST_SWEEP {
            // Edges of tips and boxes run along the flow, and are no trailing edges.
            if s.least_off() < 0.7 || s.turn < least || s.sweep() > 87.0 {
                return None;
            }
            Reason::AlongTheFlow
        } else if s.least_off() < RUNS_OFF {
            if !base {
                return None;
            }
            Reason::Base
        } else if s.turn < NEVER_SMOOTH && s.sweep() <= STEEP && s.turn < PROMINENCE * beside[edge as usize] {
            Reason::Smooth
        } else if s.turn < least {
            Reason::Flat
        } else if by_angle {
            Reason::Smooth
        } else {
            Reason::NotNamed
        })
    };
    let reasons: Vec<Option<Reason>> = (0..panels.edges.len() as u32).map(reason).collect();
    let mut lines = Vec::new();
    for why in Reason::ALL {
        let edges = (0..reasons.len() as u32).filter(|e| reasons[*e as usize] == Some(why)).collect();
        for line in EdgeLine::of(panels, points, sights, edges) {
            lines.push(LeftOut { line, reason: why });
        }
    }
    lines
}
