//! Planform of a wing: the polygon through stations on its leading and trailing edge, seen along z.

use moldline_geometry::Body;
use moldline_spline::Vector3;

use super::gradient::{At, FunctionGradient};

/// Area, m^2, span, m, and mean aerodynamic chord, m, of stations `[leading, trailing]`.
pub(super) fn eval(stations: &[[At; 2]], bodies: &[Body]) -> [f64; 3] {
    values_and_gradients(stations, bodies).0
}

/// Their gradients.
pub(super) fn gradients(stations: &[[At; 2]], bodies: &[Body]) -> [FunctionGradient; 3] {
    values_and_gradients(stations, bodies).1.map(|by_points| {
        let mut gradient = FunctionGradient::default();
        for (station, by) in stations.iter().zip(by_points) {
            for (point, by) in station.iter().zip(by) {
                gradient.add_point(point, &by, bodies);
            }
        }
        gradient
    })
}

/// The values, and their gradients with respect to the points.
fn values_and_gradients(stations: &[[At; 2]], bodies: &[Body]) -> ([f64; 3], [Vec<[Vector3; 2]>; 3]) {
    let points: Vec<[Vector3; 2]> = stations
        .iter()
        .map(|station| station.each_ref().map(|p| bodies[p.component].position(&p.location)))
        .collect();
    let chord = |k: usize| points[k][1].x - points[k][0].x;
    let y = |k: usize| 0.5 * (points[k][0].y + points[k][1].y);
    let last = points.len() - 1;
    // Stations may run from either tip.
    let sign = (y(last) - y(0)).signum();
    let (mut area, mut squares) = (0.0, 0.0);
    // Gradients of the area and of the integral of the squared chord with respect to chords and to y.
    let mut by = vec![[[0.0; 2]; 2]; points.len()];
    for k in 0..last {
        let (c, d, width) = (chord(k), chord(k + 1), sign * (y(k + 1) - y(k)));
        let (mean, square) = (0.5 * (c + d), (c * c + c * d + d * d) / 3.0);
        area += width * mean;
        squares += width * square;
        for (i, by_chord) in [(k, (2.0 * c + d) / 3.0), (k + 1, (c + 2.0 * d) / 3.0)] {
            by[i][0][0] += 0.5 * width;
            by[i][1][0] += width * by_chord;
        }
        for (i, s) in [(k, -sign), (k + 1, sign)] {
            by[i][0][1] += s * mean;
            by[i][1][1] += s * square;
        }
    }
    let chord_mean = squares / area;
    let at_points = |c: f64, y: f64| [Vector3::new(-c, 0.5 * y, 0.0), Vector3::new(c, 0.5 * y, 0.0)];
    let area_by = by.iter().map(|g| at_points(g[0][0], g[0][1])).collect();
    let chord_by = by
        .iter()
        .map(|g| {
            let through = |k: usize| (g[1][k] - chord_mean * g[0][k]) / area;
            at_points(through(0), through(1))
        })
        .collect();
    let mut span_by = vec![[Vector3::zeros(); 2]; points.len()];
    span_by[0] = at_points(0.0, -sign);
    span_by[last] = at_points(0.0, sign);
    ([area, sign * (y(last) - y(0)), chord_mean], [area_by, span_by, chord_by])
}
