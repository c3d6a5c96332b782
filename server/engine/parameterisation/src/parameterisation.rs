//! The compiled parameterisation: design vector to control points, and its derivatives.

use std::collections::HashMap;
use std::ops::Range;

use moldline_foundation::Vector3;
use nalgebra::convert;

use crate::compile::Compiler;
use crate::error::{DesignError, ParameterisationError};
use crate::operation::{Declaration, Lattice, Operation};
use crate::operations::{AnyOperation, OperationDeclaration};
use crate::reference::ComponentReference;
use crate::scalar::Scalar;
use crate::variables::{DesignSpace, Group, Variable, VariableDeclaration};

/// Cartesian control points, m: per component, in the order of its reference.
pub type ControlPoints = Vec<Vec<[f64; 3]>>;

/// The map from design variables to the control points of every component. Immutable.
#[derive(Clone, Debug)]
pub struct Parameterisation {
    variables: Vec<Variable>,
    groups: Vec<Group>,
    /// Variables that must be positive whatever their bounds.
    positive: Vec<bool>,
    names: HashMap<String, usize>,
    component_names: Vec<String>,
    /// Each component's control points among the points.
    ranges: Vec<Range<usize>>,
    /// Reference control points of all components, then points carried along (pivots, centre lines).
    reference: Vec<Vector3>,
    operations: Vec<AnyOperation>,
}

/// Control points of one component, given directly in place of those of the design.
#[derive(Clone, Debug, PartialEq)]
pub struct Override {
    /// Index of the component.
    pub component: usize,
    /// As many Cartesian control points as the component has, m.
    pub control_points: Vec<[f64; 3]>,
}

/// The map at one design, ready for products with its Jacobian (3 control-point coordinates x variables).
#[derive(Debug)]
pub struct Linearisation<'a> {
    parameterisation: &'a Parameterisation,
    design: Vec<f64>,
    /// The points before each operation, and after the last.
    states: Vec<Vec<Vector3>>,
}

impl Parameterisation {
    /// Compiles a declaration against the reference geometry.
    ///
    /// # Errors
    /// The first violation in the declaration, with its path.
    pub fn new(
        components: &[ComponentReference],
        variables: &[VariableDeclaration],
        operations: &[OperationDeclaration],
    ) -> Result<Self, ParameterisationError> {
        let mut compiler = Compiler::new(components, variables)?;
        let mut sites = Vec::with_capacity(operations.len());
        for (i, operation) in operations.iter().enumerate() {
            let mut site = compiler.site(i, operation.components())?;
            if let Some(pivot) = operation.pivot(&site, &compiler)? {
                compiler.place_pivot(&mut site, pivot);
            }
            sites.push(site);
        }
        for (site, operation) in sites.iter_mut().zip(operations) {
            site.centres = operation.centres(site, &mut compiler)?;
        }
        let operations = sites
            .iter()
            .zip(operations)
            .map(|(site, operation)| operation.compile(site, &mut compiler))
            .collect::<Result<_, _>>()?;
        let Compiler { ranges, points: reference, variables, .. } = compiler;
        let DesignSpace { variables, groups, positive } = variables.finish()?;
        let names = variables.iter().enumerate().map(|(i, v)| (v.name.clone(), i)).collect();
        Ok(Self {
            variables,
            groups,
            positive,
            names,
            component_names: components.iter().map(|c| c.name.clone()).collect(),
            ranges,
            reference,
            operations,
        })
    }

    /// The scalars of the design vector, in order.
    pub fn variables(&self) -> &[Variable] {
        &self.variables
    }

    /// The declared variables as ranges of the design vector.
    pub fn groups(&self) -> &[Group] {
        &self.groups
    }

    /// Names of the components, in the order of the control points.
    pub fn components(&self) -> &[String] {
        &self.component_names
    }

    /// The design that reproduces the reference geometry.
    pub fn baseline(&self) -> Vec<f64> {
        self.variables.iter().map(|v| v.baseline).collect()
    }

    /// Index of a scalar by its full name, e.g. `wing.twist[3]`.
    ///
    /// # Errors
    /// [`DesignError::UnknownName`].
    pub fn index(&self, name: &str) -> Result<usize, DesignError> {
        self.names.get(name).copied().ok_or_else(|| DesignError::UnknownName {
            name: name.into(),
            nearest: nearest(name, self.variables.iter().map(|v| v.name.as_str())),
        })
    }

    /// The baseline with some scalars set by name.
    ///
    /// # Errors
    /// [`DesignError::UnknownName`].
    pub fn design<'n>(
        &self,
        values: impl IntoIterator<Item = (&'n str, f64)>,
    ) -> Result<Vec<f64>, DesignError> {
        let mut design = self.baseline();
        for (name, value) in values {
            design[self.index(name)?] = value;
        }
        Ok(design)
    }

    /// Checks length, finite values and bounds.
    ///
    /// # Errors
    /// The first value that is not accepted.
    pub fn validate(&self, design: &[f64]) -> Result<(), DesignError> {
        self.check(design)?;
        for (index, (&value, variable)) in design.iter().zip(&self.variables).enumerate() {
            if !(variable.lower <= value && value <= variable.upper) {
                return Err(DesignError::OutOfBounds {
                    index,
                    name: variable.name.clone(),
                    value,
                    lower: variable.lower,
                    upper: variable.upper,
                    unit: variable.unit,
                });
            }
        }
        Ok(())
    }

    /// Checks everything that evaluation relies on; bounds are left to the caller.
    fn check(&self, design: &[f64]) -> Result<(), DesignError> {
        if design.len() != self.variables.len() {
            return Err(DesignError::Length { expected: self.variables.len(), found: design.len() });
        }
        for (index, &value) in design.iter().enumerate() {
            let name = || self.variables[index].name.clone();
            if !value.is_finite() {
                return Err(DesignError::NotFinite { index, name: name(), value });
            }
            if self.positive[index] && value <= 0.0 {
                return Err(DesignError::NotPositive { index, name: name(), value });
            }
        }
        Ok(())
    }

    /// Control points of every component at a design, which may be outside its bounds. At the baseline they are the
    /// reference control points, bit by bit.
    ///
    /// # Errors
    /// A design of the wrong length, with NaN or infinity, or with a factor that is not positive.
    pub fn control_points(&self, design: &[f64]) -> Result<ControlPoints, DesignError> {
        self.check(design)?;
        self.control_points_in(design)
    }

    /// As [`Self::control_points`], with some components' control points replaced by given ones; the other components
    /// are not affected.
    ///
    /// # Errors
    /// As [`Self::control_points`], and for an override of the wrong size or with NaN or infinity.
    pub fn control_points_with(
        &self,
        design: &[f64],
        overrides: &[Override],
    ) -> Result<ControlPoints, DesignError> {
        let mut all = self.control_points(design)?;
        for Override { component, control_points } in overrides {
            let expected = all.get(*component).map_or(0, Vec::len);
            if control_points.len() != expected || *component >= all.len() {
                return Err(DesignError::OverrideSize {
                    component: *component,
                    found: control_points.len(),
                    expected,
                });
            }
            for (index, point) in control_points.iter().enumerate() {
                if let Some(axis) = point.iter().position(|v| !v.is_finite()) {
                    return Err(DesignError::OverrideNotFinite {
                        component: *component,
                        index,
                        axis,
                        value: point[axis],
                    });
                }
            }
            all[*component].clone_from(control_points);
        }
        Ok(all)
    }

    /// The linearisation of the map at a design.
    ///
    /// # Errors
    /// As [`Self::control_points`].
    pub fn linearise(&self, design: &[f64]) -> Result<Linearisation<'_>, DesignError> {
        self.check(design)?;
        let mut states = vec![self.reference.clone()];
        for (i, operation) in self.operations.iter().enumerate() {
            let mut points = states[i].clone();
            operation.eval(design, &mut points);
            states.push(points);
        }
        Ok(Linearisation { parameterisation: self, design: design.to_vec(), states })
    }

    /// Lattices of the free-form blocks at a design, in the order of the operations.
    ///
    /// # Errors
    /// As [`Self::control_points`].
    pub fn lattices(&self, design: &[f64]) -> Result<Vec<Lattice>, DesignError> {
        self.check(design)?;
        Ok(self.operations.iter().filter_map(|operation| operation.lattice(design)).collect())
    }

    /// As [`Self::control_points`] in another number type, such as dual numbers: the same operations in the same order, so
    /// that derivatives carried along are those of the map. Bounds and signs are not checked.
    ///
    /// # Errors
    /// [`DesignError::Length`].
    pub fn control_points_in<T: Scalar>(&self, design: &[T]) -> Result<Vec<Vec<[T; 3]>>, DesignError> {
        if design.len() != self.variables.len() {
            return Err(DesignError::Length { expected: self.variables.len(), found: design.len() });
        }
        let mut points: Vec<_> = self.reference.iter().map(|p| p.map(convert::<f64, T>)).collect();
        for operation in &self.operations {
            operation.eval(design, &mut points);
        }
        Ok(self.split(&points))
    }

    fn split<T: Scalar>(&self, points: &[nalgebra::Vector3<T>]) -> Vec<Vec<[T; 3]>> {
        self.ranges.iter().map(|range| points[range.clone()].iter().map(|&p| p.into()).collect()).collect()
    }
}

impl Linearisation<'_> {
    /// The control points at this design.
    pub fn control_points(&self) -> ControlPoints {
        self.states.last().map_or_else(Vec::new, |points| self.parameterisation.split(points))
    }

    /// J v for each of `directions` (change of the design, in the declared units): change of the control points.
    ///
    /// # Errors
    /// [`DesignError::VectorLength`].
    pub fn jvp<V: AsRef<[f64]>>(&self, directions: &[V]) -> Result<Vec<ControlPoints>, DesignError> {
        directions.iter().enumerate().map(|(k, v)| self.jvp_one(k, v.as_ref())).collect()
    }

    fn jvp_one(&self, k: usize, direction: &[f64]) -> Result<ControlPoints, DesignError> {
        expect_length(|| format!("direction {k}"), direction.len(), self.design.len())?;
        let mut tangents = vec![Vector3::zeros(); self.parameterisation.reference.len()];
        for (operation, points) in self.parameterisation.operations.iter().zip(&self.states) {
            operation.jvp(&self.design, points, direction, &mut tangents);
        }
        Ok(self.parameterisation.split(&tangents))
    }

    /// J^T w for each of `seeds` (one 3-vector per control point of every component): the gradient with respect to the
    /// design variables in their declared units.
    ///
    /// # Errors
    /// [`DesignError::VectorLength`].
    pub fn vjp(&self, seeds: &[ControlPoints]) -> Result<Vec<Vec<f64>>, DesignError> {
        seeds.iter().enumerate().map(|(k, seed)| self.vjp_one(k, seed)).collect()
    }

    fn vjp_one(&self, k: usize, seed: &ControlPoints) -> Result<Vec<f64>, DesignError> {
        let parameterisation = self.parameterisation;
        expect_length(|| format!("components of seed {k}"), seed.len(), parameterisation.ranges.len())?;
        let mut seeds = vec![Vector3::zeros(); parameterisation.reference.len()];
        for (c, (component, range)) in seed.iter().zip(&parameterisation.ranges).enumerate() {
            expect_length(|| format!("component {c} of seed {k}"), component.len(), range.len())?;
            for (to, from) in seeds[range.clone()].iter_mut().zip(component) {
                *to = Vector3::from(*from);
            }
        }
        let mut gradient = vec![0.0; self.design.len()];
        for (operation, points) in parameterisation.operations.iter().zip(&self.states).rev() {
            operation.vjp(&self.design, points, &mut seeds, &mut gradient);
        }
        Ok(gradient)
    }
}

fn expect_length(what: impl FnOnce() -> String, found: usize, expected: usize) -> Result<(), DesignError> {
    if found == expected { Ok(()) } else { Err(DesignError::VectorLength { what: what(), expected, found }) }
}

/// The name with the smallest edit distance, if it is close enough for a misspelling.
fn nearest<'n>(name: &str, names: impl Iterator<Item = &'n str>) -> Option<String> {
    const LONGEST: usize = 100;
    if name.len() > LONGEST {
        return None;
    }
    names
        .filter(|candidate| candidate.len() <= LONGEST)
        .map(|candidate| (strsim::levenshtein(name, candidate), candidate))
        .min()
        .filter(|(distance, _)| *distance <= 3)
        .map(|(_, candidate)| candidate.into())
}
