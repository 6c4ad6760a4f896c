//! The smaller files in TOML: faults of a rehearsal, a supervisor's limits, options of fits and of predictive control.
#![no_main]

use flyvine::control::mpc::MpcOptions;
use flyvine::control::supervisor::Limits;
use flyvine::model::FitOptions;
use flyvine_link::rehearsal::Script;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let _ = Script::parse(text);
    let _ = toml::from_str::<Limits>(text);
    let _ = toml::from_str::<FitOptions>(text);
    let _ = toml::from_str::<MpcOptions>(text);
});
