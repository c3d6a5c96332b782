//! `moldline check`: whether the derivatives of a set-up are right, and if not, at which step of the chain they go wrong.

use std::{num::NonZeroUsize, path::PathBuf, sync::Arc};

use clap::Args;
use moldline_check::{Designs, Observer, Report, Request};
use serde_json::{Map, Value, json};

use crate::{
    bar::Bar,
    failure::Failure,
    local::{self, Source},
    output::{say, write_with_folder},
};

/// Options of `moldline check`.
#[derive(Debug, Args)]
pub struct CheckOptions {
    /// The set-up.
    #[command(flatten)]
    pub source: Source,
    /// Number of designs: the baseline, then random ones far from it
    #[arg(long, value_name = "N", default_value_t = NonZeroUsize::MIN, conflicts_with = "design")]
    pub designs: NonZeroUsize,
    /// Seed of the random designs and vectors
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// File with the design to check instead, as JSON: an object of names and values, or an array of all values in order
    #[arg(long, alias = "design-file", value_name = "FILE")]
    pub design: Option<PathBuf>,
    /// Variables to compare with dual numbers and differences, by name or by the name of an array of them [default: all]
    #[arg(long, value_delimiter = ',', value_name = "NAME,...")]
    pub variables: Vec<String>,
    /// Write all errors to this JSON file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Plot the errors against the step of the differences into this folder, a PNG for each design
    #[arg(long, value_name = "FOLDER")]
    pub plots: Option<PathBuf>,
}

/// `moldline check`
pub fn run(options: &CheckOptions) -> Result<(), Failure> {
    #[cfg(not(feature = "plot"))]
    if options.plots.is_some() {
        return Err(Failure::NoPlots);
    }
    let pool = local::pool(&options.source)?;
    let setup = Arc::new(pool.install(|| local::build(&options.source))?);
    let designs = match &options.design {
        Some(path) => Designs::Given(local::design_file(path, &setup)?),
        None => Designs::Number(options.designs.get()),
    };
    let request = Request { designs, seed: options.seed, variables: options.variables.clone() };
    let report = pool.install(|| Report::new(&setup, &request, &Bar::new()))?;

    say(&format_args!("{}", report.to_string().trim_end()))?;
    if let Some(path) = &options.json {
        write_with_folder(path, format!("{:#}\n", document(&report)).as_bytes())?;
        say(&format_args!("wrote {}", path.display()))?;
    }
    #[cfg(feature = "plot")]
    if let Some(folder) = &options.plots {
        let groups = setup.parameterisation().groups();
        for (number, check) in report.designs.iter().enumerate() {
            let path = folder.join(format!("plateau-{}.png", number + 1));
            write_with_folder(&path, &crate::plot::plateau(&report.title(number), groups, check)?)?;
            say(&format_args!("wrote {}", path.display()))?;
        }
    }
    let maxima = report.maxima();
    let off: Vec<&str> = maxima.iter().filter(|m| !m.passes()).map(|m| m.comparison).collect();
    if off.is_empty() { Ok(()) } else { Err(Failure::Derivatives(off.join(", "))) }
}

impl Observer for Bar {
    fn progress(&self, fraction: f64, at: &str) {
        self.tell(at.to_owned(), fraction);
    }

    fn cancelled(&self) -> bool {
        false
    }
}

/// The report as JSON, with a row for each design and variable.
fn document(report: &Report) -> Value {
    let designs: Vec<Value> = report
        .designs
        .iter()
        .map(|check| {
            let values: Map<String, Value> = report
                .variables
                .iter()
                .zip(&check.design)
                .map(|(name, x)| (name.clone(), json!(x)))
                .collect();
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
    let rows: Vec<Value> = report
        .rows()
        .map(|(number, variable, row)| {
            let best = row.best();
            let stages: Map<String, Value> =
                row.steps.iter().map(|(step, error)| (step.name().to_owned(), json!(error))).collect();
            let differences: Vec<Value> =
                row.differences.iter().map(|d| json!({ "step": d.step, "error": d.error })).collect();
            json!({
                "design": number,
                "variable": variable,
                "size": row.size,
                "dual": row.dual,
                "worst_vertex": row.worst_vertex,
                "stages": stages,
                "first_discrepancy": row.first_off.map(|step| step.name()),
                "central_difference": best.map(|(_, error)| error),
                "best_step": best.map(|(step, _)| step),
                "functions": row.functions,
                "differences": differences,
                "kink": row.kink.as_ref().map(|kink| json!({
                    "vertices": kink.vertices.len(),
                    "worst_vertex": kink.worst,
                    "jump": kink.jump,
                    "position": kink.position,
                    "component": kink.component,
                    "error": kink.error,
                })),
            })
        })
        .collect();
    let [dot_products, dual, central] = report.maxima().map(|maximum| maximum.error);
    json!({
        "definition": Report::DEFINITION,
        "seed": report.seed,
        "dot_product_max": dot_products,
        "dual_max": dual,
        "central_difference_max": central,
        "designs": designs,
        "rows": rows,
    })
}
