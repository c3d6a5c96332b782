//! Lints and tests.

use crate::{
    clients::Clients,
    demo, fuzz, links,
    process::{Outcome, build_moldline, cargo, command, run},
    python::Python,
    tools, wheel,
};

/// Seconds for each fuzz target in the long run.
const FUZZ_SECONDS: u64 = 60;

/// All lints, whatever it takes to install them.
pub fn lint() -> Outcome {
    let mut steps = Steps::default();
    lints(&Python::ready()?, &mut steps);
    steps.of(dependencies(true));
    steps.end()
}

/// What must hold before a change lands; with `all`, also what takes too long for every change: lints of dependencies, the
/// wheel, the demo, the torture trials and a minute of each fuzz target.
pub fn test(all: bool) -> Outcome {
    let python = Python::ready()?;
    let mut steps = Steps::default();
    lints(&python, &mut steps);
    steps.of(dependencies(all));
    // With an object store for the tests that use one.
    let mut tests = python.script("tests/e2e/seaweed.py");
    tests.arg(cargo().get_program()).args(["test", "--locked", "--workspace", "--no-fail-fast"]);
    steps.of(run("cargo test", &mut tests));
    steps.of(build_moldline(false).and_then(|binary| {
        let clients = Clients::built()?;
        // Without them the tests of gmsh's dialects say so and are left out.
        if let Err(message) = python.gmsh_libraries() {
            eprintln!("    {message}");
        }
        let mut pytest = python.module("pytest");
        pytest.args(["-q", "--durations=5", "tests/e2e", "xtask/scripts/demo", "examples/e175/study"]);
        pytest.env("MOLDLINE_BINARY", binary);
        run("pytest", clients.tell(&mut pytest))
    }));
    if all {
        steps.of(wheel::wheel());
        steps.of(demo::demo(true));
        steps.of(demo::torture(false, &[]));
        steps.of(fuzz::fuzz(FUZZ_SECONDS, &[]));
    }
    steps.end()
}

/// Steps that all run; failures are listed again at the end.
#[derive(Debug, Default)]
struct Steps {
    failures: Vec<String>,
}

impl Steps {
    fn of(&mut self, outcome: Outcome) {
        if let Err(message) = outcome {
            eprintln!("    {message}");
            self.failures.push(message);
        }
    }

    fn end(self) -> Outcome {
        if self.failures.is_empty() {
            eprintln!("\nall checks passed");
            return Ok(());
        }
        Err(format!("{} checks failed:\n  {}", self.failures.len(), self.failures.join("\n  ")))
    }
}

/// Format, compiler, documentation and spelling.
fn lints(python: &Python, steps: &mut Steps) {
    steps.of(run("cargo fmt --check", cargo().args(["fmt", "--all", "--check"])));
    let fuzz = ["fmt", "--manifest-path", "tests/fuzz/Cargo.toml", "--check"];
    steps.of(run("cargo fmt --check on the fuzz targets", cargo().args(fuzz)));
    let clippy = ["clippy", "--locked", "--workspace", "--all-targets", "--", "-D", "warnings"];
    steps.of(run("clippy", cargo().args(clippy)));
    let mut rustdoc = cargo();
    // Its readers work on the code: private items are documented, and may be linked.
    rustdoc.args(["doc", "--locked", "--workspace", "--no-deps", "--document-private-items"]);
    rustdoc.env("RUSTDOCFLAGS", "-D warnings -A rustdoc::private_intra_doc_links");
    steps.of(run("rustdoc", &mut rustdoc));
    steps.of(run("ruff check", python.module("ruff").args(["check", "--quiet"])));
    steps.of(run("ruff format --check", python.module("ruff").args(["format", "--check", "--quiet"])));
    let client = ["--config-file", "client/python/pyproject.toml", "client/python/src/moldline"];
    steps.of(run("mypy on the client", python.module("mypy").args(client)));
    steps.of(run("typos", &mut command(python.program("typos"))));
    steps.of(links::check());
}

/// Licences, sources and uses of the crates that this one is built from. Installing the tools takes a minute: unless `install`
/// is set, the lint is left out where they are missing.
fn dependencies(install: bool) -> Outcome {
    let ready = |tool: tools::Tool| if install { tool.ready().map(Some) } else { Ok(tool.installed()) };
    if let Some(deny) = ready(tools::DENY)? {
        run("cargo deny", command(deny).args(["--locked", "check", "bans", "licenses", "sources"]))?;
    }
    if let Some(machete) = ready(tools::MACHETE)? {
        run("cargo machete", &mut command(machete))?;
    }
    Ok(())
}
