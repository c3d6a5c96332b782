//! The context in which operations are compiled: components by name, their reference geometry, the design variables, and
//! the points carried along.
//!
//! Pivots and centre lines are points beside the control points. They are placed before any operation is compiled, so
//! that each is a target of every operation declared before the one that needs it.

use std::{cell::OnceCell, collections::HashMap, ops::Range, rc::Rc};

use moldline_foundation::Vector3;

use crate::axis::{Axes, Axis};
use crate::error::ParameterisationError;
use crate::reference::{ComponentReference, reference_points};
use crate::sections::SampledSurfaces;
use crate::variables::{VariableDeclaration, Variables, list};

/// An operation being compiled: its place in the declaration, its components, and the points that it needs carried along.
pub(crate) struct Site {
    index: usize,
    /// Indices of its components, at least one.
    pub(crate) members: Vec<usize>,
    /// Index of the pivot among the points, if the operation has one.
    pivot: Option<usize>,
    /// Points that are scaled, each with its centre, as indices of points.
    pub(crate) centres: Vec<(usize, usize)>,
}

impl Site {
    /// The path of one of its fields.
    pub(crate) fn field(&self, what: &str) -> String {
        format!("operations[{}].{what}", self.index)
    }

    /// The error of geometry that the operation cannot work on.
    pub(crate) fn geometry(&self, reason: &str) -> ParameterisationError {
        ParameterisationError::Geometry {
            field: format!("operations[{}]", self.index),
            reason: reason.into(),
        }
    }

    /// A declared point.
    pub(crate) fn point(&self, what: &str, point: [f64; 3]) -> Result<Vector3, ParameterisationError> {
        match point.iter().position(|v| !v.is_finite()) {
            Some(axis) => Err(ParameterisationError::NotFinite {
                field: format!("{}[{axis}]", self.field(what)),
                value: point[axis],
            }),
            None => Ok(Vector3::from(point)),
        }
    }

    /// The unit vector along a declared direction.
    pub(crate) fn direction(
        &self,
        what: &str,
        direction: [f64; 3],
    ) -> Result<Vector3, ParameterisationError> {
        let vector = self.point(what, direction)?;
        // Scaled by the largest entry first, so that no norm over- or underflows.
        let largest = vector.amax();
        if largest == 0.0 {
            return Err(ParameterisationError::Geometry {
                field: self.field(what),
                reason: "is the zero vector; give a direction".into(),
            });
        }
        Ok((vector / largest).normalize())
    }

    /// Index of the pivot among the points; meaningless for an operation that placed none.
    pub(crate) fn pivot(&self) -> usize {
        self.pivot.unwrap_or_default()
    }
}

/// The state of the compilation of operations, one by one.
pub(crate) struct Compiler<'a> {
    pub(crate) components: &'a [ComponentReference],
    /// The surfaces of each component alone, sampled at first use.
    sampled: Vec<OnceCell<Rc<SampledSurfaces>>>,
    index: HashMap<&'a str, usize>,
    /// Each component's control points among the points.
    pub(crate) ranges: Vec<Range<usize>>,
    /// Reference control points, then the points carried along, m.
    pub(crate) points: Vec<Vector3>,
    pub(crate) variables: Variables<'a>,
    /// Points carried along with each component.
    carried: Vec<Vec<usize>>,
}

impl<'a> Compiler<'a> {
    /// Checks the reference geometry and the declared variables.
    pub(crate) fn new(
        components: &'a [ComponentReference],
        variables: &'a [VariableDeclaration],
    ) -> Result<Self, ParameterisationError> {
        let (ranges, points) = reference_points(components)?;
        let variables = Variables::new(variables)?;
        let mut index = HashMap::new();
        for (i, component) in components.iter().enumerate() {
            if index.insert(component.name.as_str(), i).is_some() {
                return Err(ParameterisationError::DuplicateName {
                    field: format!("components[{i}].name"),
                    name: component.name.clone(),
                });
            }
        }
        Ok(Self {
            components,
            sampled: components.iter().map(|_| OnceCell::new()).collect(),
            index,
            ranges,
            points,
            variables,
            carried: vec![Vec::new(); components.len()],
        })
    }

    /// The site of operation `index`, which names `components`.
    pub(crate) fn site(&self, index: usize, components: &[String]) -> Result<Site, ParameterisationError> {
        if components.is_empty() {
            return Err(ParameterisationError::Empty { field: format!("operations[{index}].components") });
        }
        let mut members = Vec::with_capacity(components.len());
        for (j, name) in components.iter().enumerate() {
            let field = format!("operations[{index}].components[{j}]");
            let Some(&member) = self.index.get(name.as_str()) else {
                let known: Vec<&str> = self.components.iter().map(|c| c.name.as_str()).collect();
                return Err(ParameterisationError::UnknownName {
                    field,
                    name: name.clone(),
                    known: list(&known),
                });
            };
            if members.contains(&member) {
                return Err(ParameterisationError::DuplicateName { field, name: name.clone() });
            }
            members.push(member);
        }
        Ok(Site { index, members, pivot: None, centres: Vec::new() })
    }

    /// Carries the pivot of an operation along with its first component.
    pub(crate) fn place_pivot(&mut self, site: &mut Site, point: Vector3) {
        site.pivot = Some(self.carry(site.members[0], point));
    }

    /// Carries a point along with a component; its index among the points.
    pub(crate) fn carry(&mut self, component: usize, point: Vector3) -> usize {
        self.points.push(point);
        self.carried[component].push(self.points.len() - 1);
        self.points.len() - 1
    }

    /// The points that an operation moves: the control points of its members, then the points carried along with them,
    /// without its own pivot.
    pub(crate) fn targets(&self, site: &Site) -> Vec<usize> {
        let own = site.members.iter().flat_map(|&c| self.ranges[c].clone());
        let carried = site.members.iter().flat_map(|&c| self.carried[c].iter().copied());
        own.chain(carried.filter(|&p| Some(p) != site.pivot)).collect()
    }

    /// The sampled surfaces of the operation's first component.
    pub(crate) fn surfaces(&self, site: &Site) -> Rc<SampledSurfaces> {
        let first = site.members[0];
        let sample = || Rc::new(SampledSurfaces::new(&[&self.components[first]]));
        Rc::clone(self.sampled[first].get_or_init(sample))
    }

    /// The quarter-chord point of the first component's root: in the plane 0 of the span axis, or at the lower end of
    /// the span if not `symmetric`.
    pub(crate) fn root_quarter_chord(
        &self,
        site: &Site,
        span: Axis,
        symmetric: bool,
    ) -> Result<Vector3, ParameterisationError> {
        let axes = Axes::of_span(span);
        let surfaces = self.surfaces(site);
        let station = if symmetric { 0.0 } else { surfaces.range(axes.span).0 };
        let section = surfaces
            .section(axes, station, symmetric)
            .ok_or_else(|| site.geometry("the component has no root chord: is the span axis right?"))?;
        let mut point = Vector3::zeros();
        [point[axes.chord], point[axes.thickness]] = section.quarter_chord();
        point[axes.span] = station;
        Ok(point)
    }
}
