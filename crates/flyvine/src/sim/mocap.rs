//! Motion capture: late, noisy poses with occlusions, frozen frames and mistaken identities, counted by cause.

use super::history::History;
use super::parameters::{Checker, ParameterError};
use super::wind::normal;
use crate::flight::Pose;
use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

/// Noise and faults of motion capture. The faults are off by default.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MocapParameters {
    /// Standard deviation of a position, per axis, m.
    pub position_noise_m: f64,
    /// Standard deviation of an attitude, per axis, degrees.
    pub attitude_noise_deg: f64,
    /// Frames per second of the cameras; without it, poses are as fresh as the flight controller's rate loop.
    pub rate_hz: Option<f64>,
    /// Age of the poses that arrive, s.
    pub latency_s: f64,
    /// Further age, drawn evenly between 0 and this at every frame, s.
    pub jitter_s: f64,
    /// Chance that a body's occlusion starts in a frame.
    pub dropout_probability: f64,
    /// Length of an occlusion, frames of 20 Hz.
    pub dropout_frames: u32,
    /// Chance that quadrotor and end effector are taken for each other in a frame.
    pub swap_probability: f64,
    /// Chance that a body's pose freezes at a frame; it then repeats exactly for `frozen_frames`.
    pub freeze_probability: f64,
    /// Length of a freeze, frames of 20 Hz.
    pub frozen_frames: u32,
}

impl Default for MocapParameters {
    fn default() -> Self {
        MocapParameters {
            position_noise_m: 3e-4,
            attitude_noise_deg: 0.1,
            rate_hz: None,
            latency_s: 0.0,
            jitter_s: 0.0,
            dropout_probability: 0.0,
            dropout_frames: 1,
            swap_probability: 0.0,
            freeze_probability: 0.0,
            frozen_frames: 3,
        }
    }
}

impl MocapParameters {
    pub(super) fn validate(&self) -> Result<(), ParameterError> {
        let check = Checker::new("mocap");
        check.range("position_noise_m", self.position_noise_m, 0.0, 0.1, "m")?;
        check.range(
            "attitude_noise_deg",
            self.attitude_noise_deg,
            0.0,
            20.0,
            "degrees",
        )?;
        if let Some(rate) = self.rate_hz {
            check.range("rate_hz", rate, 1.0, 1e4, "Hz")?;
        }
        check.range("latency_s", self.latency_s, 0.0, 1.0, "s")?;
        check.range("jitter_s", self.jitter_s, 0.0, 1.0, "s")?;
        check.range("dropout_probability", self.dropout_probability, 0.0, 1.0, "")?;
        check.range(
            "dropout_frames",
            f64::from(self.dropout_frames),
            1.0,
            1000.0,
            "frames",
        )?;
        check.range("swap_probability", self.swap_probability, 0.0, 1.0, "")?;
        check.range("freeze_probability", self.freeze_probability, 0.0, 1.0, "")?;
        check.range(
            "frozen_frames",
            f64::from(self.frozen_frames),
            0.0,
            1000.0,
            "frames",
        )
    }
}

/// How many poses of either body the faults took.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MocapFaults {
    /// Poses missed.
    pub dropped: usize,
    /// Poses repeated from an earlier frame.
    pub frozen: usize,
    /// Frames in which the bodies were taken for each other.
    pub swapped: usize,
}

/// What the cameras could see at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scene {
    /// Quadrotor position, m.
    pub position: Vector3<f64>,
    /// Quadrotor attitude `world_from_body`.
    pub attitude: UnitQuaternion<f64>,
    /// End-effector position, m.
    pub end_effector: Vector3<f64>,
}

/// One tracked body: what it last showed, for how many frames it will go on showing it, and for how many it stays
/// hidden.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tracked<T> {
    last: Option<T>,
    frozen_for: u32,
    hidden_for: u32,
}

impl<T> Default for Tracked<T> {
    fn default() -> Self {
        Tracked {
            last: None,
            frozen_for: 0,
            hidden_for: 0,
        }
    }
}

impl<T: Copy> Tracked<T> {
    /// Passes `fresh` through the faults.
    fn observe(
        &mut self,
        parameters: &MocapParameters,
        fresh: T,
        faults: &mut MocapFaults,
        random: &mut impl Rng,
    ) -> Option<T> {
        // Both draws happen at every frame, so that one fault's rate does not change the other's stream.
        let occluded = random.random::<f64>() < parameters.dropout_probability;
        let freezes = random.random::<f64>() < parameters.freeze_probability;
        if self.frozen_for == 0 && freezes {
            self.frozen_for = parameters.frozen_frames;
        }
        let shown = match self.last {
            Some(last) if self.frozen_for > 0 => {
                self.frozen_for -= 1;
                faults.frozen += 1;
                last
            }
            _ => fresh,
        };
        self.last = Some(shown);
        if self.hidden_for == 0 && occluded {
            self.hidden_for = parameters.dropout_frames;
        }
        if self.hidden_for > 0 {
            self.hidden_for -= 1;
            faults.dropped += 1;
            return None;
        }
        Some(shown)
    }
}

/// The motion-capture system watching the vehicle.
#[derive(Debug, Clone)]
pub struct Mocap {
    quadrotor: Tracked<Pose>,
    end_effector: Tracked<[f64; 3]>,
    past: History<Scene>,
    /// What the cameras' newest frame shows, and the time to the next one, s.
    frame: Scene,
    next_frame_s: f64,
    period: f64,
    /// Faults since the start.
    pub faults: MocapFaults,
}

impl Mocap {
    /// Watching a vehicle that has been in `scene` for long; scenes will come every `period` seconds.
    pub fn new(parameters: &MocapParameters, scene: Scene, period: f64) -> Mocap {
        Mocap {
            quadrotor: Tracked::default(),
            end_effector: Tracked::default(),
            past: History::new(parameters.latency_s + parameters.jitter_s, period, scene),
            frame: scene,
            next_frame_s: 0.0,
            period,
            faults: MocapFaults::default(),
        }
    }

    /// The scene after another period.
    pub fn watch(&mut self, parameters: &MocapParameters, scene: Scene) {
        self.next_frame_s -= self.period;
        if self.next_frame_s < 1e-9 {
            self.frame = scene;
            // Frames that fall between two periods are seen at the second.
            self.next_frame_s += parameters
                .rate_hz
                .map_or(self.period, |rate| (1.0 / rate).max(self.period));
        }
        self.past.push(self.frame);
    }

    /// One answer: quadrotor pose and end-effector position as measured.
    pub fn frame(
        &mut self,
        parameters: &MocapParameters,
        random: &mut impl Rng,
    ) -> (Option<Pose>, Option<[f64; 3]>) {
        let age = parameters.latency_s + parameters.jitter_s * random.random::<f64>();
        let scene = self.past.back((age / self.period).round() as usize);
        let mut position = scene.position + parameters.position_noise_m * normal(random);
        let turn = parameters.attitude_noise_deg.to_radians() * normal(random);
        let mut tip = scene.end_effector + parameters.position_noise_m * normal(random);
        if random.random::<f64>() < parameters.swap_probability {
            std::mem::swap(&mut position, &mut tip);
            self.faults.swapped += 1;
        }
        let pose = pose(
            &position,
            &(UnitQuaternion::from_scaled_axis(turn) * scene.attitude),
        );
        (
            self.quadrotor.observe(parameters, pose, &mut self.faults, random),
            self.end_effector
                .observe(parameters, tip.into(), &mut self.faults, random),
        )
    }
}

/// A pose with the quaternion's sign chosen so that w ≥ 0.
pub(super) fn pose(position: &Vector3<f64>, attitude: &UnitQuaternion<f64>) -> Pose {
    let sign = if attitude.w < 0.0 { -1.0 } else { 1.0 };
    Pose {
        position: (*position).into(),
        attitude: [
            sign * attitude.w,
            sign * attitude.i,
            sign * attitude.j,
            sign * attitude.k,
        ],
    }
}
