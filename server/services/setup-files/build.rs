//! Names this build of the engine: a hash of its sources, what they depend on, and the compiler.

use std::{
    collections::BTreeMap,
    env,
    error::Error,
    fs,
    hash::Hasher,
    path::{Path, PathBuf},
    process::Command,
};

use toml::Table;

fn main() -> Result<(), Box<dyn Error>> {
    // The same on every machine with the same compiler; another compiler gives another name.
    let mut hasher = std::hash::DefaultHasher::new();
    let workspace = workspace()?;
    for folder in own_crates(&workspace)?.values() {
        sources(&folder.join("src"), &mut hasher)?;
    }
    let lock = &workspace.join("Cargo.lock");
    println!("cargo::rerun-if-changed={}", lock.display());
    hasher.write(&fs::read(lock)?);
    let compiler = Command::new(env::var("RUSTC")?).arg("-vV").output()?;
    hasher.write(&compiler.stdout);
    for name in ["TARGET", "OPT_LEVEL", "CARGO_CFG_TARGET_FEATURE"] {
        hasher.write(env::var(name).unwrap_or_default().as_bytes());
    }
    println!("cargo::rustc-env=MOLDLINE_BUILD={:016x}", hasher.finish());
    Ok(())
}

/// The nearest folder above this crate that has a lock file.
fn workspace() -> Result<PathBuf, Box<dyn Error>> {
    let here = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?);
    let found = here.ancestors().find(|folder| folder.join("Cargo.lock").exists());
    Ok(found.ok_or("there is no Cargo.lock above this crate")?.to_owned())
}

/// Folders, by name, of this crate and of all crates of the workspace that it is built from: their code decides what a
/// set-up derives.
fn own_crates(workspace: &Path) -> Result<BTreeMap<String, PathBuf>, Box<dyn Error>> {
    let manifest = table(&workspace.join("Cargo.toml"))?;
    let shared =
        manifest["workspace"]["dependencies"].as_table().ok_or("[workspace.dependencies] is no table")?;
    let mut found = BTreeMap::new();
    let mut waiting = vec![(env::var("CARGO_PKG_NAME")?, PathBuf::from(env::var("CARGO_MANIFEST_DIR")?))];
    while let Some((name, folder)) = waiting.pop() {
        let manifest = table(&folder.join("Cargo.toml"))?;
        let dependencies = manifest.get("dependencies").and_then(|d| d.as_table());
        for dependency in dependencies.into_iter().flat_map(Table::keys) {
            let path = shared.get(dependency).and_then(|d| d.get("path")).and_then(|p| p.as_str());
            if let Some(path) = path.filter(|_| !found.contains_key(dependency)) {
                waiting.push((dependency.clone(), workspace.join(path)));
            }
        }
        found.insert(name, folder);
    }
    Ok(found)
}

fn table(manifest: &Path) -> Result<Table, Box<dyn Error>> {
    println!("cargo::rerun-if-changed={}", manifest.display());
    let text = fs::read_to_string(manifest).map_err(|error| format!("{}: {error}", manifest.display()))?;
    Ok(text.parse()?)
}

fn sources(folder: &Path, hasher: &mut impl Hasher) -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed={}", folder.display());
    let mut entries: Vec<_> = fs::read_dir(folder)?.collect::<Result<_, _>>()?;
    entries.sort_by_key(fs::DirEntry::file_name);
    for entry in entries {
        let path = entry.path();
        if path.is_dir() {
            sources(&path, hasher)?;
        } else {
            hasher.write(entry.file_name().as_encoded_bytes());
            hasher.write(&fs::read(&path)?);
        }
    }
    Ok(())
}
