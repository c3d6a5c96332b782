//! Planform area S and aspect ratio A: with r = S/S0 and q = A/A0 the span is scaled by f = sqrt(r q), chord and
//! thickness by g = sqrt(r/q), so that span * chord goes with S and span / chord with A.
//!
//! About the pivot P (the root quarter chord unless given), with the point's section scaled about P + o (o = 0 for
//! [`SweepRule::Scaled`], so that sweep and dihedral go with the chord; the quarter chord of its section less that of the
//! root for [`SweepRule::Kept`]):
//! along the span x' = x + (f - 1)(x - P); along chord and thickness x' = x + (g - 1)(x - P - o) + (f - 1) o.
//!
//! [`SweepRule::Scaled`]: crate::SweepRule::Scaled
//! [`SweepRule::Kept`]: crate::SweepRule::Kept

use moldline_spline::Vector3;
use nalgebra::convert;

use crate::{Scalar, channel::Relative, parameterisation::shift};

#[derive(Clone, Debug)]
pub(crate) struct Planform {
    pub(crate) targets: Vec<PlanformTarget>,
    /// Index of P among the points; not a target.
    pub(crate) pivot: usize,
    /// Coordinate index of the span axis.
    pub(crate) span: usize,
    pub(crate) area: Option<Relative>,
    pub(crate) aspect_ratio: Option<Relative>,
}

#[derive(Clone, Debug)]
pub(crate) struct PlanformTarget {
    pub(crate) point: usize,
    /// o; its component along the span is zero.
    pub(crate) axis_offset: Vector3,
}

impl Planform {
    /// r and q.
    fn ratios<T: Scalar>(&self, design: &[T]) -> (T, T) {
        let ratio = |variable: &Option<Relative>| variable.as_ref().map_or(T::one(), |v| v.value(design));
        (ratio(&self.area), ratio(&self.aspect_ratio))
    }

    /// f and g.
    fn factors<T: Scalar>(&self, design: &[T]) -> (T, T) {
        let (r, q) = self.ratios(design);
        ((r * q).sqrt(), (r / q).sqrt())
    }

    /// One factor per coordinate: `span` along the span axis, `chord` along the others.
    fn diagonal<T: Scalar>(&self, span: T, chord: T) -> nalgebra::Vector3<T> {
        let mut diagonal = nalgebra::Vector3::repeat(chord);
        diagonal[self.span] = span;
        diagonal
    }

    pub(crate) fn eval<T: Scalar>(&self, design: &[T], points: &mut [nalgebra::Vector3<T>]) {
        let (f, g) = self.factors(design);
        let growth = self.diagonal(f - T::one(), g - T::one());
        let pivot = points[self.pivot];
        for t in &self.targets {
            let offset = t.axis_offset.map(convert::<f64, T>);
            let step = growth.component_mul(&(points[t.point] - pivot - offset)) + offset * (f - T::one());
            shift(&mut points[t.point], step);
        }
    }

    /// `points` are those that `eval` was given.
    pub(crate) fn jvp(
        &self,
        design: &[f64],
        points: &[Vector3],
        direction: &[f64],
        tangents: &mut [Vector3],
    ) {
        let (f, g) = self.factors(design);
        let (r, q) = self.ratios(design);
        let tangent = |variable: &Option<Relative>| variable.as_ref().map_or(0.0, |v| v.jvp(direction));
        let (dr, dq) = (tangent(&self.area) / r, tangent(&self.aspect_ratio) / q);
        let (df, dg) = (0.5 * f * (dr + dq), 0.5 * g * (dr - dq));
        let growth = self.diagonal(f - 1.0, g - 1.0);
        let growth_tangent = self.diagonal(df, dg);
        let (pivot, pivot_tangent) = (points[self.pivot], tangents[self.pivot]);
        for t in &self.targets {
            let step = growth.component_mul(&(tangents[t.point] - pivot_tangent))
                + growth_tangent.component_mul(&(points[t.point] - pivot - t.axis_offset))
                + t.axis_offset * df;
            tangents[t.point] += step;
        }
    }

    /// Turns the seeds on the results into those on the arguments.
    pub(crate) fn vjp(
        &self,
        design: &[f64],
        points: &[Vector3],
        seeds: &mut [Vector3],
        gradient: &mut [f64],
    ) {
        let (f, g) = self.factors(design);
        let (r, q) = self.ratios(design);
        let growth = self.diagonal(f - 1.0, g - 1.0);
        let pivot = points[self.pivot];
        let (mut on_diagonal, mut on_f, mut on_pivot) = (Vector3::zeros(), 0.0, Vector3::zeros());
        for t in &self.targets {
            let seed = seeds[t.point];
            on_diagonal += seed.component_mul(&(points[t.point] - pivot - t.axis_offset));
            on_f += seed.dot(&t.axis_offset);
            let back = growth.component_mul(&seed);
            seeds[t.point] += back;
            on_pivot -= back;
        }
        seeds[self.pivot] += on_pivot;
        let on_f = on_f + on_diagonal[self.span];
        let on_g = on_diagonal.sum() - on_diagonal[self.span];
        if let Some(area) = &self.area {
            area.vjp(0.5 * (f * on_f + g * on_g) / r, gradient);
        }
        if let Some(aspect_ratio) = &self.aspect_ratio {
            aspect_ratio.vjp(0.5 * (f * on_f - g * on_g) / q, gradient);
        }
    }
}
