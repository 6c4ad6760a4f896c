//! The files of sweeps.
#![no_main]

use flyvine_sweep::SweepFile;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let _ = SweepFile::parse(text, "fuzz");
});
