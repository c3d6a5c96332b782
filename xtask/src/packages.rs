//! Packages of the distribution, where they can be installed without a password.

use std::process::{Command, Stdio};

use crate::process::{Outcome, command, run};

/// Whether a command succeeds, whatever it prints.
pub fn succeeds(command: &mut Command) -> bool {
    command.stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok_and(|status| status.success())
}

/// Installs Debian packages. `why`: what does not work without them.
///
/// # Errors
/// With `why` and the command to give, if this user cannot install them.
pub fn install(packages: &[&str], why: &str) -> Outcome {
    let names = packages.join(" ");
    let is_root = command("id").arg("-u").output().is_ok_and(|output| output.stdout.trim_ascii() == b"0");
    if !is_root || !succeeds(command("apt-get").arg("--version")) {
        return Err(format!("{why}; install them (Debian: apt-get install {names})"));
    }
    let apt = || {
        let mut apt = command("apt-get");
        apt.args(["--quiet", "--yes"]).env("DEBIAN_FRONTEND", "noninteractive").stdout(Stdio::null());
        apt
    };
    run("package lists", apt().arg("update"))?;
    run(&names, apt().args(["install", "--no-install-recommends"]).args(packages))
}
