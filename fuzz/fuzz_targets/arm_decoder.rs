//! Any bytes: no panic; what is read is written back as it came; the next good frame is read.

#![no_main]

use libfuzzer_sys::fuzz_target;
use vine_arm::{Decoder, Frame, Message, Request};

fuzz_target!(|bytes: &[u8]| {
    let mut decoder = Decoder::new();
    decoder.extend(bytes, |frame| {
        if let Ok(frame) = frame {
            let encoded = frame.encode();
            let mut again = None;
            Decoder::new().extend(&encoded, |frame| again = frame.ok());
            // NaN is not equal to itself; its bytes are.
            assert_eq!(&again.expect("a frame").encode()[..], &encoded[..]);
        }
    });
    let good = Frame {
        sequence: 7,
        message: Message::Request(Request::Resume),
    };
    let mut found = false;
    decoder.extend(&good.encode(), |frame| found |= frame == Ok(good));
    assert!(found);
});
