//! Banks: JSON.
#![no_main]

mod scratch;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    scratch::with_file("bank", data, |path| {
        let _ = flyvine::model::Bank::read(path);
    });
});
