//! A STEP file: it is imported or refused.
#![no_main]

use libfuzzer_sys::fuzz_target;
use moldline_aircraft_files::{ImportLimits, ImportOptions, import};
use moldline_foundation::monitor::NoMonitor;

fuzz_target!(|input: &[u8]| {
    let text = [b"ISO-10303-21;\nDATA;\n", input].concat();
    let _ = import(&text, &options(), &NoMonitor);
});

fn options() -> ImportOptions {
    let limits = ImportLimits { bytes: 1 << 20, entities: 10_000, patches: 50, control_points: 2000 };
    ImportOptions { limits, ..ImportOptions::default() }
}
