//! B-spline surfaces of STEP files, rational or not.

use moldline_foundation::Vector3;
use moldline_geometry::PatchInput;
use moldline_spline::{Curve, KnotVector, MAX_DEGREE};

use super::{Budget, entity::Entity};
use crate::{
    error::ImportError,
    knots::with_clamped_ends,
    part21::{Record, Value},
};

/// Types of B-spline surfaces.
pub(super) const SPLINES: [&str; 4] =
    ["B_SPLINE_SURFACE_WITH_KNOTS", "BEZIER_SURFACE", "QUASI_UNIFORM_SURFACE", "UNIFORM_SURFACE"];

/// Where the attributes of a B-spline surface stand: all in one record behind the name, or in records of their own.
struct Layout<'r, 'a> {
    name: &'r str,
    basis: &'r Record<'a>,
    first: usize,
    knots: Option<(&'r Record<'a>, usize)>,
    weights: Option<&'r Record<'a>>,
}

impl<'r, 'a> Layout<'r, 'a> {
    fn of(surface: &'r Entity<'_, 'a>) -> Result<Self, ImportError> {
        const KNOTS: &str = "B_SPLINE_SURFACE_WITH_KNOTS";
        if surface.is_simple() {
            let keyword = SPLINES.into_iter().find(|k| surface.is(k)).unwrap_or(KNOTS);
            let basis = surface.record(keyword)?;
            let name = surface.text(basis, 0)?;
            return Ok(Self {
                name,
                basis,
                first: 1,
                knots: (keyword == KNOTS).then_some((basis, 8)),
                weights: None,
            });
        }
        let name = match surface.record("REPRESENTATION_ITEM") {
            Ok(item) => surface.text(item, 0)?,
            Err(_) => "",
        };
        let knots = surface.record(KNOTS).ok().map(|record| (record, 0));
        let weights = surface.record("RATIONAL_B_SPLINE_SURFACE").ok();
        Ok(Self { name, basis: surface.record("B_SPLINE_SURFACE")?, first: 0, knots, weights })
    }
}

/// Reads a B-spline surface.
pub(super) fn spline_surface(
    surface: &Entity<'_, '_>,
    budget: &mut Budget<'_>,
) -> Result<PatchInput, ImportError> {
    let Layout { name, basis, first, knots, weights } = Layout::of(surface)?;
    let degree = |index| surface.count(surface.value(basis, first + index)?, MAX_DEGREE);
    let (degree_u, degree_v) = (degree(0)?, degree(1)?);
    let rows = surface.list(basis, first + 2)?;
    let row = |value: &'_ _| -> Result<usize, ImportError> {
        match value {
            Value::List(row) => Ok(row.len()),
            _ => Err(surface.error("control points must be a list of lists".into())),
        }
    };
    let n_u = rows.len();
    let n_v = rows.first().map_or(Ok(0), row)?;
    budget.take(n_u.saturating_mul(n_v))?;
    let mut control_points = Vec::with_capacity(n_u * n_v);
    for (index, value) in rows.iter().enumerate() {
        let Value::List(row) = value else {
            return Err(surface.error("control points must be a list of lists".into()));
        };
        if row.len() != n_v {
            let message =
                format!("row {} has {} control points, and the first has {n_v}", index + 1, row.len());
            return Err(surface.error(message));
        }
        for point in row {
            let Value::Reference(point) = point else {
                return Err(surface.error("control points must be references".into()));
            };
            control_points.push(surface.at(*point)?.coordinates("CARTESIAN_POINT")?);
        }
    }
    let (knots_u, knots_v) = match knots {
        Some((record, at)) => (
            expand(surface, record, at, at + 2, degree_u, n_u)?,
            expand(surface, record, at + 1, at + 3, degree_v, n_v)?,
        ),
        None => (implied(surface, degree_u, n_u)?, implied(surface, degree_v, n_v)?),
    };
    let valid = |direction, degree, knots| {
        KnotVector::new(degree, with_clamped_ends(degree, knots)).map_err(|source| ImportError::Knots {
            entity: surface.label(),
            line: surface.line(),
            direction,
            source,
        })
    };
    let weights = weights.map(|record| read_weights(surface, record, (n_u, n_v))).transpose()?;
    Ok(PatchInput {
        name: name.to_owned(),
        knots_u: valid('u', degree_u, knots_u)?,
        knots_v: valid('v', degree_v, knots_v)?,
        control_points,
        weights,
    })
}

/// A B-spline curve with its control points.
pub(super) struct SplineCurve {
    pub(super) knots: KnotVector,
    curve: Curve,
    control_points: Vec<[f64; 4]>,
}

impl SplineCurve {
    pub(super) fn position(&self, t: f64) -> Vector3 {
        self.curve.position(&self.control_points, t)
    }
}

/// Reads a B-spline curve with knots.
pub(super) fn spline_curve(entity: &Entity<'_, '_>) -> Result<SplineCurve, ImportError> {
    let knots = entity.record("B_SPLINE_CURVE_WITH_KNOTS")?;
    let simple = entity.is_simple();
    let (basis, first, at) = if simple { (knots, 1, 6) } else { (entity.record("B_SPLINE_CURVE")?, 0, 0) };
    let degree = entity.count(entity.value(basis, first)?, MAX_DEGREE)?;
    let mut control_points = Vec::new();
    for point in entity.list(basis, first + 1)? {
        let Value::Reference(point) = point else {
            return Err(entity.error("control points must be references".into()));
        };
        let [x, y, z] = entity.at(*point)?.coordinates("CARTESIAN_POINT")?;
        control_points.push([x, y, z, 1.0]);
    }
    if let Ok(record) = entity.record("RATIONAL_B_SPLINE_CURVE") {
        let weights = entity.numbers(record, 0)?;
        if weights.len() != control_points.len() || weights.iter().any(|w| !(1e-9..=1e9).contains(w)) {
            return Err(
                entity.error("needs a positive weight for each control point, from 1e-9 to 1e9".into())
            );
        }
        for (point, w) in control_points.iter_mut().zip(weights) {
            *point = [w * point[0], w * point[1], w * point[2], w];
        }
    }
    let knots = expand(entity, knots, at, at + 1, degree, control_points.len())?;
    let knots = KnotVector::new(degree, with_clamped_ends(degree, knots)).map_err(|source| {
        ImportError::Knots { entity: entity.label(), line: entity.line(), direction: 't', source }
    })?;
    let curve = Curve::for_control_points(knots.clone(), &control_points);
    Ok(SplineCurve { knots, curve, control_points })
}

/// Knots by their multiplicities.
fn expand(
    surface: &Entity<'_, '_>,
    record: &Record<'_>,
    multiplicities: usize,
    knots: usize,
    degree: usize,
    control_points: usize,
) -> Result<Vec<f64>, ImportError> {
    let values = surface.numbers(record, knots)?;
    let multiplicities = surface.list(record, multiplicities)?;
    if values.len() != multiplicities.len() {
        let (knots, found) = (values.len(), multiplicities.len());
        return Err(surface.error(format!("has {knots} knots and {found} multiplicities")));
    }
    let mut all = Vec::new();
    for (value, multiplicity) in values.iter().zip(multiplicities) {
        let multiplicity = surface.count(multiplicity, degree + 1)?;
        all.extend(std::iter::repeat_n(*value, multiplicity));
    }
    let expected = control_points + degree + 1;
    if all.len() != expected {
        let found = all.len();
        return Err(surface.error(format!(
            "has {found} knots with their multiplicities; {control_points} control points of degree {degree} need {expected}"
        )));
    }
    Ok(all)
}

/// Knots of a surface that names only their kind.
fn implied(surface: &Entity<'_, '_>, degree: usize, control_points: usize) -> Result<Vec<f64>, ImportError> {
    let intervals = control_points.saturating_sub(degree);
    if degree == 0 || intervals == 0 {
        return Err(surface.error(format!("{control_points} control points are too few for degree {degree}")));
    }
    if surface.is("UNIFORM_SURFACE") {
        return Ok((0..control_points + degree + 1).map(|k| k as f64 - degree as f64).collect());
    }
    if surface.is("BEZIER_SURFACE") {
        if !(control_points - 1).is_multiple_of(degree) {
            return Err(surface
                .error(format!("{control_points} control points make no Bezier pieces of degree {degree}")));
        }
        let pieces = (control_points - 1) / degree;
        let inner = (0..=pieces).flat_map(|k| std::iter::repeat_n(k as f64, degree));
        return Ok([0.0].into_iter().chain(inner).chain([pieces as f64]).collect());
    }
    let ends = |value| std::iter::repeat_n(value, degree);
    Ok(ends(0.0).chain((0..=intervals).map(|k| k as f64)).chain(ends(intervals as f64)).collect())
}

fn read_weights(
    surface: &Entity<'_, '_>,
    record: &Record<'_>,
    (n_u, n_v): (usize, usize),
) -> Result<Vec<f64>, ImportError> {
    let rows = surface.list(record, 0)?;
    let mut weights = Vec::with_capacity(n_u * n_v);
    for row in rows {
        let Value::List(row) = row else {
            return Err(surface.error("weights must be a list of lists".into()));
        };
        for weight in row {
            match weight {
                Value::Number(weight) if (1e-9..=1e9).contains(weight) => weights.push(*weight),
                other => {
                    return Err(surface.error(format!(
                        "a weight is {other:?}; weights must be positive, from 1e-9 to 1e9"
                    )));
                }
            }
        }
    }
    if rows.len() != n_u || weights.len() != n_u * n_v {
        return Err(surface.error(format!("has {} weights for {} control points", weights.len(), n_u * n_v)));
    }
    Ok(weights)
}
