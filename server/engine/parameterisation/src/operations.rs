//! The list of operations. A new one is a file beside these, and its lines here.

mod free_form;
mod planform;
mod radial_scale;
mod rotation;
mod translation;

pub use free_form::{FreeFormDeclaration, SectionDeclaration, SectionKind};
pub use planform::{PlanformDeclaration, SweepRule};
pub use radial_scale::{CentreLine, RadialScaleDeclaration};
pub use rotation::RotationDeclaration;
pub use translation::TranslationDeclaration;

use moldline_foundation::Vector3;

use crate::compile::{Compiler, Site};
use crate::error::ParameterisationError;
use crate::operation::{Declaration, Lattice, Operation};
use crate::scalar::Scalar;

/// Makes the declared and the compiled form of all operations out of the list, and passes calls on to each.
///
/// `Operation::eval` is generic, so that compiled operations cannot be trait objects.
macro_rules! operations {
    ($($(#[$doc:meta])* $name:ident($declaration:ty),)*) => {
        /// An operation on the control points of some components. Operations act in the declared order, each on the
        /// result of those before it; the points that they turn or scale about are carried along by the earlier ones.
        #[derive(Clone, Debug, PartialEq)]
        pub enum OperationDeclaration {
            $($(#[$doc])* $name($declaration),)*
        }

        /// A compiled operation.
        #[derive(Clone, Debug)]
        pub(crate) enum AnyOperation {
            $($name(Box<<$declaration as Declaration>::Compiled>),)*
        }

        impl Declaration for OperationDeclaration {
            type Compiled = AnyOperation;

            fn components(&self) -> &[String] {
                match self {
                    $(Self::$name(d) => d.components(),)*
                }
            }

            fn pivot(
                &self,
                site: &Site,
                compiler: &Compiler<'_>,
            ) -> Result<Option<Vector3>, ParameterisationError> {
                match self {
                    $(Self::$name(d) => d.pivot(site, compiler),)*
                }
            }

            fn centres(
                &self,
                site: &Site,
                compiler: &mut Compiler<'_>,
            ) -> Result<Vec<(usize, usize)>, ParameterisationError> {
                match self {
                    $(Self::$name(d) => d.centres(site, compiler),)*
                }
            }

            fn compile(
                &self,
                site: &Site,
                compiler: &mut Compiler<'_>,
            ) -> Result<AnyOperation, ParameterisationError> {
                Ok(match self {
                    $(Self::$name(d) => AnyOperation::$name(Box::new(d.compile(site, compiler)?)),)*
                })
            }
        }

        impl Operation for AnyOperation {
            fn eval<T: Scalar>(&self, design: &[T], points: &mut [nalgebra::Vector3<T>]) {
                match self {
                    $(Self::$name(o) => o.eval(design, points),)*
                }
            }

            fn jvp(&self, design: &[f64], points: &[Vector3], direction: &[f64], tangents: &mut [Vector3]) {
                match self {
                    $(Self::$name(o) => o.jvp(design, points, direction, tangents),)*
                }
            }

            fn vjp(&self, design: &[f64], points: &[Vector3], seeds: &mut [Vector3], gradient: &mut [f64]) {
                match self {
                    $(Self::$name(o) => o.vjp(design, points, seeds, gradient),)*
                }
            }

            fn lattice(&self, design: &[f64]) -> Option<Lattice> {
                match self {
                    $(Self::$name(o) => o.lattice(design),)*
                }
            }
        }
    };
}

operations! {
    /// Free-form deformation by a B-spline volume organised by sections.
    FreeForm(FreeFormDeclaration),
    /// Planform area and aspect ratio.
    Planform(PlanformDeclaration),
    /// Rigid rotation.
    Rotation(RotationDeclaration),
    /// Rigid translation.
    Translation(TranslationDeclaration),
    /// Scaling of a body about its centre line.
    RadialScale(RadialScaleDeclaration),
}
