//! Flights in CSV: what is read is cleaned too.
#![no_main]

use flyvine::flight::{HygieneOptions, clean, parse_csv};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    if let Ok(mut flight) = parse_csv("fuzz", data) {
        clean(&mut flight, &HygieneOptions::default());
        let _ = flight.valid_transitions(3);
    }
});
