//! The system of equations for the potential, and its derivative.
//!
//! The unknown mu is the total potential on the outside, the strength of a sheet of doublets. It is linear on every element, so that the sheet is
//! one of vortices, `gamma = n x grad mu`, and the flow inside is at rest once none passes through the surface. That is asked for in the
//! mean with every test function w (Galerkin): with the vector potential A of the sheet, V' the onset flow, and Stokes' theorem on the surface that is
//! cut along trailing edges,
//!
//! ```text
//! integral w n.(V' + curl A) dS = 0
//! integral A.(n x grad w) dS - integral_cut w A.dl = integral w n.V' dS
//! ```
//!
//! For a pair of elements both integrals are `c_w . c_mu I` with `c = area n x grad`, linear in the potential and in the positions, and the mean
//! inverse distance I. So one scalar of every pair is all that is needed; the matrix is positive semidefinite but for the wakes, whatever the shape of
//! the cells. Wakes are elements that carry the circulation of trailing edges.
//!
//! [`near`] and [`far`] have the mean inverse distances, [`targets`] what is tested, [`records`] the geometry of what acts, [`assembly`] the matrix and the
//! right-hand sides, [`walk`] the pass over all pairs that the products [`jvp`] and [`vjp`] share.

mod assembly;
mod far;
mod figure;
mod jvp;
mod near;
mod records;
mod targets;
mod vjp;
mod walk;

pub(crate) use records::{Charges, Influence, Layout};
