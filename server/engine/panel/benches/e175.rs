//! Times on the E175 mesh of the examples: `cargo bench -p moldline-panel [-- Single]`. Forces, times and memory, no pass or fail.

use std::{
    sync::{Arc, Mutex},
    time::Instant,
};

use moldline_mesh::{Limits, io::msh};
use moldline_panel::{
    Flow, Inputs, Monitor, Options, Outputs, PanelSetup, Reference, Scalars, Solver, Stage, TrailingEdges,
};

/// Prints the time of each stage, and of the assembly the time of a pair: a collocation point and a panel, doublet and source, both
/// images.
struct Clock {
    last: Mutex<Option<(Stage, Times)>>,
    pairs: f64,
}

impl Clock {
    fn new(unknowns: usize) -> Self {
        Self { last: Mutex::new(None), pairs: (unknowns as f64).powi(2) }
    }
}

impl Monitor<Stage> for Clock {
    fn progress(&self, stage: Stage, fraction: f64) {
        let Ok(mut last) = self.last.lock() else { return };
        match *last {
            Some((current, start)) if current == stage => {
                if fraction >= 1.0 {
                    let [wall, processor] = start.since();
                    println!("    {stage:<14} {}", seconds([wall, processor]));
                    if stage == Stage::Influence {
                        let [wall, processor] = [wall, processor].map(|t| 1e9 * t / self.pairs);
                        println!("    {:<14} {wall:7.2} ns, processor {processor:7.2} ns", "  a pair");
                    }
                    *last = None;
                }
            }
            _ => *last = Some((stage, Times::now())),
        }
    }
}

/// Seconds on the wall and of all threads' processor time since the start of the process: other programs disturb the second less.
#[derive(Clone, Copy)]
struct Times(Instant, f64);

impl Times {
    fn now() -> Self {
        let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
        let after_name = stat.rsplit(')').next().unwrap_or_default();
        let ticks = |field: usize| -> f64 {
            after_name.split_whitespace().nth(field).and_then(|x| x.parse().ok()).unwrap_or(f64::NAN)
        };
        Self(Instant::now(), (ticks(11) + ticks(12)) / 100.0)
    }

    fn since(self) -> [f64; 2] {
        let now = Self::now();
        [(now.0 - self.0).as_secs_f64(), now.1 - self.1]
    }
}

fn seconds([wall, processor]: [f64; 2]) -> String {
    format!("{wall:7.2} s, processor {processor:7.2} s")
}

/// Peak of the resident memory, MB.
fn peak() -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM")).unwrap_or("VmHWM unknown");
    line.to_owned()
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../examples/e175/mesh.msh");
    let mesh = msh::read(&std::fs::read(path)?, &Limits::default())?.mesh;
    let names = ["trailing_edge_wing", "trailing_edge_htail"].map(str::to_owned).to_vec();
    let reference = Reference { area: 68.2, chord: 3.42, span: 23.82, point: [14.0, 0.0, 0.5] };
    let flow = |degrees: f64| Flow { alpha: degrees.to_radians(), sideslip: 0.0, reference };
    let all = [Solver::Single, Solver::Iterative, Solver::Double];
    // Cargo adds an option of its own.
    let chosen = std::env::args().skip(1).find(|argument| !argument.starts_with("--")).unwrap_or_default();
    for solver in all.into_iter().filter(|s| format!("{s:?}").contains(&chosen)) {
        let options =
            Options { trailing_edges: TrailingEdges::Groups(names.clone()), solver, ..Options::default() };
        let setup = PanelSetup::new(&mesh, options)?;
        let summary = setup.summary();
        println!("{solver:?}: {} unknowns, {} MB", summary.unknowns, summary.memory >> 20);
        let start = Times::now();
        let solution = Arc::new(setup.solve(&mesh.vertices, 0.7, &Clock::new(summary.unknowns))?);
        for degrees in [0.0, 3.0] {
            let a = solution.analyse(&flow(degrees))?;
            println!(
                "  alpha {degrees}: {:?}, on the wake {:.5}, disagreement {:.4}",
                a.scalars, a.wake_lift, a.disagreement
            );
            for c in &a.components {
                println!("    {:<10} CL {:8.5} CD {:8.5} CM {:8.5}", c.name, c.lift, c.drag, c.moment[1]);
            }
        }
        println!("  solution with forces {}", seconds(start.since()));
        let linearisation = solution.linearise(&flow(3.0))?;
        let seed = |i: usize| {
            let mut values = [0.0; Scalars::COUNT];
            values[i] = 1.0;
            Outputs { scalars: Scalars::from_array(values), ..Outputs::default() }
        };
        for count in [1, 6] {
            let start = Times::now();
            linearisation.vjp(&(0..count).map(seed).collect::<Vec<_>>(), &Clock::new(summary.unknowns))?;
            println!("  {count} adjoints {}", seconds(start.since()));
        }
        let direction = Inputs { vertices: mesh.vertices.clone(), ..Inputs::default() };
        for count in [1, 8] {
            let start = Times::now();
            linearisation.jvp(&vec![direction.clone(); count], &Clock::new(summary.unknowns))?;
            println!("  {count} directions {}", seconds(start.since()));
        }
        println!("  {}", peak());
    }
    Ok(())
}
