//! One view of motion capture for everybody who needs poses: [`MocapSource`].

use std::str::FromStr;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Instant;

use super::natnet::{NatNetAddress, NatNetClient};
use super::tracker::{Latest, MocapStatus, Tracker};
use super::vrpn::{VrpnAddress, VrpnClient};
use super::{Bodies, HygieneLimits, MocapError, Sink};
#[cfg(feature = "ros2")]
use crate::ros2::{RosAddress, RosClient};

/// A motion-capture server, by protocol.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Address {
    /// VRPN.
    Vrpn(VrpnAddress),
    /// NatNet.
    NatNet(NatNetAddress),
    /// Topics of ROS 2.
    #[cfg(feature = "ros2")]
    Ros2(RosAddress),
}

impl FromStr for Address {
    type Err = MocapError;

    /// Reads `vrpn:…` or `natnet:…` with the protocol's own address after the colon, such as
    /// `vrpn:tcp://10.0.0.7` or `natnet:motive`; with the feature `ros2` also `ros2:DOMAIN` or `ros2:DOMAIN@ADDRESS`.
    fn from_str(address: &str) -> Result<Self, MocapError> {
        match address.split_once(':') {
            Some(("vrpn", rest)) => rest.parse().map(Address::Vrpn),
            Some(("natnet", rest)) => rest.parse().map(Address::NatNet),
            #[cfg(feature = "ros2")]
            Some(("ros2", rest)) => Ok(Address::Ros2(rest.parse()?)),
            _ => Err(MocapError::Address {
                address: address.to_owned(),
                problem: "expected `vrpn:HOST` or `natnet:HOST`".into(),
            }),
        }
    }
}

/// Poses from a motion-capture server, kept up to date by threads of their own until this value is dropped.
pub struct MocapSource {
    tracker: Arc<Mutex<Tracker>>,
    _client: Client,
}

/// Which protocol keeps it up to date. Dropping it stops the threads.
enum Client {
    Vrpn {
        _client: VrpnClient,
    },
    NatNet {
        _client: NatNetClient,
    },
    #[cfg(feature = "ros2")]
    Ros2 {
        _client: RosClient,
    },
}

impl std::fmt::Debug for MocapSource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("MocapSource").finish_non_exhaustive()
    }
}

impl MocapSource {
    /// Starts to listen to the server at `address`. Without `bodies` all bodies are watched, and none is the quadrotor
    /// or the end effector. `tap` hears everything as it comes, before it is judged.
    ///
    /// # Errors
    /// The host is unknown. A server that does not answer is no error: see [`MocapSource::status`].
    pub fn start(
        address: &Address,
        bodies: Option<Bodies>,
        limits: HygieneLimits,
        tap: Option<Sink>,
    ) -> Result<Self, MocapError> {
        let wanted: Vec<String> = bodies.iter().flat_map(Bodies::names).collect();
        let tracker = Arc::new(Mutex::new(Tracker::new(bodies, limits, Instant::now())));
        let shared = tracker.clone();
        let sink: Sink = Arc::new(move |incoming| {
            if let Some(tap) = &tap {
                tap(incoming.clone());
            }
            lock(&shared).take(incoming);
        });
        let client = match address {
            Address::Vrpn(address) => Client::Vrpn {
                _client: VrpnClient::start(address, &wanted, sink)?,
            },
            Address::NatNet(address) => Client::NatNet {
                _client: NatNetClient::start(address, sink)?,
            },
            #[cfg(feature = "ros2")]
            Address::Ros2(address) => Client::Ros2 {
                _client: RosClient::start(address, &wanted, sink)?,
            },
        };
        Ok(MocapSource {
            tracker,
            _client: client,
        })
    }

    /// The newest credible poses and their ages at `now`. It waits for nothing but the microseconds in which another
    /// thread takes a frame.
    pub fn latest(&self, now: Instant) -> Latest {
        lock(&self.tracker).latest(now)
    }

    /// How motion capture comes, at `now`.
    pub fn status(&self, now: Instant) -> MocapStatus {
        lock(&self.tracker).status(now)
    }
}

/// A lock on what no thread leaves half-changed.
fn lock(tracker: &Mutex<Tracker>) -> MutexGuard<'_, Tracker> {
    tracker.lock().expect("no thread panics with it")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_name_their_protocol() {
        assert!(matches!("vrpn:tcp://vicon".parse(), Ok(Address::Vrpn(address)) if address.tcp_only));
        assert!(matches!("natnet:motive:1510".parse(), Ok(Address::NatNet(address)) if address.port == 1510));
        assert!("vicon".parse::<Address>().is_err());
        assert!("qualisys:host".parse::<Address>().is_err());
    }
}
