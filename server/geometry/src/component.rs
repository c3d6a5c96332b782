//! Components: named sets of untrimmed patches that enclose a volume (the S_c of eq. 1).
//!
//! A user's patches may be only C0 at knots of full multiplicity, may be unclamped, and may be oriented either way.
//! Inside, patches are clamped and smooth, cut at their C0 knots; the cut is a linear map of control points that is kept
//! as a sparse matrix, so that deformed control points and derivatives pass through it.

use crate::block::add_row;
use crate::topology::{Piece, Topology};
use crate::{Block, Edge, Location, Side, Vector3, Vertex};
use moldline_foundation::quadrature::GAUSS_4;
use moldline_spline::{KnotVector, LinearRow, Surface, SurfacePoint};
use std::ops::Range;

/// A patch as a user gives it.
#[derive(Debug, Clone, PartialEq)]
pub struct PatchInput {
    /// Its name, for messages.
    pub name: String,
    /// Knots along `u`.
    pub knots_u: KnotVector,
    /// Knots along `v`.
    pub knots_v: KnotVector,
    /// Cartesian control points, metres, index `i n_v + j`.
    pub control_points: Vec<[f64; 3]>,
    /// Positive weights in the same order; none means all 1.
    pub weights: Option<Vec<f64>>,
}

/// How patches are joined.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ComponentOptions {
    /// An edge is sharp where the normals of its two sides differ by more than this, degrees.
    pub sharp_angle_degrees: f64,
    /// Patch edges this close, relative to the component's size, are the same.
    pub edge_tolerance: f64,
    /// Whether a shell may have a boundary (a half model cut at its symmetry plane).
    pub allow_open: bool,
}

impl Default for ComponentOptions {
    fn default() -> Self {
        Self { sharp_angle_degrees: 20.0, edge_tolerance: 1e-7, allow_open: false }
    }
}

/// Why patches do not make a component.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ComponentError {
    /// There is no patch.
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
        /// How many were given.
        count: usize,
        /// How many the knots need along `u`.
        n_u: usize,
        /// How many the knots need along `v`.
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
    /// A weight is not positive and finite.
    #[error("weight {index} of patch '{patch}' is {value}: weights must be positive")]
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
    /// The shell has a boundary, and that was not allowed.
    #[error(
        "side {side:?} of patch '{patch}' from {from:?} to {to:?} joins no other patch ({count} such edges): close the \
         shell, or allow open shells"
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
        /// How many sides share the edge.
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

/// A smooth, clamped, oriented piece of a component.
#[derive(Debug, Clone, PartialEq)]
pub struct Patch {
    /// The name of the user's patch it is (part of).
    pub name: String,
    /// Index of that patch among the user's.
    pub source: usize,
    /// Its basis; a part of a user's patch keeps that patch's parameters.
    pub surface: Surface,
    /// Its control points in the component's array.
    pub range: Range<usize>,
    /// Whether `S_u x S_v` points into the component.
    pub flipped: bool,
}

impl Patch {
    pub(crate) fn point(&self, control_points: &[[f64; 4]], u: f64, v: f64) -> SurfacePoint {
        self.surface.point(&control_points[self.range.clone()], u, v)
    }

    /// First and last value of the parameter along a side.
    pub(crate) fn side_domain(&self, side: Side) -> (f64, f64) {
        self.surface.domain()[usize::from(side.holds_u())]
    }

    pub(crate) fn on_side(&self, patch: u32, side: Side, t: f64) -> Location {
        let [u, v] = self.surface.domain();
        match side {
            Side::UMin => Location { patch, u: u.0, v: t },
            Side::UMax => Location { patch, u: u.1, v: t },
            Side::VMin => Location { patch, u: t, v: v.0 },
            Side::VMax => Location { patch, u: t, v: v.1 },
        }
    }

    /// Parameters along a side: every break and `per_interval - 1` values between each two.
    pub(crate) fn side_samples(&self, side: Side, per_interval: usize) -> Vec<f64> {
        let knots = if side.holds_u() { self.surface.knots_v() } else { self.surface.knots_u() };
        samples(knots, per_interval)
    }

    /// The point of a side nearest to `x` within a range of its parameter: the parameter and the distance. Newton from
    /// the best of a number of samples, in steps that never increase the distance.
    pub(crate) fn closest_on_side(
        &self,
        control_points: &[[f64; 4]],
        side: Side,
        range: (f64, f64),
        x: &Vector3,
    ) -> (f64, f64) {
        let inside = |t: &f64| *t > range.0 && *t < range.1;
        let candidates = self.side_samples(side, 6).into_iter().filter(inside).chain([range.0, range.1]);
        let distance = |t: f64| {
            let l = self.on_side(0, side, t);
            (self.surface.position(&control_points[self.range.clone()], l.u, l.v) - x).norm()
        };
        let best = candidates.map(|t| (distance(t), t)).min_by(|a, b| a.0.total_cmp(&b.0));
        let start = best.map_or(range.0, |b| b.1);
        crate::newton::on_side(self, control_points, side, range, x, start)
    }

    /// The unit normal `S_u x S_v`, not yet turned outward; its limit where the product vanishes, and zero if there is
    /// none.
    pub(crate) fn normal(&self, control_points: &[[f64; 4]], u: f64, v: f64) -> Vector3 {
        self.normal_at(control_points, u, v, &self.point(control_points, u, v))
    }

    /// The same for a point that is already evaluated.
    #[inline]
    pub(crate) fn normal_at(&self, control_points: &[[f64; 4]], u: f64, v: f64, p: &SurfacePoint) -> Vector3 {
        let [(u0, u1), (v0, v1)] = self.surface.domain();
        if let Some(n) = cross(&p.d_u, &p.d_v, u1 - u0, v1 - v0) {
            return n;
        }
        let control_points = &control_points[self.range.clone()];
        // On a collapsed side the derivative along it vanishes; to first order it grows with the mixed derivative.
        let j = self.surface.jet(control_points, u, v);
        let (middle_u, middle_v) = (0.5 * (u0 + u1), 0.5 * (v0 + v1));
        let (lu, lv) = (u1 - u0, v1 - v0);
        let toward_u = if u < middle_u { lu } else { -lu };
        let toward_v = if v < middle_v { lv } else { -lv };
        let limits = [(p.d_u, j.d_uv * toward_u), (j.d_uv * toward_v, p.d_v)];
        let at_side = [u == u0 || u == u1, v == v0 || v == v1];
        for ((a, b), _) in limits.iter().zip(at_side).filter(|(_, at)| *at) {
            let scale_u = if b == &p.d_v { 1.0 } else { lu };
            let scale_v = if a == &p.d_u { 1.0 } else { lv };
            if let Some(n) = cross(a, b, scale_u, scale_v) {
                return n;
            }
        }
        // Higher contact: the normal a little further inside.
        for step in [1e-6, 1e-4, 1e-2] {
            let (u, v) = (u + step * toward_u, v + step * toward_v);
            let p = self.surface.point(control_points, u, v);
            if let Some(n) = cross(&p.d_u, &p.d_v, lu, lv) {
                return n;
            }
        }
        Vector3::zeros()
    }

    /// Volume of the cone from `origin` over the patch: `1/3` of the integral of `(S - o) . (S_u x S_v)`, by Gauss
    /// quadrature with four points per interval; only its sign is used.
    pub(crate) fn cone_volume(&self, control_points: &[[f64; 4]], origin: &Vector3) -> f64 {
        let mut sum = 0.0;
        for u in self.surface.knots_u().breaks().windows(2) {
            for v in self.surface.knots_v().breaks().windows(2) {
                let area = (u[1] - u[0]) * (v[1] - v[0]);
                for (a, wa) in GAUSS_4 {
                    for (b, wb) in GAUSS_4 {
                        let at = |x: f64, w: &[f64]| w[0] + 0.5 * (1.0 + x) * (w[1] - w[0]);
                        let p = self.point(control_points, at(a, u), at(b, v));
                        sum += 0.25 * area * wa * wb * (p.position - origin).dot(&p.d_u.cross(&p.d_v));
                    }
                }
            }
        }
        sum / 3.0
    }
}

/// The unit vector along `a x b`, unless the angle between them or one of their lengths is lost in rounding.
fn cross(a: &Vector3, b: &Vector3, scale_a: f64, scale_b: f64) -> Option<Vector3> {
    let (a, b) = (a * scale_a, b * scale_b);
    let n = a.cross(&b);
    let (la, lb, ln) = (a.norm(), b.norm(), n.norm());
    let long_enough = la.min(lb) > 1e-9 * la.max(lb);
    (long_enough && ln > 1e-9 * la * lb).then(|| n / ln)
}

pub(crate) fn samples(knots: &KnotVector, per_interval: usize) -> Vec<f64> {
    let breaks = knots.breaks();
    let between = |w: &[f64]| {
        let (a, b) = (w[0], w[1]);
        (0..per_interval).map(move |k| a + (b - a) * k as f64 / per_interval as f64).collect::<Vec<_>>()
    };
    let mut all: Vec<f64> = breaks.windows(2).flat_map(between).collect();
    all.push(breaks[breaks.len() - 1]);
    all
}

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
            validate(patch)?;
        }
        let user_points: Vec<[f64; 3]> =
            patches.iter().flat_map(|p| p.control_points.iter().copied()).collect();
        let bounds = crate::Aabb::around(user_points.iter().map(|p| Vector3::from(*p)));
        let size = bounds.diagonal();
        if size == 0.0 {
            return Err(ComponentError::NoExtent { component: name });
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
        let topology = Topology::find(&pieces, &control_points, size, options)?;
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

    /// The edge a location lies on, whatever its kind, if it is within `tolerance` (relative to the length of the patch's
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

fn validate(patch: &PatchInput) -> Result<(), ComponentError> {
    let name = || patch.name.clone();
    let (n_u, n_v) = (patch.knots_u.control_point_count(), patch.knots_v.control_point_count());
    let count = patch.control_points.len();
    if count != n_u * n_v {
        return Err(ComponentError::ControlPointCount { patch: name(), count, n_u, n_v });
    }
    for (index, p) in patch.control_points.iter().enumerate() {
        if let Some(&value) = p.iter().find(|c| !c.is_finite()) {
            return Err(ComponentError::NotFinite { patch: name(), index, value });
        }
    }
    if let Some(weights) = &patch.weights {
        if weights.len() != count {
            return Err(ComponentError::WeightCount { patch: name(), weights: weights.len(), count });
        }
        if let Some(index) = weights.iter().position(|w| !w.is_finite() || *w <= 0.0) {
            return Err(ComponentError::Weight { patch: name(), index, value: weights[index] });
        }
    }
    Ok(())
}
