//! The journal of a sweep, as a killed process or a full disk may leave it.
#![no_main]

use flyvine_sweep::journal_rows;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let folder = std::env::temp_dir().join(format!("flyvine-fuzz-{}", std::process::id()));
    std::fs::create_dir_all(folder.join("journal")).expect("the temporary folder can be written");
    std::fs::write(folder.join("journal/1-of-1.jsonl"), data).expect("the temporary folder can be written");
    journal_rows(&folder).expect("a line that is none is left out");
});
