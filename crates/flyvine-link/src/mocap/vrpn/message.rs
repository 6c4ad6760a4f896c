//! Bytes to messages and back: the cookie that opens a connection, and the framing of everything after it.

/// Length of the cookie that each side sends first, bytes.
pub const COOKIE_LENGTH: usize = 24;
/// Length of a message's header, bytes.
pub const HEADER_LENGTH: usize = 24;
/// Longest message that is accepted, bytes: the reference implementation's TCP buffer.
pub const LONGEST_MESSAGE: usize = 64_000;
/// Longest datagram that is sent, bytes.
pub const LONGEST_DATAGRAM: usize = 1472;
/// Longest name of a device or message type, bytes with the NUL: the reference implementation's.
pub const LONGEST_NAME: usize = 100;

/// Type of the message that names a sender.
pub const SENDER_DESCRIPTION: i32 = -1;
/// Type of the message that names a message type.
pub const TYPE_DESCRIPTION: i32 = -2;
/// Type of the message that says where its sender wants low-latency messages.
pub const UDP_DESCRIPTION: i32 = -3;

const MAGIC: &[u8] = b"vrpn: ver. 07.";
const COOKIE: &[u8; COOKIE_LENGTH] = b"vrpn: ver. 07.38  0\0\0\0\0\0";
const LOG_MODE: usize = 18;

/// What a peer sent that is not VRPN, or not to be accepted.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum VrpnError {
    /// The peer's cookie is of another protocol, or of another major version.
    #[error("the peer says `{found}`, expected `vrpn: ver. 07.…`")]
    Cookie {
        /// Its first bytes, as text.
        found: String,
    },
    /// The peer asks that this side write a log file of its naming.
    #[error("the peer asks for log mode `{found}`, expected `0` (nothing is logged for a peer)")]
    LogMode {
        /// The mode it asks for.
        found: char,
    },
    /// A length outside its bounds.
    #[error("found {what} of {found} bytes, expected {expected}")]
    Length {
        /// What is so long, or short.
        what: &'static str,
        /// Its length, bytes.
        found: u64,
        /// What is allowed.
        expected: &'static str,
    },
    /// The peer names more senders or types than anyone needs.
    #[error("the peer describes {what} {found}, expected 0 … {last}")]
    Identifier {
        /// Senders or types.
        what: &'static str,
        /// The identifier.
        found: i32,
        /// The last one accepted.
        last: i32,
    },
}

/// The cookie that this side sends: version 07.38, asking for no log.
pub fn cookie() -> [u8; COOKIE_LENGTH] {
    *COOKIE
}

/// The peer's version from its cookie, such as `07.38`.
///
/// # Errors
/// Another protocol or major version; a request for a log.
pub fn read_cookie(cookie: &[u8; COOKIE_LENGTH]) -> Result<String, VrpnError> {
    if !cookie.starts_with(MAGIC) {
        let shown = String::from_utf8_lossy(&cookie[..LOG_MODE]);
        let found = shown.escape_default().to_string();
        return Err(VrpnError::Cookie { found });
    }
    if cookie[LOG_MODE] != b'0' {
        let found = cookie[LOG_MODE].into();
        return Err(VrpnError::LogMode { found });
    }
    let version = String::from_utf8_lossy(&cookie[MAGIC.len() - 3..LOG_MODE]);
    Ok(version.trim_matches([' ', '\0']).to_owned())
}

/// One message.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// Unix time of its sender's clock, s; carried in microseconds.
    pub time_s: f64,
    /// Index into the sending side's table of senders; another number in system messages.
    pub sender: i32,
    /// Index into the sending side's table of types; negative in system messages.
    pub kind: i32,
    /// Counts the sending side's messages; receivers ignore it.
    pub sequence: u32,
    /// Its content.
    pub payload: Vec<u8>,
}

impl Message {
    /// Appends the message to `out`, padded. A payload longer than [`LONGEST_MESSAGE`] allows is the caller's bug
    /// and would be refused by the receiver.
    pub fn write(&self, out: &mut Vec<u8>) {
        let microseconds = (self.time_s.max(0.0) * 1e6).round() as u64;
        let length = (HEADER_LENGTH + self.payload.len()) as u32;
        out.extend(length.to_be_bytes());
        out.extend(((microseconds / 1_000_000) as u32).to_be_bytes());
        out.extend(((microseconds % 1_000_000) as u32).to_be_bytes());
        out.extend(self.sender.to_be_bytes());
        out.extend(self.kind.to_be_bytes());
        out.extend(self.sequence.to_be_bytes());
        out.extend(&self.payload);
        out.resize(out.len() + padding(self.payload.len()), 0);
    }

    /// The first message in `bytes` and how many bytes it takes; `None` if its end has not come yet.
    ///
    /// # Errors
    /// A length that no message has: there is no way to find the next one.
    pub fn read(bytes: &[u8]) -> Result<Option<(Message, usize)>, VrpnError> {
        let mut reader = Reader(bytes);
        let Some(length) = reader.u32() else {
            return Ok(None);
        };
        let expected = "24 … 64000";
        let (what, found) = ("a message", u64::from(length));
        let length = length as usize;
        if !(HEADER_LENGTH..=LONGEST_MESSAGE).contains(&length) {
            return Err(VrpnError::Length {
                what,
                found,
                expected,
            });
        }
        let payload_length = length - HEADER_LENGTH;
        let size = length + padding(payload_length);
        if bytes.len() < size {
            return Ok(None);
        }
        Ok(reader.header(payload_length).map(|message| (message, size)))
    }
}

/// Zeros after a payload: the whole message takes a multiple of eight bytes.
fn padding(payload_length: usize) -> usize {
    payload_length.next_multiple_of(8) - payload_length
}

/// Big-endian fields, taken from the front of a slice.
pub(super) struct Reader<'a>(pub &'a [u8]);

impl Reader<'_> {
    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (first, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*first)
    }

    pub(super) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_be_bytes)
    }

    pub(super) fn i32(&mut self) -> Option<i32> {
        self.array().map(i32::from_be_bytes)
    }

    pub(super) fn f64s<const N: usize>(&mut self) -> Option<[f64; N]> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.array().map(f64::from_be_bytes)?;
        }
        Some(numbers)
    }

    /// What follows the length in a message.
    fn header(&mut self, payload_length: usize) -> Option<Message> {
        let (seconds, microseconds) = (self.u32()?, self.u32()?);
        Some(Message {
            time_s: f64::from(seconds) + 1e-6 * f64::from(microseconds),
            sender: self.i32()?,
            kind: self.i32()?,
            sequence: self.u32()?,
            payload: self.0.get(..payload_length)?.to_vec(),
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_sender_description_is_what_the_reference_sends() {
        let message = Message {
            time_s: 1_700_000_000.25,
            sender: 1,
            kind: SENDER_DESCRIPTION,
            sequence: 7,
            payload: b"\0\0\0\x07Drone1\0".to_vec(),
        };
        let mut bytes = Vec::new();
        message.write(&mut bytes);
        let expected: [&[u8]; 4] = [
            &[0, 0, 0, 35, 0x65, 0x53, 0xf1, 0x00, 0, 3, 0xd0, 0x90],
            &[0, 0, 0, 1, 0xff, 0xff, 0xff, 0xff, 0, 0, 0, 7],
            &[0, 0, 0, 7, 0x44, 0x72, 0x6f, 0x6e, 0x65, 0x31, 0],
            &[0; 5],
        ];
        assert_eq!(bytes, expected.concat());
        assert_eq!(bytes.len(), 40);
    }

    #[test]
    fn cookies_are_accepted_by_major_version_and_without_log() {
        let expected = "76 72 70 6e 3a 20 76 65 72 2e 20 30 37 2e 33 38 20 20 30 00 00 00 00 00";
        let hex: Vec<String> = cookie().iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(hex.join(" "), expected);
        assert_eq!(read_cookie(&cookie()), Ok("07.38".to_owned()));
        assert_eq!(
            read_cookie(b"vrpn: ver. 07.24  0\0\0\0\0\0"),
            Ok("07.24".to_owned())
        );
        let refused = |cookie: &[u8; COOKIE_LENGTH]| read_cookie(cookie).unwrap_err();
        assert!(matches!(
            refused(b"vrpn: ver. 08.01  0\0\0\0\0\0"),
            VrpnError::Cookie { .. }
        ));
        assert!(matches!(
            refused(b"GET / HTTP/1.1\r\n\r\n......"),
            VrpnError::Cookie { .. }
        ));
        for mode in ['1', '2', '3', 'x', '\0'] {
            let mut cookie = cookie();
            cookie[18] = mode as u8;
            assert_eq!(refused(&cookie), VrpnError::LogMode { found: mode });
        }
    }

    #[test]
    fn impossible_lengths_are_refused() {
        for length in [0_u32, 23, 64_001, u32::MAX] {
            assert!(Message::read(&length.to_be_bytes()).is_err());
        }
    }

    proptest! {
        #[test]
        fn messages_survive_a_round_trip(
            microseconds in 0..u64::from(u32::MAX) * 1_000_000,
            ids in any::<(i32, i32, u32)>(),
            payload in prop::collection::vec(any::<u8>(), 0..200),
            rest in prop::collection::vec(any::<u8>(), 0..30),
        ) {
            let (sender, kind, sequence) = ids;
            // As the receiver computes it.
            let time_s = (microseconds / 1_000_000) as f64 + 1e-6 * (microseconds % 1_000_000) as f64;
            let message = Message { time_s, sender, kind, sequence, payload };
            let mut bytes = Vec::new();
            message.write(&mut bytes);
            prop_assert_eq!(bytes.len() % 8, 0);
            let size = bytes.len();
            for end in 0..size {
                prop_assert_eq!(Message::read(&bytes[..end]).unwrap(), None);
            }
            bytes.extend(rest);
            prop_assert_eq!(Message::read(&bytes).unwrap(), Some((message, size)));
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let _ = Message::read(&bytes);
        }
    }
}
