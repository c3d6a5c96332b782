//! The conforming surface mesh of the union of closed components.
//!
//! 1. `tessellation`: triangles on each component, with the same vertices on both sides of every patch edge.
//! 2. `union`: their exact union; each triangle knows its component, so seams are edges between two components.
//! 3. `surface`, `hold`: every vertex is put onto the splines: onto its component, a seam vertex onto both by Newton's method,
//!    a corner onto the sharp edge of one and the surface of the other.
//! 4. `sizes`, `remesh`: triangles of the wanted sizes, on the splines throughout.
//!
//! Everything after the union runs in one fixed order, so that the same input gives the same bits.
//!
//! Absent on purpose: files, quadrilaterals, moving components.

mod error;
mod generate;
mod hold;
mod remesh;
mod sizes;
mod surface;
mod tessellation;
mod union;

pub use error::MesherError;
pub use generate::{Generated, Options, Seam, Stage, generate};
