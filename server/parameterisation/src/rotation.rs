//! Rotation about the axis k through the pivot P, by Rodrigues' formula:
//! x' = x + T (x - P), T = R - I = sin(a) K + (1 - cos(a)) K^2, K v = k x v.

use moldline_spline::Vector3;
use nalgebra::{Matrix3, convert};

use crate::{Scalar, channel::Additive, parameterisation::shift};

#[derive(Clone, Debug)]
pub(crate) struct Rotation {
    pub(crate) targets: Vec<usize>,
    /// Unit vector.
    pub(crate) axis: Vector3,
    /// Index of the pivot among the points; not a target.
    pub(crate) pivot: usize,
    pub(crate) angle: Additive,
}

impl Rotation {
    /// T and dT/da.
    fn turn<T: Scalar>(&self, design: &[T]) -> (Matrix3<T>, Matrix3<T>) {
        let angle = self.angle.value(design, 0);
        let (sin, cos) = angle.sin_cos();
        let half = (convert::<f64, T>(0.5) * angle).sin();
        let k = self.axis.cross_matrix();
        let (k, k2) = (k.map(convert::<f64, T>), (k * k).map(convert::<f64, T>));
        (k * sin + k2 * (convert::<f64, T>(2.0) * half * half), k * cos + k2 * sin)
    }

    pub(crate) fn eval<T: Scalar>(&self, design: &[T], points: &mut [nalgebra::Vector3<T>]) {
        let (turn, _) = self.turn(design);
        let pivot = points[self.pivot];
        for &i in &self.targets {
            let step = turn * (points[i] - pivot);
            shift(&mut points[i], step);
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
        let (turn, slope) = self.turn(design);
        let slope = slope * self.angle.jvp(direction, 0);
        let (pivot, pivot_tangent) = (points[self.pivot], tangents[self.pivot]);
        for &i in &self.targets {
            let step = turn * (tangents[i] - pivot_tangent) + slope * (points[i] - pivot);
            tangents[i] += step;
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
        let (turn, slope) = self.turn(design);
        let pivot = points[self.pivot];
        let (mut on_angle, mut on_pivot) = (0.0, Vector3::zeros());
        for &i in &self.targets {
            on_angle += seeds[i].dot(&(slope * (points[i] - pivot)));
            let back = turn.tr_mul(&seeds[i]);
            seeds[i] += back;
            on_pivot -= back;
        }
        seeds[self.pivot] += on_pivot;
        self.angle.vjp(on_angle, 0, gradient);
    }
}
