//! Recordings: one [`Flight`] is a list of [`Sample`]s at [`crate::DT`].
//!
//! A recording in flyvine's own format is read by [`read_flight`], anyone else's through a column
//! [`Mapping`], which resamples it. [`clean`] then rejects what motion capture got wrong and reports it;
//! [`Flight::segments`] and [`Flight::valid_transitions`] say which rows may be used together.

mod continuity;
mod control_step;
mod corner;
mod csv;
mod error;
mod files;
mod hygiene;
pub mod mapping;
mod mcap;
pub mod messages;
mod plausible;
pub mod quaternion;
mod resample;
#[cfg(test)]
pub(crate) mod shared_data;
mod table;

pub use self::continuity::CLOCK_TOLERANCE_S;
pub use self::control_step::{ControlStep, StepReport, StepStatus, SurroundingsReport};
pub use self::corner::Corner;
pub use self::csv::{COLUMNS, COMMAND_COLUMNS, VELOCITY_COLUMNS, columns_of, parse_csv};
pub use self::error::{FlightError, Place, Problem};
pub use self::files::{
    read_control_steps, read_flight, recover_flight, write_controlled_flight, write_flight,
};
pub use self::hygiene::{Body, Fault, Finding, HygieneOptions, HygieneReport, clean};
pub use self::mapping::Mapping;
pub use self::mcap::sound_mcap;
pub use self::resample::{Reading, Recording, RecordingRow, resample};

use serde::{Deserialize, Serialize};

/// Names of the nine entries of the state x, in order.
pub const SIGNALS: [&str; 9] = [
    "qr_x", "qr_y", "qr_z", "qr_qx", "qr_qy", "qr_qz", "ee_x", "ee_y", "ee_z",
];

/// The arm's configuration: rest distance from quadrotor to end effector, and gauge pressure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Configuration {
    /// Rest distance from the quadrotor to the end effector, m.
    pub length_m: f64,
    /// Gauge pressure, kPa.
    pub pressure_kpa: f64,
}

/// Position and attitude of a rigid body in the world frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Position, m, ENU.
    pub position: [f64; 3],
    /// Hamilton quaternion `world_from_body`, `[w, x, y, z]`, unit length, `w ≥ 0`.
    pub attitude: [f64; 4],
}

/// One row of a flight: the poses at `t_s` and the command issued at `t_s` and held until the next row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Time since the flight's start, s.
    pub t_s: f64,
    /// Configuration of the arm at `t_s`.
    pub configuration: Configuration,
    /// Commanded quadrotor position, m.
    pub command: [f64; 3],
    /// Commanded quadrotor velocity (feed-forward), m/s, where the recording has it.
    pub command_velocity: Option<[f64; 3]>,
    /// Quadrotor pose; `None` where motion capture missed it or hygiene rejected it.
    pub quadrotor: Option<Pose>,
    /// End-effector position, m; `None` where motion capture missed it or hygiene rejected it.
    pub end_effector: Option<[f64; 3]>,
}

/// One recording, sampled every [`crate::DT`] seconds.
#[derive(Debug, Clone, PartialEq)]
pub struct Flight {
    /// Where it came from, for messages and reports.
    pub name: String,
    /// Rows in time order.
    pub samples: Vec<Sample>,
}

impl Sample {
    /// The state `x ∈ R⁹` (quadrotor position, attitude vector part, end-effector position), if both poses exist.
    pub fn state(&self) -> Option<[f64; 9]> {
        let (pose, tip) = (self.quadrotor?, self.end_effector?);
        let ([x, y, z], [_, qx, qy, qz]) = (pose.position, pose.attitude);
        Some([x, y, z, qx, qy, qz, tip[0], tip[1], tip[2]])
    }
}
