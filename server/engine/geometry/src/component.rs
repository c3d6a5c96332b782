//! Components: named sets of untrimmed patches that enclose a volume (the S_c of eq. 1).
//!
//! A user's patches may be only C0 at knots of full multiplicity, unclamped, and oriented either way. Internal patches are
//! clamped and smooth, cut at the C0 knots; the cut is a linear map of control points, kept as a sparse matrix, so that
//! deformed control points and derivatives pass through it.

use crate::block::{Block, add_row};
use crate::bounds::Aabb;
use crate::error::ComponentError;
use crate::joining::{ComponentOptions, join};
use crate::location::{Location, Side};
use crate::patch::{Patch, PatchInput};
use crate::topology::{Edge, Piece, Topology, Vertex};
use moldline_foundation::Vector3;
use moldline_spline::{KnotVector, LinearRow, Surface};
use std::ops::Range;

/// A component's patches and how they join. Immutable set-up data, the same for all states of its control points.
#[derive(Debug, Clone)]
pub struct Component {
    name: String,
    patches: Vec<Patch>,
    topology: Topology,
    control_point_count: usize,
    user: UserMap,
}

/// The linear map from a user's control points to the internal ones, row by row.
#[derive(Debug, Clone)]
struct UserMap {
    /// Weight of each of the user's control points.
    weights: Vec<f64>,
    offsets: Vec<usize>,
    columns: Vec<u32>,
    values: Vec<f64>,
    /// Weight of each internal control point.
    internal_weights: Vec<f64>,
    /// The user's control points of each of the user's patches.
    ranges: Vec<Range<usize>>,
}

impl Component {
    /// Joins patches into a component and returns it with its internal control points.
    ///
    /// # Errors
    /// If the input is inconsistent, or the patches enclose no volume; see [`ComponentError`].
    pub fn new(
        name: String,
        patches: Vec<PatchInput>,
        options: &ComponentOptions,
    ) -> Result<(Self, Vec<[f64; 4]>), ComponentError> {
        if patches.is_empty() {
            return Err(ComponentError::Empty { component: name });
        }
        for patch in &patches {
            patch.validate()?;
        }
        let user_points: Vec<[f64; 3]> =
            patches.iter().flat_map(|p| p.control_points.iter().copied()).collect();
        let bounds = Aabb::around(user_points.iter().map(|p| Vector3::from(*p)));
        let size = bounds.diagonal();
        if size == 0.0 {
            return Err(ComponentError::NoExtent { component: name });
        }
        if !(1e-30..=1e30).contains(&size) {
            return Err(ComponentError::Size { component: name, size });
        }

        let mut pieces = Vec::new();
        let mut user = UserMap {
            weights: Vec::new(),
            offsets: vec![0],
            columns: Vec::new(),
            values: Vec::new(),
            internal_weights: Vec::new(),
            ranges: Vec::new(),
        };
        for (source, input) in patches.iter().enumerate() {
            let base = user.weights.len();
            let count = input.control_points.len();
            let weights = input.weights.clone().unwrap_or_else(|| vec![1.0; count]);
            let rational = weights.iter().any(|&w| w != 1.0);
            user.weights.extend_from_slice(&weights);
            user.ranges.push(base..base + count);
            let n_v = input.knots_v.control_point_count();
            for (knots_u, rows_u) in smooth_pieces(&input.knots_u) {
                for (knots_v, rows_v) in smooth_pieces(&input.knots_v) {
                    let start = user.internal_weights.len();
                    for ru in &rows_u {
                        for rv in &rows_v {
                            user.push_row(base, n_v, ru, rv, rational);
                        }
                    }
                    let surface = if rational {
                        Surface::rational(knots_u.clone(), knots_v)
                    } else {
                        Surface::new(knots_u.clone(), knots_v)
                    };
                    pieces.push(Patch {
                        name: input.name.clone(),
                        source,
                        surface,
                        range: start..user.internal_weights.len(),
                        flipped: false,
                    });
                }
            }
        }
        let control_points = user.apply(&user_points);
        let topology = join(&pieces, &control_points, size, options)?;
        for (patch, &flipped) in pieces.iter_mut().zip(&topology.flipped) {
            patch.flipped = flipped;
        }
        let control_point_count = control_points.len();
        Ok((Self { name, patches: pieces, topology, control_point_count, user }, control_points))
    }

    /// The component's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The internal patches.
    pub fn patches(&self) -> &[Patch] {
        &self.patches
    }

    /// Number of internal control points.
    pub fn control_point_count(&self) -> usize {
        self.control_point_count
    }

    /// Number of the user's control points.
    pub fn user_control_point_count(&self) -> usize {
        self.user.weights.len()
    }

    /// The user's control points of each of the user's patches.
    pub fn user_ranges(&self) -> &[Range<usize>] {
        &self.user.ranges
    }

    /// The internal homogeneous control points for the user's Cartesian ones (patch after patch, as given to
    /// [`Component::new`]); weights stay as they were given. Linear and exact.
    ///
    /// # Panics
    /// If `user` does not have [`user_control_point_count`](Self::user_control_point_count) entries.
    pub fn internal_control_points(&self, user: &[[f64; 3]]) -> Vec<[f64; 4]> {
        assert_eq!(user.len(), self.user.weights.len(), "one point for each of the user's control points");
        self.user.apply(user)
    }

    /// The derivative of [`internal_control_points`](Self::internal_control_points): tangents of the user's control
    /// points (rows of vectors) to those of the internal ones, whose weights are fixed.
    ///
    /// # Panics
    /// If `tangents` does not have [`user_control_point_count`](Self::user_control_point_count) rows.
    pub fn internal_jvp(&self, tangents: &Block) -> Block {
        let map = &self.user;
        let mut out = Block::zeros(self.control_point_count, tangents.width());
        for row in 0..self.control_point_count {
            for k in map.offsets[row]..map.offsets[row + 1] {
                let column = map.columns[k] as usize;
                let factor = map.values[k] * map.weights[column];
                add_row(out.row_mut(row), factor, tangents.row(column));
            }
        }
        out
    }

    /// The transpose of [`internal_jvp`](Self::internal_jvp).
    ///
    /// # Panics
    /// If `seeds` does not have [`control_point_count`](Self::control_point_count) rows.
    pub fn internal_vjp(&self, seeds: &Block) -> Block {
        let map = &self.user;
        let mut out = Block::zeros(map.weights.len(), seeds.width());
        for row in 0..self.control_point_count {
            for k in map.offsets[row]..map.offsets[row + 1] {
                let column = map.columns[k] as usize;
                let factor = map.values[k] * map.weights[column];
                add_row(out.row_mut(column), factor, seeds.row(row));
            }
        }
        out
    }

    /// All edges: where patches meet, boundaries, and collapsed sides.
    pub fn edges(&self) -> &[Edge] {
        &self.topology.edges
    }

    /// All vertices: where edges end.
    pub fn vertices(&self) -> &[Vertex] {
        &self.topology.vertices
    }

    /// Whether any edge is a boundary.
    pub fn is_open(&self) -> bool {
        self.edges().iter().any(Edge::is_boundary)
    }

    /// The edge that a location lies on, whatever its kind, if it is within `tolerance` (relative to the length of the patch's
    /// parameter range) of a side; sharp and collapsed edges go before smooth ones.
    pub fn edge_of(&self, location: &Location, tolerance: f64) -> Option<u32> {
        let patch = self.patches.get(location.patch as usize)?;
        let near = |side: Side| {
            let [u, v] = patch.surface.domain();
            let (value, (a, b)) = if side.holds_u() { (location.u, u) } else { (location.v, v) };
            (value - if side.is_min() { a } else { b }).abs() <= tolerance * (b - a)
        };
        let rank = |&e: &u32| {
            let edge = &self.edges()[e as usize];
            if edge.collapsed { 0 } else { 1 + usize::from(!edge.sharp) }
        };
        Side::ALL
            .into_iter()
            .filter(|&side| near(side))
            .filter_map(|side| {
                let t = if side.holds_u() { location.v } else { location.u };
                self.piece(location.patch, side, t).map(|p| p.edge)
            })
            .min_by_key(rank)
    }

    /// The piece of a side that contains parameter `t`.
    pub(crate) fn piece(&self, patch: u32, side: Side, t: f64) -> Option<&Piece> {
        let pieces = &self.topology.pieces[patch as usize][side as usize];
        pieces.iter().find(|p| t <= p.high).or(pieces.last())
    }
}

impl UserMap {
    fn push_row(&mut self, base: usize, n_v: usize, ru: &LinearRow, rv: &LinearRow, rational: bool) {
        let mut weight = 0.0;
        for i in 0..ru.count {
            for j in 0..rv.count {
                let value = ru.weights[i] * rv.weights[j];
                if value != 0.0 {
                    let column = base + (ru.first + i) * n_v + rv.first + j;
                    weight += value * self.weights[column];
                    self.columns.push(column as u32);
                    self.values.push(value);
                }
            }
        }
        self.offsets.push(self.columns.len());
        self.internal_weights.push(if rational { weight } else { 1.0 });
    }

    fn apply(&self, user: &[[f64; 3]]) -> Vec<[f64; 4]> {
        self.internal_weights
            .iter()
            .zip(self.offsets.windows(2))
            .map(|(&weight, range)| {
                let mut out = [0.0, 0.0, 0.0, weight];
                for k in range[0]..range[1] {
                    let column = self.columns[k] as usize;
                    let factor = self.values[k] * self.weights[column];
                    for d in 0..3 {
                        out[d] += factor * user[column][d];
                    }
                }
                out
            })
            .collect()
    }
}

/// The clamped pieces of a knot vector between knots at which the spline is only continuous, with the rows that give
/// their control points.
fn smooth_pieces(knots: &KnotVector) -> Vec<(KnotVector, Vec<LinearRow>)> {
    let (a, b) = knots.domain();
    let mut ends: Vec<f64> = knots
        .breaks()
        .iter()
        .copied()
        .filter(|&t| t == a || t == b || knots.multiplicity(t) >= knots.degree())
        .collect();
    ends.dedup();
    ends.windows(2)
        .map(|w| {
            let piece = knots.clamped_piece(w[0], w[1]);
            let rows = knots.refinement(&piece);
            (piece, rows)
        })
        .collect()
}
