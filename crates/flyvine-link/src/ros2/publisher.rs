//! A flight as topics of ROS 2.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::Duration;

use flyvine::flight::{Pose, Sample};
use rustdds::dds::statusevents::DataWriterStatus;
use rustdds::no_key::DataWriter;
use rustdds::serialization::CDRSerializerAdapter;
use rustdds::{DomainParticipant, Publisher, StatusEvented, TopicKind};
use serde::Serialize;

use super::messages::{Float64, Header, Message, PoseStamped, Time};
use super::{RosAddress, RosError, dds_topic, offered};
use crate::worker::Worker;

/// The topics: their names and types.
pub const TOPICS: [(&str, &str); 5] = [
    (QUADROTOR, "geometry_msgs/msg/PoseStamped"),
    (END_EFFECTOR, "geometry_msgs/msg/PoseStamped"),
    (SETPOINT, "geometry_msgs/msg/PoseStamped"),
    (LENGTH, "std_msgs/msg/Float64"),
    (PRESSURE, "std_msgs/msg/Float64"),
];
const QUADROTOR: &str = "/flyvine/quadrotor/pose";
const END_EFFECTOR: &str = "/flyvine/end_effector/pose";
const SETPOINT: &str = "/flyvine/setpoint/pose";
const LENGTH: &str = "/flyvine/arm/length_m";
const PRESSURE: &str = "/flyvine/arm/pressure_kpa";
/// The frame that all poses are in.
const FRAME: &str = "world";
/// How soon the thread sees that it shall end.
const PATIENCE: Duration = Duration::from_millis(50);
/// Upright: what has no attitude.
const UPRIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

/// Tells a flight to whoever subscribes. A thread of its own does: the flight waits for nobody, and whatever becomes of ROS, it
/// goes on.
#[derive(Debug)]
pub struct RosPublisher {
    rows: Sender<(u64, Sample)>,
    subscribers: Arc<AtomicUsize>,
    _worker: Worker,
}

impl RosPublisher {
    /// Joins a domain and offers the topics.
    ///
    /// # Errors
    /// DDS or a thread cannot be started.
    pub fn start(address: &RosAddress) -> Result<Self, RosError> {
        let participant = address.join()?;
        let mut writers = Writers::new(&participant)?;
        let (rows, queue) = channel::<(u64, Sample)>();
        let subscribers = Arc::new(AtomicUsize::new(0));
        let count = Arc::clone(&subscribers);
        let worker = Worker::start("ROS 2 publisher", move |stop| {
            while !stop.load(Ordering::Relaxed) {
                match queue.recv_timeout(PATIENCE) {
                    Ok((time_ns, sample)) => writers.write(time_ns, &sample),
                    Err(RecvTimeoutError::Timeout) => (),
                    Err(RecvTimeoutError::Disconnected) => break,
                }
                count.store(writers.subscribers(), Ordering::Relaxed);
            }
            // What came before the end is told.
            queue
                .try_iter()
                .for_each(|(time_ns, sample)| writers.write(time_ns, &sample));
            writers.wait();
            drop(participant);
        })?;
        Ok(Self {
            rows,
            subscribers,
            _worker: worker,
        })
    }

    /// Tells one row of a flight: what was seen, what is asked of vehicle and arm. `time_ns` is since 1970.
    pub fn row(&self, time_ns: u64, sample: &Sample) {
        // A thread that has ended tells nobody.
        let _ = self.rows.send((time_ns, *sample));
    }

    /// How many subscriptions there are, of all topics together. DDS takes a second or two to find them; what is told before is
    /// lost to them.
    pub fn subscribers(&self) -> usize {
        self.subscribers.load(Ordering::Relaxed)
    }
}

struct Writers {
    quadrotor: Writer<PoseStamped>,
    end_effector: Writer<PoseStamped>,
    setpoint: Writer<PoseStamped>,
    length: Writer<Float64>,
    pressure: Writer<Float64>,
}

impl Writers {
    fn new(participant: &DomainParticipant) -> Result<Self, RosError> {
        let publisher = participant.create_publisher(&offered())?;
        Ok(Self {
            quadrotor: Writer::new(participant, &publisher, QUADROTOR)?,
            end_effector: Writer::new(participant, &publisher, END_EFFECTOR)?,
            setpoint: Writer::new(participant, &publisher, SETPOINT)?,
            length: Writer::new(participant, &publisher, LENGTH)?,
            pressure: Writer::new(participant, &publisher, PRESSURE)?,
        })
    }

    /// A pose that was missed is not told.
    fn write(&self, time_ns: u64, sample: &Sample) {
        let stamped = |pose: Pose| PoseStamped {
            header: Header {
                stamp: Time::from_unix_ns(time_ns),
                frame_id: FRAME.to_owned(),
            },
            pose: pose.into(),
        };
        let upright = |position| {
            stamped(Pose {
                position,
                attitude: UPRIGHT,
            })
        };
        if let Some(pose) = sample.quadrotor {
            self.quadrotor.write(stamped(pose));
        }
        if let Some(tip) = sample.end_effector {
            self.end_effector.write(upright(tip));
        }
        self.setpoint.write(upright(sample.command));
        let number = |data| Float64 { data };
        self.length.write(number(sample.configuration.length_m));
        self.pressure.write(number(sample.configuration.pressure_kpa));
    }

    fn subscribers(&mut self) -> usize {
        let poses = [&mut self.quadrotor, &mut self.end_effector, &mut self.setpoint];
        let poses: usize = poses.into_iter().map(Writer::count).sum();
        poses + self.length.count() + self.pressure.count()
    }

    /// Waits for readers to acknowledge the last messages, but not for long.
    fn wait(&self) {
        for writer in [&self.quadrotor, &self.setpoint] {
            let _ = writer.writer.wait_for_acknowledgments(PATIENCE);
        }
    }
}

/// One topic, and how many subscribe to it.
struct Writer<M: Message + Serialize> {
    writer: DataWriter<M, CDRSerializerAdapter<M>>,
    subscribers: usize,
}

impl<M: Message + Serialize> Writer<M> {
    fn new(participant: &DomainParticipant, publisher: &Publisher, topic: &str) -> Result<Self, RosError> {
        let topic =
            participant.create_topic(dds_topic(topic), M::TYPE.to_owned(), &offered(), TopicKind::NoKey)?;
        Ok(Self {
            writer: publisher.create_datawriter_no_key(&topic, None)?,
            subscribers: 0,
        })
    }

    /// A write that fails has no reader, or one that is too slow: the next one will do.
    fn write(&self, message: M) {
        let _ = self.writer.write(message, None);
    }

    fn count(&mut self) -> usize {
        while let Some(status) = self.writer.try_recv_status() {
            if let DataWriterStatus::PublicationMatched { current, .. } = status {
                self.subscribers = usize::try_from(current.count()).unwrap_or(0);
            }
        }
        self.subscribers
    }
}
