//! `moldline check`: are the derivatives right, and if not, where do they go wrong?

use std::sync::Arc;

use moldline_check::{
    Chain, CheckError, CheckOptions, DesignCheck, Phase, Watch, check_design, designs, largest,
};
use moldline_deform::{Setup, Silent};
use serde_json::{Value, json};

use crate::{
    bar::Bar,
    config,
    local::{self, Failure, say},
    plot,
};

/// Errors up to which the derivatives pass.
const DOT_PRODUCT: f64 = 1e-12;
const DUAL: f64 = 1e-10;
const CENTRAL_DIFFERENCE: f64 = 1e-6;

/// `moldline check`
pub fn run(options: &config::Check) -> Result<(), Failure> {
    let pool = local::pool(&options.source)?;
    let setup = Arc::new(pool.install(|| local::build(&options.source))?);
    let check_options = CheckOptions { variables: variables(options, &setup)?, ..all(&setup, options.seed) };
    let checks = pool.install(|| all_designs(options, &setup, &check_options))?;

    for (number, check) in checks.iter().enumerate() {
        say(&table(&setup, &title(options, number, checks.len()), check))?;
    }
    let maxima = [
        ("dot products", largest(checks.iter().map(DesignCheck::dot_product_max)), DOT_PRODUCT),
        ("dual numbers", largest(checks.iter().map(DesignCheck::dual_max)), DUAL),
        (
            "central differences",
            largest(checks.iter().map(DesignCheck::central_difference_max)),
            CENTRAL_DIFFERENCE,
        ),
    ];
    for (name, error, goal) in maxima {
        let verdict = if error <= goal { "passes" } else { "DOES NOT PASS" };
        say(&format_args!("{name:<20} largest error {error:.1e}, goal {goal:.0e}: {verdict}"))?;
    }
    if let Some(path) = &options.json {
        local::write_with_folder(
            path,
            format!("{:#}\n", document(&setup, &check_options, &checks)).as_bytes(),
        )?;
        say(&format_args!("wrote {}", path.display()))?;
    }
    if let Some(folder) = &options.plots {
        for (number, check) in checks.iter().enumerate() {
            let path = folder.join(format!("plateau-{}.png", number + 1));
            let title = title(options, number, checks.len());
            local::write_with_folder(
                &path,
                &plot::plateau(&title, setup.parameterisation().groups(), check)?,
            )?;
            say(&format_args!("wrote {}", path.display()))?;
        }
    }
    let off: Vec<&str> = maxima
        .iter()
        .filter(|(_, error, goal)| error.is_nan() || error > goal)
        .map(|(name, ..)| *name)
        .collect();
    if off.is_empty() { Ok(()) } else { Err(Failure::Derivatives(off.join(", "))) }
}

fn all(setup: &Setup, seed: u64) -> CheckOptions {
    CheckOptions { seed, ..CheckOptions::all(setup.parameterisation().variables().len()) }
}

/// Indices of the variables asked for: names of scalars or of arrays.
fn variables(options: &config::Check, setup: &Setup) -> Result<Vec<usize>, Failure> {
    let parameterisation = setup.parameterisation();
    if options.variables.is_empty() {
        return Ok((0..parameterisation.variables().len()).collect());
    }
    let mut indices = Vec::new();
    for name in &options.variables {
        match parameterisation.groups().iter().find(|g| g.name == *name) {
            Some(group) => indices.extend(group.range.clone()),
            None => {
                indices.push(parameterisation.index(name).map_err(|error| Failure::Refused(error.into()))?);
            }
        }
    }
    indices.sort_unstable();
    indices.dedup();
    Ok(indices)
}

fn all_designs(
    options: &config::Check,
    setup: &Arc<Setup>,
    check_options: &CheckOptions,
) -> Result<Vec<DesignCheck>, Failure> {
    let bar = Bar::new();
    bar.tell("looking for designs".to_owned(), 0.0);
    let count = options.designs.get();
    let designs = match &options.design {
        Some(path) => vec![local::design_file(path, setup)?],
        None => designs(setup, &**setup, count, options.seed, &Progress { bar: &bar, number: 0, count })?,
    };
    let chain = Chain::new(setup);
    let mut checks = Vec::with_capacity(designs.len());
    for (number, design) in designs.iter().enumerate() {
        let watch = Progress { bar: &bar, number: number + 1, count: designs.len() };
        let linear = setup.linearise(design, &Silent).map_err(CheckError::from)?;
        checks.push(check_design(setup, &chain, &linear, &**setup, design, check_options, &watch)?);
    }
    Ok(checks)
}

struct Progress<'a> {
    bar: &'a Bar,
    number: usize,
    count: usize,
}

impl Watch for Progress<'_> {
    fn progress(&self, phase: Phase, fraction: f64) {
        let phase = match phase {
            Phase::DotProducts => "dot products",
            Phase::DualNumbers => "dual numbers",
            Phase::Differences => "central differences",
        };
        self.bar.tell(format!("design {} of {}: {phase}", self.number, self.count), fraction);
    }
}

fn title(options: &config::Check, number: usize, count: usize) -> String {
    match (&options.design, number) {
        (Some(path), _) => format!("design {}", path.display()),
        (None, 0) => format!("design 1 of {count}, the baseline"),
        (None, _) => format!("design {} of {count}, far from the baseline", number + 1),
    }
}

fn table(setup: &Setup, title: &str, check: &DesignCheck) -> String {
    let variables = setup.parameterisation().variables();
    let mut text = format!("{title}\n");
    for dot in &check.dot_products {
        text += &format!("  dot products, k = {:<3}  {:.1e}\n", dot.block, dot.error);
    }
    text += &format!("  values against dual numbers: {:.1e} of the length\n", check.values);
    let name = |k: usize| &variables[k].name;
    let width = check.variables.iter().map(|v| name(v.variable).len()).max().unwrap_or(0).max(8);
    text += &format!(
        "  {:<width$}  |J v|/unit     dual  central difference  at step/range  first off at\n",
        "variable"
    );
    for row in &check.variables {
        let (step, error) = row.best().unwrap_or((f64::NAN, f64::INFINITY));
        let off = match row.first_off {
            Some(step) => format!("{} (vertex {} the most)", step.name(), row.worst_vertex),
            None => String::new(),
        };
        let line = format!(
            "  {:<width$}  {:>10.3e}  {:>7.1e}  {:>18.1e}  {:>13.0e}  {off}",
            name(row.variable),
            row.size,
            row.dual,
            error,
            step
        );
        text += line.trim_end();
        text.push('\n');
    }
    text
}

/// All errors, a row for each design and variable.
fn document(setup: &Setup, options: &CheckOptions, checks: &[DesignCheck]) -> Value {
    let variables = setup.parameterisation().variables();
    let designs: Vec<Value> = checks
        .iter()
        .map(|check| {
            let values: serde_json::Map<String, Value> =
                variables.iter().zip(&check.design).map(|(v, x)| (v.name.clone(), json!(x))).collect();
            let dots: Vec<Value> =
                check.dot_products.iter().map(|d| json!({ "block": d.block, "error": d.error })).collect();
            json!({
                "design": values,
                "dot_products": dots,
                "dot_product_max": check.dot_product_max(),
                "dual_max": check.dual_max(),
                "central_difference_max": check.central_difference_max(),
                "values_max": check.values,
            })
        })
        .collect();
    let rows: Vec<Value> = checks
        .iter()
        .enumerate()
        .flat_map(|(number, check)| check.variables.iter().map(move |row| (number, row)))
        .map(|(number, row)| {
            let best = row.best();
            let stages: serde_json::Map<String, Value> =
                row.steps.iter().map(|(step, error)| (step.name().to_owned(), json!(error))).collect();
            let differences: Vec<Value> =
                row.differences.iter().map(|d| json!({ "step": d.step, "error": d.error })).collect();
            json!({
                "design": number,
                "variable": variables[row.variable].name,
                "size": row.size,
                "dual": row.dual,
                "worst_vertex": row.worst_vertex,
                "stages": stages,
                "first_discrepancy": row.first_off.map(|step| step.name()),
                "central_difference": best.map(|(_, error)| error),
                "best_step": best.map(|(step, _)| step),
                "functions": row.functions,
                "differences": differences,
            })
        })
        .collect();
    json!({
        "definition": "relative errors: norm over all vertices of the difference, over that of the derivative; steps \
                       relative to the range of the variable",
        "seed": options.seed,
        "dot_product_max": largest(checks.iter().map(DesignCheck::dot_product_max)),
        "dual_max": largest(checks.iter().map(DesignCheck::dual_max)),
        "central_difference_max": largest(checks.iter().map(DesignCheck::central_difference_max)),
        "designs": designs,
        "rows": rows,
    })
}
