//! One line of an `exec:` vehicle.
#![no_main]

/// The vehicle's own, which nothing else needs; it finds the library's items where it looks for them.
#[path = "../../crates/flyvine/src/link/exec/reply.rs"]
mod reply;

use flyvine::link::Observation;
use flyvine::link::exec::ExecFault;
use flyvine::{flight, link};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|line: &[u8]| {
    if let Ok(Observation {
        quadrotor: Some(pose),
        ..
    }) = reply::parse(line)
    {
        let norm = pose.attitude.iter().map(|x| x * x).sum::<f64>().sqrt();
        assert!((norm - 1.0).abs() < 1e-12 && pose.attitude[0] >= 0.0);
    }
    let _ = reply::shown(line);
});
