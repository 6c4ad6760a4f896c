//! Anyone's CSV, through the column mappings of the examples; what is read is resampled.
#![no_main]

use std::sync::LazyLock;

use flyvine::flight::{Mapping, resample};
use libfuzzer_sys::fuzz_target;

static MAPPINGS: LazyLock<[Mapping; 2]> = LazyLock::new(|| {
    [
        include_str!("../../examples/mappings/motive_mm.toml"),
        include_str!("../../examples/mappings/crazyflie_slung.toml"),
    ]
    .map(|text| Mapping::parse("example", text).expect("an example can be read"))
});

fuzz_target!(|data: &[u8]| {
    for mapping in MAPPINGS.iter() {
        if let Ok(recording) = mapping.parse_recording("fuzz", data) {
            let _ = resample(&recording, 0.2);
        }
    }
});
