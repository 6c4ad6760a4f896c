//! The bytes of each kind of message; the table is in [`crate::message`].

use super::FrameError;
use crate::message::{Message, Refusal, Request, Setpoint, Telemetry};
use crate::pumps::Air;
use crate::state::State;

/// The longest payload, telemetry, bytes.
pub(super) const MAX_PAYLOAD: usize = 35;

const SETPOINT: u8 = 0x01;
const STOP: u8 = 0x02;
const RESUME: u8 = 0x03;
const SET_LENGTH: u8 = 0x04;
const ACKNOWLEDGEMENT: u8 = 0x81;
const TELEMETRY: u8 = 0x82;

/// On the wire: no set-point yet.
const NO_SETPOINT: u32 = u32::MAX;
const LENGTH_KNOWN: u8 = 1;
const PRESSURE_KNOWN: u8 = 2;

/// The kind byte.
pub(super) fn kind(message: &Message) -> u8 {
    match message {
        Message::Request(Request::Setpoint(_)) => SETPOINT,
        Message::Request(Request::Stop) => STOP,
        Message::Request(Request::Resume) => RESUME,
        Message::Request(Request::SetLength(_)) => SET_LENGTH,
        Message::Acknowledgement(_) => ACKNOWLEDGEMENT,
        Message::Telemetry(_) => TELEMETRY,
    }
}

/// Appends the payload.
pub(super) fn write<const N: usize>(message: &Message, to: &mut Writer<N>) {
    match message {
        Message::Request(Request::Setpoint(setpoint)) => {
            to.f32(setpoint.growth_rate_m_s);
            to.f32(setpoint.pressure_kpa);
        }
        Message::Request(Request::Stop | Request::Resume) => {}
        Message::Request(Request::SetLength(length_m)) => to.f32(*length_m),
        Message::Acknowledgement(answer) => to.u8(match answer {
            Ok(()) => 0,
            Err(refusal) => *refusal as u8,
        }),
        Message::Telemetry(telemetry) => {
            let mut flags = 0;
            if telemetry.length_m.is_some() {
                flags |= LENGTH_KNOWN;
            }
            if telemetry.pressure_kpa.is_some() {
                flags |= PRESSURE_KNOWN;
            }
            to.u32(telemetry.time_ms);
            to.u32(telemetry.setpoint_age_ms.unwrap_or(NO_SETPOINT));
            to.u8(flags);
            to.f32(telemetry.length_m.unwrap_or(0.0));
            to.f32(telemetry.pressure_kpa.unwrap_or(0.0));
            to.f32(telemetry.growth_rate_m_s);
            to.f32(telemetry.growth_duty);
            to.u8(telemetry.air as u8);
            to.u8(telemetry.state.code());
            to.u32(telemetry.frames_received);
            to.u32(telemetry.frames_rejected);
        }
    }
}

/// Reads the payload of a kind. Requests keep what is not finite, for the arm to refuse it by name; telemetry with a
/// value that is not finite is rejected.
pub(super) fn read(kind: u8, payload: &[u8]) -> Result<Message, FrameError> {
    let mut from = Reader { rest: payload };
    let message = match kind {
        SETPOINT => {
            from.expect_length(8)?;
            Message::Request(Request::Setpoint(Setpoint {
                growth_rate_m_s: from.f32(),
                pressure_kpa: from.f32(),
            }))
        }
        STOP => {
            from.expect_length(0)?;
            Message::Request(Request::Stop)
        }
        RESUME => {
            from.expect_length(0)?;
            Message::Request(Request::Resume)
        }
        SET_LENGTH => {
            from.expect_length(4)?;
            Message::Request(Request::SetLength(from.f32()))
        }
        ACKNOWLEDGEMENT => {
            from.expect_length(1)?;
            Message::Acknowledgement(match from.u8() {
                0 => Ok(()),
                code => Err(Refusal::from_code(code).ok_or(FrameError::Value("refusal"))?),
            })
        }
        TELEMETRY => {
            from.expect_length(MAX_PAYLOAD)?;
            Message::Telemetry(telemetry(&mut from)?)
        }
        other => return Err(FrameError::Kind(other)),
    };
    Ok(message)
}

fn telemetry(from: &mut Reader) -> Result<Telemetry, FrameError> {
    let time_ms = from.u32();
    let setpoint_age_ms = Some(from.u32()).filter(|&age| age != NO_SETPOINT);
    let flags = from.u8();
    if flags & !(LENGTH_KNOWN | PRESSURE_KNOWN) != 0 {
        return Err(FrameError::Value("flags"));
    }
    let length_m = from.finite("length")?;
    let pressure_kpa = from.finite("pressure")?;
    Ok(Telemetry {
        time_ms,
        setpoint_age_ms,
        length_m: (flags & LENGTH_KNOWN != 0).then_some(length_m),
        pressure_kpa: (flags & PRESSURE_KNOWN != 0).then_some(pressure_kpa),
        growth_rate_m_s: from.finite("growth rate")?,
        growth_duty: from.finite("growth duty")?,
        air: Air::from_code(from.u8()).ok_or(FrameError::Value("pump state"))?,
        state: State::from_code(from.u8()).ok_or(FrameError::Value("state"))?,
        frames_received: from.u32(),
        frames_rejected: from.u32(),
    })
}

/// Bytes as they are written; N is enough for any frame.
pub(super) struct Writer<const N: usize> {
    bytes: [u8; N],
    length: usize,
}

impl<const N: usize> Writer<N> {
    pub(super) fn new() -> Self {
        Writer {
            bytes: [0; N],
            length: 0,
        }
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes[..self.length]
    }

    fn put(&mut self, bytes: &[u8]) {
        self.bytes[self.length..self.length + bytes.len()].copy_from_slice(bytes);
        self.length += bytes.len();
    }

    pub(super) fn u8(&mut self, value: u8) {
        self.put(&[value]);
    }

    pub(super) fn u16(&mut self, value: u16) {
        self.put(&value.to_le_bytes());
    }

    fn u32(&mut self, value: u32) {
        self.put(&value.to_le_bytes());
    }

    fn f32(&mut self, value: f32) {
        self.put(&value.to_le_bytes());
    }
}

/// Bytes as they are read, after their number has been checked.
struct Reader<'a> {
    rest: &'a [u8],
}

impl Reader<'_> {
    fn expect_length(&self, expected: usize) -> Result<(), FrameError> {
        let found = self.rest.len();
        if found == expected {
            Ok(())
        } else {
            Err(FrameError::Length { found, expected })
        }
    }

    fn take<const N: usize>(&mut self) -> [u8; N] {
        let (value, rest) = self
            .rest
            .split_first_chunk()
            .expect("the length has been checked");
        self.rest = rest;
        *value
    }

    fn u8(&mut self) -> u8 {
        u8::from_le_bytes(self.take())
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }

    fn f32(&mut self) -> f32 {
        f32::from_le_bytes(self.take())
    }

    fn finite(&mut self, name: &'static str) -> Result<f32, FrameError> {
        let value = self.f32();
        if value.is_finite() {
            Ok(value)
        } else {
            Err(FrameError::Value(name))
        }
    }
}
