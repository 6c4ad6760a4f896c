//! What can be wrong with a motion-capture connection or its description.

use std::io;

use super::vrpn::VrpnError;

/// Why motion capture cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MocapError {
    /// A server's address cannot be understood or resolved.
    #[error("motion-capture server `{address}`: {problem}")]
    Address {
        /// The address as it was given.
        address: String,
        /// What is wrong with it.
        problem: String,
    },
    /// A socket failed.
    #[error("{doing}: {source}")]
    Socket {
        /// What was being done.
        doing: String,
        /// The system's error.
        #[source]
        source: io::Error,
    },
    /// A thread cannot be started.
    #[error("cannot start a thread: {0}")]
    Thread(#[source] io::Error),
    /// The file of body names cannot be read.
    #[error("{file}: {problem}")]
    Bodies {
        /// The file, as it was named by the caller.
        file: String,
        /// What is wrong with it.
        problem: String,
    },
    /// The peer does not speak VRPN.
    #[error(transparent)]
    Vrpn(#[from] VrpnError),
    /// A NatNet packet cannot be read or written.
    #[error("NatNet: {0}")]
    NatNet(#[from] ::natnet::Error),
    /// There is no ROS 2.
    #[cfg(feature = "ros2")]
    #[error(transparent)]
    Ros2(#[from] crate::ros2::RosError),
    /// A capture time that no protocol can carry.
    #[error("found a capture time of {found} s, expected Unix time, 0 … 2³² s")]
    CaptureTime {
        /// The time found, s.
        found: f64,
    },
}

impl MocapError {
    /// An error of a socket while `doing` something.
    pub(super) fn socket(doing: impl Into<String>) -> impl FnOnce(io::Error) -> Self {
        move |source| MocapError::Socket {
            doing: doing.into(),
            source,
        }
    }
}
