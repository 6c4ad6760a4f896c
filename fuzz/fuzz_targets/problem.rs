//! Problems in the neutral benchmark format.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let _ = flyvine::benchmark::parse_problem(text);
});
