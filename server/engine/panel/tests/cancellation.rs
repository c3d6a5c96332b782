//! A computation that is cancelled ends soon, in whatever stage it is.
#![allow(clippy::unwrap_used, reason = "helpers of tests may panic")]

use std::{
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

use moldline_mesh::{Cell, SurfaceMesh};
use moldline_panel::{
    Flow, Inputs, Monitor, Options, Outputs, PanelError, PanelSetup, Reference, Scalars, Solver, Stage,
    TrailingEdges,
};
use moldline_testing::{Random, Wing};

/// Cancels at the look of that number, and counts looks.
struct Looks {
    cancel: usize,
    looked: AtomicUsize,
}

impl Looks {
    fn new(cancel: usize) -> Self {
        Self { cancel, looked: AtomicUsize::new(0) }
    }
}

impl Monitor<Stage> for Looks {
    fn progress(&self, _: Stage, _: f64) {}

    fn cancelled(&self) -> bool {
        self.looked.fetch_add(1, Ordering::Relaxed) >= self.cancel
    }
}

/// Prisms beside and behind each other, each with a sharp edge: as many wakes as there are prisms.
fn prisms(count: usize) -> SurfaceMesh {
    let (mut vertices, mut cells) = (Vec::new(), Vec::new());
    for k in 0..count {
        let first = vertices.len() as u32;
        let (y, z) = (2.0 * (k % 20) as f64, 1.0 * (k / 20) as f64);
        for end in [0.0, 1.0] {
            vertices.extend([[0.0, y + end, z - 0.1], [1.0, y + end, z], [0.0, y + end, z + 0.1]]);
        }
        let v = |i: u32| first + i;
        cells.extend([
            Cell::triangle(v(0), v(1), v(2)),
            Cell::triangle(v(3), v(5), v(4)),
            Cell::quad(v(0), v(3), v(4), v(1)),
            Cell::quad(v(1), v(4), v(5), v(2)),
            Cell::quad(v(2), v(5), v(3), v(0)),
        ]);
    }
    SurfaceMesh::new(vertices, cells, Vec::new(), Vec::new()).unwrap()
}

fn flow() -> Flow {
    let reference = Reference { area: 8.0, chord: 1.0, span: 8.0, point: [0.0; 3] };
    Flow { alpha: 0.05, sideslip: 0.0, reference }
}

/// All of the work on a mesh.
fn work(mesh: &SurfaceMesh, options: Options, monitor: &dyn Monitor<Stage>) -> Result<(), PanelError> {
    let setup = PanelSetup::monitored(mesh, options, monitor)?;
    let solution = Arc::new(setup.solve(&mesh.vertices, 0.3, monitor)?);
    let linearisation = solution.linearise(&flow())?;
    let direction = Inputs { vertices: vec![[0.1, 0.2, 0.3]; mesh.vertices.len()], ..Inputs::default() };
    linearisation.jvp(&vec![direction; 3], monitor)?;
    let seed = Outputs { scalars: Scalars { induced_drag: 1.0, ..Scalars::default() }, ..Outputs::default() };
    linearisation.vjp(&vec![seed; 3], monitor)?;
    Ok(())
}

/// Cancelled at every place where it looks, or at many of them, work ends with that error: no result is half done.
#[test]
fn work_ends_wherever_it_is_cancelled() {
    let wing = Wing { half: true, ..Wing::rectangular(12, 8) }.mesh();
    let mut random = Random::new(14);
    for solver in [Solver::Double, Solver::Single, Solver::Iterative] {
        let options = Options { solver, ..Options::default() };
        let all = Looks::new(usize::MAX);
        work(&wing, options.clone(), &all).unwrap();
        let count = all.looked.into_inner();
        assert!(count > 100, "{count}");
        for _ in 0..40 {
            let monitor = Looks::new((random.unit() * count as f64) as usize);
            match work(&wing, options.clone(), &monitor) {
                Err(PanelError::Cancelled) => {}
                // Threads look in any order, so that the last looks may not come.
                Ok(()) => assert!(monitor.looked.into_inner() <= monitor.cancel),
                Err(other) => panic!("{other}"),
            }
        }
    }
}

/// The looks are close to each other, also in the stages whose work goes with the square of the number of wakes.
#[test]
fn looks_are_frequent_whatever_the_number_of_wakes() {
    /// The longest time between two looks.
    struct Gaps(std::sync::Mutex<(Instant, Duration)>);
    impl Monitor<Stage> for Gaps {
        fn progress(&self, _: Stage, _: f64) {}
        fn cancelled(&self) -> bool {
            let mut state = self.0.lock().unwrap();
            let gap = state.0.elapsed();
            *state = (Instant::now(), state.1.max(gap));
            false
        }
    }
    let mesh = prisms(80);
    let options =
        || Options { trailing_edges: TrailingEdges::Angle { degrees: 120.0 }, ..Options::default() };
    let looks = Looks::new(usize::MAX);
    let setup = PanelSetup::monitored(&mesh, options(), &looks).unwrap();
    let wakes = setup.summary().trailing_edges.len();
    assert!(wakes >= 80, "{wakes}");
    // Once for each wake at least, in setting up, in the check of wakes, in the forces and in the drag.
    assert!(looks.looked.into_inner() >= wakes);
    let looks = Looks::new(usize::MAX);
    let solution = Arc::new(setup.solve(&mesh.vertices, 0.3, &looks).unwrap());
    assert!(looks.looked.into_inner() >= 3 * wakes);
    let looks = Looks::new(usize::MAX);
    let seed = Outputs { scalars: Scalars { induced_drag: 1.0, ..Scalars::default() }, ..Outputs::default() };
    solution.linearise(&flow()).unwrap().vjp(&[seed], &looks).unwrap();
    assert!(looks.looked.into_inner() >= wakes);
    let gaps = Gaps(std::sync::Mutex::new((Instant::now(), Duration::ZERO)));
    work(&mesh, options(), &gaps).unwrap();
    eprintln!("longest time between two looks: {:?}", gaps.0.into_inner().unwrap().1);
}
