//! The check of a linearisation at a design: dot products, dual numbers, central differences.

use moldline_deform::{DeformError, Monitor, Setup, Stage};
use moldline_parameterisation::Variable;
use rayon::prelude::*;

use crate::{
    Chain, CheckError, Evaluation, Stages,
    differences::{norm, relative_error},
    dual::Real,
    kink::{Kink, kink},
    random::Random,
};

/// Largest error of the dot products with which derivatives pass.
pub const DOT_PRODUCT: f64 = 1e-12;
/// Largest relative error against dual numbers.
pub const DUAL: f64 = 1e-10;
/// Largest relative error against central differences.
pub const CENTRAL_DIFFERENCE: f64 = 1e-6;
/// The error of a derivative of a scalar output is relative to this fraction of the sum of its terms' absolute values, if the derivative
/// is smaller: it cancels, and rounding remains.
const CANCELLED: f64 = 1e-3;

/// The outputs of a design, a derivative of them, or a seed for them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outputs {
    /// Vertices, m.
    pub vertices: Vec<[f64; 3]>,
    /// Scalar outputs, in their own units.
    pub functions: Vec<f64>,
}

/// The linearisation that is checked.
pub trait Linear {
    /// The outputs themselves.
    fn outputs(&self) -> Outputs;

    /// `J v` for each direction in the space of the design variables.
    ///
    /// # Errors
    /// The engine's.
    fn jvp(&self, directions: &[Vec<f64>]) -> Result<Vec<Outputs>, DeformError>;

    /// `J^T w` for each seed.
    ///
    /// # Errors
    /// The engine's.
    fn vjp(&self, seeds: &[Outputs]) -> Result<Vec<Vec<f64>>, DeformError>;

    /// The derivatives of each step along a direction, so that a discrepancy can be traced.
    ///
    /// # Errors
    /// The engine's.
    fn stages(&self, direction: &[f64]) -> Result<Stages, DeformError>;
}

/// The engine as a function, for differences.
pub trait Function: Sync {
    /// The outputs of a design; the bounds of the variables are ignored.
    ///
    /// # Errors
    /// [`DeformError`] if there is no mesh.
    fn eval(&self, design: &[f64], monitor: &dyn Monitor<Stage>) -> Result<Outputs, DeformError>;
}

/// The phase of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// `<w, J v>` against `<J^T w, v>`.
    DotProducts,
    /// Dual numbers.
    DualNumbers,
    /// Central differences.
    Differences,
}

/// The observer of a check: it receives progress and can cancel.
pub trait Watch: Sync {
    /// The check has done `fraction` (0..=1) of a phase.
    fn progress(&self, phase: Phase, fraction: f64);

    /// Whether the check should stop.
    fn cancelled(&self) -> bool {
        false
    }
}

/// The engine's monitor: passes cancellation on, but no progress.
struct Quietly<'a>(&'a dyn Watch);

impl Monitor<Stage> for Quietly<'_> {
    fn progress(&self, _: Stage, _: f64) {}

    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

/// Options of a check.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckOptions {
    /// Variables whose derivatives are compared with dual numbers and differences.
    pub variables: Vec<usize>,
    /// Steps of the differences, relative to the range of the variable.
    pub steps: Vec<f64>,
    /// Seed of the random vectors.
    pub seed: u64,
    /// Relative error of a step of the chain from which on the step is reported as wrong.
    pub tolerance: f64,
    /// Relative error against central differences from which on kinks are sought.
    pub differences: f64,
}

impl CheckOptions {
    /// All of `count` variables, steps from 1e-2 to 1e-9.
    pub fn all(count: usize) -> Self {
        Self {
            variables: (0..count).collect(),
            steps: (2..=9).map(|k| 10_f64.powi(-k)).collect(),
            seed: 1,
            tolerance: DUAL,
            differences: CENTRAL_DIFFERENCE,
        }
    }
}

/// A step of the chain, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Step {
    /// Design to control points.
    ControlPoints,
    /// Points on the seams.
    SeamPositions,
    /// Their parameters on the components.
    SeamParameters,
    /// Motions of the seams in the terms of the fields.
    Motions,
    /// The fields at the vertices.
    Displacements,
    /// Vertices on their components.
    Placed,
    /// Vertices on the outer mold line.
    Vertices,
    /// The scalar outputs.
    Functions,
}

impl Step {
    /// All, in order.
    pub const ALL: [Self; 8] = [
        Self::ControlPoints,
        Self::SeamPositions,
        Self::SeamParameters,
        Self::Motions,
        Self::Displacements,
        Self::Placed,
        Self::Vertices,
        Self::Functions,
    ];

    /// Name for reports and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::ControlPoints => "control points",
            Self::SeamPositions => "seam positions",
            Self::SeamParameters => "seam parameters",
            Self::Motions => "seam motions",
            Self::Displacements => "field",
            Self::Placed => "placement",
            Self::Vertices => "outer mold line",
            Self::Functions => "scalar outputs",
        }
    }

    /// The step's numbers, one after the other.
    fn numbers(self, stages: &Stages) -> Vec<f64> {
        let flat = |x: &[Real]| x.iter().flat_map(|x| [x.x, x.y, x.z]).collect::<Vec<_>>();
        match self {
            Self::ControlPoints => stages.control_points.iter().flatten().flatten().copied().collect(),
            Self::SeamPositions => flat(&stages.seam_positions),
            Self::SeamParameters => stages.seam_parameters.iter().flatten().flatten().copied().collect(),
            Self::Motions => stages.motions.iter().flat_map(|m| flat(m)).collect(),
            Self::Displacements => flat(&stages.displacements),
            Self::Placed => flat(&stages.placed),
            Self::Vertices => flat(&stages.vertices),
            Self::Functions => stages.functions.clone(),
        }
    }
}

/// `J v` and `J^T w` against each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DotProduct {
    /// Vectors in the block.
    pub block: usize,
    /// `|W^T (J V) - (J^T W)^T V| / |W^T (J V)|`, Frobenius norms of the k x k matrices.
    pub error: f64,
}

/// A central difference with one step size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Step, relative to the range of the variable.
    pub step: f64,
    /// Relative error of the vertices; `None` if one of the two designs has no mesh.
    pub error: Option<f64>,
}

/// The derivative with respect to one variable.
#[derive(Clone, Debug, PartialEq)]
pub struct VariableCheck {
    /// Index of the variable.
    pub variable: usize,
    /// `|J v|` over all vertices, m per unit of the variable.
    pub size: f64,
    /// Relative error against dual numbers: of the vertices, or of a scalar output where that is larger.
    pub dual: f64,
    /// The vertex that contributes most to this error.
    pub worst_vertex: usize,
    /// Relative errors of the steps of the chain.
    pub steps: Vec<(Step, f64)>,
    /// The first step whose error is beyond the tolerance.
    pub first_off: Option<Step>,
    /// Relative errors against central differences.
    pub differences: Vec<Difference>,
    /// Vertices with different one-sided derivatives. They are sought where central differences do not agree at any step.
    pub kink: Option<Kink>,
    /// The largest relative error of a scalar output against central differences at the best step. Zero if there are none.
    pub functions: f64,
}

impl VariableCheck {
    /// The least error against central differences, and its step.
    pub fn best(&self) -> Option<(f64, f64)> {
        let errors = self.differences.iter().filter_map(|d| d.error.map(|e| (d.step, e)));
        errors.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The least error against central differences; at kinks, against the one-sided derivative.
    pub fn difference_error(&self) -> f64 {
        let best = self.best().map_or(f64::INFINITY, |(_, error)| error);
        self.kink.as_ref().map_or(best, |kink| kink.error)
    }
}

/// All comparisons at one design.
#[derive(Clone, Debug, PartialEq)]
pub struct DesignCheck {
    /// The design.
    pub design: Vec<f64>,
    /// Largest distance between a vertex from the engine and the same vertex from the evaluation in dual numbers, relative to
    /// the reference length.
    pub values: f64,
    /// With blocks of one vector, and of as many as there are variables.
    pub dot_products: Vec<DotProduct>,
    /// A row for each requested variable.
    pub variables: Vec<VariableCheck>,
}

impl DesignCheck {
    /// The largest error of the dot products.
    pub fn dot_product_max(&self) -> f64 {
        largest(self.dot_products.iter().map(|d| d.error))
    }

    /// The largest relative error against dual numbers.
    pub fn dual_max(&self) -> f64 {
        largest(self.variables.iter().map(|v| v.dual))
    }

    /// The largest relative error against central differences at the best step of each variable; at kinks against the
    /// one-sided derivative.
    pub fn central_difference_max(&self) -> f64 {
        largest(self.variables.iter().map(VariableCheck::difference_error))
    }
}

/// The largest value; NaN if any value is.
pub fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, |a, b| if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) })
}

/// The range of a variable: between its bounds, or else its baseline or one.
pub fn range(variable: &Variable) -> f64 {
    let range = variable.upper - variable.lower;
    if range.is_finite() && range > 0.0 { range } else { variable.baseline.abs().max(1.0) }
}

impl Function for Setup {
    fn eval(&self, design: &[f64], monitor: &dyn Monitor<Stage>) -> Result<Outputs, DeformError> {
        let control_points = self.parameterisation().control_points(design)?;
        let deformation = self.deform_control_points(&control_points, monitor)?;
        Ok(Outputs { vertices: deformation.vertices, functions: deformation.functions })
    }
}

/// The baseline and random designs far from it that have a mesh, `count` in all.
///
/// # Errors
/// [`CheckError::NoDesign`] if many random designs in a row have none.
pub fn designs(
    setup: &Setup,
    function: &dyn Function,
    count: usize,
    seed: u64,
    watch: &dyn Watch,
) -> Result<Vec<Vec<f64>>, CheckError> {
    const ATTEMPTS: usize = 100;
    let mut random = Random::new(seed);
    let mut designs = vec![setup.parameterisation().baseline()];
    let mut refused = 0;
    while designs.len() < count {
        let design = far_design(setup.parameterisation().variables(), &mut random);
        match function.eval(&design, &Quietly(watch)) {
            Ok(_) => {
                designs.push(design);
                refused = 0;
            }
            Err(DeformError::Cancelled) => return Err(DeformError::Cancelled.into()),
            Err(last) => {
                refused += 1;
                if refused == ATTEMPTS {
                    return Err(CheckError::NoDesign { attempts: ATTEMPTS, last: Box::new(last) });
                }
            }
        }
    }
    designs.truncate(count);
    Ok(designs)
}

/// A random design far from the baseline: each variable half to nine tenths of the way to one of its bounds.
fn far_design(variables: &[Variable], random: &mut Random) -> Vec<f64> {
    variables
        .iter()
        .map(|v| {
            let up = random.uniform() < 0.5;
            let way = 0.5 + 0.4 * random.uniform();
            let bound = if up { v.upper } else { v.lower };
            let reach = if bound.is_finite() { bound - v.baseline } else { 0.1 * range(v) };
            v.baseline + way * reach
        })
        .collect()
}

/// Checks a linearisation at a design.
///
/// # Errors
/// [`CheckError`]: the engine's errors, cancellation included, and those of the evaluation in dual numbers. It is no error if a
/// difference's design has no mesh.
pub fn check_design(
    setup: &Setup,
    chain: &Chain<'_>,
    linear: &dyn Linear,
    function: &dyn Function,
    design: &[f64],
    options: &CheckOptions,
    watch: &dyn Watch,
) -> Result<DesignCheck, CheckError> {
    let variables = setup.parameterisation().variables();
    watch.progress(Phase::DotProducts, 0.0);
    let mut random = Random::new(options.seed);
    let mut dot_products = Vec::new();
    for (done, block) in [1, variables.len()].into_iter().enumerate() {
        dot_products.push(dot_product(linear, variables, block, &mut random)?);
        watch.progress(Phase::DotProducts, 0.5 * (done + 1) as f64);
    }

    watch.progress(Phase::DualNumbers, 0.0);
    let unit = |k: usize| (0..design.len()).map(|i| f64::from(i == k)).collect::<Vec<f64>>();
    let directions: Vec<Vec<f64>> = options.variables.iter().map(|&k| unit(k)).collect();
    let tangents = linear.jvp(&directions)?;
    let dual = chain.eval(design, &directions, &DualProgress(watch))?;
    let engine = linear.outputs();
    let values = largest(
        engine
            .vertices
            .iter()
            .zip(&dual.values.vertices)
            .map(|(a, b)| (Real::from(*a) - b).norm() / setup.length()),
    );
    let mut rows = Vec::with_capacity(options.variables.len());
    for (row, &variable) in options.variables.iter().enumerate() {
        let stages = linear.stages(&directions[row])?;
        rows.push(against_dual(variable, &tangents[row], &stages, &dual, row, options.tolerance));
    }

    watch.progress(Phase::Differences, 0.0);
    let work = rows.len() * options.steps.len();
    for (row, check) in rows.iter_mut().enumerate() {
        let variable = check.variable;
        let mut best = f64::INFINITY;
        for (k, &step) in options.steps.iter().enumerate() {
            let h = step * range(&variables[variable]);
            let difference = central(function, design, &directions[row], h, &Quietly(watch))?;
            let error = difference.as_ref().map(|d| relative_error(&d.vertices, &tangents[row].vertices));
            if let (Some(difference), Some(error)) = (&difference, error)
                && error < best
            {
                best = error;
                check.functions =
                    function_error(&difference.functions, &tangents[row].functions, &dual.terms[row]);
            }
            check.differences.push(Difference { step, error });
            watch.progress(Phase::Differences, (row * options.steps.len() + k + 1) as f64 / work as f64);
        }
        if best > options.differences {
            let at = [design, &directions[row]];
            let range = range(&variables[variable]);
            let tangent = &tangents[row].vertices;
            check.kink = kink(setup, function, at, range, &engine, tangent, &Quietly(watch))?;
        }
    }
    Ok(DesignCheck { design: design.to_vec(), values, dot_products, variables: rows })
}

/// Passes on the progress of the evaluation in dual numbers.
struct DualProgress<'a>(&'a dyn Watch);

impl Monitor<Stage> for DualProgress<'_> {
    fn progress(&self, stage: Stage, fraction: f64) {
        if stage == Stage::Projection {
            self.0.progress(Phase::DualNumbers, fraction);
        }
    }

    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

fn dot_product(
    linear: &dyn Linear,
    variables: &[Variable],
    block: usize,
    random: &mut Random,
) -> Result<DotProduct, DeformError> {
    let outputs = linear.outputs();
    let directions: Vec<Vec<f64>> =
        (0..block).map(|_| variables.iter().map(|v| range(v) * random.signed()).collect()).collect();
    let tangents = linear.jvp(&directions)?;
    // Seeds that give the scalar outputs the same weight as the vertices, whatever their units; except outputs that only
    // rounding changes (the y of a tracked point in the plane of symmetry).
    let changes: Vec<f64> = (0..outputs.functions.len())
        .map(|k| largest(tangents.iter().map(|t| t.functions[k].abs())))
        .collect();
    let least = 1e-9 * largest(changes.iter().copied());
    let moved = largest(tangents.iter().map(|t| norm(&t.vertices)));
    let weights: Vec<f64> =
        changes.iter().map(|&change| if change > least { moved / change } else { 1.0 }).collect();
    let seeds: Vec<Outputs> = (0..block)
        .map(|_| Outputs {
            vertices: outputs.vertices.iter().map(|_| std::array::from_fn(|_| random.signed())).collect(),
            functions: weights.iter().map(|w| w * random.signed()).collect(),
        })
        .collect();
    let gradients = linear.vjp(&seeds)?;
    let (mut difference, mut size) = (0.0, 0.0);
    for (seed, gradient) in seeds.iter().zip(&gradients) {
        for (direction, tangent) in directions.iter().zip(&tangents) {
            let forward = inner(seed, tangent);
            let backward: f64 = gradient.iter().zip(direction).map(|(g, v)| g * v).sum();
            difference += (forward - backward).powi(2);
            size += forward.powi(2);
        }
    }
    Ok(DotProduct { block, error: if difference == 0.0 { 0.0 } else { (difference / size).sqrt() } })
}

fn inner(a: &Outputs, b: &Outputs) -> f64 {
    let vertices: f64 =
        a.vertices.iter().flatten().zip(b.vertices.iter().flatten()).map(|(a, b)| a * b).sum();
    vertices + a.functions.iter().zip(&b.functions).map(|(a, b)| a * b).sum::<f64>()
}

fn against_dual(
    variable: usize,
    tangent: &Outputs,
    stages: &Stages,
    dual: &Evaluation,
    row: usize,
    tolerance: f64,
) -> VariableCheck {
    let exact = &dual.tangents[row];
    let length = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>().sqrt();
    let moved = length(&Step::ControlPoints.numbers(exact));
    let steps: Vec<(Step, f64)> = Step::ALL
        .into_iter()
        .map(|step| {
            let (a, b) = (step.numbers(stages), step.numbers(exact));
            let difference: Vec<f64> = a.iter().zip(&b).map(|(a, b)| a - b).collect();
            // The derivative of a step that does next to nothing is rounding.
            let size = length(&b).max(1e-6 * moved);
            let error = match step {
                _ if a.len() != b.len() => f64::INFINITY,
                // Each output has its own unit.
                Step::Functions => function_error(&a, &b, &dual.terms[row]),
                _ => length(&difference) / size,
            };
            (step, if error.is_nan() && size == 0.0 { 0.0 } else { error })
        })
        .collect();
    let functions = function_error(&tangent.functions, &exact.functions, &dual.terms[row]);
    let exact: Vec<[f64; 3]> = exact.vertices.iter().map(|&x| x.into()).collect();
    let off = |v: &usize| (Real::from(tangent.vertices[*v]) - Real::from(exact[*v])).norm();
    let worst = (0..exact.len()).max_by(|a, b| off(a).total_cmp(&off(b)));
    VariableCheck {
        variable,
        size: norm(&tangent.vertices),
        dual: largest([relative_error(&tangent.vertices, &exact), functions].into_iter()),
        worst_vertex: worst.unwrap_or(0),
        // NaN counts as wrong.
        first_off: steps
            .iter()
            .find(|(_, error)| error.is_nan() || *error > tolerance)
            .map(|(step, _)| *step),
        steps,
        differences: Vec::new(),
        kink: None,
        functions: 0.0,
    }
}

/// `(f(p + h d) - f(p - h d)) / 2 h`, or `None` if one of the two has no mesh.
fn central(
    function: &dyn Function,
    design: &[f64],
    direction: &[f64],
    h: f64,
    monitor: &dyn Monitor<Stage>,
) -> Result<Option<Outputs>, DeformError> {
    let at = |sign: f64| {
        let design: Vec<f64> = design.iter().zip(direction).map(|(p, d)| p + sign * h * d).collect();
        function.eval(&design, monitor)
    };
    let both: Vec<Result<Outputs, DeformError>> = [1.0, -1.0].into_par_iter().map(at).collect();
    let mut outputs = Vec::with_capacity(2);
    for result in both {
        match result {
            Ok(result) => outputs.push(result),
            Err(DeformError::Cancelled) => return Err(DeformError::Cancelled),
            Err(_) => return Ok(None),
        }
    }
    let [above, below] = &outputs[..] else { return Ok(None) };
    let slope = |a: f64, b: f64| (a - b) / (2.0 * h);
    Ok(Some(Outputs {
        vertices: above
            .vertices
            .iter()
            .zip(&below.vertices)
            .map(|(a, b)| [0, 1, 2].map(|axis| slope(a[axis], b[axis])))
            .collect(),
        functions: above.functions.iter().zip(&below.functions).map(|(a, b)| slope(*a, *b)).collect(),
    }))
}

/// The largest error of a scalar output: relative to its derivative, or to [`CANCELLED`] times the sum of its terms' absolute values.
fn function_error(found: &[f64], exact: &[f64], terms: &[f64]) -> f64 {
    largest(found.iter().zip(exact).zip(terms).map(|((found, exact), terms)| {
        let size = exact.abs().max(CANCELLED * terms);
        if found == exact { 0.0 } else { (found - exact).abs() / size }
    }))
}
