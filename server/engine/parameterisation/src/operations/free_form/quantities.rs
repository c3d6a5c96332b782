//! Section-level functions: B-splines along the span whose coefficients are design variables.

use moldline_spline::KnotVector;
use nalgebra::convert;

use super::declaration::{FreeFormDeclaration, SectionDeclaration, SectionKind};
use super::lattice::{CAMBER, SHIFT, STRETCH, SectionLattice, THICKNESS_STRETCH, TWIST};
use crate::axis::Axes;
use crate::compile::Site;
use crate::error::ParameterisationError;
use crate::scalar::Scalar;
use crate::unit::Dimension;
use crate::variables::Variables;

impl SectionKind {
    fn dimension(&self) -> Dimension {
        match self {
            Self::ChordStretch { .. } | Self::Camber { .. } | Self::Thickness { .. } => Dimension::Ratio,
            Self::SpanStretch | Self::Sweep | Self::Dihedral => Dimension::Length,
            Self::Twist => Dimension::Angle,
        }
    }

    /// The lattice rows that camber or thickness moves.
    fn rows(&self, field: &str, count: usize) -> Result<Option<Vec<usize>>, ParameterisationError> {
        match self {
            Self::Camber { rows } | Self::Thickness { rows } => lattice_rows(field, count, rows).map(Some),
            _ => Ok(None),
        }
    }

    /// The slots of a section that the quantity adds to. Camber and thickness have one for each of `rows`, of `count`.
    fn slots(&self, axes: Axes, rows: &[usize], count: usize) -> Vec<usize> {
        match self {
            Self::ChordStretch { scales_thickness: false } => vec![STRETCH],
            Self::ChordStretch { scales_thickness: true } => vec![STRETCH, THICKNESS_STRETCH],
            Self::SpanStretch => vec![SHIFT + axes.span],
            Self::Sweep => vec![SHIFT + axes.chord],
            Self::Dihedral => vec![SHIFT + axes.thickness],
            Self::Twist => vec![TWIST],
            Self::Camber { .. } => rows.iter().map(|row| CAMBER + row).collect(),
            Self::Thickness { .. } => rows.iter().map(|row| CAMBER + count + row).collect(),
        }
    }
}

/// The linear map from the design to the slots of all sections.
#[derive(Clone, Debug)]
pub(super) struct Quantities {
    /// Slots of all sections together.
    count: usize,
    influences: Vec<Influence>,
}

/// A design variable's linear effect on one slot.
#[derive(Clone, Debug)]
struct Influence {
    slot: usize,
    variable: usize,
    baseline: f64,
    /// Includes the unit.
    weight: f64,
}

impl Quantities {
    pub(super) fn new(
        site: &Site,
        declaration: &FreeFormDeclaration,
        lattice: &SectionLattice,
        variables: &mut Variables<'_>,
    ) -> Result<Self, ParameterisationError> {
        let count = lattice.slots() * lattice.sections.stations.len();
        let mut quantities = Self { count, influences: Vec::new() };
        for (s, section) in declaration.sections.iter().enumerate() {
            quantities.add(
                &site.field(&format!("sections[{s}]")),
                declaration,
                section,
                lattice,
                variables,
            )?;
        }
        Ok(quantities)
    }

    /// Adds one function along the span: coefficients times the basis at each section.
    fn add(
        &mut self,
        field: &str,
        block: &FreeFormDeclaration,
        section: &SectionDeclaration,
        lattice: &SectionLattice,
        variables: &mut Variables<'_>,
    ) -> Result<(), ParameterisationError> {
        let SectionDeclaration { kind, variable, degree } = section;
        let variable_field = format!("{field}.variable");
        let rows = kind.rows(field, block.shape[0])?;
        let coefficients = coefficients(&variable_field, variable, rows.as_deref(), variables)?;
        let channel = variables.additive(&variable_field, variable, kind.dimension())?;
        // The root coefficient of a mirrored span stretch is zero and no variable.
        let fixed = usize::from(block.symmetric && *kind == SectionKind::SpanStretch);
        let function = SpanFunction::new(&format!("{field}.degree"), *degree, coefficients + fixed)?;
        let slots = kind.slots(lattice.sections.axes, rows.as_deref().unwrap_or_default(), block.shape[0]);
        for (k, &station) in lattice.sections.stations.iter().enumerate() {
            let antisymmetric = block.symmetric && *kind == SectionKind::SpanStretch;
            let side = if antisymmetric && station < 0.0 { -1.0 } else { 1.0 };
            for (m, weight) in function.at(lattice.sections.eta(station)) {
                let Some(m) = m.checked_sub(fixed) else { continue };
                // Stretch drives both of its slots by one coefficient; each row of camber or thickness has its own.
                let per_slot = if rows.is_some() { coefficients } else { 0 };
                self.influences.extend(slots.iter().enumerate().map(|(r, slot)| Influence {
                    slot: k * lattice.slots() + slot,
                    variable: channel.range.start + r * per_slot + m,
                    baseline: channel.baseline,
                    weight: side * weight * channel.si,
                }));
            }
        }
        Ok(())
    }

    /// All slots of all sections.
    pub(super) fn eval<T: Scalar>(&self, design: &[T]) -> Vec<T> {
        let mut values = vec![T::zero(); self.count];
        for f in &self.influences {
            values[f.slot] += (design[f.variable] - convert(f.baseline)) * convert(f.weight);
        }
        values
    }

    pub(super) fn jvp(&self, direction: &[f64]) -> Vec<f64> {
        let mut change = vec![0.0; self.count];
        for f in &self.influences {
            change[f.slot] += direction[f.variable] * f.weight;
        }
        change
    }

    pub(super) fn vjp(&self, seeds: &[f64], gradient: &mut [f64]) {
        for f in &self.influences {
            gradient[f.variable] += seeds[f.slot] * f.weight;
        }
    }
}

/// Number of coefficients along the span of a variable, after a check of its shape.
fn coefficients(
    field: &str,
    variable: &str,
    rows: Option<&[usize]>,
    variables: &mut Variables<'_>,
) -> Result<usize, ParameterisationError> {
    let expected = match (rows, variables.shape(field, variable)?) {
        (None, [stations]) => return Ok(*stations),
        (Some(rows), [n, stations]) if *n == rows.len() => return Ok(*stations),
        (None, _) => "one number per station along the span: [stations]".into(),
        (Some(rows), _) => format!("[{}, stations], one row per lattice row moved", rows.len()),
    };
    Err(variables.wrong_shape(field, variable, expected))
}

/// The lattice rows, of `count`, that camber or thickness moves: `rows`, or all but the outermost.
fn lattice_rows(field: &str, count: usize, rows: &[usize]) -> Result<Vec<usize>, ParameterisationError> {
    for (r, &row) in rows.iter().enumerate() {
        if row >= count {
            return Err(ParameterisationError::OutOfRange {
                field: format!("{field}.rows[{r}]"),
                value: row,
                lowest: 0,
                highest: count - 1,
            });
        }
        if rows[..r].contains(&row) {
            return Err(ParameterisationError::DuplicateName {
                field: format!("{field}.rows[{r}]"),
                name: row.to_string(),
            });
        }
    }
    if !rows.is_empty() {
        return Ok(rows.to_vec());
    }
    if count < 3 {
        return Err(ParameterisationError::OutOfRange {
            field: format!("{field}: lattice rows along the chord (or give rows)"),
            value: count,
            lowest: 3,
            highest: usize::MAX,
        });
    }
    Ok((1..count - 1).collect())
}

/// A B-spline function on [0, 1], or a constant with a single coefficient.
struct SpanFunction {
    knots: Option<KnotVector>,
}

impl SpanFunction {
    fn new(field: &str, degree: usize, coefficients: usize) -> Result<Self, ParameterisationError> {
        if degree == 0 && coefficients == 1 {
            return Ok(Self { knots: None });
        }
        let knots = KnotVector::clamped_uniform(degree, coefficients)
            .map_err(|source| ParameterisationError::Knots { field: field.into(), source })?;
        Ok(Self { knots: Some(knots) })
    }

    /// The coefficients with influence at `eta`, with their weights.
    fn at(&self, eta: f64) -> Vec<(usize, f64)> {
        match &self.knots {
            None => vec![(0, 1.0)],
            Some(knots) => {
                let basis = knots.basis(eta, 0);
                basis.value().iter().enumerate().map(|(m, &w)| (basis.first + m, w)).collect()
            }
        }
    }
}
