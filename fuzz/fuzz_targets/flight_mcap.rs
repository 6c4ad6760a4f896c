//! Flights in MCAP, whole and cut off.
#![no_main]

mod scratch;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    scratch::with_file("mcap", data, |path| {
        let _ = flyvine::flight::read_flight(path);
        let _ = flyvine::flight::recover_flight(path);
        let _ = flyvine::flight::read_control_steps(path);
    });
});
