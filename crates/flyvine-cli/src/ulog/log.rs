//! The topics of a log that make a flight, in ENU and FLU.

use std::path::Path;

use anyhow::{Context, Result};
use flyvine::flight::{Pose, Reading, quaternion};
use flyvine_link::autopilot::{ned_frd_from_enu_flu, ned_from_enu};
use px4_ulog::full_parser::Completeness;
use px4_ulog::stream_parser::{
    DataMessage, Message, ParseableFieldType, SimpleCallbackResult, read_file_with_simple_callback,
};

/// The estimated position.
pub const POSITION: &str = "vehicle_local_position";
/// The estimated attitude.
pub const ATTITUDE: &str = "vehicle_attitude";
/// External vision, as it was received.
pub const VISION: &str = "vehicle_visual_odometry";
/// What the autopilot was asked for.
pub const TRAJECTORY_SETPOINT: &str = "trajectory_setpoint";
/// What its position controller made of it.
pub const POSITION_SETPOINT: &str = "vehicle_local_position_setpoint";
const STATUS: &str = "vehicle_status";
/// `vehicle_status.nav_state` in OFFBOARD.
const OFFBOARD: u8 = 14;

/// Something at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stamped<T> {
    /// Time since the autopilot's boot, s.
    pub t_s: f64,
    /// What.
    pub value: T,
}

/// A set-point; `None` has no position.
pub type Setpoint = Stamped<Option<[f64; 3]>>;

/// The topics of one log, each in the order of its stamps.
#[derive(Debug, Default)]
pub struct Log {
    /// Estimated positions, m; `None` where the estimator disowns it.
    pub positions: Vec<Stamped<Option<[f64; 3]>>>,
    /// Estimated attitudes.
    pub attitudes: Vec<Stamped<[f64; 4]>>,
    /// External vision.
    pub vision: Vec<Stamped<Reading<Pose>>>,
    /// What the autopilot was asked for.
    pub trajectory_setpoints: Vec<Setpoint>,
    /// What its position controller made of it.
    pub position_setpoints: Vec<Setpoint>,
    /// From when on it was in OFFBOARD, or not.
    offboard: Vec<Stamped<bool>>,
    /// How often the logger lost messages.
    pub dropouts: usize,
    /// For how long in all, s.
    pub dropped_s: f64,
    /// Whether the file was cut off.
    pub is_cut: bool,
}

impl Log {
    /// Reads a file, as far as it is whole.
    pub fn read(path: &Path) -> Result<Self> {
        let path = path.to_str().context("expected a path in UTF-8")?;
        let mut log = Self::default();
        let completeness = read_file_with_simple_callback(path, &mut |message| {
            match message {
                // Of several instances the first is the one that flies.
                Message::Data(data) if data.multi_id.value() == 0 => log.take(data),
                Message::DropoutMessage(dropout) => {
                    log.dropouts += 1;
                    log.dropped_s += 1e-3 * f64::from(dropout.duration_ms);
                }
                _ => {}
            }
            SimpleCallbackResult::KeepReading
        })?;
        log.is_cut = completeness != Completeness::Complete;
        log.sort();
        Ok(log)
    }

    /// Whether a base station flew it at a time.
    pub fn is_offboard(&self, t_s: f64) -> bool {
        let after = self.offboard.partition_point(|status| status.t_s <= t_s);
        after > 0 && self.offboard[after - 1].value
    }

    fn take(&mut self, data: &DataMessage) {
        match data.flattened_format.message_name() {
            POSITION => {
                let is_valid = flag(data, "xy_valid") && flag(data, "z_valid");
                let position = position(data).filter(|_| is_valid);
                self.positions.extend(at(sampled_s(data), position));
            }
            ATTITUDE => {
                let attitude = attitude(data).and_then(|attitude| at(sampled_s(data), attitude));
                self.attitudes.extend(attitude);
            }
            VISION => {
                let pose = match (position(data), attitude(data)) {
                    (Some(position), Some(attitude)) => Reading::Measured(Pose { position, attitude }),
                    _ => Reading::Invalid,
                };
                self.vision.extend(at(sampled_s(data), pose));
            }
            TRAJECTORY_SETPOINT => self
                .trajectory_setpoints
                .extend(at(seconds(data, "timestamp"), position(data))),
            POSITION_SETPOINT => self
                .position_setpoints
                .extend(at(seconds(data, "timestamp"), position(data))),
            STATUS => {
                let is_offboard = field::<u8>(data, "nav_state") == Some(OFFBOARD);
                self.offboard.extend(at(seconds(data, "timestamp"), is_offboard));
            }
            _ => {}
        }
    }

    /// Topics are logged by when they came, poses are wanted by when they were; of one instant the first counts.
    fn sort(&mut self) {
        fn in_order<T>(stamped: &mut Vec<Stamped<T>>) {
            stamped.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
            stamped.dedup_by(|later, first| later.t_s == first.t_s);
        }
        in_order(&mut self.positions);
        in_order(&mut self.attitudes);
        in_order(&mut self.vision);
        in_order(&mut self.trajectory_setpoints);
        in_order(&mut self.position_setpoints);
        in_order(&mut self.offboard);
    }
}

fn at<T>(t_s: Option<f64>, value: T) -> Option<Stamped<T>> {
    t_s.map(|t_s| Stamped { t_s, value })
}

/// When a pose was measured, s.
fn sampled_s(data: &DataMessage) -> Option<f64> {
    seconds(data, "timestamp_sample")
        .filter(|t_s| *t_s > 0.0)
        .or_else(|| seconds(data, "timestamp"))
}

/// A field of microseconds, s.
fn seconds(data: &DataMessage, name: &str) -> Option<f64> {
    field::<u64>(data, name).map(|stamp_us| 1e-6 * stamp_us as f64)
}

/// A position, ENU, m: of three fields before PX4 1.14, of one since. `None` where it is no finite number.
fn position(data: &DataMessage) -> Option<[f64; 3]> {
    let names = [["position[0]", "position[1]", "position[2]"], ["x", "y", "z"]];
    let ned = names.iter().find_map(|names| numbers(data, names))?;
    ned.iter()
        .all(|number| number.is_finite())
        .then(|| ned_from_enu(ned))
}

/// An attitude, FLU in ENU.
fn attitude(data: &DataMessage) -> Option<[f64; 4]> {
    let ned = numbers(data, &["q[0]", "q[1]", "q[2]", "q[3]"])?;
    quaternion::unit(ned).ok().map(ned_frd_from_enu_flu)
}

fn numbers<const N: usize>(data: &DataMessage, names: &[&str; N]) -> Option<[f64; N]> {
    let mut numbers = [0.0; N];
    for (number, name) in numbers.iter_mut().zip(names) {
        *number = f64::from(field::<f32>(data, name)?);
    }
    Some(numbers)
}

/// A flag; set where there is none.
fn flag(data: &DataMessage, name: &str) -> bool {
    field::<bool>(data, name).unwrap_or(true)
}

fn field<T: ParseableFieldType>(data: &DataMessage, name: &str) -> Option<T> {
    let parser = data.flattened_format.get_field_parser::<T>(name).ok()?;
    Some(parser.parse(data.data))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whatever a log has become, reading it ends.
    #[test]
    fn damaged_logs_are_read_or_refused() {
        let whole = include_bytes!("../../tests/data/px4_offboard.ulg");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("damaged.ulg");
        let mut refused = 0;
        for k in 0..600_usize {
            let mut bytes = whole.to_vec();
            // The formats are in the first 800 bytes; the rest is samples the one as the other.
            let place = if k < 400 { 2 * k } else { k * 7919 % bytes.len() };
            bytes[place] = bytes[place].wrapping_add((1 + k * 31 % 255) as u8);
            if k % 3 == 0 {
                bytes.drain(place..place + 5);
            }
            std::fs::write(&path, &bytes).unwrap();
            match Log::read(&path) {
                Ok(log) => assert!(log.positions.len() <= 301 && log.attitudes.len() <= 601),
                Err(_) => refused += 1,
            }
        }
        assert!((10..500).contains(&refused), "{refused} refused");
    }
}
