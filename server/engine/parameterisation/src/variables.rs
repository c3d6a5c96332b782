//! The compiled design vector, and the resolution of variable names while operations are compiled.

use std::collections::HashMap;
use std::ops::Range;

use crate::channel::{Additive, Relative};
use crate::error::ParameterisationError;
use crate::unit::{Dimension, Unit};

/// Scalars that one parameterisation may have.
const VARIABLE_LIMIT: usize = 1_000_000;

/// A named design variable: a scalar, a vector or a table of them, in row-major order.
#[derive(Clone, Debug, PartialEq)]
pub struct VariableDeclaration {
    /// Unique name; the scalars are called `name`, `name[i]` or `name[i][j]`.
    pub name: String,
    /// Empty for a scalar, `[n]`, or `[rows, stations]`.
    pub shape: Vec<usize>,
    /// Unit of baseline, bounds and values.
    pub unit: Unit,
    /// The value that leaves the reference geometry as it is. Default: 0 for a variable that is added, 1 for a factor,
    /// the reference geometry's own value for planform area and aspect ratio.
    pub baseline: Option<f64>,
    /// Lower bound of each scalar; may be `-INFINITY`.
    pub lower: f64,
    /// Upper bound of each scalar; may be `INFINITY`.
    pub upper: f64,
}

/// One scalar of the design vector.
#[derive(Clone, Debug, PartialEq)]
pub struct Variable {
    /// `wing.translation`, `wing.twist[3]`, `wing.camber[0][4]`.
    pub name: String,
    /// Unit of the three numbers and of the values in a design.
    pub unit: Unit,
    /// At the baseline the reference geometry is reproduced bit by bit.
    pub baseline: f64,
    /// Lower bound; may be `-INFINITY`.
    pub lower: f64,
    /// Upper bound; may be `INFINITY`.
    pub upper: f64,
}

/// A declared variable: a name for a range of the design vector.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// The declared name.
    pub name: String,
    /// Empty for a scalar, `[n]` or `[rows, stations]`.
    pub shape: Vec<usize>,
    /// Its scalars in the design vector, row-major.
    pub range: Range<usize>,
}

/// The design vector after compilation: its scalars, its groups, and which scalars must be positive.
pub(crate) struct DesignSpace {
    pub(crate) variables: Vec<Variable>,
    pub(crate) groups: Vec<Group>,
    pub(crate) positive: Vec<bool>,
}

/// The declared variables, with the baselines and requirements that operations find for them.
pub(crate) struct Variables<'a> {
    declarations: &'a [VariableDeclaration],
    index: HashMap<&'a str, usize>,
    ranges: Vec<Range<usize>>,
    /// Baselines as declared or as derived by the first operation that uses the variable.
    baselines: Vec<Option<f64>>,
    used: Vec<bool>,
    positive: Vec<bool>,
}

impl<'a> Variables<'a> {
    pub(crate) fn new(declarations: &'a [VariableDeclaration]) -> Result<Self, ParameterisationError> {
        let mut index = HashMap::new();
        let mut ranges = Vec::with_capacity(declarations.len());
        let mut start = 0;
        for (i, declaration) in declarations.iter().enumerate() {
            let name = declaration.name.as_str();
            if name.is_empty() {
                return Err(ParameterisationError::Empty { field: format!("variables[{i}].name") });
            }
            if index.insert(name, i).is_some() {
                return Err(ParameterisationError::DuplicateName {
                    field: format!("variables[{i}].name"),
                    name: name.into(),
                });
            }
            if declaration.shape.len() > 2 {
                return Err(ParameterisationError::OutOfRange {
                    field: format!("variables[{i}].shape (dimensions)"),
                    value: declaration.shape.len(),
                    lowest: 0,
                    highest: 2,
                });
            }
            let mut count = 1_usize;
            for (d, &n) in declaration.shape.iter().enumerate() {
                count = count.saturating_mul(n);
                if n == 0 || start + count > VARIABLE_LIMIT {
                    return Err(ParameterisationError::OutOfRange {
                        field: format!("variables[{i}].shape[{d}]"),
                        value: n,
                        lowest: 1,
                        highest: VARIABLE_LIMIT,
                    });
                }
            }
            // An infinite bound means no bound; a baseline must be finite.
            let finite = [("baseline", declaration.baseline.unwrap_or(0.0))];
            let not_nan = [("lower", declaration.lower), ("upper", declaration.upper)];
            let bad = finite
                .into_iter()
                .filter(|(_, v)| !v.is_finite())
                .chain(not_nan.into_iter().filter(|(_, v)| v.is_nan()))
                .next();
            if let Some((what, value)) = bad {
                return Err(ParameterisationError::NotFinite {
                    field: format!("variables[{i}].{what}"),
                    value,
                });
            }
            ranges.push(start..start + count);
            start += count;
        }
        Ok(Self {
            declarations,
            index,
            ranges,
            baselines: declarations.iter().map(|d| d.baseline).collect(),
            used: vec![false; declarations.len()],
            positive: vec![false; declarations.len()],
        })
    }

    fn find(&mut self, field: &str, name: &str) -> Result<usize, ParameterisationError> {
        let Some(&i) = self.index.get(name) else {
            let known: Vec<&str> = self.declarations.iter().map(|d| d.name.as_str()).collect();
            return Err(ParameterisationError::UnknownName {
                field: field.into(),
                name: name.into(),
                known: list(&known),
            });
        };
        self.used[i] = true;
        Ok(i)
    }

    /// The declared shape.
    pub(crate) fn shape(&mut self, field: &str, name: &str) -> Result<&'a [usize], ParameterisationError> {
        let i = self.find(field, name)?;
        Ok(&self.declarations[i].shape)
    }

    pub(crate) fn wrong_shape(&self, field: &str, name: &str, expected: String) -> ParameterisationError {
        let shape = self.index.get(name).map_or_else(Vec::new, |&i| self.declarations[i].shape.clone());
        ParameterisationError::WrongShape { field: field.into(), variable: name.into(), shape, expected }
    }

    fn check_unit(&self, field: &str, i: usize, allowed: &[Dimension]) -> Result<(), ParameterisationError> {
        let declaration = &self.declarations[i];
        if allowed.contains(&declaration.unit.dimension()) {
            return Ok(());
        }
        Err(ParameterisationError::WrongUnit {
            field: field.into(),
            variable: declaration.name.clone(),
            unit: declaration.unit,
            expected: allowed[0],
        })
    }

    fn baseline(&mut self, field: &str, i: usize, derived: f64) -> Result<f64, ParameterisationError> {
        match self.baselines[i] {
            Some(baseline) if self.declarations[i].baseline.is_some() || baseline == derived => Ok(baseline),
            Some(_) => Err(ParameterisationError::NeedsBaseline {
                field: field.into(),
                variable: self.declarations[i].name.clone(),
                reason: "the operations that use it have different natural baselines",
            }),
            None => {
                self.baselines[i] = Some(derived);
                Ok(derived)
            }
        }
    }

    /// An additive variable of any shape.
    pub(crate) fn additive(
        &mut self,
        field: &str,
        name: &str,
        dimension: Dimension,
    ) -> Result<Additive, ParameterisationError> {
        let i = self.find(field, name)?;
        self.check_unit(field, i, &[dimension])?;
        let baseline = self.baseline(field, i, 0.0)?;
        Ok(Additive { range: self.ranges[i].clone(), baseline, si: self.declarations[i].unit.to_si() })
    }

    /// An additive scalar.
    pub(crate) fn additive_scalar(
        &mut self,
        field: &str,
        name: &str,
        dimension: Dimension,
    ) -> Result<Additive, ParameterisationError> {
        self.scalar(field, name)?;
        self.additive(field, name, dimension)
    }

    /// A multiplicative scalar; `natural` is the baseline in SI units that the geometry gives it, if any.
    pub(crate) fn relative(
        &mut self,
        field: &str,
        name: &str,
        allowed: &[Dimension],
        natural: impl FnOnce(Dimension) -> Option<f64>,
    ) -> Result<Relative, ParameterisationError> {
        self.scalar(field, name)?;
        let i = self.find(field, name)?;
        self.check_unit(field, i, allowed)?;
        let unit = self.declarations[i].unit;
        let derived = natural(unit.dimension()).map(|si| si / unit.to_si()).or(self.baselines[i]).ok_or_else(|| {
            ParameterisationError::NeedsBaseline {
                field: field.into(),
                variable: name.into(),
                reason: "the reference value of this quantity cannot be derived; give it in the variable's unit",
            }
        })?;
        let baseline = self.baseline(field, i, derived)?;
        if baseline <= 0.0 {
            return Err(ParameterisationError::BaselineNotPositive {
                field: field.into(),
                variable: name.into(),
                baseline,
            });
        }
        self.positive[i] = true;
        Ok(Relative { index: self.ranges[i].start, baseline })
    }

    fn scalar(&mut self, field: &str, name: &str) -> Result<(), ParameterisationError> {
        if self.shape(field, name)?.is_empty() {
            Ok(())
        } else {
            Err(self.wrong_shape(field, name, "a scalar (no shape)".into()))
        }
    }

    /// Refuses unused variables and baselines out of bounds, and lays the scalars one after the other.
    pub(crate) fn finish(self) -> Result<DesignSpace, ParameterisationError> {
        let (mut variables, mut groups, mut positive) = (Vec::new(), Vec::new(), Vec::new());
        for (i, declaration) in self.declarations.iter().enumerate() {
            let VariableDeclaration { name, shape, unit, lower, upper, .. } = declaration;
            let Some(baseline) = self.baselines[i].filter(|_| self.used[i]) else {
                return Err(ParameterisationError::UnusedVariable { index: i, name: name.clone() });
            };
            if !(*lower <= baseline && baseline <= *upper) {
                return Err(ParameterisationError::BaselineOutsideBounds {
                    index: i,
                    name: name.clone(),
                    baseline,
                    lower: *lower,
                    upper: *upper,
                    unit: *unit,
                });
            }
            for flat in 0..self.ranges[i].len() {
                let suffix = match shape.as_slice() {
                    [] => String::new(),
                    [_] => format!("[{flat}]"),
                    [_, stations, ..] => format!("[{}][{}]", flat / stations, flat % stations),
                };
                variables.push(Variable {
                    name: format!("{name}{suffix}"),
                    unit: *unit,
                    baseline,
                    lower: *lower,
                    upper: *upper,
                });
                positive.push(self.positive[i]);
            }
            groups.push(Group { name: name.clone(), shape: shape.clone(), range: self.ranges[i].clone() });
        }
        Ok(DesignSpace { variables, groups, positive })
    }
}

/// A comma-separated list, cut after twenty names.
pub(crate) fn list(names: &[&str]) -> String {
    const SHOWN: usize = 20;
    match names.len() {
        0 => "none".into(),
        n if n <= SHOWN => names.join(", "),
        n => format!("{}, and {} more", names[..SHOWN].join(", "), n - SHOWN),
    }
}
