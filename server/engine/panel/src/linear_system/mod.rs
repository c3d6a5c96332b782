//! The linear system `A mu = b`, its transpose, and their solvers.
//!
//! [`operator`] has the solvers' view of A: products, and blocks of entries. [`matrix`] is the dense one. [`lu`] and [`block_jacobi`] are
//! inverses, exact and approximate; [`refinement`] and [`gmres`] bring their solutions to one tolerance. [`system`] picks among them.

mod block_jacobi;
mod gmres;
mod lu;
mod matrix;
mod operator;
mod refinement;
mod system;

pub(crate) use matrix::Matrix;
pub(crate) use system::System;
