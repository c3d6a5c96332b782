//! `moldline`: the services, and the same engines on local files.

use std::process::ExitCode;

use clap::Parser;
use moldline::{cli::Cli, telemetry};

fn main() -> ExitCode {
    let Cli { command, telemetry } = Cli::parse();
    let _traces = telemetry::start(&telemetry);
    match moldline::run(command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
