//! Inputs far outside, and work that nobody waits for any more: both end soon, with an error that says why.

// Helpers of tests fail by panicking, like the tests themselves.
#![allow(clippy::unwrap_used)]

use std::{
    collections::BTreeMap,
    path::Path,
    sync::{
        Mutex,
        atomic::{AtomicUsize, Ordering},
    },
};

use moldline_deform::{
    ControlPointsError, DeformError, Inputs, Monitor, NoMonitor, Setup, SetupError, SetupInput, Stage,
};
use moldline_foundation::Failure;
use moldline_parameterisation::Override;
use moldline_setup_files::{Files, Limits, read_folder, read_setup};

fn input(change: impl FnOnce(&mut Files)) -> SetupInput {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../tests/configurations/boom");
    let (mut files, setup_file) = read_folder(&folder, &Limits::default()).unwrap();
    change(&mut files);
    read_setup(&files, Some(&setup_file), &Limits::default()).unwrap().input
}

fn build(input: SetupInput) -> Result<Setup, SetupError> {
    Setup::build(input, &NoMonitor)
}

/// Runs a computation on a stack that unbounded recursion would exhaust at once.
fn on_a_small_stack<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).stack_size(1 << 20).build().unwrap();
    pool.install(work)
}

/// The boom's and the fairing's control points, `shift` metres along the span.
fn shifted(setup: &Setup, shift: f64) -> Inputs {
    let baseline = setup.parameterisation().baseline();
    let points = setup.parameterisation().control_points(&baseline).unwrap();
    let of = |component: usize| Override {
        component,
        control_points: points[component].iter().map(|[x, y, z]| [*x, y + shift, *z]).collect(),
    };
    Inputs { design: baseline, given: vec![of(1), of(2)] }
}

#[test]
fn control_points_within_reach_are_searched_and_those_beyond_refused_by_field() {
    let setup = build(input(|_| {})).unwrap();
    let length = setup.length();
    on_a_small_stack(|| {
        for lengths in [3.0, 30.0, 300.0, 990.0] {
            let error = setup.deform(shifted(&setup, lengths * length), &NoMonitor).unwrap_err();
            assert!(matches!(error, DeformError::SeamLost { .. }), "{lengths}: {error}");
        }
        for lengths in [1010.0, 1e6, 1e100, 1e200, 1e300] {
            let error = setup.deform(shifted(&setup, lengths * length), &NoMonitor).unwrap_err();
            let DeformError::ControlPoints(ControlPointsError::Far {
                component: 1, by_design: false, ..
            }) = &error
            else {
                panic!("{lengths}: {error}")
            };
            assert_eq!(error.field().unwrap(), "control_points");
        }
    });
}

#[test]
fn a_design_that_moves_a_component_out_of_reach_is_refused_by_field() {
    let setup = build(input(|files| {
        let text = String::from_utf8(files["setup.toml"].clone()).unwrap();
        files.insert("setup.toml".into(), text.replace("upper = 0.2", "upper = 1e300").into_bytes());
    }))
    .unwrap();
    on_a_small_stack(|| {
        for far in [1e6, 1e150, 1e300] {
            let design = setup.parameterisation().design([("boom.translation", far)]).unwrap();
            let error = setup.deform(design, &NoMonitor).unwrap_err();
            assert!(error.to_string().contains("design variables"), "{error}");
            assert_eq!(error.field().unwrap(), "design");
        }
    });
}

#[test]
fn a_mesh_in_another_unit_than_its_components_is_refused_before_any_search() {
    for scale in [0.0, 1e-200, 1e-6] {
        let mut input = input(|_| {});
        input.mesh.vertices.iter_mut().flatten().for_each(|x| *x *= scale);
        let watch = Watch::until(usize::MAX);
        let error = Setup::build(input, &watch).unwrap_err();
        assert!(matches!(error, SetupError::ControlPoints(ControlPointsError::Far { .. })), "{error}");
        assert_eq!(watch.polls(), 0, "no stage has begun");
    }
}

/// Counts the polls of each stage, and cancels from a given one on.
struct Watch {
    left: AtomicUsize,
    stage: Mutex<Option<Stage>>,
    polls: Mutex<BTreeMap<Option<Stage>, usize>>,
}

impl Watch {
    fn until(polls: usize) -> Self {
        Self { left: polls.into(), stage: Mutex::default(), polls: Mutex::default() }
    }

    fn polls(&self) -> usize {
        self.polls.lock().unwrap().values().sum()
    }
}

impl Monitor<Stage> for Watch {
    fn progress(&self, stage: Stage, _: f64) {
        *self.stage.lock().unwrap() = Some(stage);
    }

    fn cancelled(&self) -> bool {
        *self.polls.lock().unwrap().entry(*self.stage.lock().unwrap()).or_default() += 1;
        let one_less = |left: usize| Some(left.saturating_sub(1));
        self.left.fetch_update(Ordering::SeqCst, Ordering::SeqCst, one_less) == Ok(0)
    }
}

#[test]
fn every_loop_over_vertices_polls_and_whenever_it_does_the_work_can_end() {
    let all = Watch::until(usize::MAX);
    let mut with_rounds = input(|_| {});
    with_rounds.options.smoothing.rounds = 2;
    with_rounds.options.outer_mold_line = moldline_deform::OuterMoldLine::Smooth;
    let setup = Setup::build(with_rounds.clone(), &all).unwrap();
    let (vertices, seams) = (setup.mesh().vertices.len(), setup.seam_vertices().len());
    {
        let polls = all.polls.lock().unwrap();
        assert!(polls[&Some(Stage::Ownership)] >= vertices, "{polls:?}");
        assert!(polls[&Some(Stage::Seams)] >= 2 * seams, "{polls:?}");
        assert!(polls[&Some(Stage::Training)] >= 30, "{polls:?}");
    }
    let total = all.polls();
    for part in 0..24 {
        let watch = Watch::until(part * total / 24);
        let outcome = Setup::build(with_rounds.clone(), &watch);
        assert!(matches!(outcome, Err(SetupError::Cancelled)), "poll {} of {total}", part * total / 24);
    }

    let all = Watch::until(usize::MAX);
    let design = setup.parameterisation().design([("boom.translation", 0.05)]).unwrap();
    setup.deform(&design, &all).unwrap();
    {
        let polls = all.polls.lock().unwrap();
        assert!(polls[&Some(Stage::SeamSearch)] >= seams, "{polls:?}");
        // Placement, two rounds of smoothing, and the projection of free vertices.
        assert!(polls[&Some(Stage::Projection)] >= 3 * vertices, "{polls:?}");
    }
    let total = all.polls();
    for part in 0..24 {
        let outcome = setup.deform(&design, &Watch::until(part * total / 24));
        assert!(matches!(outcome, Err(DeformError::Cancelled)), "poll {} of {total}", part * total / 24);
    }
}
