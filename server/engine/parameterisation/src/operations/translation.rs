//! Translation: x' = x + a d, with the unit direction d and the length a.

use moldline_foundation::Vector3;
use nalgebra::convert;

use crate::channel::Additive;
use crate::compile::{Compiler, Site};
use crate::error::ParameterisationError;
use crate::operation::{Declaration, Operation};
use crate::scalar::{Scalar, shift};
use crate::unit::Dimension;

/// Translation along a direction.
#[derive(Clone, Debug, PartialEq)]
pub struct TranslationDeclaration {
    /// Components that move together.
    pub components: Vec<String>,
    /// The direction; need not be of unit length.
    pub direction: [f64; 3],
    /// Scalar variable, a length.
    pub variable: String,
}

impl Declaration for TranslationDeclaration {
    type Compiled = Translation;

    fn components(&self) -> &[String] {
        &self.components
    }

    fn compile(
        &self,
        site: &Site,
        compiler: &mut Compiler<'_>,
    ) -> Result<Translation, ParameterisationError> {
        let direction = site.direction("direction", self.direction)?;
        let variables = &mut compiler.variables;
        let length = variables.additive_scalar(&site.field("variable"), &self.variable, Dimension::Length)?;
        Ok(Translation { targets: compiler.targets(site), direction, length })
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Translation {
    targets: Vec<usize>,
    direction: Vector3,
    length: Additive,
}

impl Operation for Translation {
    fn eval<T: Scalar>(&self, design: &[T], points: &mut [nalgebra::Vector3<T>]) {
        let step = self.direction.map(convert::<f64, T>) * self.length.value(design, 0);
        for &i in &self.targets {
            shift(&mut points[i], step);
        }
    }

    fn jvp(&self, _: &[f64], _: &[Vector3], direction: &[f64], tangents: &mut [Vector3]) {
        let step = self.direction * self.length.jvp(direction, 0);
        for &i in &self.targets {
            tangents[i] += step;
        }
    }

    fn vjp(&self, _: &[f64], _: &[Vector3], seeds: &mut [Vector3], gradient: &mut [f64]) {
        let sum: Vector3 = self.targets.iter().map(|&i| seeds[i]).sum();
        self.length.vjp(self.direction.dot(&sum), 0, gradient);
    }
}
