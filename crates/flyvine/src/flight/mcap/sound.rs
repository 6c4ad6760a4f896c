//! What of an MCAP file the crate `mcap` may be given.

use ::mcap::MAGIC;
use ::mcap::records::op::CHUNK;

/// Opcode and length in front of every record, bytes.
const RECORD_HEAD: usize = 1 + 8;
/// Times, size and checksum in front of a chunk's compression, bytes.
const CHUNK_HEAD: usize = 8 + 8 + 8 + 4;

/// The part of an MCAP file in front of its first chunk in which a record is longer than what is left of the chunk. It is the
/// whole file but for damaged ones: of those, the crate `mcap` 0.26 subtracts the one length from the other, and panics
/// wherever overflow is checked.
pub fn sound_mcap(bytes: &[u8]) -> &[u8] {
    let mut at = MAGIC.len();
    while let Some((opcode, body, next)) = record(bytes, at) {
        if opcode == CHUNK && !records_fit(body) {
            return &bytes[..at];
        }
        at = next;
    }
    bytes
}

/// The opcode and body of the record at a place, and the place behind it; `None` where there is no whole one.
fn record(bytes: &[u8], at: usize) -> Option<(u8, &[u8], usize)> {
    let (body, length) = sized(bytes.get(at + 1..)?, 8)?;
    Some((bytes[at], body, at + RECORD_HEAD + length))
}

/// Whether a chunk's records fill it; of a compressed one, or one without a head, others judge.
fn records_fit(chunk: &[u8]) -> bool {
    let Some((compression, length)) = chunk.get(CHUNK_HEAD..).and_then(|rest| sized(rest, 4)) else {
        return true;
    };
    let Some((records, _)) = chunk
        .get(CHUNK_HEAD + 4 + length..)
        .and_then(|rest| sized(rest, 8))
    else {
        return true;
    };
    let mut at = 0;
    while compression.is_empty() && at < records.len() {
        match record(records, at) {
            Some((_, _, next)) => at = next,
            None => return false,
        }
    }
    true
}

/// What a length of `width` little-endian bytes is in front of, and that length.
fn sized(bytes: &[u8], width: usize) -> Option<(&[u8], usize)> {
    let mut length = [0; 8];
    length[..width].copy_from_slice(bytes.get(..width)?);
    let length = usize::try_from(u64::from_le_bytes(length)).ok()?;
    Some((bytes[width..].get(..length)?, length))
}
