//! Running other programs.

use std::{
    env,
    ffi::OsStr,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::Instant,
};

/// The result of a command; the error is a message for the terminal.
pub type Outcome<T = ()> = Result<T, String>;

/// The repository's root.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap_or(Path::new("."))
}

/// The cargo that runs this program.
pub fn cargo() -> Command {
    let mut cargo = command(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    // Without the variables that describe this package: build scripts depend on them, and much would be rebuilt whenever this
    // program and its user call cargo in turn.
    let of_package = |name: &str| name.starts_with("CARGO_PKG_") || name.starts_with("CARGO_MANIFEST_");
    for (name, _) in env::vars_os().filter(|(name, _)| name.to_str().is_some_and(of_package)) {
        cargo.env_remove(name);
    }
    cargo
}

/// A program, run in the repository's root.
pub fn command(program: impl AsRef<OsStr>) -> Command {
    let mut command = Command::new(program);
    command.current_dir(root()).stdin(Stdio::null());
    command
}

/// Runs a program to its end, under a headline.
pub fn run(title: &str, command: &mut Command) -> Outcome {
    eprintln!("\n==> {title}");
    let start = Instant::now();
    let status =
        command.status().map_err(|error| format!("{title}: cannot run {}: {error}", show(command)))?;
    if status.success() {
        eprintln!("    {title}: done in {:.1} s", start.elapsed().as_secs_f64());
        Ok(())
    } else {
        Err(format!("{title} failed ({status}): {}", show(command)))
    }
}

/// Builds the `moldline` program in the given profile and gives its path.
pub fn build_moldline(release: bool) -> Outcome<PathBuf> {
    eprintln!("\n==> build moldline");
    let mut command = cargo();
    // For the whole workspace, so that dependencies have the same features as in the tests and are built once.
    command.args(["build", "--locked", "--workspace", "--bin", "moldline"]);
    command.args(["--message-format", "json-render-diagnostics"]);
    if release {
        command.arg("--release");
    }
    let output = command
        .stderr(Stdio::inherit())
        .output()
        .map_err(|error| format!("cannot run {}: {error}", show(&command)))?;
    if !output.status.success() {
        return Err(format!("moldline does not build ({}); the messages above say why", output.status));
    }
    String::from_utf8_lossy(&output.stdout)
        .lines()
        .filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok())
        .filter(|message| message["target"]["name"] == "moldline")
        .find_map(|message| message["executable"].as_str().map(PathBuf::from))
        .ok_or_else(|| "cargo did not report the path of the program".to_owned())
}

fn show(command: &Command) -> String {
    let parts = std::iter::once(command.get_program()).chain(command.get_args());
    parts.map(|part| part.to_string_lossy().into_owned()).collect::<Vec<_>>().join(" ")
}
