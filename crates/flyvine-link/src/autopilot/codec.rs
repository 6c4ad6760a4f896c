//! MAVLink frames: bytes in, messages out, and back; with the signatures of MAVLink 2.

use std::collections::VecDeque;
use std::fmt;

use mavlink::dialects::common::MavMessage;
use mavlink::error::MessageReadError;
use mavlink::{MavHeader, MavlinkReader, SigningConfig, SigningData, write_v2_msg_signed};

/// Who sends a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Identity {
    /// System, 1 to 255.
    pub system: u8,
    /// Component, 1 to 255.
    pub component: u8,
}

/// The key that both ends of a link share: frames are signed, and unsigned or badly signed ones refused
/// (<https://mavlink.io/en/guide/message_signing.html>).
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct SigningKey(pub [u8; 32]);

impl fmt::Debug for SigningKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SigningKey(…)")
    }
}

/// A key that is not one.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("signing key: found {found}; expected 64 hexadecimal digits")]
pub struct SigningKeyError {
    /// What is wrong with it; never the key itself.
    pub found: String,
}

impl SigningKey {
    /// Reads 64 hexadecimal digits.
    pub fn parse(text: &str) -> Result<Self, SigningKeyError> {
        let text = text.trim();
        let digits: Option<Vec<u8>> = text
            .chars()
            .map(|c| c.to_digit(16).map(|digit| digit as u8))
            .collect();
        match digits {
            Some(digits) if digits.len() == 64 => Ok(Self(std::array::from_fn(|i| {
                16 * digits[2 * i] + digits[2 * i + 1]
            }))),
            Some(digits) => Err(SigningKeyError {
                found: format!("{} digits", digits.len()),
            }),
            None => Err(SigningKeyError {
                found: "another character".to_owned(),
            }),
        }
    }
}

/// One end of a link.
pub struct Codec {
    identity: Identity,
    sequence: u8,
    signing: Option<SigningData>,
    reader: MavlinkReader<VecDeque<u8>>,
    unreadable: u64,
}

impl Codec {
    /// Speaks as `identity`; with a key, signs and wants signatures.
    pub fn new(identity: Identity, key: Option<SigningKey>) -> Self {
        Self {
            identity,
            sequence: 0,
            signing: key.map(|key| SigningData::from_config(SigningConfig::new(key.0, 0, true, false))),
            reader: MavlinkReader::new(VecDeque::new()),
            unreadable: 0,
        }
    }

    /// The frame of one message.
    pub fn encode(&mut self, message: &MavMessage) -> Vec<u8> {
        let header = MavHeader {
            system_id: self.identity.system.into(),
            component_id: self.identity.component,
            sequence: self.sequence,
        };
        self.sequence = self.sequence.wrapping_add(1);
        let mut frame = Vec::with_capacity(64);
        write_v2_msg_signed(&mut frame, header, message, self.signing.as_ref())
            .expect("a vector takes whatever is written to it");
        frame
    }

    /// Takes in bytes as they come: any number of frames, whole or in parts.
    pub fn feed(&mut self, bytes: &[u8]) {
        self.reader.get_mut().extend(bytes);
    }

    /// The next message, `None` until more bytes come. Frames of MAVLink 1, with a wrong checksum, of unknown messages or,
    /// on a signed link, without a valid signature are passed over.
    pub fn decode(&mut self) -> Option<(MavHeader, MavMessage)> {
        loop {
            let version = mavlink::MavlinkVersion::V2;
            match self
                .reader
                .read_message_signed::<MavMessage>(version, self.signing.as_ref())
            {
                Ok(message) => return Some(message),
                // The queue is empty.
                Err(MessageReadError::Io(_)) => return None,
                // A value that its field cannot have.
                Err(MessageReadError::Parse(_)) => self.unreadable += 1,
            }
        }
    }

    /// Messages with impossible values so far.
    pub fn unreadable(&self) -> u64 {
        self.unreadable
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink::dialects::common::{HEARTBEAT_DATA, MavAutopilot, MavModeFlag, MavState, MavType};
    use proptest::prelude::*;

    const HERE: Identity = Identity {
        system: 245,
        component: 190,
    };

    fn heartbeat(custom_mode: u32) -> MavMessage {
        MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode,
            mavtype: MavType::MAV_TYPE_GCS,
            autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
            base_mode: MavModeFlag::empty(),
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
        })
    }

    fn all(codec: &mut Codec) -> Vec<MavMessage> {
        std::iter::from_fn(|| codec.decode())
            .map(|(_, message)| message)
            .collect()
    }

    #[test]
    fn a_signed_link_takes_nothing_else() {
        let key = SigningKey::parse(&"0f".repeat(32)).unwrap();
        let other = SigningKey::parse(&"aa".repeat(32)).unwrap();
        let heard = |from: Option<SigningKey>, to: Option<SigningKey>| {
            let mut receiver = Codec::new(HERE, to);
            receiver.feed(&Codec::new(HERE, from).encode(&heartbeat(1)));
            all(&mut receiver).len()
        };
        assert_eq!(heard(Some(key), Some(key)), 1);
        assert_eq!(heard(None, Some(key)), 0);
        assert_eq!(heard(Some(other), Some(key)), 0);
        assert_eq!(heard(Some(key), None), 1, "an unsigned link does not look");
        // The same frame twice is a replay.
        let frame = Codec::new(HERE, Some(key)).encode(&heartbeat(1));
        let mut receiver = Codec::new(HERE, Some(key));
        receiver.feed(&frame);
        receiver.feed(&frame);
        assert_eq!(all(&mut receiver).len(), 1);
    }

    #[test]
    fn keys_are_64_digits_and_are_never_shown() {
        for (text, found) in [("12", "2 digits"), (&"zz".repeat(32), "another character")] {
            assert_eq!(SigningKey::parse(text).unwrap_err().found, found);
        }
        let key = SigningKey::parse(&"0f".repeat(32)).unwrap();
        assert_eq!((key.0[0], format!("{key:?}")), (15, "SigningKey(…)".to_owned()));
    }

    proptest! {
        /// Whatever lies between frames and however they are cut, whole frames come through and nothing else.
        #[test]
        fn frames_survive_noise_and_cuts(
            noise in prop::collection::vec(prop::collection::vec(0_u8..0xfd, 0..20), 1..20),
            cut in 1..40_usize,
        ) {
            let mut sender = Codec::new(HERE, None);
            let mut bytes = Vec::new();
            for (k, noise) in noise.iter().enumerate() {
                bytes.extend(sender.encode(&heartbeat(k as u32)));
                bytes.extend(noise);
            }
            let mut receiver = Codec::new(HERE, None);
            let mut heard = Vec::new();
            for part in bytes.chunks(cut) {
                receiver.feed(part);
                heard.extend(all(&mut receiver));
            }
            let sent: Vec<_> = (0..noise.len()).map(|k| heartbeat(k as u32)).collect();
            prop_assert_eq!(heard, sent);
        }

        #[test]
        fn any_bytes_are_read_without_harm(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
            let mut receiver = Codec::new(HERE, None);
            receiver.feed(&bytes);
            all(&mut receiver);
        }
    }
}
