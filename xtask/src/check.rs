//! Lints and tests.

use crate::{
    clients::Clients,
    process::{Outcome, build_moldline, cargo, run},
    python::Python,
};

/// Formatting, clippy with every warning an error, documentation, Python types.
pub fn lint() -> Outcome {
    rust_lints()?;
    python_lints(&Python::ready()?)
}

fn rust_lints() -> Outcome {
    run("cargo fmt --check", cargo().args(["fmt", "--all", "--check"]))?;
    let clippy = ["clippy", "--locked", "--workspace", "--all-targets", "--", "-D", "warnings"];
    run("clippy", cargo().args(clippy))
}

fn python_lints(python: &Python) -> Outcome {
    run(
        "mypy on the client",
        python.module("mypy").args([
            "--config-file",
            "client/python/pyproject.toml",
            "client/python/src/moldline",
        ]),
    )
}

/// Everything that must hold before a change lands. All steps run; the first failure is reported at the end too.
pub fn test() -> Outcome {
    let python = Python::ready()?;
    let mut failures = Vec::new();
    let mut step = |outcome: Outcome| {
        if let Err(message) = outcome {
            eprintln!("    {message}");
            failures.push(message);
        }
    };
    step(rust_lints());
    step(python_lints(&python));
    // With an object store for those that use one.
    let mut tests = python.script("tests/e2e/seaweed.py");
    tests.arg(cargo().get_program()).args(["test", "--locked", "--workspace", "--no-fail-fast"]);
    step(run("cargo test", &mut tests));
    match build_moldline(false).and_then(|binary| Ok((binary, Clients::built()?))) {
        Ok((binary, clients)) => {
            let mut pytest = python.module("pytest");
            pytest.args(["-q", "--durations=5", "tests/e2e", "xtask/scripts/demo", "examples/e175/study"]);
            pytest.env("MOLDLINE_BINARY", binary);
            step(run("pytest", clients.tell(&mut pytest)));
        }
        Err(message) => step(Err(message)),
    }
    if failures.is_empty() {
        eprintln!("\nall checks passed");
        Ok(())
    } else {
        Err(format!("{} checks failed:\n  {}", failures.len(), failures.join("\n  ")))
    }
}
