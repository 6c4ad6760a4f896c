use super::*;
use crate::message::{Message, Refusal, Request, Setpoint, Telemetry};
use crate::pumps::Air;
use crate::state::{Fault, State};

fn setpoint(sequence: u16) -> Frame {
    let setpoint = Setpoint {
        growth_rate_m_s: 0.01,
        pressure_kpa: 0.4,
    };
    Frame {
        sequence,
        message: Message::Request(Request::Setpoint(setpoint)),
    }
}

fn read_one(bytes: &[u8]) -> Result<Frame, FrameError> {
    let mut decoder = Decoder::new();
    let mut found = None;
    decoder.extend(bytes, |frame| {
        assert!(found.is_none(), "one frame only");
        found = Some(frame);
    });
    found.expect("a frame")
}

/// A frame of these bytes, with a right checksum.
fn framed(body: &[u8]) -> Result<Frame, FrameError> {
    let mut plain = [0; 60];
    plain[..body.len()].copy_from_slice(body);
    plain[body.len()..body.len() + 2].copy_from_slice(&CRC.checksum(body).to_le_bytes());
    let mut bytes = [0; 64];
    let length = cobs::encode(&plain[..body.len() + 2], &mut bytes);
    read_one(&bytes[..length + 1])
}

#[test]
fn the_checksum_is_the_catalogue_s() {
    // Check value of CRC-16/IBM-3740 for "123456789".
    assert_eq!(CRC.checksum(b"123456789"), 0x29b1);
}

#[test]
fn a_set_point_s_bytes() {
    // Written by hand: stuffing, version 1, kind 1, sequence 0x0203, 0.0, 0.0, checksum.
    let frame = Frame {
        sequence: 0x0203,
        message: Message::Request(Request::Setpoint(Setpoint::default())),
    };
    let checksum = CRC.checksum(&[1, 1, 3, 2, 0, 0, 0, 0, 0, 0, 0, 0]).to_le_bytes();
    let expected = [
        0,
        5,
        1,
        1,
        3,
        2,
        1,
        1,
        1,
        1,
        1,
        1,
        1,
        3,
        checksum[0],
        checksum[1],
        0,
    ];
    assert_eq!(&frame.encode()[..], &expected);
}

#[test]
fn every_kind_comes_back() {
    let telemetry = Telemetry {
        time_ms: 123_456,
        setpoint_age_ms: Some(42),
        length_m: Some(0.85),
        pressure_kpa: None,
        growth_rate_m_s: -0.01,
        growth_duty: -0.5,
        air: Air::Inflate,
        state: State::Fault(Fault::MotorStalled),
        frames_received: 7,
        frames_rejected: 8,
    };
    let messages = [
        setpoint(0).message,
        Message::Request(Request::Stop),
        Message::Request(Request::Resume),
        Message::Request(Request::SetLength(0.7)),
        Message::Acknowledgement(Ok(())),
        Message::Acknowledgement(Err(Refusal::FaultPersists)),
        Message::Telemetry(telemetry),
        Message::Telemetry(Telemetry {
            setpoint_age_ms: None,
            length_m: None,
            ..telemetry
        }),
    ];
    for message in messages {
        let frame = Frame {
            sequence: 0xbeef,
            message,
        };
        assert_eq!(read_one(&frame.encode()), Ok(frame));
        assert!(frame.encode().len() <= MAX_FRAME);
    }
}

#[test]
fn what_is_wrong_is_named() {
    assert_eq!(read_one(&[3, 1, 0]), Err(FrameError::Stuffing));
    assert_eq!(read_one(&[3, 1, 1, 0]), Err(FrameError::TooShort(2)));
    assert_eq!(framed(&[2, 1, 0, 0]), Err(FrameError::Version(2)));
    assert_eq!(framed(&[1, 9, 0, 0]), Err(FrameError::Kind(9)));
    assert_eq!(
        framed(&[1, 2, 0, 0, 0]),
        Err(FrameError::Length {
            found: 1,
            expected: 0
        })
    );
    assert_eq!(framed(&[1, 0x81, 0, 0, 99]), Err(FrameError::Value("refusal")));
    let mut long = [1; MAX_STUFFED + 2];
    long[MAX_STUFFED + 1] = 0;
    assert_eq!(read_one(&long), Err(FrameError::TooLong));
    let mut flipped = setpoint(1).encode();
    flipped.bytes[3] ^= 2;
    assert!(matches!(read_one(&flipped), Err(FrameError::Checksum { .. })));
}

#[test]
fn telemetry_that_is_not_finite_is_rejected_but_a_request_is_left_to_the_arm() {
    let mut body = [0; 39];
    body[..2].copy_from_slice(&[1, 0x82]);
    body[13..17].copy_from_slice(&f32::NAN.to_le_bytes());
    assert_eq!(framed(&body), Err(FrameError::Value("length")));
    assert!(framed(&[1, 4, 0, 0, 0, 0, 0xc0, 0x7f]).is_ok());
}

/// Any one or two flipped bits of a frame, wherever they are, are found: no frame but an error, or nothing.
#[test]
fn two_flipped_bits_are_always_found() {
    let good = setpoint(77).encode();
    let bits = 8 * (good.len() - 1);
    for first in 8..bits {
        for second in first..bits {
            let mut bad = good;
            bad.bytes[first / 8] ^= 1 << (first % 8);
            if second != first {
                bad.bytes[second / 8] ^= 1 << (second % 8);
            }
            Decoder::new().extend(&bad, |frame| assert!(frame.is_err(), "bits {first} and {second}"));
        }
    }
}
