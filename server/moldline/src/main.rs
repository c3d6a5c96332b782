//! `moldline`: the server, and the same engine on local files.

use std::process::ExitCode;

use clap::Parser;

mod bar;
mod check;
mod config;
mod grpc;
mod local;
mod plot;
mod serve;
mod shutdown;
mod store;
mod telemetry;

use config::{Cli, Command};

fn main() -> ExitCode {
    let cli = Cli::parse();
    telemetry::start(&cli.telemetry);
    let outcome = match cli.command {
        Command::Serve(options) => serve::run(&options),
        Command::Deform(options) => local::deform(&options),
        Command::Setup(options) => local::setup(&options),
        Command::Check(options) => check::run(&options),
        Command::Schema(options) => local::schema(&options),
        Command::Store(options) => store::run(&options),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
