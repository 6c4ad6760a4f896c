//! Bytes on the line.
//!
//! ```text
//! 00 | COBS( version u8 | kind u8 | sequence u16 | payload | CRC-16 u16 ) | 00        numbers little-endian
//! ```
//!
//! Byte stuffing (COBS: Cheshire and Baker, IEEE/ACM Trans. Networking 7(2), 1999) keeps zeros out of a frame, so that
//! a zero always is a frame's end: after any corruption the next frame is read whole. The leading zero flushes whatever
//! noise came before. The CRC is CRC-16/IBM-3740 (polynomial 0x1021, start 0xFFFF): it finds every error of up to three
//! bits and every burst of up to 16. A payload has exactly the length of its kind.

mod payload;
#[cfg(test)]
mod tests;

use crc::{CRC_16_IBM_3740, Crc, Table};

use crate::message::Frame;
use payload::{MAX_PAYLOAD, Writer};

/// The protocol's version; a frame of another version is rejected.
pub const VERSION: u8 = 1;

/// Version, kind, sequence.
const HEADER: usize = 4;
const CHECKSUM: usize = 2;
const MAX_PLAIN: usize = HEADER + MAX_PAYLOAD + CHECKSUM;
/// COBS adds one byte for every 254.
const MAX_STUFFED: usize = MAX_PLAIN + 1;

/// The longest frame with both zeros, bytes.
pub const MAX_FRAME: usize = MAX_STUFFED + 2;

// The table is 512 bytes of flash.
static CRC: Crc<u16, Table<1>> = Crc::<u16, Table<1>>::new(&CRC_16_IBM_3740);

/// Why a frame was rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// More bytes without a zero than any frame has.
    #[error("longer than any frame")]
    TooLong,
    /// Its byte stuffing is broken.
    #[error("broken byte stuffing")]
    Stuffing,
    /// Too short for header and checksum.
    #[error("{0} bytes: shorter than any frame")]
    TooShort(usize),
    /// Corrupted.
    #[error("checksum {found:#06x}, expected {expected:#06x}")]
    Checksum {
        /// In the frame.
        found: u16,
        /// Of its bytes.
        expected: u16,
    },
    /// The other side speaks another version.
    #[error("protocol version {0}, expected {VERSION}")]
    Version(u8),
    /// A kind of message that this version does not have.
    #[error("unknown kind {0:#04x}")]
    Kind(u8),
    /// The payload is not as long as its kind's.
    #[error("payload of {found} bytes, expected {expected}")]
    Length {
        /// In the frame.
        found: usize,
        /// Of its kind.
        expected: usize,
    },
    /// A field with a value that it cannot have.
    #[error("impossible {0}")]
    Value(&'static str),
}

/// A frame as bytes, with both zeros.
#[derive(Debug, Clone, Copy)]
pub struct Encoded {
    bytes: [u8; MAX_FRAME],
    length: usize,
}

impl core::ops::Deref for Encoded {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.bytes[..self.length]
    }
}

impl Frame {
    /// The bytes of this frame.
    pub fn encode(&self) -> Encoded {
        let mut plain = Writer::<MAX_PLAIN>::new();
        plain.u8(VERSION);
        plain.u8(payload::kind(&self.message));
        plain.u16(self.sequence);
        payload::write(&self.message, &mut plain);
        plain.u16(CRC.checksum(plain.bytes()));

        let mut bytes = [0; MAX_FRAME];
        let stuffed = cobs::encode(plain.bytes(), &mut bytes[1..]);
        Encoded {
            bytes,
            length: stuffed + 2,
        }
    }
}

/// Finds frames in a stream of bytes.
#[derive(Debug, Clone)]
pub struct Decoder {
    /// The stuffed frame so far.
    stuffed: [u8; MAX_STUFFED],
    length: usize,
    /// More bytes came than fit: skip to the next zero.
    overrun: bool,
}

impl Default for Decoder {
    fn default() -> Self {
        Decoder::new()
    }
}

impl Decoder {
    /// A decoder at the start of a stream, or anywhere in one.
    pub const fn new() -> Decoder {
        Decoder {
            stuffed: [0; MAX_STUFFED],
            length: 0,
            overrun: false,
        }
    }

    /// Takes one byte; a zero may end a frame, good or bad.
    pub fn push(&mut self, byte: u8) -> Option<Result<Frame, FrameError>> {
        if byte != 0 {
            match self.stuffed.get_mut(self.length) {
                Some(slot) => {
                    *slot = byte;
                    self.length += 1;
                }
                None => self.overrun = true,
            }
            return None;
        }
        let length = core::mem::take(&mut self.length);
        if core::mem::take(&mut self.overrun) {
            return Some(Err(FrameError::TooLong));
        }
        // Two zeros in a row: the end of one frame and the beginning of the next.
        (length > 0).then(|| decode(&self.stuffed[..length]))
    }

    /// Takes `bytes` and calls `each` for every frame that they complete.
    pub fn extend(&mut self, bytes: &[u8], mut each: impl FnMut(Result<Frame, FrameError>)) {
        for &byte in bytes {
            if let Some(frame) = self.push(byte) {
                each(frame);
            }
        }
    }
}

/// Reads one stuffed frame without its zeros.
fn decode(stuffed: &[u8]) -> Result<Frame, FrameError> {
    let mut buffer = [0; MAX_STUFFED];
    let report = cobs::decode(stuffed, &mut buffer).map_err(|_| FrameError::Stuffing)?;
    let plain = &buffer[..report.frame_size()];
    let (Some(body), true) = (
        plain.len().checked_sub(CHECKSUM),
        plain.len() >= HEADER + CHECKSUM,
    ) else {
        return Err(FrameError::TooShort(plain.len()));
    };
    let (body, checksum) = plain.split_at(body);
    let found = u16::from_le_bytes([checksum[0], checksum[1]]);
    let expected = CRC.checksum(body);
    if found != expected {
        return Err(FrameError::Checksum { found, expected });
    }
    if body[0] != VERSION {
        return Err(FrameError::Version(body[0]));
    }
    Ok(Frame {
        sequence: u16::from_le_bytes([body[2], body[3]]),
        message: payload::read(body[1], &body[HEADER..])?,
    })
}
