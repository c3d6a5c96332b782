//! Errors of the engine: their class, and the field of the input that they are about.

/// The class of a [`Failure`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Class {
    /// The input is wrong.
    Input,
    /// The input is valid, but the computation fails on it.
    Computation,
    /// The computation needs more memory than the limit.
    Memory,
    /// The caller cancelled the computation.
    Cancelled,
}

/// A typed error that knows where in the input its cause is. Each error enum of the engine implements it next to its
/// variants, so that a new variant cannot be forgotten elsewhere.
pub trait Failure: std::error::Error {
    /// The class of the error.
    fn class(&self) -> Class {
        Class::Input
    }

    /// Path of the field of the input, such as `vertices[3][1]`, relative to the input of the function that returned the
    /// error; `None` if no field is to blame.
    fn field(&self) -> Option<String>;
}
