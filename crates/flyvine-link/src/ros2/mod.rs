//! ROS 2, by its wire protocol: DDS (OMG DDSI-RTPS 2.5), without an installation of ROS. Feature `ros2`, off by default.
//!
//! [`RosPublisher`] tells a flight to whoever subscribes; [`RosClient`] takes poses from a motion-capture driver of ROS 2. Both
//! use standard messages, so that `ros2 topic echo`, RViz and rclpy read and write them. World and body axes are REP 103's, which
//! are flyvine's.
//!
//! DDS finds its peers by multicast. Poses and set-points go to loopback unless another network is named, but its sockets are
//! bound to every address, as those of every DDS implementation are: who is not to be heard must be kept out by the network.

mod address;
mod client;
mod messages;
mod publisher;

use rustdds::policy::{Durability, History, Reliability};
use rustdds::{Duration, QosPolicies, QosPolicyBuilder};

pub use address::RosAddress;
pub use client::RosClient;
pub use publisher::{RosPublisher, TOPICS};

/// Why there is no ROS.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RosError {
    /// DDS cannot be started, or refuses a topic.
    #[error("ROS 2: {0}")]
    Dds(#[from] rustdds::dds::CreateError),
    /// The address is none.
    #[error(
        "`{address}`: expected DOMAIN or DOMAIN@ADDRESS, with a domain of 0 to 232 and this machine's address in the network to use"
    )]
    Address {
        /// What was found.
        address: String,
    },
    /// A thread cannot be started.
    #[error("ROS 2: cannot start a thread: {0}")]
    Thread(#[from] std::io::Error),
}

/// ROS 2's name for a topic in DDS.
fn dds_topic(topic: &str) -> String {
    format!("rt/{}", topic.trim_start_matches('/'))
}

/// What publishers of ROS 2 offer unless told otherwise: reliable, for those who come later too late. It serves readers that
/// want less, too.
fn offered() -> QosPolicies {
    QosPolicyBuilder::new()
        .reliability(Reliability::Reliable {
            max_blocking_time: Duration::ZERO,
        })
        .durability(Durability::Volatile)
        .history(History::KeepLast { depth: 10 })
        .build()
}

/// What a reader wants who would rather miss a pose than wait for it: ROS 2's "sensor data".
fn sensor_data() -> QosPolicies {
    QosPolicyBuilder::new()
        .reliability(Reliability::BestEffort)
        .durability(Durability::Volatile)
        .history(History::KeepLast { depth: 5 })
        .build()
}
