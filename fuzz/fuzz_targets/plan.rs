//! Plans: JSON.
#![no_main]

mod scratch;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    scratch::with_file("plan", data, |path| {
        let _ = flyvine::task::read_plan(path);
    });
});
