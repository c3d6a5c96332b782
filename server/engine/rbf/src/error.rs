//! What prevents a factorisation.

/// Why a system cannot be factorised.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RbfError {
    /// Too few centres, or all of them in a plane.
    #[error("the {centres} centres lie in one plane; an affine field needs centres all around")]
    Planar {
        /// Number of centres.
        centres: usize,
    },
    /// Two centres coincide.
    #[error("centres {other} and {centre} coincide: they are {distance:e} m apart; remove one of them")]
    Coincident {
        /// Index of the first centre that coincides with one before it.
        centre: usize,
        /// Index of the latter.
        other: usize,
        /// Their distance, m.
        distance: f64,
    },
    /// The matrix is not positive definite in double precision.
    #[error(
        "the interpolation matrix is not positive definite in double precision: its factorisation ends at centre \
         {centre}, which is {distance:e} m from the nearest one, centre {nearest}; thin out the centres or raise the \
         regularisation"
    )]
    NotPositiveDefinite {
        /// Index of the centre whose pivot is not positive.
        centre: usize,
        /// Index of the centre nearest to it.
        nearest: usize,
        /// Their distance, m.
        distance: f64,
    },
}
