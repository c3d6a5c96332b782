//! Times on the E175 mesh of the examples: `cargo bench -p moldline-panel`. Forces, times and memory, no pass or fail.

use std::{
    sync::{Arc, Mutex},
    time::Instant,
};

use moldline_mesh::io::msh;
use moldline_panel::{
    Flow, Inputs, Monitor, Options, Outputs, PanelSetup, Reference, Scalars, Solver, Stage, TrailingEdges,
};

/// Prints how long each stage takes.
struct Clock(Mutex<Option<(Stage, Instant)>>);

impl Clock {
    fn new() -> Self {
        Self(Mutex::new(None))
    }
}

impl Monitor for Clock {
    fn progress(&self, stage: Stage, fraction: f64) {
        let Ok(mut last) = self.0.lock() else { return };
        match *last {
            Some((current, start)) if current == stage => {
                if fraction >= 1.0 {
                    println!("    {stage:<14} {:8.3} s", start.elapsed().as_secs_f64());
                    *last = None;
                }
            }
            _ => *last = Some((stage, Instant::now())),
        }
    }

    fn residual(&self, round: usize, residual: f64) {
        println!("    round {round}: residual {residual:.2e}");
    }
}

/// Peak of the resident memory, MB.
fn peak() -> String {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM")).unwrap_or("VmHWM unknown");
    line.to_owned()
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/e175/mesh.msh");
    let mesh = msh::read(&std::fs::read(path)?)?.mesh;
    let names = ["trailing_edge_wing", "trailing_edge_htail"].map(str::to_owned).to_vec();
    let reference = Reference { area: 68.2, chord: 3.42, span: 23.82, point: [14.0, 0.0, 0.5] };
    let flow = |degrees: f64| Flow { alpha: degrees.to_radians(), sideslip: 0.0, reference };
    for solver in [Solver::Single, Solver::Iterative, Solver::Double] {
        let options =
            Options { trailing_edges: TrailingEdges::Groups(names.clone()), solver, ..Options::default() };
        let setup = PanelSetup::new(&mesh, options)?;
        let summary = setup.summary();
        println!("{solver:?}: {} unknowns, {} MB", summary.unknowns, summary.memory >> 20);
        let start = Instant::now();
        let solution = Arc::new(setup.solve(&mesh.vertices, 0.7, &Clock::new())?);
        for degrees in [0.0, 3.0] {
            let a = solution.analyse(&flow(degrees))?;
            println!("  alpha {degrees}: {:?}, disagreement {:.4}", a.scalars, a.disagreement);
            for c in &a.components {
                println!("    {:<10} CL {:8.5} CD {:8.5} CM {:8.5}", c.name, c.lift, c.drag, c.moment[1]);
            }
        }
        println!("  solution with forces {:.2} s", start.elapsed().as_secs_f64());
        let linearisation = solution.linearise(&flow(3.0))?;
        let seed = |i: usize| {
            let mut values = [0.0; Scalars::COUNT];
            values[i] = 1.0;
            Outputs { scalars: Scalars::from_array(values), ..Outputs::default() }
        };
        for count in [1, 6] {
            let start = Instant::now();
            linearisation.vjp(&(0..count).map(seed).collect::<Vec<_>>(), &Clock::new())?;
            println!("  {count} adjoints {:.2} s", start.elapsed().as_secs_f64());
        }
        let direction = Inputs { vertices: mesh.vertices.clone(), ..Inputs::default() };
        for count in [1, 8] {
            let start = Instant::now();
            linearisation.jvp(&vec![direction.clone(); count], &Clock::new())?;
            println!("  {count} directions {:.2} s", start.elapsed().as_secs_f64());
        }
        println!("  {}", peak());
    }
    Ok(())
}
