//! What an arm may answer to its host: the host's half of the protocol, in pieces, with questions in between.
#![no_main]

use flyvine_link::arm::{ArmClient, Request, Setpoint};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut client = ArmClient::new(0.0);
    client.ask(Request::Resume);
    let setpoint = Setpoint {
        growth_rate_m_s: 0.01,
        pressure_kpa: 0.4,
    };
    for (index, piece) in bytes.chunks(16).enumerate() {
        let now_s = 0.05 * index as f64;
        client.tick(now_s, setpoint);
        client.receive(now_s + 0.01, piece);
        let status = client.status(now_s + 0.05);
        assert!(status.silence_s >= 0.04 - 1e-9);
        assert!(status.acknowledged + status.refused + status.unanswered <= index as u64 + 1);
    }
});
