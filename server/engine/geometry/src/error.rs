//! Errors of components.

use crate::location::Side;

/// Why patches do not form a component.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ComponentError {
    /// No patches.
    #[error("component '{component}' has no patches")]
    Empty {
        /// The component's name.
        component: String,
    },
    /// Knots and control points do not fit.
    #[error("patch '{patch}' has {count} control points, but its knots need {n_u} x {n_v}")]
    ControlPointCount {
        /// The patch's name.
        patch: String,
        /// Number of control points given.
        count: usize,
        /// Control points that the knots need along `u`.
        n_u: usize,
        /// Control points that the knots need along `v`.
        n_v: usize,
    },
    /// Control points and weights differ in number.
    #[error("patch '{patch}' has {weights} weights for {count} control points")]
    WeightCount {
        /// The patch's name.
        patch: String,
        /// Number of weights.
        weights: usize,
        /// Number of control points.
        count: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error(
        "control point {index} of patch '{patch}' has the coordinate {value}, which is not a finite number"
    )]
    NotFinite {
        /// The patch's name.
        patch: String,
        /// Control point index.
        index: usize,
        /// The coordinate.
        value: f64,
    },
    /// A weight is not positive, or absurdly small or large.
    #[error("weight {index} of patch '{patch}' is {value}: weights must be positive, from 1e-9 to 1e9")]
    Weight {
        /// The patch's name.
        patch: String,
        /// Control point index.
        index: usize,
        /// The weight.
        value: f64,
    },
    /// All control points coincide.
    #[error("all control points of component '{component}' coincide")]
    NoExtent {
        /// The component's name.
        component: String,
    },
    /// A component is so small or so large that squares and products of its lengths leave double precision.
    #[error(
        "component '{component}' measures {size:e} m across, outside 1e-30..=1e30 m: check the unit of its control points"
    )]
    Size {
        /// The component's name.
        component: String,
        /// Diagonal of the box around its control points, m.
        size: f64,
    },
    /// The shell has a boundary, and that was not allowed.
    #[error(
        "side {side:?} of patch '{patch}' from {from:?} to {to:?} joins no other patch ({count} such edges); the nearest side is up to \
         {gap:.3e} m away: {}",
        match fraction {
            Some(fraction) => format!(
                "set the component's `edge_tolerance` to a little more, such as {fraction:e} (a fraction of its size), or close the gap"
            ),
            None => "close the shell, or set `open = true` if it is meant to be open".to_owned(),
        }
    )]
    Open {
        /// The patch's name.
        patch: String,
        /// The side.
        side: Side,
        /// Where the boundary edge starts.
        from: [f64; 3],
        /// Where it ends.
        to: [f64; 3],
        /// Number of boundary edges.
        count: usize,
        /// Largest distance of the side from the nearest other one, m; infinite without another one.
        gap: f64,
        /// The tolerance that joins them as a fraction of the component's size, if the gap looks like one.
        fraction: Option<f64>,
    },
    /// More than two patch sides share an edge.
    #[error(
        "side {side:?} of patch '{patch}' lies on an edge shared by {count} patch sides; two are possible"
    )]
    NonManifold {
        /// The patch's name.
        patch: String,
        /// The side.
        side: Side,
        /// Number of sides that share the edge.
        count: usize,
    },
    /// Inside and outside cannot be told apart.
    #[error(
        "the surface is one-sided: the orientations of patches '{patch}' and '{neighbour}' contradict each other"
    )]
    NotOrientable {
        /// The patch's name.
        patch: String,
        /// Its neighbour's name.
        neighbour: String,
    },
}
