//! `moldline import`: an aircraft file of another program as a set-up folder.

use std::{fs, path::PathBuf};

use clap::{Args, ValueEnum};
use moldline_aircraft_files::{Import, ImportOptions, ImportStage, import};
use moldline_foundation::monitor::Monitor;

use crate::{
    bar::Bar,
    failure::Failure,
    output::{say, write_with_folder},
};

/// Options of `moldline import`.
#[derive(Debug, Args)]
pub struct ImportCommand {
    /// STEP or IGES file (.stp, .step, .igs, .iges); its content tells which
    pub file: PathBuf,
    /// Folder to write the set-up to
    #[arg(short, long, value_name = "FOLDER")]
    pub output: PathBuf,
    /// Unit of length of the file [default: what the file says]
    #[arg(long)]
    pub unit: Option<Unit>,
    /// Import these components only, by name or ID
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Leave out these components, by name or ID
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    pub skip: Vec<String>,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
    /// Replace the set-up file and geometry of an earlier import
    #[arg(long)]
    pub force: bool,
}

/// Units of length.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Unit {
    /// Metre
    M,
    /// Centimetre
    Cm,
    /// Millimetre
    Mm,
    /// Foot
    Ft,
    /// Inch
    In,
}

impl Unit {
    fn metres(self) -> f64 {
        match self {
            Self::M => 1.0,
            Self::Cm => 1e-2,
            Self::Mm => 1e-3,
            Self::Ft => 0.3048,
            Self::In => 0.0254,
        }
    }
}

/// `moldline import`
pub fn run(command: &ImportCommand) -> Result<(), Failure> {
    let ImportCommand { file, output, unit, only, skip, json, force } = command;
    if !force && output.join("setup.toml").exists() {
        return Err(Failure::Exists { path: output.join("setup.toml") });
    }
    let bytes = fs::read(file).map_err(|error| Failure::File { path: file.clone(), error })?;
    let options = ImportOptions {
        title: file.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        metres_per_unit: unit.map(Unit::metres),
        only: only.clone(),
        skip: skip.clone(),
        ..ImportOptions::default()
    };
    let imported = import(&bytes, &options, &Shown(Bar::new()));
    let Import { files, report } = imported.map_err(|error| Failure::Import { path: file.clone(), error })?;
    for (name, content) in &files {
        write_with_folder(&output.join(name), content)?;
    }
    if *json {
        let report = serde_json::to_value(&report).unwrap_or_default();
        return say(&format_args!("{report:#}"));
    }
    say(&report)?;
    say(&format_args!("wrote         {}; it wants a mesh, mesh.msh", output.display()))
}

/// Progress on the terminal.
struct Shown(Bar);

impl Monitor<ImportStage> for Shown {
    fn progress(&self, stage: ImportStage, fraction: f64) {
        let message = match stage {
            ImportStage::Reading => "reading the file",
            ImportStage::Assembly => "making closed components",
            ImportStage::Writing => "writing the set-up",
        };
        self.0.tell(message.to_owned(), fraction);
    }
}
