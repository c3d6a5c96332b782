//! Departures (displacements in a chart) along a component's surface in dual numbers.

use moldline_deform::{Location, chart::Chart};
use moldline_geometry::{EdgeSide, ParameterDirection};
use nalgebra::Matrix2;

use crate::{
    body::{At, DualBody, STEPS, solve},
    dual::{Dual, Vector, constant, number, real, tangent},
};

/// The parameters reached by a departure, across the edges of patches.
pub fn walk(chart: &Chart, reference: &DualBody<'_>, from: &At, departure: [Dual; 2]) -> At {
    let mut at = *from;
    for (k, along) in departure.into_iter().enumerate() {
        let Some((axis, scale)) = chart.map(at.patch) else { return at };
        let direction = if axis[k] == 0 { ParameterDirection::U } else { ParameterDirection::V };
        at = reference.walk(&at, direction, along * scale[k]);
    }
    at
}

/// The departure from a vertex's reference location to parameters that move, by Newton steps from the engine's departure;
/// `None` where the engine finds none.
pub fn unroll(
    chart: &Chart,
    reference: &DualBody<'_>,
    from: &Location,
    to: &At,
    tolerance: f64,
) -> Option<[Dual; 2]> {
    let start = chart.unroll(reference.body, from, &to.location(), tolerance)?;
    let from = At::fixed(from);
    let goal: Vector = reference.position(to);
    let mut departure = start.map(constant);
    for _ in 0..STEPS {
        let values = departure.map(|d| d.re);
        let moving = [0, 1].map(|k| number(values[k], |lane| if lane == k { 1.0 } else { 0.0 }));
        let slope = reference.position(&walk(chart, reference, &from, moving));
        let columns = [0, 1].map(|k| tangent(&slope, k));
        let matrix = Matrix2::from_fn(|a, b| columns[a].dot(&columns[b]));
        let miss = reference.position(&walk(chart, reference, &from, departure)) - goal;
        let right = columns.map(|c| (0..3).fold(constant(0.0), |sum, axis| sum + miss[axis] * c[axis]));
        let step = solve(&matrix, &right);
        departure = [departure[0] - step[0], departure[1] - step[1]];
    }
    real(&goal).iter().all(|x| x.is_finite()).then_some(departure)
}

/// The part of a departure along a side.
pub fn along_edge(chart: &Chart, location: &Location, side: &EdgeSide, departure: [Dual; 2]) -> [Dual; 2] {
    let free = usize::from(side.side.holds_u());
    let Some((axis, _)) = chart.map(location.patch) else { return [constant(0.0); 2] };
    [0, 1].map(|k| if axis[k] == free { departure[k] } else { constant(0.0) })
}
