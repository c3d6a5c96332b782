//! Reports of derivative checks.

use moldline_proto::v1;

use crate::{Error, Point, Timings, convert};

/// `W^T (J V)` against `(J^T W)^T V`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DotProduct {
    /// Vectors in the block.
    pub block: usize,
    /// Frobenius norm of the difference over that of the product.
    pub error: f64,
}

/// Error of a derivative after one stage of the chain.
#[derive(Clone, Debug, PartialEq)]
pub struct StageError {
    /// Name of the stage.
    pub stage: String,
    /// Relative error.
    pub error: f64,
}

/// A derivative against central differences of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Step, relative to the range of the variable.
    pub step: f64,
    /// Relative error; absent if one of the two designs has no mesh.
    pub error: Option<f64>,
}

/// Vertices on a crease that they cross: they have two one-sided derivatives instead of one derivative.
#[derive(Clone, Debug, PartialEq)]
pub struct Kink {
    /// How many vertices.
    pub vertices: usize,
    /// The vertex whose one-sided derivatives differ most.
    pub worst_vertex: usize,
    /// Their difference, metres per unit of the variable.
    pub jump: f64,
    /// Position of that vertex, metres.
    pub position: Point,
    /// Its component.
    pub component: String,
    /// Relative error of the derivative: at these vertices against the nearer one-sided derivative, at all others against
    /// central differences.
    pub error: f64,
}

/// The errors at one design.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckedDesign {
    /// All variables in order, each in its unit.
    pub design: Vec<f64>,
    /// For blocks of one vector and of as many as there are variables.
    pub dot_products: Vec<DotProduct>,
    /// The largest of them.
    pub dot_product_max: f64,
    /// The largest error against dual numbers.
    pub dual_max: f64,
    /// The largest error against central differences.
    pub central_difference_max: f64,
    /// Largest distance between a vertex and that of the evaluation in dual numbers, relative to the reference length.
    pub values_max: f64,
}

/// The errors of the derivative with respect to one variable at one design.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckedVariable {
    /// Index into [`Check::designs`].
    pub design: usize,
    /// Name of the variable.
    pub variable: String,
    /// `|J v|` over all vertices, metres per unit of the variable.
    pub size: f64,
    /// Error against dual numbers.
    pub dual: f64,
    /// The vertex that contributes most to it.
    pub worst_vertex: usize,
    /// The same error after each stage of the chain, in order.
    pub stages: Vec<StageError>,
    /// The first stage whose error is too large, if any.
    pub first_discrepancy: Option<String>,
    /// Errors against central differences, over steps.
    pub differences: Vec<Difference>,
    /// Largest error of the scalar outputs against central differences at the best step.
    pub functions: f64,
    /// Searched for where central differences do not agree at any step.
    pub kink: Option<Kink>,
}

impl CheckedVariable {
    /// The central difference with the smallest error, if any has one.
    pub fn best(&self) -> Option<Difference> {
        let error = |each: &Difference| each.error.filter(|error| !error.is_nan());
        let known = self.differences.iter().filter_map(|each| Some((error(each)?, *each)));
        known.min_by(|(one, _), (other, _)| one.total_cmp(other)).map(|(_, each)| each)
    }
}

/// Errors of the derivatives of a set-up, all of them relative.
#[derive(Clone, Debug, PartialEq)]
pub struct Check {
    /// Largest error of the dot products, over all designs.
    pub dot_product_max: f64,
    /// Largest error against dual numbers, over all designs and variables.
    pub dual_max: f64,
    /// Largest error against central differences, over all designs and variables.
    pub central_difference_max: f64,
    /// Seed of the random designs and vectors.
    pub seed: u64,
    /// The designs, in order.
    pub designs: Vec<CheckedDesign>,
    /// One row for each requested variable, design after design.
    pub rows: Vec<CheckedVariable>,
    /// Definition of the errors, in words.
    pub definition: String,
    /// All errors as a table, as `moldline check` prints them.
    pub table: String,
    /// Time in the engine and in its queue.
    pub timings: Timings,
}

pub(crate) fn check(report: v1::CheckReport) -> Result<Check, Error> {
    Ok(Check {
        dot_product_max: report.dot_product_max,
        dual_max: report.dual_max,
        central_difference_max: report.central_difference_max,
        seed: report.seed,
        designs: report.designs.into_iter().map(design).collect::<Result<_, _>>()?,
        rows: report.rows.into_iter().map(row).collect::<Result<_, _>>()?,
        definition: report.definition,
        table: report.text,
        timings: convert::timings(report.timings),
    })
}

fn design(checked: v1::CheckedDesign) -> Result<CheckedDesign, Error> {
    let dot = |dot: v1::DotProductError| DotProduct { block: dot.block as usize, error: dot.error };
    Ok(CheckedDesign {
        design: convert::numbers(checked.design.as_ref())?,
        dot_products: checked.dot_products.into_iter().map(dot).collect(),
        dot_product_max: checked.dot_product_max,
        dual_max: checked.dual_max,
        central_difference_max: checked.central_difference_max,
        values_max: checked.values_max,
    })
}

fn row(row: v1::CheckedVariable) -> Result<CheckedVariable, Error> {
    let stage = |each: v1::StepError| StageError { stage: each.step, error: each.error };
    let difference = |each: v1::DifferenceError| Difference { step: each.step, error: each.error };
    Ok(CheckedVariable {
        design: row.design as usize,
        variable: row.variable,
        size: row.size,
        dual: row.dual,
        worst_vertex: row.worst_vertex as usize,
        stages: row.steps.into_iter().map(stage).collect(),
        first_discrepancy: row.first_discrepancy,
        differences: row.differences.into_iter().map(difference).collect(),
        functions: row.functions,
        kink: row.kink.map(kink).transpose()?,
    })
}

fn kink(kink: v1::Kink) -> Result<Kink, Error> {
    Ok(Kink {
        vertices: kink.vertices as usize,
        worst_vertex: kink.worst_vertex as usize,
        jump: kink.jump,
        position: convert::point(&kink.position)?,
        component: kink.component,
        error: kink.error,
    })
}
