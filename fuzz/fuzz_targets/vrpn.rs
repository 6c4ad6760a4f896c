//! VRPN as a peer may send it: the first byte says where the stream is cut, the rest is the stream. Cut anywhere, it says the
//! same, and so do the datagrams in it.
#![no_main]

use flyvine_link::mocap::vrpn::{Endpoint, parse_lob};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Some((&cut, stream)) = data.split_first() else {
        return;
    };
    let devices = ["drone".to_owned()];
    let mut whole = Endpoint::new(&devices, None);
    let expected = whole.receive(stream, 1.7e9);
    let (head, tail) = stream.split_at(usize::from(cut).min(stream.len()));
    let mut pieces = Endpoint::new(&devices, None);
    let found = pieces.receive(head, 1.7e9).and_then(|mut events| {
        events.extend(pieces.receive(tail, 1.7e9)?);
        Ok(events)
    });
    // NaN is not equal to itself, but it is printed alike.
    assert_eq!(format!("{found:?}"), format!("{expected:?}"));
    if expected.is_ok() {
        assert_eq!(pieces.take_output(), whole.take_output());
    }
    let _ = whole.receive_datagram(stream);
    let _ = parse_lob(stream);
});
