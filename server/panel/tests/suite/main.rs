//! Against closed forms, published results, differences, dual numbers, and with bad input.

mod derivatives;
mod flow;
mod meshes;
