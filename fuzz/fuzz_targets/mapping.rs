//! Column mappings of recordings.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let _ = flyvine::flight::Mapping::parse("fuzz", text);
});
