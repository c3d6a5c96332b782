//! Fuzzing of everything that reads users' bytes.

use std::{
    fs,
    io::{BufRead, BufReader},
    process::{Command, Stdio},
};

use crate::{
    process::{Outcome, command, root, run},
    python::Python,
    tools,
};

/// Longest input, bytes.
const LONGEST: usize = 64 << 10;
/// Largest single allocation and largest resident set, MiB: the targets' limits are 1 MiB of files and 10,000 vertices, and
/// the sanitizer retains 256 MiB of freed memory.
const PIECE: usize = 16;
const MEMORY: usize = 1024;
/// Longest time for one input, s.
const PATIENCE: usize = 20;

/// Progress of a target.
#[derive(Debug, Default)]
struct Progress {
    executions: String,
    /// Covered edges of the control flow.
    coverage: String,
    finding: Option<String>,
}

/// Runs the targets one after the other, for `seconds` each. The corpus in `tests/fuzz/corpus` grows from run to run.
pub fn fuzz(seconds: u64, only: &[String]) -> Outcome {
    let tool = tools::FUZZ.ready()?;
    let cargo_fuzz = |verb: &str| {
        let mut command = command(&tool);
        // The sanitizer is an unstable option of the compiler.
        command.args([verb, "--fuzz-dir", "tests/fuzz"]).env("RUSTC_BOOTSTRAP", "1");
        command
    };
    let listed = cargo_fuzz("list").output().map_err(|error| format!("cargo fuzz: {error}"))?;
    let all: Vec<String> = String::from_utf8_lossy(&listed.stdout).lines().map(str::to_owned).collect();
    if let Some(unknown) = only.iter().find(|target| !all.contains(target)) {
        return Err(format!("there is no target `{unknown}`; there are: {}", all.join(", ")));
    }
    let targets = if only.is_empty() { &all[..] } else { only };

    let seeds = root().join("target/fuzz-seeds");
    run("seeds", Python::ready()?.script("tests/fuzz/seeds.py").arg(&seeds))?;
    run("build the targets", cargo_fuzz("build").args(["--target-dir", "target/fuzz"]))?;
    let mut rows = Vec::with_capacity(targets.len());
    for target in targets {
        let corpus = root().join("tests/fuzz/corpus").join(target);
        fs::create_dir_all(&corpus).map_err(|error| format!("cannot make {}: {error}", corpus.display()))?;
        let mut fuzzing = cargo_fuzz("run");
        fuzzing.args([target, "--target-dir", "target/fuzz"]).arg(&corpus).arg(seeds.join(target));
        fuzzing.args(["--", "-print_final_stats=1", "-verbosity=1"]);
        fuzzing.args([
            format!("-max_total_time={seconds}"),
            format!("-max_len={LONGEST}"),
            format!("-malloc_limit_mb={PIECE}"),
            format!("-rss_limit_mb={MEMORY}"),
            format!("-timeout={PATIENCE}"),
        ]);
        eprintln!("\n==> fuzz {target}, {seconds} s");
        rows.push((target, watch(&mut fuzzing)?));
    }

    println!("\n{:<10} {:>12} {:>10}  finding", "target", "executions", "coverage");
    for (target, Progress { executions, coverage, finding }) in &rows {
        println!("{target:<10} {executions:>12} {coverage:>10}  {}", finding.as_deref().unwrap_or("none"));
    }
    match rows.iter().filter(|(_, progress)| progress.finding.is_some()).count() {
        0 => Ok(()),
        findings => {
            Err(format!("{findings} targets have findings; the messages above say how to reproduce them"))
        }
    }
}

/// Runs a target to its end, and passes on its messages.
fn watch(fuzzing: &mut Command) -> Outcome<Progress> {
    let cannot = |error: std::io::Error| format!("cannot run cargo fuzz: {error}");
    let mut child = fuzzing.stderr(Stdio::piped()).spawn().map_err(cannot)?;
    let mut progress = Progress::default();
    let mut artifact = None;
    for line in child.stderr.take().into_iter().flat_map(|stderr| BufReader::new(stderr).split(b'\n')) {
        let line = String::from_utf8_lossy(&line.map_err(cannot)?).into_owned();
        eprintln!("{line}");
        let mut words = line.split_whitespace();
        if words.by_ref().any(|word| word == "cov:") {
            progress.coverage = words.next().unwrap_or_default().to_owned();
        }
        if let Some(count) = line.strip_prefix("stat::number_of_executed_units:") {
            progress.executions = count.trim().to_owned();
        }
        if let Some((_, path)) = line.split_once("Test unit written to ") {
            artifact = Some(path.to_owned());
        }
    }
    let status = child.wait().map_err(cannot)?;
    if !status.success() {
        progress.finding = Some(artifact.unwrap_or_else(|| status.to_string()));
    }
    Ok(progress)
}
