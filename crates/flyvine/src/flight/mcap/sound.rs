//! What of an MCAP file the crate `mcap` may be given.

use ::mcap::MAGIC;
use ::mcap::records::op::CHUNK;

/// Opcode and length in front of every record, bytes.
const RECORD_HEAD: usize = 1 + 8;
/// Times, size and checksum in front of a chunk's compression, bytes.
const CHUNK_HEAD: usize = 8 + 8 + 8 + 4;

/// The part of an MCAP file in front of its first chunk in which a record is longer than what is left of the chunk. It is the
/// whole file but for damaged ones: of those, the crate `mcap` 0.26 adds and subtracts these lengths, and panics wherever
/// overflow is checked.
pub fn sound_mcap(bytes: &[u8]) -> &[u8] {
    let mut at = MAGIC.len();
    while let Some(record) = bytes.get(at..).and_then(Counted::record) {
        if bytes[at] == CHUNK && !records_fit(record.there) {
            return &bytes[..at];
        }
        let Some(next) = record.length.checked_add(at + RECORD_HEAD) else {
            break;
        };
        at = next;
    }
    bytes
}

/// Whether a chunk's records, as far as they are there, keep within it; of a compressed one, or one without a head, others
/// judge.
fn records_fit(chunk: &[u8]) -> bool {
    let Some((compression, rest)) = chunk
        .get(CHUNK_HEAD..)
        .and_then(|rest| Some((Counted::new(rest, 4)?, &rest[4..])))
    else {
        return true;
    };
    let Some(records) = Counted::new(rest, 8).filter(|_| compression.length == 0) else {
        return true;
    };
    let mut at = 0;
    while let Some(record) = records.there.get(at..).and_then(Counted::record) {
        match record.length.checked_add(at + RECORD_HEAD) {
            Some(next) if next <= records.length => at = next,
            _ => return false,
        }
    }
    // At the end, or cut off in a record that had room.
    at == records.length || records.length - at >= RECORD_HEAD
}

/// Bytes behind their length, as far as they are there: a file may be cut off anywhere.
struct Counted<'a> {
    length: usize,
    there: &'a [u8],
}

impl<'a> Counted<'a> {
    /// What a length of `width` little-endian bytes is in front of; `None` where not even the length is there.
    fn new(bytes: &'a [u8], width: usize) -> Option<Self> {
        let mut length = [0; 8];
        length[..width].copy_from_slice(bytes.get(..width)?);
        let length = usize::try_from(u64::from_le_bytes(length)).unwrap_or(usize::MAX);
        let there = &bytes[width..];
        let there = &there[..length.min(there.len())];
        Some(Self { length, there })
    }

    /// What is behind a record's opcode and length.
    fn record(bytes: &'a [u8]) -> Option<Self> {
        Self::new(bytes.get(1..)?, 8)
    }
}
