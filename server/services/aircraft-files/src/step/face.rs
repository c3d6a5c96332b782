//! Faces of solids and shells: accepted where their bounds are the sides of a B-spline surface, refused where they trim it.

use std::collections::HashMap;

use moldline_foundation::Vector3;
use moldline_geometry::PatchInput;
use moldline_spline::{KnotVector, Surface};

use super::{
    Budget,
    entity::Entity,
    spline::{SPLINES, spline_surface},
};
use crate::{
    error::ImportError,
    model::SurfaceSet,
    part21::{Exchange, Value},
};

/// Edges lie on the sides of their surface within this distance, relative to its size.
const TOLERANCE: f64 = 1e-5;
/// Points compared along an edge, and along a side.
const POINTS: usize = 9;
/// Edges of a face whose bounds are its sides at most; these may be split where other faces end.
const EDGES: usize = 64;
/// Intervals that a curve is searched in at most.
const SEARCHED: usize = 1000;
/// Curves that wrap another at most.
const WRAPS: usize = 4;

/// The faces of shells. Names are those of their solids.
pub(super) fn shells(
    exchange: &Exchange<'_>,
    shells: &[u64],
    budget: &mut Budget<'_>,
) -> Result<Vec<SurfaceSet>, ImportError> {
    let names = solid_names(exchange)?;
    let mut sets = Vec::new();
    for &number in shells {
        let shell = Entity::parse(exchange, number)?;
        let Some(record) = super::SHELLS.iter().find_map(|k| shell.record(k).ok()) else { continue };
        let own = shell.text(record, 0)?;
        let name = names.get(&number).map(String::as_str).filter(|n| !n.is_empty()).unwrap_or(own).trim();
        let name =
            if name.is_empty() || name == "NONE" { format!("solid_{number}") } else { name.to_owned() };
        let mut patches = Vec::new();
        for face in shell.list(record, 1)? {
            let &Value::Reference(face) = face else {
                return Err(shell.error("faces must be references".into()));
            };
            patches.push(patch(&shell.at(face)?, &name, budget)?);
        }
        if !patches.is_empty() {
            sets.push(SurfaceSet { id: format!("#{number}"), name, patches });
        }
    }
    Ok(sets)
}

/// Names of solids by the numbers of their outer shells.
fn solid_names(exchange: &Exchange<'_>) -> Result<HashMap<u64, String>, ImportError> {
    let mut names = HashMap::new();
    for number in exchange.of_type(&["MANIFOLD_SOLID_BREP", "BREP_WITH_VOIDS"]) {
        let solid = Entity::parse(exchange, number)?;
        let record =
            ["MANIFOLD_SOLID_BREP", "BREP_WITH_VOIDS"].into_iter().find_map(|k| solid.record(k).ok());
        if let Some(record) = record.filter(|_| solid.is_simple()) {
            names.insert(solid.reference(record, 1)?, solid.text(record, 0)?.to_owned());
        }
    }
    Ok(names)
}

fn patch(face: &Entity<'_, '_>, set: &str, budget: &mut Budget<'_>) -> Result<PatchInput, ImportError> {
    let Some(record) = ["ADVANCED_FACE", "FACE_SURFACE"].into_iter().find_map(|k| face.record(k).ok()) else {
        return Err(
            face.error("is no ADVANCED_FACE; faceted and other solids have no smooth surfaces".into())
        );
    };
    let surface = face.follow(record, 2)?;
    if !surface.is_any(&SPLINES) {
        return Err(surface.error(format!(
            "is the surface of face #{} of '{set}'; only B-spline surfaces are read: export with analytic surfaces converted to \
             B-splines (NURBS)",
            face.number
        )));
    }
    let patch = spline_surface(&surface, budget)?;
    let mut edges = Vec::new();
    for bound in face.list(record, 1)? {
        let &Value::Reference(bound) = bound else {
            return Err(face.error("bounds must be references".into()));
        };
        let bound = face.at(bound)?;
        let kind = ["FACE_OUTER_BOUND", "FACE_BOUND"].into_iter().find_map(|k| bound.record(k).ok());
        let Some(kind) = kind else { return Err(bound.error("is no FACE_BOUND".into())) };
        add_edges(&bound.follow(kind, 1)?, &mut edges)?;
    }
    let reason = if edges.len() > EDGES {
        Some(format!("it has {} edges", edges.len()))
    } else {
        trimmed(&patch, &edges)
    };
    match reason {
        None => Ok(patch),
        Some(reason) => Err(ImportError::Trimmed {
            face: format!("#{}", face.number),
            set: set.into(),
            line: face.line(),
            reason,
        }),
    }
}

/// An edge by points along it, in order.
struct Edge {
    number: u64,
    points: Vec<Vector3>,
}

fn add_edges(bound: &Entity<'_, '_>, edges: &mut Vec<Edge>) -> Result<(), ImportError> {
    // A loop that is one vertex bounds nothing.
    if bound.is("VERTEX_LOOP") {
        return Ok(());
    }
    let record = bound.record("EDGE_LOOP")?;
    for oriented in bound.list(record, 1)? {
        let &Value::Reference(oriented) = oriented else {
            return Err(bound.error("edges must be references".into()));
        };
        let oriented = bound.at(oriented)?;
        let edge = oriented.follow(oriented.record("ORIENTED_EDGE")?, 3)?;
        let record = edge.record("EDGE_CURVE")?;
        let vertex = |index| {
            let vertex = edge.follow(record, index)?;
            let point = vertex.follow(vertex.record("VERTEX_POINT")?, 1)?;
            point.coordinates("CARTESIAN_POINT").map(Vector3::from)
        };
        let (start, end) = (vertex(1)?, vertex(2)?);
        edges.push(Edge { number: edge.number, points: curve_points(edge.follow(record, 3)?, start, end)? });
    }
    Ok(())
}

/// Points of the curve of an edge.
fn curve_points(
    mut curve: Entity<'_, '_>,
    start: Vector3,
    end: Vector3,
) -> Result<Vec<Vector3>, ImportError> {
    for _ in 0..WRAPS {
        let wrap = ["SURFACE_CURVE", "SEAM_CURVE", "INTERSECTION_CURVE"].into_iter().find(|k| curve.is(k));
        match wrap {
            Some(keyword) => curve = curve.follow(curve.record(keyword)?, 1)?,
            None => break,
        }
    }
    if curve.is("LINE") {
        return Ok((0..=POINTS).map(|k| start + (end - start) * (k as f64 / POINTS as f64)).collect());
    }
    if !curve.is("B_SPLINE_CURVE_WITH_KNOTS") {
        return Err(curve.error(
            "bounds a B-spline surface; only lines and B-spline curves are compared with its sides: export untrimmed surfaces".into(),
        ));
    }
    let curve = super::spline::spline_curve(&curve)?;
    let (a, b) = curve.knots.domain();
    // Between its vertices, where these are not its ends.
    let at = |t: f64| curve.position(t);
    let place = |x: &Vector3| nearest(&at, (a, b), 8 * curve.knots.interval_count().max(4), x).1;
    let (mut from, mut to) = (place(&start), place(&end));
    if (from - to).abs() <= 1e-9 * (b - a) {
        (from, to) = (a, b);
    }
    Ok((0..=POINTS).map(|k| at(from + (to - from) * k as f64 / POINTS as f64)).collect())
}

/// What shows that edges cut off a part of a surface; nothing if they are its sides.
fn trimmed(patch: &PatchInput, edges: &[Edge]) -> Option<String> {
    let (knots_u, knots_v) = (&patch.knots_u, &patch.knots_v);
    let homogeneous: Vec<[f64; 4]> = patch
        .control_points
        .iter()
        .enumerate()
        .map(|(i, [x, y, z])| {
            let w = patch.weights.as_ref().map_or(1.0, |w| w[i]);
            [w * x, w * y, w * z, w]
        })
        .collect();
    let surface = Surface::for_control_points(knots_u.clone(), knots_v.clone(), &homogeneous);
    let [(u0, u1), (v0, v1)] = surface.domain();
    let size = {
        let (low, high) =
            patch.control_points.iter().map(|p| Vector3::from(*p)).fold(
                (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)),
                |(low, high), p| (low.inf(&p), high.sup(&p)),
            );
        (high - low).norm()
    };
    let tolerance = TOLERANCE * size;
    type Side<'s> = (&'s KnotVector, (f64, f64), Box<dyn Fn(f64) -> Vector3 + 's>);
    let position = |u, v| surface.position(&homogeneous, u, v);
    let sides: [Side<'_>; 4] = [
        (knots_v, (v0, v1), Box::new(move |t| position(u0, t))),
        (knots_v, (v0, v1), Box::new(move |t| position(u1, t))),
        (knots_u, (u0, u1), Box::new(move |t| position(t, v0))),
        (knots_u, (u0, u1), Box::new(move |t| position(t, v1))),
    ];
    let to_side = |x: &Vector3, (knots, range, at): &Side<'_>| {
        nearest(at, *range, 4 * knots.interval_count().max(8), x).0
    };
    for edge in edges {
        for x in &edge.points {
            let distance = sides.iter().map(|side| to_side(x, side)).fold(f64::INFINITY, f64::min);
            if distance > tolerance {
                return Some(format!(
                    "edge #{} runs inside its surface, {distance:.2e} from the nearest side",
                    edge.number
                ));
            }
        }
    }
    if edges.is_empty() {
        return None;
    }
    // Every side with a length has an edge on it, unless it is half of a seam, along which the surface meets itself.
    for (index, (_, (a, b), at)) in sides.iter().enumerate() {
        let opposite = &sides[index ^ 1];
        let inside = |k: usize| at(a + (b - a) * k as f64 / (POINTS + 1) as f64);
        let points: Vec<Vector3> = (1..=POINTS).map(inside).collect();
        let has_length = points.iter().any(|x| (x - points[0]).norm() > tolerance);
        let seam = points.iter().all(|x| to_side(x, opposite) <= tolerance);
        if !has_length || seam {
            continue;
        }
        let covered = |x: &Vector3| {
            let near = |w: &[Vector3]| {
                let along = w[1] - w[0];
                let t =
                    ((x - w[0]).dot(&along) / along.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
                // Edges are known by points, between which they bulge.
                (x - w[0] - along * t).norm() <= tolerance + 0.25 * along.norm()
            };
            edges.iter().any(|edge| edge.points.windows(2).any(near))
        };
        if !points.iter().all(covered) {
            return Some("a side of its surface has no edge".into());
        }
    }
    None
}

/// Distance of the nearest point of a curve, and its parameter: the best of `samples` intervals, refined by section.
fn nearest(at: &dyn Fn(f64) -> Vector3, (a, b): (f64, f64), samples: usize, x: &Vector3) -> (f64, f64) {
    let samples = samples.min(SEARCHED);
    let distance = |t: f64| (at(t) - x).norm();
    let parameter = |k: usize| a + (b - a) * k as f64 / samples as f64;
    let best =
        (0..=samples).min_by(|&i, &j| distance(parameter(i)).total_cmp(&distance(parameter(j)))).unwrap_or(0);
    let (mut low, mut high) = (parameter(best.saturating_sub(1)), parameter((best + 1).min(samples)));
    for _ in 0..60 {
        let (p, q) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        if distance(p) <= distance(q) { high = q } else { low = p }
    }
    [low, high, a, b]
        .into_iter()
        .map(|t| (distance(t), t))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .unwrap_or((0.0, a))
}
