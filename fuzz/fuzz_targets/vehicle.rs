//! Vehicle files: the simulated vehicle, and its supervisor's limits.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let _ = flyvine::run::parse_vehicle_file(text, "fuzz");
});
