//! Wakes: where they leave the surface, and of which strips they consist.
//!
//! From every trailing edge a strip of constant doublet strength (upper minus lower potential, [`crate::kutta`]) runs
//! downstream along x to infinity. Where a trailing edge ends on a body, the circulation of its last strip goes on over
//! the body: the strip's inner border then follows edges of the mesh along the body, near the straight line
//! downstream, to the body's aft end on the plane of symmetry. The potential jumps across those edges by the strip's circulation, so that
//! no vortex lies on the body, and what matters of the path is only that the sheet beside it is outside the body.

use std::{cmp::Reverse, collections::BinaryHeap};

use moldline_mesh::{SurfaceMesh, Vector3};

use crate::{PanelError, TrailingEdges, topology::Panels};

/// Least angle between the normals at a trailing edge that is named, degrees.
const NAMED: f64 = 30.0;
/// The same for edges between vertices of a group.
const GROUPED: f64 = 60.0;
/// How an edge at a trailing edge's end points if the body goes on downstream: cosine of its angle to the x axis.
const DOWNSTREAM: f64 = 0.5;
/// What counts as touching, as a fraction of a length.
const TOUCH: f64 = 1e-9;

/// A corner of a wake: `x` of one point (not ahead of the other), `y` and `z` of another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Corner {
    pub x: u32,
    pub yz: u32,
}

impl Corner {
    fn of(point: u32) -> Self {
        Self { x: point, yz: point }
    }

    pub fn position(&self, points: &[Vector3]) -> Vector3 {
        let (x, at) = (&points[self.x as usize], &points[self.yz as usize]);
        Vector3::new(x.x.max(at.x), at.y, at.z)
    }
}

/// A part of a strip, counter-clockwise as seen from its upper side.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Piece {
    /// From `[p, q]` along x to infinity.
    Strip([Corner; 2]),
    /// A quadrilateral.
    Quad([Corner; 4]),
}

/// What the neighbour of a strip is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Beside {
    /// Another strip.
    Strip(u32),
    /// Nothing: the wake ends there.
    Tip,
    /// Its own mirror image in the plane of symmetry.
    Plane,
    /// A body, over which its circulation goes on to the point.
    Body(u32),
}

/// One strip of constant strength.
#[derive(Clone, Debug)]
pub(crate) struct Strip {
    /// The trailing edge.
    pub edge: u32,
    /// From here, as the upper panel runs through it ...
    pub a: u32,
    /// ... to here.
    pub b: u32,
    pub upper: u32,
    pub lower: u32,
    /// What lies beside `a` and beside `b`.
    pub beside: [Beside; 2],
    pub pieces: Vec<Piece>,
}

/// A jump of the potential across an edge that is not the panels' own.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Jump {
    pub edge: u32,
    pub strip: u32,
    /// -1 if the edge's left panel is the upper one, else 1.
    pub sign: f64,
}

/// The border of strips along x.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray {
    pub point: u32,
    pub strip: u32,
    /// 1 if the strip's border runs downstream here.
    pub sign: f64,
}

/// All wakes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Wakes {
    pub strips: Vec<Strip>,
    /// Trailing edges and edges of paths over bodies.
    pub jumps: Vec<Jump>,
    pub rays: Vec<Ray>,
    /// Whether an edge of the panels is a trailing edge.
    pub trailing: Vec<bool>,
}

impl Wakes {
    pub fn new(mesh: &SurfaceMesh, panels: &Panels, rule: &TrailingEdges) -> Result<Self, PanelError> {
        let points = panels.gather(&mesh.vertices);
        let edges = find(mesh, panels, &points, rule)?;
        let mut trailing = vec![false; panels.edges.len()];
        edges.iter().for_each(|&e| trailing[e as usize] = true);
        let mut strips = oriented(panels, &points, &edges)?;
        let mut wakes = Self { strips: Vec::new(), jumps: Vec::new(), rays: Vec::new(), trailing };
        let mut paths = Vec::with_capacity(strips.len());
        for strip in &mut strips {
            let mut of_strip = [None, None];
            for (side, point) in [strip.a, strip.b].into_iter().enumerate() {
                if strip.beside[side] != Beside::Tip {
                    continue;
                }
                if panels.on_plane[point as usize] {
                    strip.beside[side] = Beside::Plane;
                } else if goes_on(panels, &points, &wakes.trailing, point) {
                    let path = path(panels, &points, &wakes.trailing, point)?;
                    strip.beside[side] = Beside::Body(path[path.len() - 1]);
                    of_strip[side] = Some(path);
                }
            }
            paths.push(of_strip);
        }
        for (index, (strip, of_strip)) in strips.iter_mut().zip(paths).enumerate() {
            let strip_index = index as u32;
            let edge = &panels.edges[strip.edge as usize];
            let sign = if edge.left == strip.upper { -1.0 } else { 1.0 };
            wakes.jumps.push(Jump { edge: strip.edge, strip: strip_index, sign });
            let (a, b) = (strip.a, strip.b);
            let mut ends = [a, b];
            match of_strip {
                [None, None] => strip.pieces.push(Piece::Strip([Corner::of(b), Corner::of(a)])),
                [Some(_), Some(_)] => {
                    return Err(PanelError::NoCarryOver { vertex: panels.vertex_of[a as usize] });
                }
                [from_a, from_b] => {
                    let at_a = from_a.is_some();
                    let path = from_a.or(from_b).unwrap_or_default();
                    let outer = if at_a { b } else { a };
                    // The sheet begins with the whole trailing edge, also if that runs upstream from the body on.
                    let beside = |q: u32| Corner { x: if q == path[0] { outer } else { q }, yz: outer };
                    for pair in path.windows(2) {
                        let (q, next) = (pair[0], pair[1]);
                        let (q_, next_) = (Corner::of(q), Corner::of(next));
                        strip.pieces.push(Piece::Quad(if at_a {
                            [beside(q), q_, next_, beside(next)]
                        } else {
                            [next_, q_, beside(q), beside(next)]
                        }));
                        // The upper panel runs against the sheet's border: from `q` on if the border comes back along `b`.
                        let upper_runs = if at_a { [next, q] } else { [q, next] };
                        let edge = panels
                            .edge_between(q, next)
                            .ok_or(PanelError::NoCarryOver { vertex: panels.vertex_of[q as usize] })?;
                        let left_is_upper = panels.edges[edge as usize].a == upper_runs[0];
                        let sign = if left_is_upper { -1.0 } else { 1.0 };
                        wakes.jumps.push(Jump { edge, strip: strip_index, sign });
                    }
                    let last = path[path.len() - 1];
                    strip.pieces.push(Piece::Strip(if at_a {
                        [beside(last), Corner::of(last)]
                    } else {
                        [Corner::of(last), beside(last)]
                    }));
                    ends[usize::from(!at_a)] = last;
                }
            }
            wakes.rays.push(Ray { point: ends[0], strip: strip_index, sign: 1.0 });
            wakes.rays.push(Ray { point: ends[1], strip: strip_index, sign: -1.0 });
        }
        wakes.strips = strips;
        Ok(wakes)
    }
}

impl Wakes {
    /// That no strip passes through a cell: seen along x, no edge of a cell downstream crosses the trailing edge. The sheets
    /// beside a body are not asked: they begin on it.
    pub fn check(&self, panels: &Panels, points: &[Vector3]) -> Result<(), PanelError> {
        for strip in &self.strips {
            for piece in &strip.pieces {
                let Piece::Strip([p, q]) = piece else { continue };
                let own = [p.x, q.x, p.yz, q.yz];
                let (p, q) = (p.position(points), q.position(points));
                let along = q - p;
                let size = along.norm();
                for e in &panels.edges {
                    if own.contains(&e.a) || own.contains(&e.b) {
                        continue;
                    }
                    let (a, b) = (&points[e.a as usize], &points[e.b as usize]);
                    if a.x.max(b.x) <= p.x.min(q.x) {
                        continue;
                    }
                    // p + s along = a + t side in y and z.
                    let (side, way) = (b - a, a - p);
                    let determinant = along.y * side.z - along.z * side.y;
                    if determinant.abs() <= TOUCH * size * side.norm() {
                        continue;
                    }
                    let s = (way.y * side.z - way.z * side.y) / determinant;
                    let t = (way.y * along.z - way.z * along.y) / determinant;
                    let inside = (TOUCH..=1.0 - TOUCH).contains(&s) && (-TOUCH..=1.0 + TOUCH).contains(&t);
                    let x = a.x + t * side.x;
                    if inside && x > p.x + s * along.x + TOUCH * size {
                        return Err(PanelError::WakeCutsBody {
                            edge: [panels.vertex_of[strip.a as usize], panels.vertex_of[strip.b as usize]],
                            cell: panels.cell_of[e.left as usize],
                            x,
                        });
                    }
                }
            }
        }
        Ok(())
    }
}

/// Angle between the outward normals at an edge, degrees, and the x component of their unit bisector.
fn turn(panels: &Panels, points: &[Vector3], edge: u32) -> Option<(f64, f64)> {
    let e = &panels.edges[edge as usize];
    let normal = |panel: u32| {
        let [a, b, c, d] = panels.corners[panel as usize].map(|v| points[v as usize]);
        (c - a).cross(&(d - b)).normalize()
    };
    let (one, two) = (normal(e.left), normal(e.right?));
    let angle = one.dot(&two).clamp(-1.0, 1.0).acos().to_degrees();
    Some((angle, (one + two).normalize().x))
}

/// The trailing edges, as edges of the panels.
fn find(
    mesh: &SurfaceMesh,
    panels: &Panels,
    points: &[Vector3],
    rule: &TrailingEdges,
) -> Result<Vec<u32>, PanelError> {
    let all = 0..panels.edges.len() as u32;
    match rule {
        TrailingEdges::None => Ok(Vec::new()),
        TrailingEdges::Angle { degrees } => {
            if !(60.0..=180.0).contains(degrees) {
                return Err(PanelError::OutOfRange {
                    field: "options.trailing_edges.degrees".to_owned(),
                    value: *degrees,
                    low: 60.0,
                    high: 180.0,
                });
            }
            let sharp =
                |e: &u32| turn(panels, points, *e).is_some_and(|(angle, x)| angle >= *degrees && x > 0.5);
            nothing_is_an_error(all.filter(sharp).collect(), || {
                format!("where normals turn by {degrees} degrees or more")
            })
        }
        TrailingEdges::Groups(names) => {
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
                    if let Ok(point) = panels.vertex_of.binary_search(vertex) {
                        inside[point] = true;
                    }
                }
                for edge in all.clone() {
                    let e = &panels.edges[edge as usize];
                    found[edge as usize] |= inside[e.a as usize]
                        && inside[e.b as usize]
                        && turn(panels, points, edge).is_some_and(|(angle, _)| angle >= GROUPED);
                }
            }
            nothing_is_an_error(all.filter(|e| found[*e as usize]).collect(), || {
                format!("in the vertex groups {names:?}")
            })
        }
        TrailingEdges::Edges(list) => {
            let mut edges = Vec::with_capacity(list.len());
            for (index, &edge) in list.iter().enumerate() {
                if edge.iter().any(|&v| v as usize >= panels.vertices) {
                    return Err(PanelError::NotAnEdge { index, edge });
                }
                // Edges of the half that is not solved are those of its image.
                let own = |v: u32| panels.vertex_of.binary_search(&v).ok();
                let image = |v: u32| panels.partner.as_ref()?.iter().position(|p| *p == v);
                let ends = [own(edge[0]).zip(own(edge[1])), image(edge[0]).zip(image(edge[1]))];
                let (a, b) =
                    ends.into_iter().flatten().next().ok_or(PanelError::NotAnEdge { index, edge })?;
                let found = panels.edge_between(a as u32, b as u32);
                let found = found.ok_or(PanelError::NotAnEdge { index, edge })?;
                let (angle, _) = turn(panels, points, found).ok_or(PanelError::NotAnEdge { index, edge })?;
                if angle < NAMED {
                    return Err(PanelError::BluntTrailingEdge { edge, angle, least: NAMED });
                }
                edges.push(found);
            }
            edges.sort_unstable();
            edges.dedup();
            nothing_is_an_error(edges, || "in the list of edges".to_owned())
        }
    }
}

fn nothing_is_an_error(edges: Vec<u32>, how: impl Fn() -> String) -> Result<Vec<u32>, PanelError> {
    if edges.is_empty() { Err(PanelError::NoTrailingEdge { how: how() }) } else { Ok(edges) }
}

/// Strips of the trailing edges, in the order along each line, oriented alike along it.
fn oriented(panels: &Panels, points: &[Vector3], edges: &[u32]) -> Result<Vec<Strip>, PanelError> {
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
    let mut seen = vec![false; panels.edges.len()];
    let mut strips = Vec::with_capacity(edges.len());
    // Lines with ends first, then closed ones.
    let is_end = |edge: u32, point: u32| at[point as usize] == [edge];
    let starts = |closed: bool| {
        let at_end = move |edge: &&u32| {
            let e = &panels.edges[**edge as usize];
            closed || is_end(**edge, e.a) || is_end(**edge, e.b)
        };
        edges.iter().filter(at_end)
    };
    for &start in starts(false).chain(starts(true)) {
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
            line.push((edge, from, to));
            let next = at[to as usize].iter().find(|next| !seen[**next as usize]);
            let Some(&next) = next else { break };
            (edge, from) = (next, to);
        }
        // The upper panel runs along the line, or against it: whichever side looks up more.
        let side = |edge: u32, from: u32| {
            let e = &panels.edges[edge as usize];
            let (left, right) = (e.left, e.right.unwrap_or(e.left));
            if e.a == from { (left, right) } else { (right, left) }
        };
        let area = |panel: u32| {
            let [a, b, c, d] = panels.corners[panel as usize].map(|v| points[v as usize]);
            (c - a).cross(&(d - b)).z
        };
        let up: f64 = line
            .iter()
            .map(|&(edge, from, _)| side(edge, from))
            .map(|(along, against)| area(along) - area(against))
            .sum();
        if up < 0.0 {
            line.reverse();
            line.iter_mut().for_each(|(_, from, to)| std::mem::swap(from, to));
        }
        let first = strips.len();
        let count = line.len();
        let closed = line[0].1 == line[count - 1].2;
        for (k, (edge, a, b)) in line.into_iter().enumerate() {
            let (upper, lower) = side(edge, a);
            let beside = |k: usize| Beside::Strip((first + k) as u32);
            let before = if k > 0 { beside(k - 1) } else { Beside::Tip };
            let after = if k + 1 < count { beside(k + 1) } else { Beside::Tip };
            let before = if k == 0 && closed { beside(count - 1) } else { before };
            let after = if k + 1 == count && closed { beside(0) } else { after };
            strips.push(Strip { edge, a, b, upper, lower, beside: [before, after], pieces: Vec::new() });
        }
    }
    Ok(strips)
}

/// Whether the surface goes on downstream of a trailing edge's end.
fn goes_on(panels: &Panels, points: &[Vector3], trailing: &[bool], point: u32) -> bool {
    panels.point_edges[point as usize].iter().any(|&edge| {
        let e = &panels.edges[edge as usize];
        let other = if e.a == point { e.b } else { e.a };
        let along = points[other as usize] - points[point as usize];
        !trailing[edge as usize] && along.x > DOWNSTREAM * along.norm()
    })
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

/// The path of edges from the end of a trailing edge to the aft end of its body: the one that keeps nearest to the straight line
/// downstream (least integral of the squared distance from it).
fn path(panels: &Panels, points: &[Vector3], trailing: &[bool], start: u32) -> Result<Vec<u32>, PanelError> {
    let none = PanelError::NoCarryOver { vertex: panels.vertex_of[start as usize] };
    let piece = panels.piece[start as usize];
    let extent = points.iter().fold(0.0_f64, |m, p| m.max(p.amax()));
    let mut blocked = vec![false; points.len()];
    for (edge, e) in panels.edges.iter().enumerate() {
        if trailing[edge] {
            [e.a, e.b].iter().for_each(|&p| blocked[p as usize] = p != start);
        }
    }
    let on_plane = |p: &u32| points[*p as usize].y.abs() <= crate::topology::SYMMETRY_TOLERANCE * extent;
    let candidates = (0..points.len() as u32)
        .filter(|p| panels.piece[*p as usize] == piece && !blocked[*p as usize])
        .filter(on_plane);
    let x = |p: &u32| points[*p as usize].x;
    let goal = candidates.max_by(|p, q| x(p).total_cmp(&x(q))).ok_or(none.clone())?;
    let from = points[start as usize];
    let deviation = |p: &Vector3| {
        let d = p - from;
        d.y * d.y + d.z * d.z + d.x.min(0.0).powi(2)
    };
    let mut cost = vec![f64::INFINITY; points.len()];
    let mut previous = vec![u32::MAX; points.len()];
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
            let e = &panels.edges[edge as usize];
            let other = if e.a == point { e.b } else { e.a };
            if trailing[edge as usize] || blocked[other as usize] {
                continue;
            }
            let (p, q) = (&points[point as usize], &points[other as usize]);
            let length = (q - p).norm();
            // Where the line lies on the body, the shorter way counts.
            let through = so_far + length * (0.5 * (deviation(p) + deviation(q)) + 0.01 * length * length);
            if through < cost[other as usize] {
                cost[other as usize] = through;
                previous[other as usize] = point;
                queue.push(Reverse((Cost(through), other)));
            }
        }
    }
    if cost[goal as usize].is_infinite() {
        return Err(none);
    }
    let mut path = vec![goal];
    while let Some(&last) = path.last().filter(|p| **p != start) {
        path.push(previous[last as usize]);
    }
    path.reverse();
    Ok(path)
}
