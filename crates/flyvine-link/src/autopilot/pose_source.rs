//! Where the poses come from: what the link needs of motion capture, and nothing more.

use flyvine::flight::Pose;

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

/// Motion capture, as the link sees it.
pub trait PoseSource {
    /// The newest poses at `now_s`; it never waits.
    fn latest(&mut self, now_s: f64) -> LatestPoses;
}
