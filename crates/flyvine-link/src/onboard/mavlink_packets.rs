//! Where MAVLink packets begin and end in a stream of bytes.
//!
//! A packet is found by its first byte and its length; the checksum needs a table of all messages and is left to the
//! receiver. (MAVLink guide, "Packet Serialization": v1 has 8 bytes around its payload, v2 has 12, and a signature of 13
//! if bit 0 of its incompatibility flags is set.)

const MAGIC_V1: u8 = 0xFE;
const MAGIC_V2: u8 = 0xFD;
/// The only incompatibility flag there is.
const SIGNED: u8 = 0x01;
/// The longest packet, signed v2, bytes.
const MAX_PACKET: usize = 12 + 255 + 13;

/// Cuts a stream into packets.
#[derive(Debug, Default)]
pub(super) struct PacketSplitter {
    buffer: Vec<u8>,
    /// Bytes that belonged to no packet.
    pub(super) skipped: u64,
}

impl PacketSplitter {
    /// Takes `bytes` and calls `each` with every packet that they complete.
    pub(super) fn extend(&mut self, bytes: &[u8], mut each: impl FnMut(&[u8])) {
        self.buffer.extend_from_slice(bytes);
        let mut rest = &self.buffer[..];
        while !rest.is_empty() {
            match packet_length(rest) {
                Some(Some(length)) if rest.len() >= length => {
                    each(&rest[..length]);
                    rest = &rest[length..];
                }
                // The rest of it is still to come.
                Some(_) => break,
                None => {
                    self.skipped += 1;
                    rest = &rest[1..];
                }
            }
        }
        let taken = self.buffer.len() - rest.len();
        self.buffer.drain(..taken);
    }

    /// Whether the bytes so far end inside a packet.
    pub(super) fn is_cut(&self) -> bool {
        !self.buffer.is_empty()
    }
}

/// The length of the packet that `bytes` begin with: `Some(None)` if more bytes are needed to tell, `None` if they begin
/// with none.
fn packet_length(bytes: &[u8]) -> Option<Option<usize>> {
    let length = match bytes {
        [MAGIC_V1] | [MAGIC_V2] | [MAGIC_V2, _] => return Some(None),
        [MAGIC_V1, payload, ..] => 8 + usize::from(*payload),
        [MAGIC_V2, payload, 0, ..] => 12 + usize::from(*payload),
        [MAGIC_V2, payload, SIGNED, ..] => 12 + usize::from(*payload) + 13,
        _ => return None,
    };
    debug_assert!(length <= MAX_PACKET);
    Some(Some(length))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn v1(payload: u8) -> Vec<u8> {
        let mut packet = vec![MAGIC_V1, payload];
        packet.extend(std::iter::repeat_n(0x55, 6 + usize::from(payload)));
        packet
    }

    fn v2(payload: u8, flags: u8) -> Vec<u8> {
        let mut packet = vec![MAGIC_V2, payload, flags];
        let signature = if flags == SIGNED { 13 } else { 0 };
        packet.extend(std::iter::repeat_n(0x55, 9 + usize::from(payload) + signature));
        packet
    }

    #[test]
    fn packets_come_out_whole_however_they_arrive() {
        let packets = [v2(255, SIGNED), v1(0), v2(0, 0), v1(255), v2(9, 0)];
        let stream = packets.concat();
        for chunk in [1, 2, 3, 7, 64, 1000] {
            let (mut splitter, mut found) = (PacketSplitter::default(), Vec::new());
            for bytes in stream.chunks(chunk) {
                splitter.extend(bytes, |packet| found.push(packet.to_vec()));
            }
            assert_eq!(found, packets);
            assert_eq!(splitter.skipped, 0);
        }
    }

    #[test]
    fn what_is_no_packet_is_skipped() {
        let (mut splitter, mut found) = (PacketSplitter::default(), Vec::new());
        let noise = [0, 1, 2, MAGIC_V2, 9, 0x80, 3];
        splitter.extend(&[&noise[..], &v1(4)].concat(), |packet| {
            found.push(packet.to_vec())
        });
        assert_eq!(found, [v1(4)]);
        assert_eq!(splitter.skipped, noise.len() as u64);
    }
}
