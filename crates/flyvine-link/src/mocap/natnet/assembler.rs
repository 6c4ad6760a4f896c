//! NatNet packets to frames with names, without sockets.

use std::collections::HashMap;

use ::natnet::modeldef::DataSet;
use ::natnet::serverinfo::ConnectionInfo;
use ::natnet::{
    Decoder, FrameOfData, Message, MessageHeader, ModelDef, NAT_SERVERINFO, ParsePolicy, ServerInfo,
};

use crate::mocap::{BodyPose, Frame};

/// More bodies than any laboratory has; the rest of a packet is ignored.
const MOST_BODIES: usize = 256;

/// What a packet said.
#[derive(Debug, Clone, PartialEq)]
pub enum Heard {
    /// The server introduced itself: name with versions, and where its data comes.
    Server(String, ConnectionInfo),
    /// The server named its bodies.
    Names,
    /// A frame. Bodies whose names are not known yet are left out.
    Frame {
        /// The frame.
        frame: Frame,
        /// Whether it had bodies without a name, or says that its bodies changed: ask for the names again.
        names_missing: bool,
    },
    /// Nothing that matters here.
    Nothing,
}

/// Remembers what later packets need: version, clock and names.
#[derive(Debug, Clone, Default)]
pub struct Assembler {
    server: Option<(Decoder, ServerInfo)>,
    names: HashMap<i32, String>,
}

impl Assembler {
    /// Takes a datagram from the server.
    ///
    /// # Errors
    /// The packet is damaged, or of a version without a known layout. Packets that need the server's introduction
    /// and come before it are no error.
    pub fn receive(&mut self, datagram: &[u8]) -> Result<Heard, ::natnet::Error> {
        let id = MessageHeader::parse(datagram)?.message_id;
        if id == NAT_SERVERINFO {
            let info = ServerInfo::parse(datagram)?;
            let decoder = Decoder::new(info.protocol_version)?.with_policy(ParsePolicy::Compatible);
            let name = format!(
                "{} {} with NatNet {}",
                info.application_name, info.server_version, info.protocol_version
            );
            let connection = info.connection;
            self.server = Some((decoder, info));
            return Ok(Heard::Server(name, connection));
        }
        let Some((decoder, info)) = &self.server else {
            return Ok(Heard::Nothing);
        };
        match decoder.parse(datagram)?.into_message() {
            Message::ModelDef(model) => {
                self.names = names(&model);
                Ok(Heard::Names)
            }
            Message::FrameOfData(frame) => Ok(self.frame(&frame, info)),
            _ => Ok(Heard::Nothing),
        }
    }

    fn frame(&self, frame: &FrameOfData, info: &ServerInfo) -> Heard {
        let timing = &frame.timing;
        let seconds = |ticks: u64| ticks as f64 / info.high_res_clock_frequency as f64;
        // Servers without a high-resolution clock only stamp the frame.
        let (captured_s, sent_s) = if info.high_res_clock_frequency > 0 && timing.camera_mid_exposure > 0 {
            (seconds(timing.camera_mid_exposure), seconds(timing.transmit))
        } else {
            (timing.timestamp, timing.timestamp)
        };
        let mut names_missing = frame.params & MODELS_CHANGED != 0;
        let mut bodies = Vec::new();
        for body in frame.rigid_bodies.iter().take(MOST_BODIES) {
            let Some(name) = self.names.get(&body.id) else {
                names_missing = true;
                continue;
            };
            let [qx, qy, qz, qw] = body.orientation.map(f64::from);
            bodies.push(BodyPose {
                name: name.clone(),
                position: body.position.map(f64::from),
                attitude: [qw, qx, qy, qz],
                tracked: body.tracking_valid(),
            });
        }
        let frame = Frame {
            captured_s,
            // A transmit stamp that is missing or precedes the exposure is none.
            sent_s: sent_s.max(captured_s),
            bodies,
        };
        Heard::Frame { frame, names_missing }
    }
}

/// The bit of a frame's parameters that says that the list of bodies changed.
const MODELS_CHANGED: u16 = 1 << 1;

fn names(model: &ModelDef) -> HashMap<i32, String> {
    let bodies = model.datasets.iter().filter_map(|dataset| match dataset {
        DataSet::RigidBody(body) => Some((body.id, body.name.clone())),
        _ => None,
    });
    bodies.take(MOST_BODIES).collect()
}

#[cfg(test)]
mod tests {
    use ::natnet::modeldef::RigidBodyDef;
    use ::natnet::{PlannedBody, SyntheticServer, Version};
    use proptest::prelude::*;

    use super::*;

    const HZ: u64 = 10_000_000;

    fn server_info(version: Version) -> ServerInfo {
        ServerInfo {
            application_name: "Motive".into(),
            server_version: Version::new(3, 1, 2, 1),
            protocol_version: version,
            high_res_clock_frequency: HZ,
            connection: ConnectionInfo {
                data_port: 1511,
                multicast: false,
                multicast_group: [239, 255, 42, 99],
            },
        }
    }

    /// No markers: their number, and nothing after it.
    fn body(id: i32, name: &str) -> DataSet {
        DataSet::RigidBody(RigidBodyDef {
            name: name.into(),
            id,
            parent_id: -1,
            offset: [0.0; 3],
            tail: vec![0; 4],
        })
    }

    fn model(names: &[(i32, &str)]) -> ModelDef {
        ModelDef {
            datasets: names.iter().map(|&(id, name)| body(id, name)).collect(),
        }
    }

    fn introduced(version: Version) -> Assembler {
        let mut assembler = Assembler::default();
        let info = server_info(version).to_datagram().unwrap();
        assert!(matches!(assembler.receive(&info), Ok(Heard::Server(..))));
        let names = model(&[(7, "drone"), (9, "tip")]).to_datagram(version).unwrap();
        assert_eq!(assembler.receive(&names), Ok(Heard::Names));
        assembler
    }

    #[test]
    fn frames_of_every_version_are_named_and_timed() {
        for (major, minor) in [(3, 0), (3, 1), (4, 0), (4, 1)] {
            let version = Version::new(major, minor, 0, 0);
            let mut assembler = introduced(version);
            let bodies = [
                PlannedBody::tracked(9, [1.0, 2.0, 3.0], [0.0, 0.6, 0.0, 0.8]),
                PlannedBody::dropout(7),
            ];
            let server = SyntheticServer::new(version, HZ);
            let mut packet = server.frame(1, 12.5, &bodies);
            packet.timing.transmit += 40_000;
            let heard = assembler.receive(&packet.to_datagram(version).unwrap()).unwrap();
            let Heard::Frame { frame, names_missing } = heard else {
                panic!("{heard:?}")
            };
            assert!(!names_missing);
            assert_eq!((frame.captured_s, frame.sent_s), (12.5, 12.504));
            assert_eq!(frame.bodies[0].name, "tip");
            assert_eq!(frame.bodies[0].position, [1.0, 2.0, 3.0]);
            assert_eq!(
                frame.bodies[0].attitude,
                [0.8, 0.0, 0.6, 0.0].map(|x: f32| f64::from(x))
            );
            assert_eq!(
                (&*frame.bodies[1].name, frame.bodies[1].tracked),
                ("drone", false)
            );
        }
    }

    #[test]
    fn bodies_without_a_name_are_left_out_and_asked_for() {
        let version = Version::new(3, 1, 0, 0);
        let mut assembler = introduced(version);
        let bodies = [PlannedBody::tracked(8, [0.0; 3], [0.0, 0.0, 0.0, 1.0])];
        let packet = SyntheticServer::new(version, HZ)
            .datagram(1, 1.0, &bodies)
            .unwrap();
        let heard = assembler.receive(&packet).unwrap();
        assert!(matches!(&heard, Heard::Frame { frame, names_missing: true } if frame.bodies.is_empty()));
        assert_eq!(Assembler::default().receive(&packet), Ok(Heard::Nothing));
    }

    #[test]
    fn the_reference_layout_of_a_frame_is_read_byte_by_byte() {
        let mut assembler = introduced(Version::new(3, 1, 0, 0));
        let mut payload: Vec<u8> = Vec::new();
        for count in [42_i32, 0, 0, 1] {
            payload.extend(count.to_le_bytes()); // frame, marker sets, other markers, rigid bodies
        }
        payload.extend(7_i32.to_le_bytes());
        for number in [1.0_f32, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0, 0.0005] {
            payload.extend(number.to_le_bytes());
        }
        payload.extend(1_i16.to_le_bytes());
        for count in [0_i32; 4] {
            payload.extend(count.to_le_bytes()); // skeletons, labelled markers, force plates, devices
        }
        payload.extend([0; 8]); // time code
        payload.extend(0.25_f64.to_le_bytes());
        for ticks in [2_500_000_u64, 2_510_000, 2_520_000] {
            payload.extend(ticks.to_le_bytes());
        }
        payload.extend([0; 6]); // parameters, end
        let mut datagram = vec![7, 0];
        datagram.extend((payload.len() as u16).to_le_bytes());
        datagram.extend(payload);
        let heard = assembler.receive(&datagram).unwrap();
        let Heard::Frame { frame, .. } = heard else {
            panic!("{heard:?}")
        };
        assert_eq!((frame.captured_s, frame.sent_s), (0.25, 0.252));
        assert_eq!(frame.bodies[0].position, [1.0, 2.0, 3.0]);
        assert_eq!(frame.bodies[0].attitude, [1.0, 0.0, 0.0, 0.0]);
    }

    proptest! {
        #[test]
        fn damaged_packets_never_panic(
            id in 0..12_u16,
            minor in 0..2_u8,
            major in 3..5_u8,
            bytes in prop::collection::vec(any::<u8>(), 0..300),
        ) {
            let mut assembler = introduced(Version::new(major, minor, 0, 0));
            let _ = assembler.receive(&bytes);
            let datagram = [&id.to_le_bytes()[..], &(bytes.len() as u16).to_le_bytes(), &bytes].concat();
            let _ = assembler.receive(&datagram);
        }
    }
}
