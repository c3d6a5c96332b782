//! `moldline setup` and `moldline schema`: the report of a set-up, and the format of its files.

use clap::{Args, ValueEnum};
use moldline_deform::Setup;
use moldline_parameterisation::{Group, Variable};
use serde_json::{Value, json};

use crate::{
    failure::Failure,
    local::{self, Source},
    output::say,
    table,
};

/// Options of `moldline setup`.
#[derive(Debug, Args)]
pub struct SetupOptions {
    /// The set-up.
    #[command(flatten)]
    pub source: Source,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Options of `moldline schema`.
#[derive(Debug, Args)]
pub struct SchemaOptions {
    /// Format to describe
    #[arg(default_value = "setup")]
    pub document: Document,
}

/// Documents of the set-up format.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Document {
    /// `setup.toml` and `setup.json`
    Setup,
    /// Geometry files
    Geometry,
}

/// `moldline setup`
pub fn report(options: &SetupOptions) -> Result<(), Failure> {
    let setup = local::pool(&options.source)?.install(|| local::build(&options.source))?;
    if options.json {
        let mut report = moldline_setup_files::report_json(setup.report());
        report["variables"] = variables(&setup);
        report["functions"] = functions(&setup);
        return say(&format_args!("{report:#}"));
    }
    say(setup.report())?;
    let groups = setup.parameterisation().groups();
    if !groups.is_empty() {
        say(&"\nvariables")?;
        let head = ["name", "shape", "baseline", "lower", "upper", "unit"].map(str::to_owned);
        let rows = groups.iter().map(|group| {
            let of = &setup.parameterisation().variables()[group.range.clone()];
            let range = |value: fn(&Variable) -> f64| values(of.iter().map(value));
            [
                group.name.clone(),
                shape(&group.shape),
                range(|v| v.baseline),
                range(|v| v.lower),
                range(|v| v.upper),
                of.first().map_or("", |v| v.unit.symbol()).to_owned(),
            ]
        });
        let rows: Vec<_> = std::iter::once(head).chain(rows).collect();
        say(&table::render(&rows).trim_end())?;
    }
    say(&"\nfunctions")?;
    let functions = setup.functions().iter().zip(setup.reference_functions());
    let rows: Vec<_> =
        functions.map(|(f, value)| [f.name.clone(), format!("{value:.6}"), f.unit.to_owned()]).collect();
    say(&table::render(&rows).trim_end())
}

/// Extents, such as `3 x 2`; nothing for a single number.
fn shape(extents: &[usize]) -> String {
    extents.iter().map(usize::to_string).collect::<Vec<_>>().join(" x ")
}

/// The value that all have, or the least and the largest.
fn values(values: impl Iterator<Item = f64>) -> String {
    let (low, high) = values
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    if low == high { low.to_string() } else { format!("{low} .. {high}") }
}

/// Every group of variables with its values. JSON has no infinity: a bound that is missing is null.
fn variables(setup: &Setup) -> Value {
    let of = |group: &Group| {
        let variables = &setup.parameterisation().variables()[group.range.clone()];
        let list = |value: fn(&Variable) -> f64| variables.iter().map(value).collect::<Vec<f64>>();
        json!({
            "name": group.name,
            "shape": group.shape,
            "unit": variables.first().map_or("", |v| v.unit.symbol()),
            "baseline": list(|v| v.baseline),
            "lower": list(|v| v.lower),
            "upper": list(|v| v.upper),
        })
    };
    setup.parameterisation().groups().iter().map(of).collect()
}

/// The functions with their values for the reference mesh.
fn functions(setup: &Setup) -> Value {
    let functions = setup.functions().iter().zip(setup.reference_functions());
    functions.map(|(f, value)| json!({ "name": f.name, "value": value, "unit": f.unit })).collect()
}

/// `moldline schema`
pub fn schema(options: &SchemaOptions) -> Result<(), Failure> {
    let schema = match options.document {
        Document::Setup => moldline_setup_files::setup_schema(),
        Document::Geometry => moldline_setup_files::geometry_schema(),
    };
    say(&format_args!("{schema:#}"))
}
