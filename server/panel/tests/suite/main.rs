//! Against closed forms, published results, differences, dual numbers, and with bad input.

mod flow;
mod meshes;
