//! What is known of the bodies, frame by frame: clock offset, hygiene, body frames, and the newest credible poses.

use std::time::{Duration, Instant};

use flyvine::flight::Pose;
use serde::Serialize;

use super::clock::seconds_since;
use super::watch::{BodyWatch, Credible, Stamp};
use super::{
    Bodies, BodyFrame, ClockEstimate, ClockFilter, Frame, HygieneCounts, HygieneLimits, Incoming, LinkState,
    LiveFault,
};

/// Bodies that are watched; names beyond are ignored.
const MOST_BODIES: usize = 64;

/// A pose, and when the cameras saw it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StampedPose {
    /// The pose in flyvine's world: ENU, m.
    pub pose: Pose,
    /// When it was captured.
    pub captured: Instant,
    /// How old it is at the time that was asked for, s.
    pub age_s: f64,
    /// What has come of the body since, if it was nonsense.
    pub nonsense: Option<Nonsense>,
}

/// Poses that cannot be, one after the other since the last credible one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nonsense {
    /// What is wrong with the newest.
    pub fault: LiveFault,
    /// For how long they have come, from the first to the newest, s.
    pub lasts_s: f64,
    /// When the newest was captured.
    pub newest: Instant,
}

/// The newest credible poses; `None` where there has not been one yet.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Latest {
    /// The quadrotor.
    pub quadrotor: Option<StampedPose>,
    /// The end effector.
    pub end_effector: Option<StampedPose>,
}

/// How one body comes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BodyStatus {
    /// Its name on the server.
    pub name: String,
    /// What it is to flyvine: `quadrotor`, `end effector`, or nothing.
    pub role: Option<&'static str>,
    /// Poses that came so far, whatever became of them.
    pub received: u64,
    /// Rate over the last two seconds, Hz.
    pub rate_hz: Option<f64>,
    /// Age of the newest credible pose, s.
    pub age_s: Option<f64>,
    /// Median time by which poses came later than the fastest, s.
    pub delay_median_s: Option<f64>,
    /// The same, 99th percentile.
    pub delay_p99_s: Option<f64>,
    /// Longest time between two frames, s.
    pub longest_gap_s: f64,
    /// The newest credible position, m, in flyvine's axes where they are known, otherwise in the server's.
    pub position_m: Option<[f64; 3]>,
    /// What was wrong with it.
    pub faults: HygieneCounts,
}

/// How motion capture comes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MocapStatus {
    /// Whether a server is connected.
    pub connected: bool,
    /// The server, or why there is none.
    pub server: String,
    /// Its clock.
    pub clock: Option<ClockEstimate>,
    /// Frames whose time stamps were no numbers.
    pub broken_stamps: u64,
    /// The bodies that were seen, and those that are expected, by name.
    pub bodies: Vec<BodyStatus>,
}

/// Everything known of motion capture, without threads and sockets.
#[derive(Debug)]
pub(crate) struct Tracker {
    /// Our clock counts from here.
    epoch: Instant,
    bodies: Option<Bodies>,
    limits: HygieneLimits,
    link: LinkState,
    clock: ClockFilter,
    watches: Vec<BodyWatch>,
    broken_stamps: u64,
}

impl Tracker {
    pub fn new(bodies: Option<Bodies>, limits: HygieneLimits, epoch: Instant) -> Self {
        let expected = bodies.iter().flat_map(Bodies::names);
        Tracker {
            epoch,
            limits,
            link: LinkState::Connecting,
            clock: ClockFilter::default(),
            watches: expected.map(|name| BodyWatch::new(&name, limits)).collect(),
            bodies,
            broken_stamps: 0,
        }
    }

    /// An instant by our clock, s.
    fn here_s(&self, instant: Instant) -> f64 {
        seconds_since(self.epoch, instant)
    }

    /// The instant at a time of our clock.
    fn instant(&self, here_s: f64) -> Instant {
        let distance = Duration::from_secs_f64(here_s.abs());
        let instant = if here_s < 0.0 {
            self.epoch.checked_sub(distance)
        } else {
            self.epoch.checked_add(distance)
        };
        instant.unwrap_or(self.epoch)
    }

    pub fn take(&mut self, incoming: Incoming) {
        match incoming {
            Incoming::Link(state) => self.link = state,
            Incoming::Frame(frame, arrived) => self.take_frame(&frame, arrived),
        }
    }

    fn take_frame(&mut self, frame: &Frame, arrived: Instant) {
        if !(frame.captured_s.is_finite() && frame.sent_s.is_finite()) {
            self.broken_stamps += 1;
            return;
        }
        let arrived_s = self.here_s(arrived);
        let steps = self.clock.estimate().map(|clock| clock.steps);
        let delay_s = self.clock.observe(frame.sent_s, arrived_s);
        if steps.is_some() && steps != self.clock.estimate().map(|clock| clock.steps) {
            self.watches.iter_mut().for_each(BodyWatch::clock_set);
        }
        let captured_s = self.clock.here_s(frame.captured_s).unwrap_or(arrived_s);
        let stamp = Stamp {
            server_s: frame.captured_s,
            captured_s: captured_s.min(arrived_s),
            delay_s,
        };
        // All bodies of a frame are judged against where the others were before it.
        let before: Vec<Option<[f64; 3]>> = self
            .watches
            .iter()
            .map(|watch| Some(watch.credible?.position))
            .collect();
        for pose in &frame.bodies {
            let Some(index) = self.index(&pose.name) else {
                continue;
            };
            let others: Vec<(usize, [f64; 3])> = before
                .iter()
                .enumerate()
                .filter(|(other, _)| *other != index)
                .filter_map(|(other, position)| Some((other, (*position)?)))
                .collect();
            self.watches[index].take(pose, stamp, &others);
        }
    }

    /// The watch over the body `name`, a new one for a new name; `None` if there are too many.
    fn index(&mut self, name: &str) -> Option<usize> {
        let known = self.watches.iter().position(|watch| watch.name == name);
        known.or_else(|| {
            (self.watches.len() < MOST_BODIES).then(|| {
                self.watches.push(BodyWatch::new(name, self.limits));
                self.watches.len() - 1
            })
        })
    }

    pub fn latest(&self, now: Instant) -> Latest {
        let Some(bodies) = &self.bodies else {
            return Latest::default();
        };
        Latest {
            quadrotor: self.pose(bodies, &bodies.quadrotor, now),
            end_effector: self.pose(bodies, &bodies.end_effector, now),
        }
    }

    fn pose(&self, bodies: &Bodies, body: &BodyFrame, now: Instant) -> Option<StampedPose> {
        let watch = self.watches.iter().find(|watch| watch.name == body.name)?;
        let credible = watch.credible?;
        let captured_s = credible.captured_s - 1e-3 * bodies.latency_ms;
        Some(StampedPose {
            pose: bodies.pose(body, credible.position, credible.attitude),
            captured: self.instant(captured_s),
            age_s: self.here_s(now) - captured_s,
            nonsense: watch.nonsense.map(|nonsense| Nonsense {
                fault: nonsense.fault,
                lasts_s: nonsense.newest_s - nonsense.since_s,
                newest: self.instant(nonsense.newest_s - 1e-3 * bodies.latency_ms),
            }),
        })
    }

    pub fn status(&self, now: Instant) -> MocapStatus {
        let (connected, server) = match &self.link {
            LinkState::Connecting => (false, "no answer yet".to_owned()),
            LinkState::Connected(server) => (true, server.clone()),
            LinkState::Lost(reason) => (false, reason.clone()),
        };
        let mut bodies: Vec<BodyStatus> = self.watches.iter().map(|watch| self.body(watch, now)).collect();
        bodies.sort_by(|a, b| a.name.cmp(&b.name));
        MocapStatus {
            connected,
            server,
            clock: self.clock.estimate(),
            broken_stamps: self.broken_stamps,
            bodies,
        }
    }

    fn body(&self, watch: &BodyWatch, now: Instant) -> BodyStatus {
        let role = self.bodies.as_ref().and_then(|bodies| {
            let roles = [
                ("quadrotor", &bodies.quadrotor),
                ("end effector", &bodies.end_effector),
            ];
            roles.into_iter().find(|(_, body)| body.name == watch.name)
        });
        let position = |credible: Credible| match (&self.bodies, role) {
            (Some(bodies), Some((_, body))) => {
                bodies.pose(body, credible.position, credible.attitude).position
            }
            (Some(bodies), None) => bodies.axes.vector(credible.position),
            _ => credible.position,
        };
        let latency_s = self
            .bodies
            .as_ref()
            .map_or(0.0, |bodies| 1e-3 * bodies.latency_ms);
        let mut delays: Vec<f64> = watch.delays.iter().copied().collect();
        delays.sort_by(f64::total_cmp);
        let quantile = |share: f64| {
            let last = delays.len().checked_sub(1)?;
            Some(delays[(share * last as f64).round() as usize])
        };
        BodyStatus {
            name: watch.name.clone(),
            role: role.map(|(role, _)| role),
            received: watch.received,
            rate_hz: watch.rate_hz(),
            age_s: watch
                .credible
                .map(|credible| self.here_s(now) - credible.captured_s + latency_s),
            delay_median_s: quantile(0.5),
            delay_p99_s: quantile(0.99),
            longest_gap_s: watch.longest_gap_s,
            position_m: watch.credible.map(position),
            faults: watch.counts,
        }
    }
}

#[cfg(test)]
mod tests;
