//! Lines of edges for reports: trailing edges that were found, and what was left out.

use std::fmt;

use moldline_mesh::Vector3;

use super::sight::Sight;
use crate::panels::Panels;

/// A line of connected edges.
#[derive(Clone, Debug, PartialEq)]
pub struct EdgeLine {
    /// Mesh vertices along it; the first again at the end of a closed line.
    pub vertices: Vec<u32>,
    /// Position of the first vertex, m.
    pub from: [f64; 3],
    /// Position of the last vertex, m.
    pub to: [f64; 3],
    /// Length, m.
    pub length: f64,
    /// Length as seen along the flow: of its projection onto the plane x = 0, m.
    pub width: f64,
    /// Angle by which the outward normal turns at its edges: the mean over its length, degrees.
    pub turn: f64,
}

/// A line that looks like a trailing edge, but was not taken as one.
#[derive(Clone, Debug, PartialEq)]
pub struct LeftOut {
    /// The line.
    pub line: EdgeLine,
    /// Why.
    pub reason: Reason,
}

/// Why a line is no trailing edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Reason {
    /// The surface turns by less than the angle asked for.
    Flat,
    /// The surface turns as much beside it, or the line fades at both ends: cells of a smooth surface.
    Smooth,
    /// Swept by more than 80 degrees.
    AlongTheFlow,
    /// The border of a blunt base.
    Base,
    /// Sharp enough, but not in the groups or edges given, or where several lines meet.
    NotNamed,
}

impl Reason {
    /// All reasons.
    pub const ALL: [Self; 5] = [Self::Flat, Self::Smooth, Self::AlongTheFlow, Self::Base, Self::NotNamed];

    /// Its name in protocols.
    pub fn name(self) -> &'static str {
        match self {
            Self::Flat => "flat",
            Self::Smooth => "smooth",
            Self::AlongTheFlow => "along_the_flow",
            Self::Base => "base",
            Self::NotNamed => "not_named",
        }
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Flat => "the surface turns by less than the angle asked for",
            Self::Smooth => {
                "the surface turns as much beside it or fades to smooth at its ends: coarse cells of a body"
            }
            Self::AlongTheFlow => "swept by more than 80 degrees",
            Self::Base => "the border of a blunt base, where the flow runs off one side only",
            Self::NotNamed => "not in the groups or edges given",
        })
    }
}

impl fmt::Display for EdgeLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [first, last] = [self.vertices.first(), self.vertices.last()].map(|v| v.copied().unwrap_or(0));
        let ([a, b, c], [p, q, r]) = (self.from, self.to);
        write!(
            f,
            "vertices {first} to {last}, ({a:.4}, {b:.4}, {c:.4}) to ({p:.4}, {q:.4}, {r:.4}) m, {} edges, {:.4} m long, turning by {:.0} \
             degrees",
            self.vertices.len() - 1,
            self.length,
            self.turn
        )
    }
}

impl EdgeLine {
    /// The lines of a set of edges, each once; where more than two meet, lines end.
    pub(crate) fn of(
        panels: &Panels,
        points: &[Vector3],
        sights: &[Option<Sight>],
        edges: Vec<u32>,
    ) -> Vec<Self> {
        let mut free = vec![false; panels.edges.len()];
        edges.iter().for_each(|&e| free[e as usize] = true);
        let inside = free.clone();
        let ends_at = |point: u32| {
            panels.point_edges[point as usize].iter().filter(|e| inside[**e as usize]).count() != 2
        };
        let mut lines = Vec::new();
        let starts = |edge: &u32| {
            let e = &panels.edges[*edge as usize];
            [e.a, e.b].into_iter().find(|p| ends_at(*p))
        };
        let open = edges.iter().filter_map(|edge| starts(edge).map(|start| (*edge, start)));
        let closed = edges.iter().map(|edge| (*edge, panels.edges[*edge as usize].a));
        for (edge, start) in open.chain(closed) {
            if !free[edge as usize] {
                continue;
            }
            let (mut of_line, mut line, mut point) = (Vec::new(), vec![start], start);
            let mut next = Some(edge);
            while let Some(edge) = next {
                free[edge as usize] = false;
                of_line.push(edge);
                point = panels.other_end(edge, point);
                line.push(point);
                let at = panels.point_edges[point as usize].iter().copied();
                next = if ends_at(point) { None } else { at.into_iter().find(|e| free[*e as usize]) };
            }
            lines.push(Self::new(panels, points, sights, &line, &of_line));
        }
        lines.sort_by(|one, two| two.length.total_cmp(&one.length));
        lines
    }

    fn new(
        panels: &Panels,
        points: &[Vector3],
        sights: &[Option<Sight>],
        line: &[u32],
        edges: &[u32],
    ) -> Self {
        let length_of = |edge: &u32| {
            let e = &panels.edges[*edge as usize];
            (points[e.b as usize] - points[e.a as usize]).norm()
        };
        let length: f64 = edges.iter().map(length_of).sum();
        let across = |edge: &u32| sights[*edge as usize].map_or(0.0, |s| s.across * s.length);
        let turn = |edge: &u32| sights[*edge as usize].map_or(0.0, |s| s.turn);
        let turned: f64 = edges.iter().map(|e| turn(e) * length_of(e)).sum();
        let at = |point: Option<&u32>| point.map_or([0.0; 3], |p| points[*p as usize].into());
        Self {
            vertices: line.iter().map(|p| panels.vertex_of[*p as usize]).collect(),
            from: at(line.first()),
            to: at(line.last()),
            length,
            width: edges.iter().map(across).sum(),
            turn: turned / length,
        }
    }
}
