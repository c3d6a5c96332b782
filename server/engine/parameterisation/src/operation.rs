//! The traits of operations: a declaration that compiles, and the compiled map with its derivatives.

use moldline_foundation::Vector3;

use crate::compile::{Compiler, Site};
use crate::error::ParameterisationError;
use crate::scalar::Scalar;

/// An operation as declared.
///
/// All operations place their pivots first, then all place their centres, then each is compiled: a point carried along
/// exists before any operation that moves it is compiled.
pub(crate) trait Declaration {
    /// The operation that it compiles to.
    type Compiled: Operation;

    /// Names of the components that it acts on.
    fn components(&self) -> &[String];

    /// The point that it turns or scales about, in reference coordinates, m.
    fn pivot(
        &self,
        _site: &Site,
        _compiler: &Compiler<'_>,
    ) -> Result<Option<Vector3>, ParameterisationError> {
        Ok(None)
    }

    /// Carries the centres that it scales about: points that are scaled, each with its centre, as indices of points.
    fn centres(
        &self,
        _site: &Site,
        _compiler: &mut Compiler<'_>,
    ) -> Result<Vec<(usize, usize)>, ParameterisationError> {
        Ok(Vec::new())
    }

    /// Checks the declaration, looks up its variables and measures the reference geometry.
    fn compile(
        &self,
        site: &Site,
        compiler: &mut Compiler<'_>,
    ) -> Result<Self::Compiled, ParameterisationError>;
}

/// A compiled operation: a map of the points (control points, then points carried along), driven by the design.
///
/// `design` is the whole design vector in declared units, `points` the points before the operation, m.
pub(crate) trait Operation {
    /// Moves the points. At the baseline they keep their bits.
    fn eval<T: Scalar>(&self, design: &[T], points: &mut [nalgebra::Vector3<T>]);

    /// Turns the tangents of the points before the operation into those after it, for the change `direction` of the
    /// design.
    fn jvp(&self, design: &[f64], points: &[Vector3], direction: &[f64], tangents: &mut [Vector3]);

    /// The transpose: turns the seeds on the points after the operation into those on the points before it, and adds
    /// to the `gradient` with respect to the design.
    fn vjp(&self, design: &[f64], points: &[Vector3], seeds: &mut [Vector3], gradient: &mut [f64]);

    /// Its control lattice at a design, if it is a free-form block.
    fn lattice(&self, _design: &[f64]) -> Option<Lattice> {
        None
    }
}

/// The control lattice of a free-form block, for pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct Lattice {
    /// Points along chord, span and thickness.
    pub shape: [usize; 3],
    /// The points, m; index `(i n_span + k) n_thickness + j`.
    pub points: Vec<[f64; 3]>,
}
