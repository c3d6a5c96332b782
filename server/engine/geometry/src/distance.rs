//! The signed distance of a component as an operation, with its first and second-order terms (eqs. 5 and 6;
//! `docs/derivation.md`, section 2).
//!
//! A foot point `y = S(mu)` in a face obeys `J^T (x - y) = 0`, so that `x - y = phi n`, and for changes `dx` of the point
//! and `dS`, `dJ` of the surface at fixed parameters
//!
//! ```text
//! dphi = n . (dx - dS)
//! dmu  = (G - phi B)^-1 [J^T (dx - dS) + phi dJ^T n]
//! dn   = -J G^-1 [dJ^T n + B dmu]
//! ```
//!
//! with `G = J^T J` and `B_ab = S_ab . n`. On a sharp edge the same holds with the one parameter along it, at a corner the
//! parameters are fixed; there `n = (x - y) / phi`.

use crate::body::Body;
use crate::foot_point::{Feature, FootPoint};
use crate::location::{Location, Side};
use moldline_foundation::Vector3;
use nalgebra::Matrix2;

/// The operation `x -> phi, n` for one body.
#[derive(Debug, Clone, Copy)]
pub struct SignedDistance<'a> {
    /// The body.
    pub body: &'a Body,
}

/// Signed distance and its gradient at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SignedDistancePoint {
    /// `phi`, metres, negative inside.
    pub phi: f64,
    /// `n = grad phi`: the surface's outward normal at a foot point inside a face; `(x - y) / phi` where the foot point
    /// `y` is on a sharp edge or at a corner.
    pub normal: Vector3,
    /// The foot point.
    pub foot: FootPoint,
}

/// The arguments of a foot point: the point itself, and the surface under it at fixed parameters. Holds their tangents or
/// their seeds.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FootChange {
    /// `dx`, the point.
    pub x: Vector3,
    /// `dS`.
    pub s: Vector3,
    /// `dS_u`, `dS_v`.
    pub s_uv: [Vector3; 2],
}

/// A signed distance and its foot point, ready for products.
#[derive(Debug, Clone, Copy)]
pub struct SignedDistanceDerivative {
    /// `phi`, metres.
    pub phi: f64,
    /// `n = grad phi`.
    pub normal: Vector3,
    /// `S_u`, `S_v` at the foot point.
    pub j: [Vector3; 2],
    /// `x - y`.
    offset: Vector3,
    /// Rows of `P` in `dmu = P (dx - dS) + Q dJ^T (x - y)`.
    p: [Vector3; 2],
    q: Matrix2<f64>,
    turn: Turn,
}

/// The form of `dn`.
#[derive(Debug, Clone, Copy)]
enum Turn {
    /// `dn = -J G^-1 [dJ^T n + B dmu]`.
    Face {
        /// Columns of `J G^-1`.
        lift: [Vector3; 2],
        b: Matrix2<f64>,
    },
    /// `dn = (I - n n^T) (dx - dS - J dmu) / phi`: edges and corners.
    Fan,
    /// `dn = 0`: on an edge or a corner itself the gradient jumps; the mean normal is held.
    Held,
}

impl<'a> SignedDistance<'a> {
    /// The operation for a body.
    pub fn new(body: &'a Body) -> Self {
        Self { body }
    }

    /// Value and gradient at `x`, from the globally nearest point.
    pub fn eval(&self, x: &Vector3) -> SignedDistancePoint {
        self.at(x, self.body.closest_point(x))
    }

    /// Value and gradient at `x` for the sheet that `hint` is on; falls back on the globally nearest point.
    pub fn eval_near(&self, x: &Vector3, hint: &Location) -> SignedDistancePoint {
        let foot = self.body.closest_point_near(x, hint);
        self.at(x, foot.unwrap_or_else(|| self.body.closest_point(x)))
    }

    /// Value and gradient at `x` for a foot point already found.
    pub fn at(&self, x: &Vector3, foot: FootPoint) -> SignedDistancePoint {
        let phi = foot.distance;
        let off_face = foot.feature != Feature::Face && !self.is_on(phi);
        let normal = if off_face { (x - foot.position) / phi } else { foot.normal };
        SignedDistancePoint { phi, normal, foot }
    }

    /// Whether a distance is zero up to rounding.
    fn is_on(&self, phi: f64) -> bool {
        phi.abs() <= 1e-12 * self.body.size()
    }

    /// The derivative for a foot point of `x`. On an edge the foot point is that on the edge's curve.
    pub fn derivative(&self, x: &Vector3, foot: &FootPoint) -> SignedDistanceDerivative {
        let at = self.at(x, *foot);
        let jet = self.body.jet(&foot.location);
        let offset = x - foot.position;
        let j = [jet.d_u, jet.d_v];
        let uv = jet.d_uv;
        let dot = |v: &Vector3| Matrix2::new(jet.d_uu.dot(v), uv.dot(v), uv.dot(v), jet.d_vv.dot(v));
        let g = Matrix2::from_fn(|a, b| j[a].dot(&j[b]));
        let mut p = [Vector3::zeros(); 2];
        let mut q = Matrix2::zeros();
        let turn = match (foot.feature, self.parameter_along(foot)) {
            (Feature::Face, _) => {
                // phi B, with x - y = phi n.
                q = inverse(g - dot(&offset));
                p = std::array::from_fn(|a| j[0] * q[(a, 0)] + j[1] * q[(a, 1)]);
                let g = inverse(g);
                Turn::Face {
                    lift: std::array::from_fn(|a| j[0] * g[(0, a)] + j[1] * g[(1, a)]),
                    b: dot(&at.normal),
                }
            }
            (_, along) => {
                // An end of the edge holds a foot point that would go on behind it.
                let free = |t: &usize| j[*t].dot(&offset).abs() <= 1e-9 * self.body.size() * j[*t].norm();
                if let Some(t) = along.filter(free) {
                    q[(t, t)] = 1.0 / (g[(t, t)] - dot(&offset)[(t, t)]);
                    p[t] = j[t] * q[(t, t)];
                }
                if self.is_on(at.phi) { Turn::Held } else { Turn::Fan }
            }
        };
        SignedDistanceDerivative { phi: at.phi, normal: at.normal, j, offset, p, q, turn }
    }

    /// The parameter (0: u, 1: v) that runs along the edge which a foot point is on; `None` at corners and inside faces.
    fn parameter_along(&self, foot: &FootPoint) -> Option<usize> {
        let Feature::Edge { edge } = foot.feature else { return None };
        let l = &foot.location;
        let [u, v] = self.body.component().patches()[l.patch as usize].surface.domain();
        let on = |side: Side| match side {
            Side::UMin => l.u <= u.0,
            Side::UMax => l.u >= u.1,
            Side::VMin => l.v <= v.0,
            Side::VMax => l.v >= v.1,
        };
        let sides = &self.body.component().edges()[edge as usize].sides;
        let side = sides.iter().find(|s| s.patch == l.patch && on(s.side)).map(|s| s.side);
        // A vertex that a sharp edge passes through may have been reached from a patch that only touches it.
        side.or_else(|| Side::ALL.into_iter().find(|s| on(*s))).map(|s| usize::from(s.holds_u()))
    }
}

impl SignedDistanceDerivative {
    /// `dmu`: the change of the foot point's parameters.
    pub fn parameters_jvp(&self, change: &FootChange) -> [f64; 2] {
        let step = change.x - change.s;
        let tilt = change.s_uv.map(|s| s.dot(&self.offset));
        std::array::from_fn(|a| self.p[a].dot(&step) + self.q[(a, 0)] * tilt[0] + self.q[(a, 1)] * tilt[1])
    }

    /// The transpose of [`parameters_jvp`](Self::parameters_jvp).
    pub fn parameters_vjp(&self, seed: [f64; 2]) -> FootChange {
        let x = self.p[0] * seed[0] + self.p[1] * seed[1];
        // Q is symmetric.
        let tilt: [f64; 2] = std::array::from_fn(|a| self.q[(a, 0)] * seed[0] + self.q[(a, 1)] * seed[1]);
        FootChange { x, s: -x, s_uv: tilt.map(|t| self.offset * t) }
    }

    /// `(dphi, dn)`.
    pub fn jvp(&self, change: &FootChange) -> (f64, Vector3) {
        let step = change.x - change.s;
        let mu = self.parameters_jvp(change);
        let turned = match &self.turn {
            Turn::Face { lift, b } => {
                let rhs: [f64; 2] = std::array::from_fn(|a| {
                    self.normal.dot(&change.s_uv[a]) + b[(a, 0)] * mu[0] + b[(a, 1)] * mu[1]
                });
                -(lift[0] * rhs[0] + lift[1] * rhs[1])
            }
            Turn::Fan => {
                let moved = step - self.j[0] * mu[0] - self.j[1] * mu[1];
                (moved - self.normal * self.normal.dot(&moved)) / self.phi
            }
            Turn::Held => Vector3::zeros(),
        };
        (self.normal.dot(&step), turned)
    }

    /// The transpose of [`jvp`](Self::jvp) for seeds of `phi` and `n`.
    pub fn vjp(&self, phi: f64, n: &Vector3) -> FootChange {
        let mut out = FootChange { x: self.normal * phi, s: -self.normal * phi, ..FootChange::default() };
        let mu = match &self.turn {
            Turn::Face { lift, b } => {
                let t = lift.map(|l| -l.dot(n));
                for a in 0..2 {
                    out.s_uv[a] += self.normal * t[a];
                }
                std::array::from_fn(|a| b[(a, 0)] * t[0] + b[(a, 1)] * t[1])
            }
            Turn::Fan => {
                let across = (n - self.normal * self.normal.dot(n)) / self.phi;
                out.x += across;
                out.s -= across;
                self.j.map(|j| -j.dot(&across))
            }
            Turn::Held => [0.0; 2],
        };
        let by_parameters = self.parameters_vjp(mu);
        out.x += by_parameters.x;
        out.s += by_parameters.s;
        for a in 0..2 {
            out.s_uv[a] += by_parameters.s_uv[a];
        }
        out
    }

    /// Change of the foot point `y = S(mu)` itself.
    pub fn foot_jvp(&self, change: &FootChange) -> Vector3 {
        let mu = self.parameters_jvp(change);
        change.s + self.j[0] * mu[0] + self.j[1] * mu[1]
    }

    /// The transpose of [`foot_jvp`](Self::foot_jvp).
    pub fn foot_vjp(&self, seed: &Vector3) -> FootChange {
        let mut out = self.parameters_vjp(self.j.map(|j| j.dot(seed)));
        out.s += seed;
        out
    }

    /// `P`: the derivative of the parameters with respect to the point, rows for `u` and `v`.
    pub fn parameters_by_point(&self) -> [Vector3; 2] {
        self.p
    }
}

/// The inverse; not a number at a focal point, where the foot point and so the derivative are not unique.
fn inverse(m: Matrix2<f64>) -> Matrix2<f64> {
    m.try_inverse().unwrap_or_else(|| Matrix2::repeat(f64::NAN))
}
