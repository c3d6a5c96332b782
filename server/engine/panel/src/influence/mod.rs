//! The influence of doublet panels, source panels and wakes on the collocation points, and its derivative.
//!
//! With `R_i` the potential inside the surface at collocation point i (zero in the solution), mu the doublet strengths and
//! `s = sigma n` the sources:
//!
//! ```text
//! 4 pi R_i = - sum_j mu_j Omega_ij - sum_w Gamma_w Omega_iw - sum_e Q_ie T_e.(a_e - P_i) + sum_j s_j.(c_j - P_i) Omega_ij
//! ```
//!
//! Omega is the solid angle (van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30, 1983) of the panel's spherical
//! polygon, so that a closed surface of warped quadrilaterals closes exactly. Sources are summed by edges:
//! `Q_e = ln((r_a + r_b + L) / (r_a + r_b - L))` belongs to an edge, and both of its panels enter through `T_e = e x (s_left - s_right)`. The
//! solid angle's derivative is a sum over edges as well, with the difference of the strengths on both sides.
//!
//! [`kernels`] has the formulas and their derivatives, [`records`] the geometry in the order of the loops, [`assembly`] the matrix and the
//! right-hand sides, [`derivative`] the pass over pairs that [`jvp`] and [`vjp`] share.
//!
//! Loops run over the collocation points of a tile and the panels of a patch. Nothing is approximated at a distance, so nothing jumps.

mod assembly;
mod derivative;
mod jvp;
mod kernels;
mod records;
mod vjp;

pub(crate) use derivative::Strengths;
pub(crate) use jvp::PairChange;
pub(crate) use records::Influence;
pub(crate) use vjp::PairSeeds;
