//! The repository's own commands: `cargo xtask demo | figures | study | validate-panel | test | lint | clients | wheel | bench
//! | torture | attack | fuzz`.
//!
//! They need only Rust, a C compiler and Python >= 3.11. Everything else comes from crates.io and PyPI, into `target/`, except
//! the libraries of the C++ client, which come from the distribution.

mod bench;
mod check;
mod clients;
mod demo;
mod fuzz;
mod links;
mod packages;
mod process;
mod python;
mod tools;
mod wheel;

use std::{path::PathBuf, process::ExitCode};

use clap::{Parser, Subcommand};

/// Commands for people who work on Moldline.
#[derive(Debug, Parser)]
#[command(name = "cargo xtask")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Deform the E175 through a real server; report, meshes and pictures go to out/demo
    Demo {
        /// Leave out the pictures
        #[arg(long)]
        no_pictures: bool,
    },
    /// Draw the fillet against rho on the 100,000-cell mesh into docs/images (makes the mesh with gmsh if it is missing)
    Figures {
        /// Set-up folder of the fine mesh: mesh.msh and geometry/ [default: out/e175-100k, made if missing]
        #[arg(long)]
        large: Option<PathBuf>,
    },
    /// Run the fuel-burn study of the E175 on both services; report, records and pictures go to out/study
    Study {
        /// Arguments of the script, such as --resume, --coarse, --check; see examples/e175/study/study.py
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Validate the panel method on known flows; numbers and pictures go to out/panel, the page to docs/validation.md
    ValidatePanel,
    /// Run what a change must pass: lints, all Rust tests, all Python tests
    Test {
        /// Also the long checks: lints of dependencies, demo, torture and a minute of each fuzz target (about an hour)
        #[arg(long)]
        all: bool,
    },
    /// Check formatting, clippy, rustdoc, licences and uses of dependencies, Python lints and types, spelling, links of documents
    Lint,
    /// Build the Rust and C++ clients with their examples and test drivers; installs gRPC for C++ where it can
    Clients,
    /// Build the Python package with the stripped server in it into target/wheels, and deform a mesh with it in an empty
    /// environment
    Wheel,
    /// Run the benchmarks behind the goals, beside scipy; numbers go to out/bench.json
    Bench {
        /// Also on the mesh of about 100,000 cells, made with gmsh if it is missing
        #[arg(long)]
        large: bool,
        /// Set-up folder of that mesh: mesh.msh and geometry/
        #[arg(long, requires = "large")]
        large_folder: Option<PathBuf>,
    },
    /// Kill, overload and starve servers, spoil their disks, move sessions between two; figures go to out/torture.json
    Torture {
        /// Smaller trials: three minutes at most
        #[arg(long)]
        short: bool,
        /// Run only this trial, such as `kill`; may be repeated
        #[arg(long, value_name = "TRIAL")]
        only: Vec<String>,
    },
    /// Attack a server: connections, memory, tenants, drains; figures go to out/attack.json
    Attack {
        /// Less of everything: two minutes at most
        #[arg(long)]
        short: bool,
        /// Run only this attack, such as `bodies`; may be repeated
        #[arg(long, value_name = "ATTACK")]
        only: Vec<String>,
    },
    /// Fuzz the readers of set-ups, meshes, archives and request bodies with cargo-fuzz, which is installed if missing
    Fuzz {
        /// Seconds for each target
        #[arg(long, default_value_t = 600)]
        seconds: u64,
        /// Run only these: setup, mesh, archive, body
        #[arg(value_name = "TARGET")]
        only: Vec<String>,
    },
}

fn main() -> ExitCode {
    let outcome = match Cli::parse().command {
        Command::Demo { no_pictures } => demo::demo(!no_pictures),
        Command::Figures { large } => demo::figures(large),
        Command::Study { arguments } => demo::study(&arguments),
        Command::ValidatePanel => demo::validate_panel(),
        Command::Test { all } => check::test(all),
        Command::Lint => check::lint(),
        Command::Clients => clients::Clients::built().map(drop),
        Command::Wheel => wheel::wheel(),
        Command::Bench { large, large_folder } => bench::bench(large, large_folder),
        Command::Torture { short, only } => demo::torture(short, &only),
        Command::Attack { short, only } => demo::attack(short, &only),
        Command::Fuzz { seconds, only } => fuzz::fuzz(seconds, &only),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("\nerror: {message}");
            ExitCode::FAILURE
        }
    }
}
