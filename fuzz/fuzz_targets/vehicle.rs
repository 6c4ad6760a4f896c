//! Vehicle files of the simulator.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let _ = flyvine::sim::VehicleParameters::from_toml(text);
});
