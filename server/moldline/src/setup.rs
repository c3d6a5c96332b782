//! `moldline setup` and `moldline schema`: the report of a set-up, and the format of its files.

use clap::{Args, ValueEnum};

use crate::{
    failure::Failure,
    local::{self, Source},
    output::say,
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
        say(&format_args!("{:#}", moldline_setup_files::report_json(setup.report())))
    } else {
        say(setup.report())
    }
}

/// `moldline schema`
pub fn schema(options: &SchemaOptions) -> Result<(), Failure> {
    let schema = match options.document {
        Document::Setup => moldline_setup_files::setup_schema(),
        Document::Geometry => moldline_setup_files::geometry_schema(),
    };
    say(&format_args!("{schema:#}"))
}
