//! The benchmarks behind the goals, beside their peers.

use std::{
    cmp::Ordering,
    fs,
    path::PathBuf,
    process::{Command, Stdio},
};

use serde_json::{Value, json};

use crate::{
    demo::large_mesh,
    process::{Outcome, build_moldline, cargo, root},
    python::Python,
};

/// Rounds of a comparison, in which its two sides take turns.
const ROUNDS: usize = 3;

/// Runs the Rust benchmarks, scipy on the same data, and round trips through server and client; writes `out/bench.json`.
pub fn bench(large: bool, large_folder: Option<PathBuf>) -> Outcome {
    let python = Python::ready()?;
    let data = root().join("out/bench");
    eprintln!("\n==> benchmarks");
    // The machine's speed may change: the sides of a comparison take turns.
    let (mut rounds, mut peers) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        rounds.push(json_lines(goals("interpolation").env("MOLDLINE_BENCH_DATA", &data))?);
        let answers = json_lines(python.script("xtask/scripts/bench/rbf.py").arg(&data))?;
        peers.push(answers.last().ok_or("the benchmark of scipy printed nothing")?.clone());
    }
    let answer = median(peers, "milliseconds").ok_or("the benchmark of scipy printed no time")?;
    let mut rows: Vec<Value> = (0..rounds[0].len())
        .filter_map(|row| {
            median(rounds.iter().filter_map(|round| round.get(row).cloned()).collect(), "value")
        })
        .collect();
    let peer = answer["milliseconds"].as_f64();

    let mut speeds = Vec::new();
    for row in &mut rows {
        let name = row["name"].as_str().unwrap_or_default().to_owned();
        if name.contains("solve and evaluate") {
            row["peer"] = json!({ "name": "scipy RBFInterpolator, evaluation alone", "value": peer });
            let ratio = peer.zip(row["value"].as_f64()).map(|(peer, own)| peer / own);
            // The goal is for the whole machine.
            let goal = if name.ends_with(" 2 threads") { ">= 5" } else { "measured" };
            let name = name.replace("solve and evaluate", "times as fast as scipy");
            speeds.push(json!({ "name": name, "value": ratio, "unit": "1", "goal": goal }));
        }
    }
    rows.append(&mut speeds);
    rows.push(json!({
        "name": "cubic RBF, largest difference from scipy", "value": answer["difference"], "unit": "1", "goal": "<= 1e-10",
    }));
    let mut engine = goals("engine");
    if large {
        engine.env("MOLDLINE_BENCH_LARGE", large_mesh(&python, large_folder)?);
    }
    rows.append(&mut json_lines(&mut engine)?);
    let binary = build_moldline(true)?;
    rows.append(&mut json_lines(
        python.script("xtask/scripts/bench/round_trip.py").arg("--binary").arg(binary),
    )?);

    let mut missed = 0;
    println!("\n{:<84} {:>12} {:<9} goal", "quantity", "value", "unit");
    for row in &mut rows {
        let reached = reached(row);
        row["reached"] = json!(reached);
        missed += usize::from(reached == Some(false));
        let value = match row["value"].as_f64() {
            Some(value) if value != 0.0 && value.abs() < 1e-3 => format!("{value:.2e}"),
            Some(value) if value.fract() != 0.0 => format!("{value:.3}"),
            _ => row["value"].to_string(),
        };
        let text = |key: &str| row[key].as_str().unwrap_or_default().to_owned();
        let mark = if reached == Some(false) { "   MISSED" } else { "" };
        println!("{:<84} {value:>12} {:<9} {}{mark}", text("name"), text("unit"), text("goal"));
    }
    let path = root().join("out/bench.json");
    let text = serde_json::to_string_pretty(&Value::from(rows)).map_err(|error| error.to_string())?;
    fs::write(&path, text + "\n").map_err(|error| format!("cannot write {}: {error}", path.display()))?;
    println!("\nwritten to {}; {missed} goals missed", path.display());
    Ok(())
}

/// One part of the engine's benchmark.
fn goals(part: &str) -> Command {
    let mut goals = cargo();
    goals.args(["bench", "--locked", "--workspace", "--bench", "goals", "--", part]);
    goals
}

/// The object with the median number.
fn median(mut objects: Vec<Value>, key: &str) -> Option<Value> {
    let number = |object: &Value| object[key].as_f64();
    objects.retain(|object| number(object).is_some());
    objects.sort_by(|a, b| number(a).partial_cmp(&number(b)).unwrap_or(Ordering::Equal));
    objects.get(objects.len() / 2).cloned()
}

/// Whether a numeric goal is reached; `None` if the goal is not numeric.
fn reached(row: &Value) -> Option<bool> {
    let goal = row["goal"].as_str()?;
    let value = &row["value"];
    if goal == "true" {
        return Some(value == &Value::Bool(true));
    }
    let (at_least, limit) = match goal.split_once(' ') {
        Some((">=", limit)) => (true, limit),
        Some(("<=", limit)) => (false, limit),
        _ => (false, goal),
    };
    let (value, limit) = (value.as_f64()?, limit.parse::<f64>().ok()?);
    Some(if at_least { value >= limit } else { value <= limit })
}

/// Runs a program, passes on its messages, and collects the lines that are JSON objects.
fn json_lines(command: &mut Command) -> Outcome<Vec<Value>> {
    let program = command.get_program().to_string_lossy().into_owned();
    let output = command
        .stderr(Stdio::inherit())
        .output()
        .map_err(|error| format!("cannot run {program}: {error}"))?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    if !output.status.success() {
        return Err(format!("{program} failed ({}):\n{text}", output.status));
    }
    Ok(text
        .lines()
        .filter(|line| line.starts_with('{'))
        .filter_map(|line| serde_json::from_str(line).ok())
        .collect())
}
