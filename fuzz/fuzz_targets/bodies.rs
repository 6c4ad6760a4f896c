//! The file of motion-capture body names.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let _ = flyvine_link::mocap::Bodies::parse("fuzz", text);
});
