//! Names this build of the engine: a hash of its sources, what they depend on, and the compiler.

use std::{env, error::Error, fs, hash::Hasher, path::Path, process::Command};

/// Crates whose code decides what a set-up derives.
const ENGINE: [&str; 6] = ["spline", "mesh", "geometry", "parameterisation", "deform", "setup"];

fn main() -> Result<(), Box<dyn Error>> {
    // With the same compiler the same on every machine; another compiler is another build.
    let mut hasher = std::hash::DefaultHasher::new();
    for engine in ENGINE {
        sources(&Path::new("..").join(engine).join("src"), &mut hasher)?;
    }
    let lock = Path::new("../../Cargo.lock");
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
