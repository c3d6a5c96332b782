//! Translation: x' = x + a d, with the unit direction d and the length a.

use moldline_spline::Vector3;
use nalgebra::convert;

use crate::{Scalar, channel::Additive, parameterisation::shift};

#[derive(Clone, Debug)]
pub(crate) struct Translation {
    pub(crate) targets: Vec<usize>,
    pub(crate) direction: Vector3,
    pub(crate) length: Additive,
}

impl Translation {
    pub(crate) fn eval<T: Scalar>(&self, design: &[T], points: &mut [nalgebra::Vector3<T>]) {
        let step = self.direction.map(convert::<f64, T>) * self.length.value(design, 0);
        for &i in &self.targets {
            shift(&mut points[i], step);
        }
    }

    pub(crate) fn jvp(&self, direction: &[f64], tangents: &mut [Vector3]) {
        let step = self.direction * self.length.jvp(direction, 0);
        for &i in &self.targets {
            tangents[i] += step;
        }
    }

    pub(crate) fn vjp(&self, seeds: &[Vector3], gradient: &mut [f64]) {
        let sum: Vector3 = self.targets.iter().map(|&i| seeds[i]).sum();
        self.length.vjp(self.direction.dot(&sum), 0, gradient);
    }
}
