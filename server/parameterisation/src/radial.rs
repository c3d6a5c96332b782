//! Radial scale of a body: x' = x + (r - 1) w (x - c), with r = value / baseline, the taper w of the point's reference
//! station, and the point c of the centre line at that station. c is carried along by the earlier operations, so that
//! the scaling stays radial when the body has been moved or turned.

use moldline_foundation::smooth_step::smooth_step;
use moldline_spline::Vector3;
use nalgebra::convert;

use crate::{Scalar, channel::Relative, parameterisation::shift};

#[derive(Clone, Debug)]
pub(crate) struct RadialScale {
    pub(crate) targets: Vec<RadialTarget>,
    pub(crate) ratio: Relative,
}

#[derive(Clone, Debug)]
pub(crate) struct RadialTarget {
    pub(crate) point: usize,
    /// Index of c among the points; never a target itself.
    pub(crate) centre: usize,
    /// w, 0 to 1.
    pub(crate) taper: f64,
}

/// w: 0 before the first station, 1 between the second and the third, 0 after the fourth, C2 between.
pub(crate) fn taper(stations: &[f64; 4], x: f64) -> f64 {
    let [a, b, c, d] = *stations;
    smooth_step(ramp(x, a, b)) * smooth_step(ramp(-x, -d, -c))
}

/// 0 before `from`, 1 after `to`, linear between; a jump where the two coincide.
fn ramp(x: f64, from: f64, to: f64) -> f64 {
    if from < to { ((x - from) / (to - from)).clamp(0.0, 1.0) } else { f64::from(x >= from) }
}

impl RadialScale {
    pub(crate) fn eval<T: Scalar>(&self, design: &[T], points: &mut [nalgebra::Vector3<T>]) {
        let growth = self.ratio.value(design) - T::one();
        for t in &self.targets {
            let step = (points[t.point] - points[t.centre]) * (growth * convert(t.taper));
            shift(&mut points[t.point], step);
        }
    }

    /// `points` are those that `eval` was given.
    pub(crate) fn jvp(
        &self,
        design: &[f64],
        points: &[Vector3],
        direction: &[f64],
        tangents: &mut [Vector3],
    ) {
        let growth = self.ratio.value(design) - 1.0;
        let growth_tangent = self.ratio.jvp(direction);
        for t in &self.targets {
            let step = (tangents[t.point] - tangents[t.centre]) * (growth * t.taper)
                + (points[t.point] - points[t.centre]) * (growth_tangent * t.taper);
            tangents[t.point] += step;
        }
    }

    /// Turns the seeds on the results into those on the arguments.
    pub(crate) fn vjp(
        &self,
        design: &[f64],
        points: &[Vector3],
        seeds: &mut [Vector3],
        gradient: &mut [f64],
    ) {
        let growth = self.ratio.value(design) - 1.0;
        let mut on_ratio = 0.0;
        for t in &self.targets {
            let seed = seeds[t.point];
            on_ratio += t.taper * seed.dot(&(points[t.point] - points[t.centre]));
            let back = seed * (growth * t.taper);
            seeds[t.point] += back;
            seeds[t.centre] -= back;
        }
        self.ratio.vjp(on_ratio, gradient);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn taper_is_zero_outside_one_inside_and_smooth_between() {
        let stations = [2.0, 6.0, 20.0, 25.0];
        for (x, w) in [
            (-1.0, 0.0),
            (2.0, 0.0),
            (4.0, 0.5),
            (6.0, 1.0),
            (13.0, 1.0),
            (20.0, 1.0),
            (22.5, 0.5),
            (25.0, 0.0),
        ] {
            assert_eq!(taper(&stations, x), w, "at {x}");
        }
        // First and second differences vanish on both sides of each station.
        let h = 1e-4;
        for x in stations {
            let [a, b, c] = [x - h, x, x + h].map(|x| taper(&stations, x));
            assert!(((c - a) / (2.0 * h)).abs() < 1e-6);
            assert!(((a - 2.0 * b + c) / (h * h)).abs() < 1e-2, "{x}");
        }
    }

    #[test]
    fn coinciding_stations_reach_the_end_of_the_body() {
        let whole = [0.0, 0.0, 10.0, 10.0];
        assert_eq!([-1.0, 0.0, 5.0, 10.0, 11.0].map(|x| taper(&whole, x)), [0.0, 1.0, 1.0, 1.0, 0.0]);
    }
}
