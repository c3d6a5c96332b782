//! Radial scale of a body: x' = x + (r - 1) w (x - c), with r = value / baseline, the taper w of the point's reference
//! station, and the point c of the centre line at that station. c is carried along by the earlier operations, so that
//! the scaling stays radial when the body has been moved or turned.

use std::collections::BTreeMap;

use moldline_foundation::{Vector3, smooth_step::smooth_step};
use nalgebra::convert;

use crate::axis::Axis;
use crate::channel::Relative;
use crate::compile::{Compiler, Site};
use crate::error::ParameterisationError;
use crate::operation::{Declaration, Operation};
use crate::scalar::{Scalar, shift};
use crate::table::Table;
use crate::unit::Dimension;

/// The line about which a body is scaled.
#[derive(Clone, Debug, PartialEq)]
pub enum CentreLine {
    /// Parallel to the body's axis through this point, m (the coordinate along the axis does not matter).
    Point([f64; 3]),
    /// The middle of the extent of each cross-section of the reference geometry.
    Sections,
}

/// Scales a body perpendicular to its axis. The factor is value / baseline (of a ratio or of a diameter) between the
/// two inner stations and fades to 1 at the outer ones, twice continuously differentiable.
#[derive(Clone, Debug, PartialEq)]
pub struct RadialScaleDeclaration {
    /// Components scaled; the centre line is that of the first.
    pub components: Vec<String>,
    /// The body's axis.
    pub axis: Axis,
    /// The centre line.
    pub centre: CentreLine,
    /// Non-decreasing coordinates along the axis, m: no scaling before the first, full between second and third,
    /// none after the fourth.
    pub stations: [f64; 4],
    /// Scalar variable: a ratio (baseline 1 unless given) or a diameter (baseline required).
    pub variable: String,
}

impl RadialScaleDeclaration {
    fn centre_line(&self, site: &Site, compiler: &Compiler<'_>) -> Result<Table, ParameterisationError> {
        let axis = self.axis.index();
        match self.centre {
            CentreLine::Point(point) => Ok(Table::constant(site.point("centre", point)?)),
            CentreLine::Sections => {
                let surfaces = compiler.surfaces(site);
                let (low, high) = surfaces.range(axis);
                Table::new(low, high, |x| Some(surfaces.centre(axis, x)))
                    .ok_or_else(|| site.geometry("the body has no cross-sections along this axis"))
            }
        }
    }

    fn check_stations(&self, site: &Site) -> Result<(), ParameterisationError> {
        for (s, &station) in self.stations.iter().enumerate() {
            let field = site.field(&format!("stations[{s}]"));
            if !station.is_finite() {
                return Err(ParameterisationError::NotFinite { field, value: station });
            }
            if s > 0 && station < self.stations[s - 1] {
                let (before, last) = (s - 1, self.stations[s - 1]);
                let reason =
                    format!("{station} is before station {before}, {last}; stations must not decrease");
                return Err(ParameterisationError::Geometry { field, reason });
            }
        }
        Ok(())
    }
}

impl Declaration for RadialScaleDeclaration {
    type Compiled = RadialScale;

    fn components(&self) -> &[String] {
        &self.components
    }

    /// One centre a station. Centres of this operation have none of their own: they stay where they are.
    fn centres(
        &self,
        site: &Site,
        compiler: &mut Compiler<'_>,
    ) -> Result<Vec<(usize, usize)>, ParameterisationError> {
        let axis = self.axis.index();
        let scaled = compiler.targets(site);
        let line = self.centre_line(site, compiler)?;
        let mut at_station = BTreeMap::new();
        let with_centre = scaled.into_iter().map(|point| {
            let station = compiler.points[point][axis];
            let centre = *at_station.entry(station.to_bits()).or_insert_with(|| {
                let mut centre = line.at(station);
                centre[axis] = station;
                compiler.carry(site.members[0], centre)
            });
            (point, centre)
        });
        Ok(with_centre.collect())
    }

    fn compile(
        &self,
        site: &Site,
        compiler: &mut Compiler<'_>,
    ) -> Result<RadialScale, ParameterisationError> {
        self.check_stations(site)?;
        let axis = self.axis.index();
        let taper = |point: usize| taper(&self.stations, compiler.points[point][axis]);
        let targets =
            site.centres.iter().map(|&(point, centre)| Target { point, centre, taper: taper(point) });
        let targets = targets.filter(|t| t.taper != 0.0).collect();
        let ratio = compiler.variables.relative(
            &site.field("variable"),
            &self.variable,
            &[Dimension::Ratio, Dimension::Length],
            |dimension| (dimension == Dimension::Ratio).then_some(1.0),
        )?;
        Ok(RadialScale { targets, ratio })
    }
}

#[derive(Clone, Debug)]
pub(crate) struct RadialScale {
    targets: Vec<Target>,
    /// r.
    ratio: Relative,
}

#[derive(Clone, Debug)]
struct Target {
    point: usize,
    /// Index of c among the points; never a target itself.
    centre: usize,
    /// w, 0 to 1.
    taper: f64,
}

/// w: 0 before the first station, 1 between the second and the third, 0 after the fourth, C2 between.
fn taper(stations: &[f64; 4], x: f64) -> f64 {
    let [a, b, c, d] = *stations;
    smooth_step(ramp(x, a, b)) * smooth_step(ramp(-x, -d, -c))
}

/// 0 before `from`, 1 after `to`, linear between; a jump where the two coincide.
fn ramp(x: f64, from: f64, to: f64) -> f64 {
    if from < to { ((x - from) / (to - from)).clamp(0.0, 1.0) } else { f64::from(x >= from) }
}

impl Operation for RadialScale {
    fn eval<T: Scalar>(&self, design: &[T], points: &mut [nalgebra::Vector3<T>]) {
        let growth = self.ratio.value(design) - T::one();
        for t in &self.targets {
            let step = (points[t.point] - points[t.centre]) * (growth * convert(t.taper));
            shift(&mut points[t.point], step);
        }
    }

    fn jvp(&self, design: &[f64], points: &[Vector3], direction: &[f64], tangents: &mut [Vector3]) {
        let growth = self.ratio.value(design) - 1.0;
        let growth_tangent = self.ratio.jvp(direction);
        for t in &self.targets {
            let step = (tangents[t.point] - tangents[t.centre]) * (growth * t.taper)
                + (points[t.point] - points[t.centre]) * (growth_tangent * t.taper);
            tangents[t.point] += step;
        }
    }

    fn vjp(&self, design: &[f64], points: &[Vector3], seeds: &mut [Vector3], gradient: &mut [f64]) {
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
