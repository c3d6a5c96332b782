//! The command line: the commands. The options of a command are beside it.

use clap::{Args, CommandFactory, Parser, Subcommand};

#[cfg(feature = "plot")]
use crate::draw::PlotOptions;
use crate::{
    check::CheckOptions,
    deform::DeformOptions,
    failure::Failure,
    import::ImportCommand,
    mesh::MeshOptions,
    output::say,
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
    /// Deform the mesh of a set-up on this machine and write it as VTU, MSH or STL
    Deform(DeformOptions),
    /// Draw the mesh of a file or set-up as a PNG picture, coloured by the aspect ratio of its cells
    #[cfg(feature = "plot")]
    Plot(PlotOptions),
    /// Make a set-up of an aircraft file: STEP or IGES, untrimmed
    Import(ImportCommand),
    /// Mesh the union of a set-up's components
    Mesh(MeshOptions),
    /// Build a set-up on this machine and print its report
    Setup(SetupOptions),
    /// Check the derivatives of a set-up against their transposes, dual numbers and central differences
    Check(CheckOptions),
    /// Print the JSON Schema of set-up or geometry files
    Schema(SchemaOptions),
    /// Print a script that completes commands and options in a shell
    Completions(CompletionOptions),
    /// Maintain a store of set-ups and sessions
    #[command(subcommand)]
    Store(StoreCommand),
}

/// Options of `moldline completions`.
#[derive(Debug, Args)]
pub struct CompletionOptions {
    /// The shell
    pub shell: clap_complete::Shell,
}

/// `moldline completions`
pub(crate) fn completions(options: &CompletionOptions) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(options.shell, &mut Cli::command(), "moldline", &mut script);
    say(&String::from_utf8_lossy(&script))
}

/// Commands of the panel method.
#[derive(Debug, Subcommand)]
pub enum PanelCommand {
    /// Serve analyses and their derivatives over gRPC and HTTP
    Serve(PanelServeOptions),
    /// Analyse the flow over a mesh on this machine
    Analyze(AnalyzeOptions),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
