//! `moldline`: the server, and the same engine on local files.

use std::process::ExitCode;

use clap::Parser;

#[cfg(test)]
mod access_tests;
mod bar;
mod check;
mod config;
mod convert;
mod grpc;
mod http;
mod local;
mod mesh;
mod panel;
mod plot;
mod serve;
mod shell;
mod shutdown;
mod status;
mod store;
mod table;
mod telemetry;
#[cfg(test)]
mod testing;
mod token;

use config::{Cli, Command, Panel};

fn main() -> ExitCode {
    let cli = Cli::parse();
    let _traces = telemetry::start(&cli.telemetry);
    let outcome = match cli.command {
        Command::Serve(options) => serve::run(&options),
        Command::Panel(Panel::Serve(options)) => panel::serve::run(&options),
        Command::Panel(Panel::Analyze(options)) => panel::local::analyze(&options),
        Command::Status(options) => status::run(&options).map_err(Into::into),
        Command::Token(options) => token::run(&options).map_err(Into::into),
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
