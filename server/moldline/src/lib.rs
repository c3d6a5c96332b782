//! The program `moldline`: services on a port, and the same engines on local files.
//!
//! Start reading at [`cli`], which has the commands. [`serve`] and [`panel::serve`] build the two services: `api` is a service in
//! messages of the protocol, `convert` has the meaning of these messages, and `grpc` and `http` are the transports.
//! [`shell`] puts a service on a port.

mod api;
mod bar;
mod check;
pub mod cli;
mod convert;
mod deform;
#[cfg(feature = "plot")]
mod draw;
mod failure;
mod grpc;
mod http;
mod import;
mod local;
mod machine;
mod mesh;
mod output;
pub mod panel;
#[cfg(feature = "plot")]
mod picture;
#[cfg(feature = "plot")]
mod plot;
pub mod quotas;
pub mod serve;
mod setup;
pub mod shell;
mod shutdown;
mod status;
mod store;
mod table;
pub mod telemetry;
mod token;
mod values;

pub use failure::Failure;

use cli::{Command, PanelCommand};

/// Runs a command.
///
/// # Errors
/// If it fails, in words for the user.
pub fn run(command: Command) -> Result<(), Failure> {
    match command {
        Command::Serve(options) => serve::run(&options),
        Command::Panel(PanelCommand::Serve(options)) => panel::serve::run(&options),
        Command::Panel(PanelCommand::Analyze(options)) => panel::analyze::run(&options),
        Command::Status(options) => Ok(status::run(&options)?),
        Command::Token(options) => Ok(token::run(&options)?),
        Command::Deform(options) => deform::run(&options),
        #[cfg(feature = "plot")]
        Command::Plot(options) => draw::run(&options),
        Command::Import(options) => import::run(&options),
        Command::Mesh(options) => mesh::run(&options),
        Command::Setup(options) => setup::report(&options),
        Command::Check(options) => check::run(&options),
        Command::Schema(options) => setup::schema(&options),
        Command::Completions(options) => cli::completions(&options),
        Command::Store(options) => store::run(&options),
    }
}
