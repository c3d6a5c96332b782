//! Sweeps design variables of the E175 through their ranges and looks for jumps of the mesh and of its derivative that smooth
//! change does not explain. Writes the paths of some vertices as JSON, for `xtask/scripts/smoothness/plot.py`.
//!
//! Over a step h the mesh must move by the mean of the derivatives at both ends, up to what the derivative's own change
//! explains; and the derivative must change as in the neighbouring steps.

use std::{error::Error, fs, path::Path, sync::Arc};

use moldline_deform::{NoMonitor, Options, OuterMoldLine, Setup};
use moldline_setup_files::{Limits, read_folder, read_setup};
use serde_json::{Value, json};

/// Steps of a sweep.
const STEPS: usize = 200;
/// Ratio of a change of the derivative to that of its neighbours from which on it counts as a jump ...
const SUSPICIOUS: f64 = 20.0;
/// ... if it is more than this fraction of the largest derivative of any vertex.
const NOTICEABLE: f64 = 1e-3;
/// Largest unexplained motion of a step, as a fraction of the longest step of any vertex.
const UNEXPLAINED: f64 = 1e-3;

type Positions = Vec<[f64; 3]>;

fn main() -> Result<(), Box<dyn Error>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    let out = root.join("out/smoothness");
    fs::create_dir_all(&out)?;
    let mut sweeps = Vec::new();
    for (name, change) in
        [("sharp", (|_| {}) as fn(&mut Options)), ("smooth", |o| o.outer_mold_line = OuterMoldLine::Smooth)]
    {
        let mut input = read_setup(
            &read_folder(&root.join("examples/e175"), &Limits::default())?.0,
            None,
            &Limits::default(),
        )?
        .input;
        change(&mut input.options);
        let setup = Arc::new(Setup::build(input, &NoMonitor)?);
        for variable in ["wing.translation", "htail.rotation", "fuselage.diameter"] {
            sweeps.push(sweep(name, &setup, variable)?);
        }
    }
    fs::write(out.join("smoothness.json"), serde_json::to_vec(&sweeps)?)?;
    Ok(())
}

fn sweep(name: &str, setup: &Arc<Setup>, variable: &str) -> Result<Value, Box<dyn Error>> {
    let index = setup.parameterisation().index(variable)?;
    let declared = &setup.parameterisation().variables()[index];
    let mut direction = setup.parameterisation().baseline();
    direction.iter_mut().enumerate().for_each(|(i, d)| *d = f64::from(i == index));
    let h = (declared.upper - declared.lower) / STEPS as f64;
    let value = |k: usize| declared.lower + h * k as f64;
    let mut meshes: Vec<Positions> = Vec::new();
    let mut tangents: Vec<Positions> = Vec::new();
    for k in 0..=STEPS {
        let mut design = setup.parameterisation().baseline();
        design[index] = value(k).min(declared.upper);
        let linearisation = setup.linearise(&design, &NoMonitor)?;
        meshes.push(linearisation.deformation().vertices.clone());
        tangents.push(linearisation.jvp(&[&direction])?.remove(0).vertices);
    }

    let count = meshes[0].len();
    let largest = tangents.iter().flatten().map(|t| norm(t, &[0.0; 3])).fold(0.0, f64::max);
    let mut jumps: Vec<(f64, Value)> = Vec::new();
    let mut worst_step: f64 = 0.0;
    let mut roughness = vec![0.0_f64; count];
    for v in 0..count {
        let change: Vec<f64> = (0..STEPS).map(|k| norm(&tangents[k + 1][v], &tangents[k][v])).collect();
        for k in 0..STEPS {
            let miss = std::array::from_fn(|a| {
                meshes[k + 1][v][a] - meshes[k][v][a] - 0.5 * h * (tangents[k][v][a] + tangents[k + 1][v][a])
            });
            // The trapezoid's error is a sixth of h times the second difference of the derivative, at most.
            let around = &change[k.saturating_sub(1)..(k + 2).min(STEPS)];
            let explained = h * around.iter().fold(0.0, |a: f64, b| a.max(*b));
            let unexplained = (norm(&miss, &[0.0; 3]) - explained) / (h * largest);
            worst_step = worst_step.max(unexplained);
            // The change of the derivative against the larger one of its neighbours two steps on either side.
            let beside = [k.checked_sub(2), k.checked_sub(1), Some(k + 1), Some(k + 2)];
            let typical =
                beside.into_iter().flatten().filter_map(|j| change.get(j)).fold(0.0, |a: f64, b| a.max(*b));
            let jump = change[k] / largest;
            roughness[v] = roughness[v].max(jump);
            let suspicious = jump > NOTICEABLE && change[k] > SUSPICIOUS * typical;
            if unexplained > UNEXPLAINED || suspicious {
                let owners: Vec<&str> = setup
                    .ownership()
                    .of(v as u32)
                    .iter()
                    .map(|a| setup.components()[a.component as usize].name())
                    .collect();
                jumps.push((
                    jump.max(unexplained),
                    json!({ "vertex": v, "from": value(k), "to": value(k + 1), "of": owners,
                            "derivative": jump, "unexplained": unexplained, "at": meshes[k][v] }),
                ));
            }
        }
    }
    jumps.sort_by(|a, b| b.0.total_cmp(&a.0));
    println!(
        "{name:<7} {variable:<18} {STEPS} steps: motion left unexplained at most {worst_step:.1e} of the largest step, \
         derivative changes by {:.1e} of the largest at most, {} jumps",
        roughness.iter().fold(0.0, |a: f64, b| a.max(*b)),
        jumps.len()
    );
    for (_, jump) in jumps.iter().take(5) {
        println!("        {jump}");
    }
    // The vertices whose derivatives change fastest, and some spread over the mesh.
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|a, b| roughness[*b].total_cmp(&roughness[*a]).then(a.cmp(b)));
    let chosen: Vec<usize> =
        order.iter().take(4).copied().chain((0..4).map(|k| order[count * (k + 1) / 6])).collect();
    let courses: Vec<Value> = chosen
        .iter()
        .map(|&v| {
            json!({ "vertex": v, "start": meshes[STEPS / 2][v],
                    "moved": meshes.iter().map(|m| norm(&m[v], &meshes[STEPS / 2][v])).collect::<Vec<_>>(),
                    "derivative": tangents.iter().map(|t| t[v]).collect::<Vec<_>>() })
        })
        .collect();
    Ok(json!({
        "outer_mold_line": name, "variable": variable, "unit": declared.unit.to_string(),
        "values": (0..=STEPS).map(value).collect::<Vec<_>>(), "vertices": courses,
        "jumps": jumps.iter().map(|(_, jump)| jump).collect::<Vec<_>>(),
        "unexplained": worst_step,
    }))
}

fn norm(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}
