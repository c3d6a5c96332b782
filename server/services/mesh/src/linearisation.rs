//! A requested design, its linearisation, and products with it: requests are checked and handed to the engine.

use std::{collections::BTreeMap, sync::Arc};

use moldline_deform::{Deformation, Direction, Inputs, Linearisation, Monitor, Setup, Stage, Tangent};
use moldline_host::{Code, ServiceError, Timing, shorten};
use moldline_parameterisation::{ControlPoints, Override, Parameterisation};
use moldline_store::Numbers;

use crate::{limits::Limits, read::explained, setup_id::SetupId};

/// A design: the input of a deformation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Design {
    /// Values of the design variables.
    pub values: Values,
    /// Given control points of components, in place of those of the design variables: name and points, m.
    pub control_points: Vec<(String, Vec<[f64; 3]>)>,
}

/// Values of the design variables, each in its variable's unit.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Every variable in order.
    Vector(Vec<f64>),
    /// Some variables by name; the others stay at their baseline.
    Named(BTreeMap<String, f64>),
}

impl Default for Values {
    fn default() -> Self {
        Self::Named(BTreeMap::new())
    }
}

/// Vectors with an entry for every control point of a component: directions, m, or gradients, 1/m.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlPointVectors {
    /// Name of the component.
    pub component: String,
    /// One after the other.
    pub vectors: Vec<Vec<[f64; 3]>>,
}

/// Directions of the inputs; absent parts are zero, and all given parts have the same number of directions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Directions {
    /// Of the design variables, each entry in its variable's unit.
    pub design: Option<Vec<Vec<f64>>>,
    /// Of the control points of some components, in addition to the changes that the design causes.
    pub control_points: Vec<ControlPointVectors>,
}

/// Weights of the outputs; absent parts are zero, and all given parts have the same number of seeds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seeds {
    /// Of the vertices, per metre.
    pub vertices: Option<Vec<Vec<[f64; 3]>>>,
    /// Of the functions, each per its unit.
    pub functions: Option<Vec<Vec<f64>>>,
}

/// Inputs with respect to which gradients are requested.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Wanted {
    /// The design variables.
    pub design: bool,
    /// The control points of these components.
    pub control_points: Vec<String>,
}

/// Gradients of some seeds.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients {
    /// With respect to the design variables, per unit of each, if requested.
    pub design: Option<Vec<Vec<f64>>>,
    /// With respect to control points, in the requested order.
    pub control_points: Vec<ControlPointVectors>,
}

/// A validated design, before it enters the queue.
pub(crate) struct Resolved(Inputs);

impl Resolved {
    pub fn new(parameterisation: &Parameterisation, design: Design) -> Result<Self, ServiceError> {
        let vector = match design.values {
            Values::Vector(vector) => vector,
            Values::Named(values) => {
                parameterisation.design(values.iter().map(|(name, &value)| (name.as_str(), value)))?
            }
        };
        parameterisation.validate(&vector)?;
        let overrides = design.control_points.into_iter().map(|(name, control_points)| {
            Ok(Override { component: component(&name, "control_points", parameterisation)?, control_points })
        });
        Ok(Self(Inputs { design: vector, given: overrides.collect::<Result<_, ServiceError>>()? }))
    }

    /// Values of all variables.
    pub fn into_vector(self) -> Vec<f64> {
        self.0.design
    }

    /// Its stored form: the variables, and the coordinates of given control points.
    pub fn numbers(&self, parameterisation: &Parameterisation) -> (Numbers, Vec<(String, Numbers)>) {
        let given = self.0.given.iter().map(|Override { component, control_points }| {
            let name = parameterisation.components()[*component].clone();
            (name, Numbers(control_points.as_flattened().to_vec()))
        });
        (Numbers(self.0.design.clone()), given.collect())
    }

    /// The id of (set-up, design), the same on every server.
    pub fn id(&self, setup: &SetupId) -> String {
        let mut hasher = blake3::Hasher::new();
        hasher.update(setup.as_str().as_bytes());
        for value in &self.0.design {
            hasher.update(&value.to_le_bytes());
        }
        for Override { component, control_points } in &self.0.given {
            hasher.update(&(*component as u64).to_le_bytes());
            for value in control_points.iter().flatten() {
                hasher.update(&value.to_le_bytes());
            }
        }
        hasher.finalize().to_hex().to_string()
    }

    /// Deforms and linearises.
    pub fn linearise(
        self,
        id: String,
        setup_id: SetupId,
        setup: &Arc<Setup>,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Linearised, ServiceError> {
        let engine = setup.linearise(self.0, monitor).map_err(|error| explained(setup.origin(), error))?;
        Ok(Linearised { id, setup_id, engine, timing: Timing::default() })
    }
}

/// A deformed mesh with its derivative.
#[derive(Debug)]
pub struct Linearised {
    id: String,
    setup_id: SetupId,
    engine: Linearisation,
    /// Time of the deformation.
    timing: Timing,
}

impl Linearised {
    /// Id of set-up and design in requests for derivatives.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Its set-up.
    pub(crate) fn setup_id(&self) -> &SetupId {
        &self.setup_id
    }

    /// The mesh.
    pub fn deformation(&self) -> &Deformation {
        self.engine.deformation()
    }

    /// Time that it took to compute.
    pub fn timing(&self) -> Timing {
        self.timing
    }

    /// Sets the time that it took.
    pub(crate) fn taking(self, timing: Timing) -> Self {
        Self { timing, ..self }
    }

    /// Number of design variables: columns of the Jacobian.
    pub fn columns(&self) -> usize {
        self.engine.design().len()
    }

    /// Its size without the set-up, bytes.
    pub fn bytes(&self) -> usize {
        self.engine.bytes()
    }

    /// Size of one vector for all vertices and control points, bytes.
    pub(crate) fn vector_bytes(&self) -> usize {
        vector_bytes(self.engine.setup())
    }

    /// Columns of the Jacobian from the `first` one on, `count` at most.
    pub(crate) fn jacobian(&self, first: usize, count: usize) -> Result<Vec<Tangent>, ServiceError> {
        let columns = first..self.columns().min(first + count);
        let unit = |column| {
            let mut direction = vec![0.0; self.columns()];
            direction[column] = 1.0;
            direction
        };
        finite(self.engine.jvp(&columns.map(unit).collect::<Vec<_>>())?)
    }

    /// Changes of the outputs.
    pub(crate) fn jvp(&self, directions: &CheckedDirections) -> Result<Vec<Tangent>, ServiceError> {
        finite(self.engine.jvp_inputs(&directions.0)?)
    }

    /// Gradients with respect to the requested inputs.
    pub(crate) fn vjp(&self, seeds: &[Tangent], wanted: &CheckedWanted) -> Result<Gradients, ServiceError> {
        let (design, all): (Option<Vec<_>>, Vec<ControlPoints>) = if wanted.design {
            let gradients = self.engine.vjp(seeds)?.into_iter();
            let (design, all) = gradients.map(|g| (g.design, g.control_points)).unzip();
            (Some(design), all)
        } else {
            (None, self.engine.vjp_control_points(seeds)?)
        };
        let designs = design.iter().flatten().flatten();
        let points = all.iter().flatten().flatten().flatten();
        if !designs.chain(points).all(|x| x.is_finite()) {
            return Err(overflow());
        }
        let names = self.engine.setup().parameterisation().components();
        let of = |&component: &usize| ControlPointVectors {
            component: names[component].clone(),
            vectors: all.iter().map(|gradient| gradient[component].clone()).collect(),
        };
        Ok(Gradients { design, control_points: wanted.control_points.iter().map(of).collect() })
    }
}

/// Products without overflow.
fn finite(tangents: Vec<Tangent>) -> Result<Vec<Tangent>, ServiceError> {
    let mut numbers =
        tangents.iter().flat_map(|tangent| tangent.vertices.as_flattened().iter().chain(&tangent.functions));
    match numbers.all(|x| x.is_finite()) {
        true => Ok(tangents),
        false => Err(overflow()),
    }
}

fn overflow() -> ServiceError {
    const MESSAGE: &str = "the product overflows: directions or seeds are too large; products are linear in them, so scale them down";
    ServiceError::new(Code::FailedPrecondition, MESSAGE)
}

/// Directions that have been checked against the set-up.
pub(crate) struct CheckedDirections(Vec<Direction>);

impl CheckedDirections {
    /// Their number.
    pub(crate) fn count(&self) -> usize {
        self.0.len()
    }
}

impl Directions {
    /// # Errors
    /// `InvalidArgument` naming the invalid field.
    pub(crate) fn check(self, setup: &Setup, limits: &Limits) -> Result<CheckedDirections, ServiceError> {
        let parameterisation = setup.parameterisation();
        let mut count = Count::new(setup, limits);
        if let Some(design) = &self.design {
            count.add("design", design.len())?;
            let variables = parameterisation.variables();
            check("design", design, variables.len(), "design variables")?;
        }
        let counts: Vec<usize> = control_point_counts(setup).collect();
        let mut control_points: Vec<(usize, _)> = Vec::with_capacity(self.control_points.len());
        for ControlPointVectors { component: name, vectors } in self.control_points {
            let component = component(&name, "control_points", parameterisation)?;
            let field = format!("control_points[\"{name}\"]");
            if control_points.iter().any(|(other, _)| *other == component) {
                return Err(ServiceError::invalid(field, "the component occurs twice"));
            }
            count.add(&field, vectors.len())?;
            check_points(&field, &vectors, counts[component], "control points")?;
            control_points.push((component, vectors));
        }
        let count =
            count.of_all("design", "there is no direction: send `design`, `control_points` or both")?;
        let mut directions = vec![Direction::default(); count];
        for (direction, design) in directions.iter_mut().zip(self.design.into_iter().flatten()) {
            direction.design = Some(design);
        }
        for (component, vectors) in control_points {
            for (direction, vectors) in directions.iter_mut().zip(vectors) {
                direction.control_points.push((component, vectors));
            }
        }
        Ok(CheckedDirections(directions))
    }
}

impl Seeds {
    /// # Errors
    /// `InvalidArgument` naming the invalid field.
    pub(crate) fn check(self, setup: &Setup, limits: &Limits) -> Result<Vec<Tangent>, ServiceError> {
        let (vertices, functions) = (setup.mesh().vertices.len(), setup.functions().len());
        let mut count = Count::new(setup, limits);
        if let Some(seeds) = &self.vertices {
            count.add("vertices", seeds.len())?;
            check_points("vertices", seeds, vertices, "vertices")?;
        }
        if let Some(seeds) = &self.functions {
            count.add("functions", seeds.len())?;
            check("functions", seeds, functions, "functions")?;
        }
        let count = count.of_all("vertices", "there is no seed: send `vertices`, `functions` or both")?;
        let of_vertices = self.vertices.unwrap_or_else(|| vec![vec![[0.0; 3]; vertices]; count]);
        let of_functions = self.functions.unwrap_or_else(|| vec![vec![0.0; functions]; count]);
        let both = of_vertices.into_iter().zip(of_functions);
        Ok(both.map(|(vertices, functions)| Tangent { vertices, functions }).collect())
    }
}

/// Requested gradients, by index.
pub(crate) struct CheckedWanted {
    design: bool,
    control_points: Vec<usize>,
}

impl Wanted {
    /// # Errors
    /// `InvalidArgument` if nothing is requested, or for an unknown component.
    pub(crate) fn check(self, parameterisation: &Parameterisation) -> Result<CheckedWanted, ServiceError> {
        let mut control_points = Vec::with_capacity(self.control_points.len());
        for name in &self.control_points {
            let component = component(name, "control_points_of", parameterisation)?;
            if control_points.contains(&component) {
                let field = format!("control_points_of[\"{name}\"]");
                return Err(ServiceError::invalid(field, "the component occurs twice"));
            }
            control_points.push(component);
        }
        if !self.design && control_points.is_empty() {
            return Err(ServiceError::invalid(
                "include_design",
                "no gradient is asked for: set `include_design`, name components in `control_points_of`, or both",
            ));
        }
        Ok(CheckedWanted { design: self.design, control_points })
    }
}

/// The number of vectors in each part of a request.
struct Count<'a> {
    limits: &'a Limits,
    /// Size of one vector.
    bytes: usize,
    /// Number of vectors in the parts so far, and the name of the first part.
    known: Option<(String, usize)>,
}

fn vector_bytes(setup: &Setup) -> usize {
    size_of::<[f64; 3]>() * (setup.mesh().vertices.len() + control_point_counts(setup).sum::<usize>())
}

impl<'a> Count<'a> {
    fn new(setup: &Setup, limits: &'a Limits) -> Self {
        Self { limits, bytes: vector_bytes(setup), known: None }
    }

    fn add(&mut self, field: &str, count: usize) -> Result<(), ServiceError> {
        let shape = format!("{field}.shape[0]");
        let most = (self.limits.vector_bytes / self.bytes.max(1)).clamp(1, self.limits.vectors.max(1));
        if !(1..=most).contains(&count) {
            return Err(ServiceError::invalid(
                shape,
                format!("{count} vectors are outside 1..={most}; send them in several requests"),
            ));
        }
        match &self.known {
            Some((first, known)) if *known != count => Err(ServiceError::invalid(
                shape,
                format!("{count} vectors, but `{first}` has {known}; all parts of a request have as many"),
            )),
            Some(_) => Ok(()),
            None => {
                self.known = Some((field.to_owned(), count));
                Ok(())
            }
        }
    }

    fn of_all(self, field: &str, none: &str) -> Result<usize, ServiceError> {
        self.known.map(|(_, count)| count).ok_or_else(|| ServiceError::invalid(field, none))
    }
}

fn check(field: &str, vectors: &[Vec<f64>], length: usize, what: &str) -> Result<(), ServiceError> {
    for (k, vector) in vectors.iter().enumerate() {
        check_length(field, vector.len(), length, what)?;
        if let Some(i) = vector.iter().position(|x| !x.is_finite()) {
            return Err(not_finite(format!("{field}[{k}][{i}]"), vector[i]));
        }
    }
    Ok(())
}

fn check_points(
    field: &str,
    vectors: &[Vec<[f64; 3]>],
    length: usize,
    what: &str,
) -> Result<(), ServiceError> {
    for (k, vector) in vectors.iter().enumerate() {
        check_length(field, vector.len(), length, what)?;
        if let Some(i) = vector.as_flattened().iter().position(|x| !x.is_finite()) {
            let (point, axis) = (i / 3, i % 3);
            return Err(not_finite(format!("{field}[{k}][{point}][{axis}]"), vector[point][axis]));
        }
    }
    Ok(())
}

fn check_length(field: &str, found: usize, expected: usize, what: &str) -> Result<(), ServiceError> {
    if found == expected {
        return Ok(());
    }
    let description = format!("{found} entries in a vector, expected {expected}, the number of {what}");
    Err(ServiceError::invalid(format!("{field}.shape[1]"), description))
}

fn not_finite(field: String, value: f64) -> ServiceError {
    let description = format!("{field} = {value} is not finite");
    ServiceError::invalid(field, description)
}

fn control_point_counts(setup: &Setup) -> impl Iterator<Item = usize> + '_ {
    setup.components().iter().map(|component| component.user_control_point_count())
}

/// Index of the component that `field` names.
fn component(name: &str, field: &str, parameterisation: &Parameterisation) -> Result<usize, ServiceError> {
    parameterisation.components().iter().position(|known| known == name).ok_or_else(|| {
        ServiceError::invalid(
            format!("{field}[\"{}\"]", shorten(name)),
            format!("there is no such component; there are: {}", parameterisation.components().join(", ")),
        )
    })
}
