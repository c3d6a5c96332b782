//! Radial basis function interpolation of scattered data in space, with an affine term (eq. 16 and 17 of the paper): a system over
//! fixed centres is factorised once, then solved and evaluated for any number of data.
//!
//! The interpolant is `d(x) = sum_j psi(|x - c_j|) w_j + A^T p(x)`, `p = [1, x]`, with `P^T w = 0`. Both kernels are
//! conditionally positive definite (multiquadric `psi = -sqrt(r^2 + c^2)`, order 1; cubic `psi = r^3`, order 2; Wendland,
//! Scattered Data Approximation, sec. 8.1), so with `P = Q [R; 0]` the block `(Q^T Psi Q)_22` is positive definite and Cholesky
//! applies. The saddle-point matrix is symmetric: the same factor serves the adjoint.
//!
//! Close centres with different data have weights that are much larger than the data and cancel in the sum; with `r^3` a
//! million times and more. Sums over cubic functions are therefore exact in their leading digits, and their weights have
//! twice the digits of a double, by iterative refinement with residuals from such sums.
//!
//! Parallel loops run on rayon's current pool. Results are the same to the last bit whatever its size: every value is
//! computed by one task in one fixed order.
//!
//! ```
//! use moldline_rbf::{Block, Kernel, RadialBasis, Vector3};
//!
//! // The corners of a cube, m, and one number for each of them.
//! let corner = |i: u8| Vector3::new((i & 1).into(), (i >> 1 & 1).into(), (i >> 2).into());
//! let centres: Vec<Vector3> = (0..8).map(corner).collect();
//! let mut data = Block::zeros(8, 1);
//! for (i, c) in centres.iter().enumerate() {
//!     data.row_mut(i)[0] = 1.0 + 2.0 * c.x - c.z;
//! }
//!
//! let basis = RadialBasis::new(Kernel::Cubic, &centres, 0.0)?;
//! let interpolant = basis.fit(&data);
//! // Affine data are reproduced.
//! let values = basis.evaluate(&interpolant, &[Vector3::new(0.5, 0.25, 1.5)]);
//! assert!((values.row(0)[0] - 0.5).abs() < 1e-14);
//!
//! // The gradient of that value with respect to the data comes from the transposes: at a corner, that corner's datum alone counts.
//! let mut seed = Block::zeros(1, 1);
//! seed.row_mut(0)[0] = 1.0;
//! let gradient = basis.fit_vjp(&basis.evaluate_vjp(&centres[3..4], &seed));
//! assert!((gradient.row(3)[0] - 1.0).abs() < 1e-14 && gradient.row(0)[0].abs() < 1e-14);
//! # Ok::<(), moldline_rbf::RbfError>(())
//! ```
//!
//! Absent on purpose: meshes, where centres and data come from, kernels of compact support.

mod coefficients;
mod error;
mod error_free;
mod evaluate;
mod factor;
mod kernel;
mod points;
mod polynomial;
mod solve;
mod sum;
mod triangular;

pub use coefficients::Coefficients;
pub use error::RbfError;
pub use factor::{Factors, RadialBasis};
pub use kernel::Kernel;
pub use moldline_foundation::{Block, Vector3};

/// Lanes of sums; they are added per lane and then across lanes in order, whatever the processor.
const LANES: usize = 8;
/// Columns up to which kernel values are formed and used in registers, and rows of triangular systems are shared out.
const FEW: usize = 3;
