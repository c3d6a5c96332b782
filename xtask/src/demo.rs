//! The scripts: demonstration, figures, study, validation and torture trials.

use std::path::PathBuf;

use crate::{
    process::{Outcome, build_moldline, root, run},
    python::Python,
};

/// Serves, uploads, deforms, reports: `xtask/scripts/demo/demo.py` against the release build.
pub fn demo(pictures: bool) -> Outcome {
    let python = Python::ready()?;
    let binary = build_moldline(true)?;
    let mut script = python.script("xtask/scripts/demo/demo.py");
    script.arg("--binary").arg(binary).arg("--out").arg(root().join("out/demo"));
    if !pictures {
        script.arg("--no-pictures");
    }
    run("demo", &mut script)
}

/// The fuel-burn study: `examples/e175/study/study.py` against the release build, with the caller's arguments.
pub fn study(arguments: &[String]) -> Outcome {
    let python = Python::ready()?;
    let binary = build_moldline(true)?;
    let mut script = python.script("examples/e175/study/study.py");
    script.arg("--binary").arg(binary).arg("--out").arg(root().join("out/study")).args(arguments);
    run("study", &mut script)
}

/// Validation of the panel method on known flows: `xtask/scripts/panel/validate.py` against the release build; writes docs/validation.md.
pub fn validate_panel() -> Outcome {
    let python = Python::ready()?;
    let binary = build_moldline(true)?;
    let mut script = python.script("xtask/scripts/panel/validate.py");
    script.arg("--binary").arg(binary).arg("--out").arg(root().join("out/panel"));
    run("validation of the panel method", script.arg("--docs").arg(root().join("docs")))
}

/// Torture trials (kills, load, full disks, two servers): `tests/torture/torture.py` against the release build.
pub fn torture(short: bool, only: &[String]) -> Outcome {
    let python = Python::ready()?;
    let binary = build_moldline(true)?;
    trials(&python, "torture", binary, short, only)
}

/// Attacks (silent connections, floods, bombs, greedy tenants): `tests/attack/attack.py` against the release build.
pub fn attack(short: bool, only: &[String]) -> Outcome {
    let python = Python::ready()?;
    let binary = build_moldline(true)?;
    trials(&python, "attack", binary, short, only)
}

/// Runs `tests/NAME/NAME.py`, which writes its figures to `out/NAME.json`.
fn trials(python: &Python, name: &str, binary: PathBuf, short: bool, only: &[String]) -> Outcome {
    let mut script = python.script(&format!("tests/{name}/{name}.py"));
    script.arg("--binary").arg(binary).arg("--out").arg(root().join(format!("out/{name}.json")));
    if short {
        script.arg("--short");
    }
    script.args(only.iter().flat_map(|trial| ["--only", trial.as_str()]));
    run(name, &mut script)
}

/// The fillet against rho (Fig. 5 of the paper).
pub fn figures(large: Option<PathBuf>) -> Outcome {
    let python = Python::ready()?;
    let folder = large_mesh(&python, large)?;
    let binary = build_moldline(true)?;
    let mut script = python.script("xtask/scripts/demo/figures.py");
    script.arg("--binary").arg(binary).arg("--mesh").arg(folder);
    run("figures", script.arg("--out").arg(root().join("docs/images")))
}

/// Folder of the mesh of about 100,000 cells: the one given, or `out/e175-100k`, made if it is missing.
pub fn large_mesh(python: &Python, given: Option<PathBuf>) -> Outcome<PathBuf> {
    if let Some(folder) = given {
        let folder =
            std::path::absolute(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
        return match folder.join("mesh.msh").is_file() {
            true => Ok(folder),
            false => Err(format!("there is no mesh.msh in {}", folder.display())),
        };
    }
    let folder = root().join("out/e175-100k");
    // The report is written last: if it exists, the mesh is complete.
    if !folder.join("report.json").is_file() {
        python.with_meshing()?;
        let mut script = python.script("examples/e175/make.py");
        script.args(["--cells", "100000", "--verbose", "--out"]).arg(&folder);
        run("mesh of 100,000 cells (several minutes)", &mut script)?;
    }
    Ok(folder)
}
