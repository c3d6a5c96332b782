//! Planform area S and aspect ratio A: with r = S/S0 and q = A/A0 the span is scaled by f = sqrt(r q), chord and
//! thickness by g = sqrt(r/q), so that span * chord goes with S and span / chord with A.
//!
//! The scaling is about the pivot P (the root quarter chord unless given), and each point's section is scaled about P + o
//! (o = 0 for [`SweepRule::Scaled`], so that sweep and dihedral go with the chord; for [`SweepRule::Kept`] the quarter
//! chord of the point's section less that of the root):
//! along the span x' = x + (f - 1)(x - P); along chord and thickness x' = x + (g - 1)(x - P - o) + (f - 1) o.

use moldline_foundation::Vector3;
use nalgebra::convert;

use crate::axis::{Axes, Axis};
use crate::channel::Relative;
use crate::compile::{Compiler, Site};
use crate::error::ParameterisationError;
use crate::operation::{Declaration, Operation};
use crate::pivot::Pivot;
use crate::scalar::{Scalar, shift};
use crate::sections::SampledSurfaces;
use crate::table::Table;
use crate::unit::Dimension;

/// Area S and aspect ratio A = b^2/S of the planform: scales the span by sqrt(S A/(S0 A0)), chord and thickness by
/// sqrt(S A0/(S0 A)), about a point of the root.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanformDeclaration {
    /// Components that are scaled; the planform is that of the first.
    pub components: Vec<String>,
    /// The span axis.
    pub span: Axis,
    /// Whether the root is the plane 0 of the span axis (mirrored or half model) or the lower end of the span.
    pub symmetric: bool,
    /// The fixed point of the scaling; its coordinate along the span is that of the root.
    pub pivot: Pivot,
    /// Variable of the area, if it varies.
    pub area: Option<String>,
    /// Variable of the aspect ratio, if it varies.
    pub aspect_ratio: Option<String>,
    /// How sweep and dihedral change.
    pub sweep: SweepRule,
}

/// How the sections of a scaled planform move along chord and thickness axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SweepRule {
    /// The whole component is scaled affinely: the tangents of sweep and dihedral go with chord over span.
    Scaled,
    /// Each section is scaled about its own quarter chord, and the quarter-chord line with the span: sweep and
    /// dihedral angles stay.
    Kept,
}

impl PlanformDeclaration {
    /// The quarter-chord line relative to the root's, over the span coordinate (its absolute value if symmetric).
    fn quarter_chord_line(
        &self,
        site: &Site,
        compiler: &Compiler<'_>,
        surfaces: &SampledSurfaces,
    ) -> Result<Table, ParameterisationError> {
        let axes = Axes::of_span(self.span);
        let root = compiler.root_quarter_chord(site, self.span, self.symmetric)?;
        let (low, high) = surfaces.range(axes.span);
        let (start, end) = if self.symmetric { (0.0, low.abs().max(high.abs())) } else { (low, high) };
        let table = Table::new(start, end, |y| {
            let quarter_chord = surfaces.section(axes, y, self.symmetric)?.quarter_chord();
            let mut offset = Vector3::zeros();
            offset[axes.chord] = quarter_chord[0] - root[axes.chord];
            offset[axes.thickness] = quarter_chord[1] - root[axes.thickness];
            Some(offset)
        });
        table.ok_or_else(|| site.geometry("a section has no chord: is the span axis right?"))
    }
}

impl Declaration for PlanformDeclaration {
    type Compiled = Planform;

    fn components(&self) -> &[String] {
        &self.components
    }

    fn pivot(&self, site: &Site, compiler: &Compiler<'_>) -> Result<Option<Vector3>, ParameterisationError> {
        let mut pivot = self.pivot.place(site, compiler, self.symmetric)?;
        let root = compiler.root_quarter_chord(site, self.span, self.symmetric)?;
        pivot[self.span.index()] = root[self.span.index()];
        Ok(Some(pivot))
    }

    fn compile(&self, site: &Site, compiler: &mut Compiler<'_>) -> Result<Planform, ParameterisationError> {
        if self.area.is_none() && self.aspect_ratio.is_none() {
            return Err(ParameterisationError::Empty { field: site.field("area and .aspect_ratio") });
        }
        let axes = Axes::of_span(self.span);
        let surfaces = compiler.surfaces(site);
        let (area, aspect_ratio) = surfaces
            .planform(axes, self.symmetric)
            .ok_or_else(|| site.geometry("the component has no planform: is the span axis right?"))?;
        let mut relative = |what: &str, name: &Option<String>, dimension, baseline| {
            let variable = name.as_ref().map(|name| {
                compiler.variables.relative(&site.field(what), name, &[dimension], |_| Some(baseline))
            });
            variable.transpose()
        };
        let area = relative("area", &self.area, Dimension::Area, area)?;
        let aspect_ratio = relative("aspect_ratio", &self.aspect_ratio, Dimension::Ratio, aspect_ratio)?;
        let line = match self.sweep {
            SweepRule::Scaled => Table::constant(Vector3::zeros()),
            SweepRule::Kept => self.quarter_chord_line(site, compiler, &surfaces)?,
        };
        let target = |point: usize| {
            let station = compiler.points[point][axes.span];
            let station = if self.symmetric { station.abs() } else { station };
            Target { point, axis_offset: line.at(station) }
        };
        let targets = compiler.targets(site).into_iter().map(target).collect();
        Ok(Planform { targets, pivot: site.pivot(), span: axes.span, area, aspect_ratio })
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Planform {
    targets: Vec<Target>,
    /// Index of P among the points; not a target.
    pivot: usize,
    /// Coordinate index of the span axis.
    span: usize,
    area: Option<Relative>,
    aspect_ratio: Option<Relative>,
}

#[derive(Clone, Debug)]
struct Target {
    point: usize,
    /// o; its component along the span is zero.
    axis_offset: Vector3,
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
}

impl Operation for Planform {
    fn eval<T: Scalar>(&self, design: &[T], points: &mut [nalgebra::Vector3<T>]) {
        let (f, g) = self.factors(design);
        let growth = self.diagonal(f - T::one(), g - T::one());
        let pivot = points[self.pivot];
        for t in &self.targets {
            let offset = t.axis_offset.map(convert::<f64, T>);
            let step = growth.component_mul(&(points[t.point] - pivot - offset)) + offset * (f - T::one());
            shift(&mut points[t.point], step);
        }
    }

    fn jvp(&self, design: &[f64], points: &[Vector3], direction: &[f64], tangents: &mut [Vector3]) {
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

    fn vjp(&self, design: &[f64], points: &[Vector3], seeds: &mut [Vector3], gradient: &mut [f64]) {
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
