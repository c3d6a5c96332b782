//! Against closed forms, published results, differences, dual numbers, and with bad input.

mod derivatives;
mod dual;
mod flow;
mod meshes;
mod refusals;
