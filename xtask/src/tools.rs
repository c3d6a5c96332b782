//! Programs from crates.io that the commands run, installed into `target/tools`.

use std::path::PathBuf;

use crate::process::{Outcome, cargo, root, run};

/// A program of crates.io, in the version that the commands are written for.
#[derive(Debug, Clone, Copy)]
pub struct Tool {
    name: &'static str,
    version: &'static str,
}

/// Licences, sources and banned crates among the dependencies.
pub const DENY: Tool = Tool { name: "cargo-deny", version: "0.20.2" };
/// Dependencies that a crate declares and does not use.
pub const MACHETE: Tool = Tool { name: "cargo-machete", version: "0.9.2" };
/// Builds and runs fuzz targets.
pub const FUZZ: Tool = Tool { name: "cargo-fuzz", version: "0.13.2" };

impl Tool {
    /// Path of the program if it is installed.
    pub fn installed(self) -> Option<PathBuf> {
        Some(self.path()).filter(|path| path.is_file())
    }

    /// Path of the program, which is installed now if it was not.
    pub fn ready(self) -> Outcome<PathBuf> {
        if let Some(path) = self.installed() {
            return Ok(path);
        }
        let Self { name, version } = self;
        let mut install = cargo();
        // Unoptimised, for they build longer than they run.
        install.args(["install", name, "--version", version, "--locked", "--debug", "--root"]);
        install.arg(self.folder()).env("CARGO_PROFILE_DEV_DEBUG", "false");
        run(&format!("install {name} {version}"), &mut install)?;
        Ok(self.path())
    }

    fn folder(self) -> PathBuf {
        root().join("target/tools").join(format!("{}-{}", self.name, self.version))
    }

    fn path(self) -> PathBuf {
        self.folder().join("bin").join(format!("{}{}", self.name, std::env::consts::EXE_SUFFIX))
    }
}
