//! From the ground to rest at the start of a trajectory.

use std::collections::VecDeque;

use crate::DT;
use crate::control::Trajectory;
use crate::control::supervisor::{State, Supervisor};
use crate::link::{Health, Mode, Observation};

/// How long the set-points stream before the autopilot is asked to follow them, s. PX4 wants more than 1 s of
/// proof of life.
const PRE_STREAM_S: f64 = 1.5;
/// Speed of the set-point on its way to the start, m/s.
const CLIMB_M_S: f64 = 0.5;
/// The quadrotor is at the start when it is this near, m.
const NEAR_M: f64 = 0.15;
/// At rest is a body that has kept within this distance, m, for this many ticks.
const REST_M: f64 = 0.05;
const REST_TICKS: usize = 30;

/// The way up: a set-point that streams from the ground, then rises to the start once the autopilot follows it.
pub(super) struct TakeOff {
    start: [f64; 3],
    begun_s: f64,
    setpoint: Option<[f64; 3]>,
    /// Where quadrotor and end effector were in the last ticks, m.
    recent: VecDeque<[[f64; 3]; 2]>,
}

impl TakeOff {
    pub(super) fn new(trajectory: &Trajectory, now_s: f64) -> Self {
        Self {
            start: trajectory.start().0,
            begun_s: now_s,
            setpoint: None,
            recent: VecDeque::with_capacity(REST_TICKS),
        }
    }

    /// Takes in one tick and tells the supervisor when to arm and when the vehicle is at the start.
    pub(super) fn watch(&mut self, supervisor: &mut Supervisor, health: &Health, credible: &Observation) {
        if health.now_s - self.begun_s >= PRE_STREAM_S {
            supervisor.take_off();
        }
        let follows = health.armed && health.mode == Some(Mode::Offboard);
        if supervisor.state() != State::Climbing || !follows {
            return;
        }
        let from = self.setpoint.unwrap_or(supervisor.setpoint().position);
        self.setpoint = Some(towards(from, self.start, CLIMB_M_S * DT));
        if let (Some(pose), Some(tip)) = (credible.quadrotor, credible.end_effector) {
            if self.recent.len() == REST_TICKS {
                self.recent.pop_front();
            }
            self.recent.push_back([pose.position, tip]);
            if distance(pose.position, self.start) < NEAR_M && self.is_at_rest() {
                supervisor.at_start();
            }
        }
    }

    /// The quadrotor position to propose, m: the supervisor's own set-point, which is in the room above the ground, until
    /// the vehicle follows.
    pub(super) fn setpoint(&self, held: [f64; 3]) -> [f64; 3] {
        self.setpoint.unwrap_or(held)
    }

    fn is_at_rest(&self) -> bool {
        let Some(newest) = self.recent.back() else {
            return false;
        };
        let still = |bodies: &[[f64; 3]; 2]| (0..2).all(|body| distance(bodies[body], newest[body]) < REST_M);
        self.recent.len() == REST_TICKS && self.recent.iter().all(still)
    }
}

/// `from`, moved towards `to` by at most `step`.
fn towards(from: [f64; 3], to: [f64; 3], step: f64) -> [f64; 3] {
    let left = distance(from, to);
    if left <= step {
        return to;
    }
    std::array::from_fn(|axis| from[axis] + step / left * (to[axis] - from[axis]))
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}
