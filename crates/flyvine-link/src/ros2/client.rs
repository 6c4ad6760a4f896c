//! Poses out of topics of ROS 2, as from any motion-capture server.

use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};

use rustdds::no_key::DataReader;
use rustdds::serialization::CDRDeserializerAdapter;
use rustdds::{DomainParticipant, TopicKind};

use super::messages::{Message, PoseStamped};
use super::{RosAddress, RosError, dds_topic, sensor_data};
use crate::mocap::{BodyPose, Frame, Incoming, LinkState, Sink};
use crate::worker::Worker;

/// Time between two looks at the topics: a pose is no older for it than for the frame it waited for.
const LOOK: Duration = Duration::from_millis(1);

type Reader = DataReader<PoseStamped, CDRDeserializerAdapter<PoseStamped>>;

/// Listens to topics of `geometry_msgs/msg/PoseStamped`, such as those of the drivers of VRPN, Vicon and OptiTrack; a body's name is
/// its topic. Capture times are those of the headers. Dropping it stops its thread.
#[derive(Debug)]
pub struct RosClient {
    _worker: Worker,
}

impl RosClient {
    /// Joins a domain and subscribes to `topics`.
    ///
    /// # Errors
    /// DDS or a thread cannot be started.
    pub fn start(address: &RosAddress, topics: &[String], sink: Sink) -> Result<Self, RosError> {
        let participant = address.join()?;
        let readers: Vec<(String, Reader)> = topics
            .iter()
            .map(|topic| Ok((topic.clone(), reader(&participant, topic)?)))
            .collect::<Result<_, RosError>>()?;
        let name = format!("ROS 2, domain {}", address.domain);
        let worker = Worker::start("ROS 2 client", move |stop| {
            // Topics have no server: whoever publishes is heard.
            sink(Incoming::Link(LinkState::Connected(name)));
            let mut readers = readers;
            while !stop.load(Ordering::Relaxed) {
                for (topic, reader) in &mut readers {
                    // A message that cannot be read is one of another type: the body is not seen.
                    while let Ok(Some(sample)) = reader.take_next_sample() {
                        sink(Incoming::Frame(frame(topic, sample.value()), Instant::now()));
                    }
                }
                thread::sleep(LOOK);
            }
            drop(participant);
        })?;
        Ok(Self { _worker: worker })
    }
}

fn frame(topic: &str, message: &PoseStamped) -> Frame {
    let captured_s = message.header.stamp.seconds();
    let (position, q) = (message.pose.position, message.pose.orientation);
    Frame {
        captured_s,
        sent_s: captured_s,
        bodies: vec![BodyPose {
            name: topic.to_owned(),
            position: [position.x, position.y, position.z],
            attitude: [q.w, q.x, q.y, q.z],
            tracked: true,
        }],
    }
}

fn reader(participant: &DomainParticipant, topic: &str) -> Result<Reader, RosError> {
    let qos = sensor_data();
    let subscriber = participant.create_subscriber(&qos)?;
    let name = PoseStamped::TYPE.to_owned();
    let topic = participant.create_topic(dds_topic(topic), name, &qos, TopicKind::NoKey)?;
    Ok(subscriber.create_datareader_no_key(&topic, None)?)
}
