//! Rotation about the axis k through the pivot P, by Rodrigues' formula:
//! x' = x + T (x - P), T = R - I = sin(a) K + (1 - cos(a)) K^2, K v = k x v.

use moldline_foundation::Vector3;
use nalgebra::{Matrix3, convert};

use crate::channel::Additive;
use crate::compile::{Compiler, Site};
use crate::error::ParameterisationError;
use crate::operation::{Declaration, Operation};
use crate::pivot::Pivot;
use crate::scalar::{Scalar, shift};
use crate::unit::Dimension;

/// Rotation about an axis through a point, right-handed: about +y positive is nose up.
#[derive(Clone, Debug, PartialEq)]
pub struct RotationDeclaration {
    /// Components that turn together.
    pub components: Vec<String>,
    /// Direction of the axis; need not be of unit length.
    pub axis: [f64; 3],
    /// A point on the axis.
    pub pivot: Pivot,
    /// Scalar variable, an angle.
    pub variable: String,
}

impl Declaration for RotationDeclaration {
    type Compiled = Rotation;

    fn components(&self) -> &[String] {
        &self.components
    }

    fn pivot(&self, site: &Site, compiler: &Compiler<'_>) -> Result<Option<Vector3>, ParameterisationError> {
        self.pivot.place(site, compiler, true).map(Some)
    }

    fn compile(&self, site: &Site, compiler: &mut Compiler<'_>) -> Result<Rotation, ParameterisationError> {
        let axis = site.direction("axis", self.axis)?;
        let variables = &mut compiler.variables;
        let angle = variables.additive_scalar(&site.field("variable"), &self.variable, Dimension::Angle)?;
        Ok(Rotation { targets: compiler.targets(site), axis, pivot: site.pivot(), angle })
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Rotation {
    targets: Vec<usize>,
    /// Unit vector.
    axis: Vector3,
    /// Index of the pivot among the points; not a target.
    pivot: usize,
    angle: Additive,
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
}

impl Operation for Rotation {
    fn eval<T: Scalar>(&self, design: &[T], points: &mut [nalgebra::Vector3<T>]) {
        let (turn, _) = self.turn(design);
        let pivot = points[self.pivot];
        for &i in &self.targets {
            let step = turn * (points[i] - pivot);
            shift(&mut points[i], step);
        }
    }

    fn jvp(&self, design: &[f64], points: &[Vector3], direction: &[f64], tangents: &mut [Vector3]) {
        let (turn, slope) = self.turn(design);
        let slope = slope * self.angle.jvp(direction, 0);
        let (pivot, pivot_tangent) = (points[self.pivot], tangents[self.pivot]);
        for &i in &self.targets {
            let step = turn * (tangents[i] - pivot_tangent) + slope * (points[i] - pivot);
            tangents[i] += step;
        }
    }

    fn vjp(&self, design: &[f64], points: &[Vector3], seeds: &mut [Vector3], gradient: &mut [f64]) {
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
