//! Sphere, box, cylinder and capsule: analytic signed distances, and the same shapes as exact rational patches.
//!
//! A quarter circle is the quadratic with weights `1, 1/sqrt(2), 1`; a full one is four of these in one knot vector with
//! double knots. Those knots are geometrically smooth, so the patches made by cutting there join in smooth edges.

use crate::component::Component;
use crate::error::ComponentError;
use crate::joining::ComponentOptions;
use crate::patch::PatchInput;
use moldline_foundation::Vector3;
use moldline_spline::{KnotError, KnotVector};
use std::f64::consts::FRAC_1_SQRT_2;

/// A shape with an analytic signed distance. Lengths in metres; cylinders and capsules are solid, and a cylinder has flat
/// ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Primitive {
    /// A ball.
    Sphere {
        /// Its centre.
        center: Vector3,
        /// Its radius.
        radius: f64,
    },
    /// A box with sides along the axes.
    Box {
        /// Smallest coordinates.
        low: Vector3,
        /// Largest coordinates.
        high: Vector3,
    },
    /// A circular cylinder with flat ends.
    Cylinder {
        /// Centre of one end.
        start: Vector3,
        /// Centre of the other end.
        end: Vector3,
        /// Its radius.
        radius: f64,
    },
    /// A cylinder with half balls at its ends.
    Capsule {
        /// Centre of one half ball.
        start: Vector3,
        /// Centre of the other half ball.
        end: Vector3,
        /// Its radius.
        radius: f64,
    },
}

/// Why a primitive is not valid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PrimitiveError {
    /// A measure is not finite, or not positive.
    #[error("the primitive's {field} is {value}: it must be finite and positive")]
    Measure {
        /// Name of the measure.
        field: &'static str,
        /// Its value.
        value: f64,
    },
    /// The patches do not join; does not happen for valid measures within the range of floating point.
    #[error(transparent)]
    Component(#[from] ComponentError),
    /// A knot vector is not valid; as above.
    #[error(transparent)]
    Knots(#[from] KnotError),
}

impl Primitive {
    /// The exact signed distance at `x`, metres, negative inside.
    pub fn signed_distance(&self, x: &Vector3) -> f64 {
        match *self {
            Self::Sphere { center, radius } => (x - center).norm() - radius,
            Self::Box { low, high } => {
                let center = (low + high) * 0.5;
                let q = (x - center).abs() - (high - low) * 0.5;
                q.sup(&Vector3::zeros()).norm() + q.max().min(0.0)
            }
            Self::Cylinder { start, end, radius } => {
                let axis = end - start;
                let length = axis.norm();
                let z = (x - start).dot(&axis) / length;
                let radial = ((x - start) - axis * (z / length)).norm() - radius;
                let axial = (z - 0.5 * length).abs() - 0.5 * length;
                radial.max(axial).min(0.0) + radial.max(0.0).hypot(axial.max(0.0))
            }
            Self::Capsule { start, end, radius } => {
                let axis = end - start;
                let t = ((x - start).dot(&axis) / axis.norm_squared()).clamp(0.0, 1.0);
                (x - start - axis * t).norm() - radius
            }
        }
    }

    fn validate(&self) -> Result<(), PrimitiveError> {
        let check = |field, value: f64| {
            if value.is_finite() && value > 0.0 {
                Ok(())
            } else {
                Err(PrimitiveError::Measure { field, value })
            }
        };
        match *self {
            Self::Sphere { center, radius } => {
                check("radius", radius)?;
                check("centre", 1.0 + center.norm())
            }
            Self::Box { low, high } => {
                check("extent along x", high.x - low.x)?;
                check("extent along y", high.y - low.y)?;
                check("extent along z", high.z - low.z)
            }
            Self::Cylinder { start, end, radius } | Self::Capsule { start, end, radius } => {
                check("radius", radius)?;
                check("length", (end - start).norm())
            }
        }
    }

    /// The shape as rational patches.
    ///
    /// # Errors
    /// If a measure is not positive and finite.
    pub fn patches(&self) -> Result<Vec<PatchInput>, PrimitiveError> {
        self.validate()?;
        match *self {
            Self::Sphere { center, radius } => {
                let profile = half_circle_profile(radius);
                Ok(vec![revolve("sphere", &center, &Vector3::z(), &profile, quadratic(2)?)?])
            }
            Self::Box { low, high } => box_patches(&low, &high),
            Self::Cylinder { start, end, radius } => {
                let axis = end - start;
                let length = axis.norm();
                let linear = || KnotVector::clamped_uniform(1, 2);
                // (radius, height, weight) along each profile.
                let side = [(radius, 0.0, 1.0), (radius, length, 1.0)];
                let bottom = [(0.0, 0.0, 1.0), (radius, 0.0, 1.0)];
                let top = [(radius, length, 1.0), (0.0, length, 1.0)];
                Ok(vec![
                    revolve("bottom", &start, &axis, &bottom, linear()?)?,
                    revolve("side", &start, &axis, &side, linear()?)?,
                    revolve("top", &start, &axis, &top, linear()?)?,
                ])
            }
            Self::Capsule { start, end, radius } => {
                let axis = end - start;
                let length = axis.norm();
                let cap = half_circle_profile(radius);
                let bottom = &cap[..3];
                let top: Vec<_> = cap[2..].iter().map(|&(r, z, w)| (r, z + length, w)).collect();
                let side = [(radius, 0.0, 1.0), (radius, length, 1.0)];
                Ok(vec![
                    revolve("bottom", &start, &axis, bottom, quadratic(1)?)?,
                    revolve("side", &start, &axis, &side, KnotVector::clamped_uniform(1, 2)?)?,
                    revolve("top", &start, &axis, &top, quadratic(1)?)?,
                ])
            }
        }
    }
}

impl Component {
    /// A primitive as a component, with its internal control points.
    ///
    /// # Errors
    /// If a measure is not positive and finite.
    pub fn primitive(name: String, primitive: &Primitive) -> Result<(Self, Vec<[f64; 4]>), PrimitiveError> {
        Ok(Self::new(name, primitive.patches()?, &ComponentOptions::default())?)
    }
}

/// Half a circle around the origin from the negative to the positive axis: (radius, height, weight).
fn half_circle_profile(r: f64) -> [(f64, f64, f64); 5] {
    let w = FRAC_1_SQRT_2;
    [(0.0, -r, 1.0), (r, -r, w), (r, 0.0, 1.0), (r, r, w), (0.0, r, 1.0)]
}

/// Quadratic pieces joined at double knots.
fn quadratic(pieces: usize) -> Result<KnotVector, KnotError> {
    let inner = (0..=pieces).flat_map(|i| [i as f64 / pieces as f64; 2]);
    KnotVector::new(2, std::iter::once(0.0).chain(inner).chain([1.0]).collect())
}

/// The surface of revolution of a profile around an axis through `origin`; `u` along the profile, `v` around.
fn revolve(
    name: &str,
    origin: &Vector3,
    axis: &Vector3,
    profile: &[(f64, f64, f64)],
    knots_u: KnotVector,
) -> Result<PatchInput, KnotError> {
    let axis = axis.normalize();
    let least = axis.iamin();
    let mut across = Vector3::zeros();
    across[least] = 1.0;
    let e1 = (across - axis * axis[least]).normalize();
    let e2 = axis.cross(&e1);
    // The square around the unit circle, with the last point equal to the first.
    const SQUARE: [(f64, f64); 9] = [
        (1.0, 0.0),
        (1.0, 1.0),
        (0.0, 1.0),
        (-1.0, 1.0),
        (-1.0, 0.0),
        (-1.0, -1.0),
        (0.0, -1.0),
        (1.0, -1.0),
        (1.0, 0.0),
    ];
    let mut control_points = Vec::with_capacity(profile.len() * 9);
    let mut weights = Vec::with_capacity(profile.len() * 9);
    for &(r, z, w) in profile {
        for (k, (c, s)) in SQUARE.into_iter().enumerate() {
            control_points.push((origin + axis * z + e1 * (r * c) + e2 * (r * s)).into());
            weights.push(if k % 2 == 0 { w } else { w * FRAC_1_SQRT_2 });
        }
    }
    let knots_v = quadratic(4)?;
    Ok(PatchInput { name: name.to_owned(), knots_u, knots_v, control_points, weights: Some(weights) })
}

/// Six bilinear faces.
fn box_patches(low: &Vector3, high: &Vector3) -> Result<Vec<PatchInput>, PrimitiveError> {
    const NAMES: [[&str; 2]; 3] = [["x low", "x high"], ["y low", "y high"], ["z low", "z high"]];
    let mut patches = Vec::with_capacity(6);
    for axis in 0..3 {
        for end in 0..2 {
            let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
            let mut control_points = Vec::with_capacity(4);
            for i in 0..2 {
                for j in 0..2 {
                    let mut p = [0.0; 3];
                    for (d, k) in [(axis, end), (a, i), (b, j)] {
                        p[d] = if k == 0 { low[d] } else { high[d] };
                    }
                    control_points.push(p);
                }
            }
            patches.push(PatchInput {
                name: NAMES[axis][end].to_owned(),
                knots_u: KnotVector::clamped_uniform(1, 2)?,
                knots_v: KnotVector::clamped_uniform(1, 2)?,
                control_points,
                weights: None,
            });
        }
    }
    Ok(patches)
}
