//! The command line: commands, and the parsers that their options share. The options of a command are beside it.

use std::{num::NonZeroUsize, time::Duration};

use clap::{Parser, Subcommand};

use crate::{
    check::CheckOptions,
    deform::DeformOptions,
    panel::{analyze::AnalyzeOptions, serve::PanelServeOptions},
    serve::ServeOptions,
    setup::{SchemaOptions, SetupOptions},
    status::StatusOptions,
    store::StoreCommand,
    telemetry::TelemetryOptions,
    token::TokenOptions,
};

/// Deforms surface meshes with their geometry.
#[derive(Debug, Parser)]
#[command(version, about)]
pub struct Cli {
    /// The command.
    #[command(subcommand)]
    pub command: Command,
    /// Logs and traces.
    #[command(flatten)]
    pub telemetry: TelemetryOptions,
}

/// Commands of the program.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Serve set-ups and sessions over gRPC and HTTP
    Serve(ServeOptions),
    /// Analyse the flow over a mesh with the panel method
    #[command(subcommand)]
    Panel(PanelCommand),
    /// Show the load of a server and what it holds
    Status(StatusOptions),
    /// Create, list and revoke the tokens that a server accepts
    Token(TokenOptions),
    /// Deform the mesh of a set-up on this machine and write it as VTU
    Deform(DeformOptions),
    /// Build a set-up on this machine and print its report
    Setup(SetupOptions),
    /// Check the derivatives of a set-up against their transposes, dual numbers and central differences
    Check(CheckOptions),
    /// Print the JSON Schema of set-up or geometry files
    Schema(SchemaOptions),
    /// Maintain a store of set-ups and sessions
    #[command(subcommand)]
    Store(StoreCommand),
}

/// Commands of the panel method.
#[derive(Debug, Subcommand)]
pub enum PanelCommand {
    /// Serve analyses and their derivatives over gRPC and HTTP
    Serve(PanelServeOptions),
    /// Analyse the flow over a mesh on this machine
    Analyze(AnalyzeOptions),
}

/// The number of threads given, or one per core.
pub(crate) fn threads(given: Option<NonZeroUsize>) -> usize {
    given.or_else(|| std::thread::available_parallelism().ok()).map_or(1, NonZeroUsize::get)
}

/// A number of seconds that a `Duration` can hold.
pub(crate) fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|error| format!("{error}"))?;
    Duration::try_from_secs_f64(value).map(|_| value).map_err(|error| error.to_string())
}

/// A duration with its units.
pub(crate) fn duration(text: &str) -> Result<Duration, String> {
    humantime::parse_duration(text).map_err(|error| {
        format!("{error}; expected a number and one of s, m, h and d, as in 90s, 30m, 24h or 7d")
    })
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn durations_have_a_unit() {
        for (text, seconds) in
            [("45s", 45), ("30m", 1800), ("24h", 86_400), ("7d", 604_800), ("1h 30m", 5400)]
        {
            assert_eq!(duration(text).unwrap(), Duration::from_secs(seconds), "{text}");
        }
        for text in ["24", "h", "-1h", "", "1.5.h", "999999999999999999999d"] {
            assert!(duration(text).unwrap_err().contains("24h"), "{text}");
        }
    }
}
