//! Set-ups for the tests.
// Not every test uses all of it.
#![allow(dead_code)]

use std::path::Path;

use moldline_deform::{NoMonitor, OnEvent, Options, Setup};
use moldline_setup_files::{Limits, read_folder, read_setup};

/// The set-up in a folder of the repository, with other options.
pub fn setup(folder: &str, change: impl Fn(&mut Options)) -> Setup {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..").join(folder);
    let limits = Limits::default();
    let (files, setup_file) = read_folder(&path, &limits).expect("is there");
    let mut input = read_setup(&files, Some(&setup_file), &limits).expect("is valid").input;
    // Derivatives are looked at where cells fold over each other, too.
    input.options.on_event = OnEvent::Report;
    change(&mut input.options);
    Setup::build(input, &NoMonitor).expect("is a set-up")
}

/// A design at a fraction of the way from the baseline to a bound, upper and lower in turn.
pub fn design(setup: &Setup, fraction: f64) -> Vec<f64> {
    let variables = setup.parameterisation().variables().iter().enumerate();
    let bound =
        |(k, v): (usize, &moldline_parameterisation::Variable)| if k % 2 == 0 { v.upper } else { v.lower };
    variables.map(|(k, v)| v.baseline + fraction * (bound((k, v)) - v.baseline)).collect()
}

/// The direction of one variable.
pub fn unit(count: usize, k: usize) -> Vec<f64> {
    (0..count).map(|i| f64::from(i == k)).collect()
}
