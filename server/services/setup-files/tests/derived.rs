//! A set-up restored from its derived data is the same, bit for bit, without a search.
#![allow(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::{
    path::Path,
    sync::Mutex,
    time::{Duration, Instant},
};

use moldline_deform::{Derived, Monitor, NoMonitor, Setup, Stage};
use moldline_setup_files::{Limits, decode_derived, encode_derived, read_folder, read_setup};

/// Time of the first report of each stage.
struct Watch(Mutex<Vec<(Stage, Instant)>>);

impl Monitor<Stage> for Watch {
    fn progress(&self, stage: Stage, _: f64) {
        let mut seen = self.0.lock().unwrap();
        if seen.last().is_none_or(|(last, _)| *last != stage) {
            seen.push((stage, Instant::now()));
        }
    }
}

fn timed(make: impl FnOnce(&Watch) -> Setup) -> (Setup, Vec<(Stage, Duration)>, Duration) {
    let (watch, start) = (Watch(Mutex::default()), Instant::now());
    let setup = make(&watch);
    let seen = watch.0.into_inner().unwrap();
    (setup, seen.iter().map(|(stage, at)| (*stage, *at - start)).collect(), start.elapsed())
}

#[test]
fn a_restored_set_up_has_the_same_bits() {
    let start = Instant::now();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../examples/e175");
    let (files, setup_file) = read_folder(&folder, &Limits::default()).unwrap();
    let input = read_setup(&files, Some(&setup_file), &Limits::default()).unwrap().input;
    println!("read in {:?}", start.elapsed());
    let (built, stages, took) = timed(|watch| Setup::build(input.clone(), watch).unwrap());
    println!("built in {took:?}: {stages:?}");
    let start = Instant::now();
    let bytes = encode_derived(&built.derived());
    println!("{} bytes encoded in {:?}", bytes.len(), start.elapsed());
    let start = Instant::now();
    let derived = decode_derived(&bytes).unwrap();
    println!("decoded in {:?}", start.elapsed());
    let (restored, stages, took) = timed(|watch| Setup::restore(input.clone(), derived, watch).unwrap());
    println!("restored in {took:?}: {stages:?}");
    assert!(!stages.iter().any(|(stage, _)| *stage == Stage::Ownership), "nothing is projected");

    assert_eq!(restored.derived(), built.derived());
    assert_eq!(restored.report(), built.report());
    assert_eq!(restored.reference_functions(), built.reference_functions());
    let mut design = built.parameterisation().baseline();
    for (x, variable) in design.iter_mut().zip(built.parameterisation().variables()) {
        let (low, high) = (variable.lower.max(*x - 1.0), variable.upper.min(*x + 1.0));
        *x = 0.7 * *x + 0.3 * (0.25 * low + 0.75 * high);
    }
    let (a, b) = (built.deform(&design, &NoMonitor).unwrap(), restored.deform(&design, &NoMonitor).unwrap());
    assert_eq!(a.vertices, b.vertices);
    assert_eq!(a.functions, b.functions);

    // Derived data of another set-up are rejected.
    let mut other = built.derived();
    other.ownership.cell_owner.pop();
    other.seams.lines[0].components = [0, 0];
    other.middles.pop();
    other.fields[0].lower.pop();
    other.fields.truncate(1);
    for derived in [other, Derived::default()] {
        let again = Setup::restore(input.clone(), derived, &NoMonitor).unwrap();
        assert_eq!(again.derived(), built.derived());
    }
}
