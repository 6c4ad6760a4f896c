//! What of an MCAP file the crate `mcap` may be given.

use ::mcap::MAGIC;
use ::mcap::records::op;

/// Opcode and length in front of every record, bytes.
const RECORD_HEAD: usize = 1 + 8;
/// Times, size and checksum in front of a chunk's compression, bytes.
const CHUNK_HEAD: usize = 8 + 8 + 8 + 4;

/// The part of an MCAP file in front of its first record that is damaged in a way that the crate `mcap` 0.26 does not look
/// for: a string longer than its record, of which it allocates the length; a record longer than what is left of its chunk, of
/// which it adds and subtracts the lengths and panics wherever overflow is checked; or one whose end no number counts.
pub fn sound_mcap(bytes: &[u8]) -> &[u8] {
    let mut at = MAGIC.len();
    while let Some(record) = bytes.get(at..).and_then(Counted::record) {
        let opcode = bytes[at];
        if !strings_fit(opcode, &record) || (opcode == op::CHUNK && !records_fit(record.there)) {
            return &bytes[..at];
        }
        let Some(next) = record.length.checked_add(at + RECORD_HEAD) else {
            return &bytes[..at];
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
        if !strings_fit(records.there[at], &record) {
            return false;
        }
        match record.length.checked_add(at + RECORD_HEAD) {
            Some(next) if next <= records.length => at = next,
            _ => return false,
        }
    }
    // At the end, or cut off in a record that had room.
    at == records.length || records.length - at >= RECORD_HEAD
}

/// Whether a record's strings keep within it; of a record that is not all there, nothing is read.
fn strings_fit(opcode: u8, record: &Counted) -> bool {
    if record.there.len() < record.length {
        return true;
    }
    // In front of its strings, bytes; how many there are; whether a map of others follows.
    let (head, strings, map) = match opcode {
        op::HEADER => (0, 2, false),
        op::SCHEMA => (2, 2, false),
        op::CHANNEL => (4, 2, true),
        op::CHUNK => (CHUNK_HEAD, 1, false),
        op::CHUNK_INDEX => (chunk_index_head(record.there), 1, false),
        op::ATTACHMENT => (2 * 8, 2, false),
        op::ATTACHMENT_INDEX => (5 * 8, 2, false),
        op::METADATA => (0, 1, true),
        op::METADATA_INDEX => (2 * 8, 1, false),
        _ => return true,
    };
    let all_fit = || {
        let mut rest = record.there.get(head..).unwrap_or_default();
        for _ in 0..strings {
            rest = behind_string(rest)?;
        }
        if let Some(entries) = Counted::new(rest, 4).filter(|_| map) {
            // The count is of bytes; strings are read until they are used up.
            rest = &rest[4..];
            let end = rest.len().saturating_sub(entries.length);
            while rest.len() > end {
                rest = behind_string(rest)?;
            }
        }
        Some(())
    };
    all_fit().is_some()
}

/// What is in front of a chunk index's compression, bytes: times, place and length of the chunk, pairs of a channel (2) and an
/// offset (8) until as many bytes as their count are read, and the length of the message index.
fn chunk_index_head(index: &[u8]) -> usize {
    const OFFSETS: usize = 4 * 8;
    const PAIR: usize = 2 + 8;
    let offsets = index.get(OFFSETS..).and_then(|rest| Counted::new(rest, 4));
    OFFSETS + 4 + offsets.map_or(0, |pairs| pairs.length.next_multiple_of(PAIR)) + 8
}

/// What is behind the string that `bytes` begin with, which is nothing where not even its length is there; `None` if it is longer
/// than they are.
fn behind_string(bytes: &[u8]) -> Option<&[u8]> {
    match Counted::new(bytes, 4) {
        Some(string) => bytes[4..].get(string.length..),
        None => Some(&[]),
    }
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
