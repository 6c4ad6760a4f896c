//! Where the poses come from: what the link needs of motion capture, and nothing more.

use std::time::Instant;

use flyvine::flight::Pose;

use super::clock::MonotonicClock;
use crate::mocap::{Latest, MocapSource, StampedPose};

/// Nonsense for so long is no longer a slip of the cameras, s: the supervisor shall know of it. Shorter, the pose counts as
/// missing.
const NONSENSE_S: f64 = 0.2;

/// Something and when it was captured, s on the link's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stamped<T> {
    /// What was captured.
    pub value: T,
    /// When, s: the cameras' time, not that of its arrival.
    pub captured_s: f64,
}

/// The newest poses of the two bodies; `None` before the first.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LatestPoses {
    /// The quadrotor, world frame ENU.
    pub quadrotor: Option<Stamped<Pose>>,
    /// The end effector's position, m, world frame ENU.
    pub end_effector: Option<Stamped<[f64; 3]>>,
}

impl LatestPoses {
    /// The newest credible poses, their instants put on the link's clock by `time_s`. A body of which nothing but nonsense has
    /// come for a while is nowhere, NaN: that is for the supervisor to judge, as everything is.
    pub(crate) fn new(latest: &Latest, time_s: impl Fn(Instant) -> f64) -> Self {
        let stamped =
            |body: StampedPose| match body.nonsense.filter(|nonsense| nonsense.lasts_s >= NONSENSE_S) {
                None => Stamped {
                    value: body.pose,
                    captured_s: time_s(body.captured),
                },
                Some(nonsense) => Stamped {
                    value: Pose {
                        position: [f64::NAN; 3],
                        attitude: [f64::NAN; 4],
                    },
                    captured_s: time_s(nonsense.newest),
                },
            };
        let end_effector = latest.end_effector.map(stamped);
        Self {
            quadrotor: latest.quadrotor.map(stamped),
            end_effector: end_effector.map(|Stamped { value, captured_s }| Stamped {
                value: value.position,
                captured_s,
            }),
        }
    }
}

/// Motion capture, as the link sees it.
pub trait PoseSource {
    /// The newest poses at `now_s`; it never waits.
    fn latest(&mut self, now_s: f64) -> LatestPoses;
}

/// A motion-capture server, on the link's clock.
pub struct MocapPoses {
    source: MocapSource,
    clock: MonotonicClock,
}

impl MocapPoses {
    /// The poses of `source`, stamped by `clock`.
    pub fn new(source: MocapSource, clock: MonotonicClock) -> Self {
        Self { source, clock }
    }
}

impl PoseSource for MocapPoses {
    fn latest(&mut self, _now_s: f64) -> LatestPoses {
        LatestPoses::new(&self.source.latest(Instant::now()), |instant| {
            self.clock.at(instant)
        })
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::mocap::{Bodies, BodyPose, Frame, HygieneLimits, Incoming, Tracker};

    #[test]
    fn a_slip_is_missing_and_lasting_nonsense_is_shown_to_the_supervisor() {
        let epoch = Instant::now();
        let at = |time_s: f64| epoch + Duration::from_secs_f64(time_s);
        let bodies = Some(Bodies::named("drone", "tip"));
        let mut tracker = Tracker::new(bodies, HygieneLimits::default(), epoch);
        let mut latest = |k: u32, x: f64| {
            let time_s = 0.01 * f64::from(k);
            let frame = Frame {
                captured_s: time_s,
                sent_s: time_s,
                bodies: vec![BodyPose {
                    name: "drone".into(),
                    position: [x + 0.1 * time_s, 0.0, 1.5],
                    attitude: [1.0, 0.0, 0.0, 0.0],
                    tracked: true,
                }],
            };
            tracker.take(Incoming::Frame(frame, at(time_s)));
            let latest = tracker.latest(at(time_s));
            LatestPoses::new(&latest, |instant| (instant - epoch).as_secs_f64())
                .quadrotor
                .unwrap()
        };
        for k in 0..10 {
            latest(k, 0.0);
        }
        // A metre beside the vehicle: the last credible pose grows old …
        for k in 10..30 {
            let seen = latest(k, 1.0);
            assert!(
                (seen.captured_s - 0.09).abs() < 1e-9 && seen.value.position[0] < 0.1,
                "{k}: {seen:?}"
            );
        }
        // … and after 0.2 s of it the body is nowhere, now.
        let seen = latest(31, 1.0);
        assert!(
            seen.value.position[0].is_nan() && (seen.captured_s - 0.31).abs() < 1e-9,
            "{seen:?}"
        );
        assert!(latest(32, 0.0).value.position[0] < 0.1, "and back again");
    }
}
