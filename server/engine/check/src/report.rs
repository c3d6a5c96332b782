//! A whole check: several designs, one after the other, and a report in words.

use std::{fmt, sync::Arc};

use moldline_deform::{NoMonitor, Setup};
use moldline_parameterisation::Parameterisation;

use crate::{
    Chain, CheckError, CheckOptions, DesignCheck, Phase, VariableCheck, Watch,
    check::{CENTRAL_DIFFERENCE, DOT_PRODUCT, DUAL},
    check_design, designs, largest,
};

/// Where derivatives are checked.
#[derive(Clone, Debug, PartialEq)]
pub enum Designs {
    /// At the baseline and at random designs far from it: their number in all.
    Number(usize),
    /// At this design.
    Given(Vec<f64>),
}

/// What to check.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    /// The designs.
    pub designs: Designs,
    /// Seed of the random designs and vectors.
    pub seed: u64,
    /// Names of variables or of groups of them, to be compared with dual numbers and differences; all if empty.
    pub variables: Vec<String>,
}

impl Request {
    /// Indices of the requested variables.
    ///
    /// # Errors
    /// [`CheckError::Variable`].
    pub fn variables(&self, parameterisation: &Parameterisation) -> Result<Vec<usize>, CheckError> {
        if self.variables.is_empty() {
            return Ok((0..parameterisation.variables().len()).collect());
        }
        let mut indices = Vec::new();
        for (index, name) in self.variables.iter().enumerate() {
            match parameterisation.groups().iter().find(|g| g.name == *name) {
                Some(group) => indices.extend(group.range.clone()),
                None => indices.push(
                    parameterisation.index(name).map_err(|error| CheckError::Variable { index, error })?,
                ),
            }
        }
        indices.sort_unstable();
        indices.dedup();
        Ok(indices)
    }
}

/// The observer of a whole check: it receives progress and can cancel.
pub trait Observer: Sync {
    /// The check has done `fraction` (0..=1); `at` is the current stage in words.
    fn progress(&self, fraction: f64, at: &str);

    /// Whether the check should stop.
    fn cancelled(&self) -> bool;
}

/// The result of a check.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// Seed of the random designs and vectors.
    pub seed: u64,
    /// Names of all variables, in the order of a design's entries.
    pub variables: Vec<String>,
    /// Whether the design was given, in place of the baseline and random ones.
    pub given: bool,
    /// Results for each design.
    pub designs: Vec<DesignCheck>,
}

/// The largest error of one comparison.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Maximum {
    /// What was compared.
    pub comparison: &'static str,
    /// The error.
    pub error: f64,
    /// Largest error with which derivatives pass.
    pub goal: f64,
}

impl Maximum {
    /// Whether the error is within the goal; NaN is not.
    pub fn passes(&self) -> bool {
        self.error <= self.goal
    }
}

impl Report {
    /// Definition of the numbers.
    pub const DEFINITION: &str = "relative errors: norm over all vertices of the difference, over that of the derivative; \
                                  steps relative to the range of the variable";

    /// Checks the linearisations that the engine makes of a set-up.
    ///
    /// # Errors
    /// [`CheckError`], cancellation included.
    pub fn new(setup: &Arc<Setup>, request: &Request, observer: &dyn Observer) -> Result<Self, CheckError> {
        let parameterisation = setup.parameterisation();
        let variables = request.variables(parameterisation)?;
        let all = parameterisation.variables();
        let options = CheckOptions { variables, seed: request.seed, ..CheckOptions::all(all.len()) };
        observer.progress(0.0, "looking for designs");
        let designs = match &request.designs {
            Designs::Number(count) => {
                designs(setup, &**setup, *count, request.seed, &Part { observer, number: 0, count: *count })?
            }
            Designs::Given(design) => vec![design.clone()],
        };
        let chain = Chain::new(setup);
        let mut checks = Vec::with_capacity(designs.len());
        for (number, design) in designs.iter().enumerate() {
            let part = Part { observer, number, count: designs.len() };
            let linear = setup.linearise(design, &NoMonitor)?;
            checks.push(check_design(setup, &chain, &linear, &**setup, design, &options, &part)?);
        }
        Ok(Self {
            seed: request.seed,
            variables: all.iter().map(|v| v.name.clone()).collect(),
            given: matches!(request.designs, Designs::Given(_)),
            designs: checks,
        })
    }

    /// The largest errors of the three comparisons over all designs.
    pub fn maxima(&self) -> [Maximum; 3] {
        let over = |of: fn(&DesignCheck) -> f64| largest(self.designs.iter().map(of));
        [
            ("dot products", over(DesignCheck::dot_product_max), DOT_PRODUCT),
            ("dual numbers", over(DesignCheck::dual_max), DUAL),
            ("central differences", over(DesignCheck::central_difference_max), CENTRAL_DIFFERENCE),
        ]
        .map(|(comparison, error, goal)| Maximum { comparison, error, goal })
    }

    /// A row for each design and variable: the number of the design, the name of the variable, and its errors.
    pub fn rows(&self) -> impl Iterator<Item = (usize, &str, &VariableCheck)> {
        self.designs.iter().enumerate().flat_map(move |(number, check)| {
            check.variables.iter().map(move |row| (number, self.variables[row.variable].as_str(), row))
        })
    }

    /// Title of one design.
    pub fn title(&self, number: usize) -> String {
        let count = self.designs.len();
        match number {
            _ if self.given => "the design given".to_owned(),
            0 => format!("design 1 of {count}, the baseline"),
            _ => format!("design {} of {count}, far from the baseline", number + 1),
        }
    }
}

/// Tables of all designs, and whether the derivatives pass.
impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (number, check) in self.designs.iter().enumerate() {
            writeln!(f, "{}", self.title(number))?;
            table(f, &self.variables, check)?;
            writeln!(f)?;
        }
        for maximum @ Maximum { comparison, error, goal } in self.maxima() {
            let verdict = if maximum.passes() { "passes" } else { "DOES NOT PASS" };
            writeln!(f, "{comparison:<20} largest error {error:.1e}, goal {goal:.0e}: {verdict}")?;
        }
        Ok(())
    }
}

fn table(f: &mut fmt::Formatter<'_>, variables: &[String], check: &DesignCheck) -> fmt::Result {
    for dot in &check.dot_products {
        writeln!(f, "  dot products, k = {:<3}  {:.1e}", dot.block, dot.error)?;
    }
    writeln!(f, "  values against dual numbers: {:.1e} of the length", check.values)?;
    /// Longer names stand out of their column: formats have a limit of their own for widths.
    const WIDEST: usize = 200;
    let name = |row: &VariableCheck| &variables[row.variable];
    let width = check.variables.iter().map(|row| name(row).len()).max().unwrap_or(0).clamp(8, WIDEST);
    writeln!(
        f,
        "  {:<width$}  |J v|/unit     dual  central difference  at step/range  first off at",
        "variable"
    )?;
    for row in &check.variables {
        let (step, error) = row.best().unwrap_or((f64::NAN, f64::INFINITY));
        let off = match row.first_off {
            Some(step) => format!("{} (vertex {} the most)", step.name(), row.worst_vertex),
            None => String::new(),
        };
        let line = format!(
            "  {:<width$}  {:>10.3e}  {:>7.1e}  {error:>18.1e}  {step:>13.0e}  {off}",
            name(row),
            row.size,
            row.dual,
        );
        writeln!(f, "{}", line.trim_end())?;
    }
    for (row, kink) in check.variables.iter().filter_map(|row| Some((row, row.kink.as_ref()?))) {
        writeln!(f, "  {}: {kink}", name(row))?;
    }
    Ok(())
}

/// One design of a whole check.
struct Part<'a> {
    observer: &'a dyn Observer,
    number: usize,
    count: usize,
}

impl Watch for Part<'_> {
    fn progress(&self, phase: Phase, fraction: f64) {
        // Approximate shares of the phases in the time.
        let (start, share, name) = match phase {
            Phase::DotProducts => (0.0, 0.1, "dot products"),
            Phase::DualNumbers => (0.1, 0.3, "dual numbers"),
            Phase::Differences => (0.4, 0.6, "central differences"),
        };
        let done = (self.number as f64 + start + share * fraction) / self.count as f64;
        self.observer.progress(done, &format!("design {} of {}: {name}", self.number + 1, self.count));
    }

    fn cancelled(&self) -> bool {
        self.observer.cancelled()
    }
}
