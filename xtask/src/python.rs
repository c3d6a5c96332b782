//! Python environments: the repository's, in `target/venv`, and empty ones.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use crate::{
    packages,
    process::{Outcome, command, root, run},
};

/// Oldest Python, as (major, minor).
const OLDEST: (u32, u32) = (3, 11);
/// Requirements of all scripts and tests, besides the client's own.
const REQUIREMENTS: [&str; 4] = [
    "xtask/scripts/demo/requirements.txt",
    "xtask/scripts/bench/requirements.txt",
    "examples/e175/study/requirements.txt",
    "tests/requirements.txt",
];
/// Requirements of the mesher, which only `figures` and `bench --large` run.
const MESHING: &str = "examples/e175/requirements.txt";

/// A virtual environment.
#[derive(Debug)]
pub struct Python {
    interpreter: PathBuf,
}

impl Python {
    /// The repository's environment, with the client and all requirements: made again if any of its ingredients has changed.
    pub fn ready() -> Outcome<Self> {
        let folder = root().join("target/venv");
        let stamp = folder.join("made-from");
        let (_, version) = interpreter()?;
        let wanted = ingredients(&version)?;
        let python = Self::below(&folder);
        if python.interpreter.exists() && fs::read_to_string(&stamp).is_ok_and(|made| made == wanted) {
            return Ok(python);
        }
        // From scratch: a half upgraded environment is worse than a minute lost.
        let python = Self::empty(&folder)?;
        let mut install = python.pip();
        install.args(["--editable", "client/python[test]"]);
        for file in REQUIREMENTS {
            install.args(["--requirement", file]);
        }
        run("client and requirements from PyPI", &mut install)?;
        fs::write(&stamp, wanted).map_err(|error| format!("cannot write {}: {error}", stamp.display()))?;
        Ok(python)
    }

    /// An environment with nothing in it, in the place of any that is there.
    pub fn empty(folder: &Path) -> Outcome<Self> {
        if folder.exists() {
            fs::remove_dir_all(folder)
                .map_err(|error| format!("cannot remove {}: {error}", folder.display()))?;
        }
        let (interpreter, version) = interpreter()?;
        let title = format!("Python environment in {} ({version})", folder.display());
        run(&title, command(interpreter).args(["-m", "venv"]).arg(folder))?;
        Ok(Self::below(folder))
    }

    fn below(folder: &Path) -> Self {
        Self { interpreter: folder.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" }) }
    }

    /// Installs the mesher (gmsh).
    pub fn with_meshing(&self) -> Outcome {
        run("gmsh from PyPI", self.pip().args(["--requirement", MESHING]))
    }

    /// Installs the libraries of the window system that gmsh loads, if it does not find them.
    ///
    /// # Errors
    /// If they are missing and this user cannot install them.
    pub fn gmsh_libraries(&self) -> Outcome {
        let mut probe = command(&self.interpreter);
        if packages::succeeds(probe.args(["-c", "import gmsh"])) {
            return Ok(());
        }
        packages::install(
            &["libglu1-mesa", "libxft2", "libxcursor1"],
            "gmsh does not load without libraries of X11",
        )
    }

    /// A command that runs a script with this environment's Python.
    pub fn script(&self, path: &str) -> Command {
        let mut command = command(&self.interpreter);
        command.arg(path);
        command
    }

    /// Path of a program that a package installs.
    pub fn program(&self, name: &str) -> PathBuf {
        self.interpreter.with_file_name(format!("{name}{}", env::consts::EXE_SUFFIX))
    }

    /// A command that runs a module with this environment's Python.
    pub fn module(&self, name: &str) -> Command {
        let mut command = command(&self.interpreter);
        command.args(["-m", name]);
        command
    }

    /// `pip install`.
    pub fn pip(&self) -> Command {
        let mut command = self.module("pip");
        command.args(["install", "--quiet", "--disable-pip-version-check", "--no-input"]);
        command
    }
}

/// The first Python that is new enough and can make environments, and its version. The variable `PYTHON` overrides the search.
fn interpreter() -> Outcome<(String, String)> {
    let named = env::var("PYTHON").ok();
    let usual = ["python3.11", "python3.12", "python3.13", "python3.14", "python3", "python"];
    let candidates: Vec<String> = match &named {
        Some(name) => vec![name.clone()],
        None => usual.map(str::to_owned).into(),
    };
    let mut seen = Vec::new();
    for name in candidates {
        let probe = "import sys; print(*sys.version_info[:3], sep='.')\ntry:\n import venv, ensurepip\nexcept ImportError: \
                     print('no venv')";
        let Ok(output) = command(&name).args(["-c", probe]).stderr(Stdio::null()).output() else { continue };
        if !output.status.success() {
            continue;
        }
        let text = String::from_utf8_lossy(&output.stdout);
        let mut lines = text.lines();
        let version = lines.next().unwrap_or_default().to_owned();
        let mut numbers = version.split('.').map(|part| part.parse().unwrap_or(0));
        if (numbers.next().unwrap_or(0), numbers.next().unwrap_or(0)) < OLDEST {
            seen.push(format!("{name} is {version}, which is too old"));
        } else if lines.next().is_some() {
            seen.push(format!("{name} ({version}) lacks the modules venv and ensurepip (Debian: apt-get install python3-venv)"));
        } else {
            return Ok((name, version));
        }
    }
    let seen = if seen.is_empty() { "none was found".to_owned() } else { seen.join("; ") };
    Err(format!(
        "Python >= {}.{} is needed, with venv: {seen}. Install one, or name it in the variable PYTHON",
        OLDEST.0, OLDEST.1
    ))
}

/// All ingredients of the environment as one text; a change of it makes the environment again.
fn ingredients(version: &str) -> Outcome<String> {
    let mut files: Vec<PathBuf> = REQUIREMENTS.iter().map(|file| root().join(file)).collect();
    files.push(root().join("client/python/pyproject.toml"));
    files.push(root().join("client/python/hatch_build.py"));
    let mut messages = files_below(&root().join("proto/moldline"))?;
    messages.sort();
    files.append(&mut messages);
    let mut text = format!("Python {version}\n");
    for file in files {
        let content =
            fs::read_to_string(&file).map_err(|error| format!("cannot read {}: {error}", file.display()))?;
        text += &format!("---- {}\n{content}\n", file.display());
    }
    Ok(text)
}

fn files_below(folder: &Path) -> Outcome<Vec<PathBuf>> {
    let cannot = |error| format!("cannot read {}: {error}", folder.display());
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(cannot)? {
        let path = entry.map_err(cannot)?.path();
        if path.is_dir() {
            files.append(&mut files_below(&path)?);
        } else {
            files.push(path);
        }
    }
    Ok(files)
}
