//! A MAVLink stream as an autopilot may send it: read by the link, signed and unsigned, which answers; and cut into packets
//! by the companion computer's bridge, which loses no byte. The first byte says where the stream is cut.
#![no_main]

/// The bridge's own, which nothing else needs.
#[path = "../../crates/flyvine-link/src/onboard/mavlink_packets.rs"]
mod mavlink_packets;

use flyvine::link::{Mode, Setpoint};
use flyvine_link::autopilot::{AutopilotLink, Codec, LinkOptions, Profile, SigningKey};
use libfuzzer_sys::fuzz_target;
use mavlink_packets::PacketSplitter;

fuzz_target!(|data: &[u8]| {
    let Some((&cut, stream)) = data.split_first() else {
        return;
    };
    let (head, tail) = stream.split_at(usize::from(cut).min(stream.len()));
    for profile in [Profile::Px4, Profile::ArduPilot] {
        for key in [None, Some(SigningKey([7; 32]))] {
            let options = LinkOptions {
                profile,
                key,
                ..LinkOptions::default()
            };
            let mut link = AutopilotLink::new(options);
            link.set_mode(Mode::Offboard);
            link.receive(0.0, head);
            link.tick(0.5);
            link.receive(0.5, tail);
            link.tick(1.5);
            let setpoint = Setpoint {
                position: [0.0, 0.0, 1.5],
                velocity: Some([0.1, 0.0, 0.0]),
            };
            link.send_setpoint(1.5, setpoint);
            let _ = link.take_notes();
            // What we say in answer can be read.
            let mut reader = Codec::new(options.identity, key);
            for frame in link.take_frames() {
                reader.feed(&frame);
                assert!(reader.decode().is_some() && reader.unreadable() == 0);
            }
        }
    }
    let mut splitter = PacketSplitter::default();
    let mut passed = 0;
    for bytes in [head, tail] {
        splitter.extend(bytes, |packet| passed += packet.len());
    }
    let whole = passed + splitter.skipped as usize;
    assert!(whole == stream.len() || (whole < stream.len() && splitter.is_cut()));
});
