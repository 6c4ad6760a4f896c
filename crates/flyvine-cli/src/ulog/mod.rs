//! Flights out of PX4's logs (ULog), with what PX4 does not know of in a file beside them.
//!
//! Topics and fields are those of PX4's uORB messages, format versions before and since 1.14; NED and FRD become ENU and FLU
//! here. [`log`] takes the topics out of a file, [`tip`] puts another recording on its clock.

mod log;
mod tip;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use flyvine::DT;
use flyvine::flight::{Configuration, Flight, Pose, Reading, Recording, RecordingRow, quaternion, resample};
use serde::Deserialize;

use self::log::{Log, Setpoint, Stamped};

/// How a log is a flight; a TOML file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LogOptions {
    /// Length of the arm, m.
    length_m: f64,
    /// Pressure in it, kPa.
    pressure_kpa: f64,
    /// What the quadrotor's pose is.
    #[serde(default)]
    quadrotor: PoseSource,
    /// What the command is.
    #[serde(default)]
    command: CommandSource,
    /// While what flew it.
    #[serde(default)]
    mode: Mode,
    /// Longest time between two poses that is interpolated, s.
    #[serde(default = "max_gap_s")]
    max_gap_s: f64,
    /// Longest time for which a set-point is held, s; beyond it the log has lost some.
    #[serde(default = "max_command_gap_s")]
    max_command_gap_s: f64,
    /// Where the end effector was; left out, its columns are empty.
    end_effector: Option<TipOptions>,
}

/// Where the end effector was.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TipOptions {
    /// A table with the columns `t_s,ee_x,ee_y,ee_z`, and `qr_x,qr_y,qr_z` to tell its clock by; ENU, m. A relative path is
    /// relative to the options' file.
    file: PathBuf,
    /// Time since the autopilot's boot at the table's time 0, s; left out, the quadrotor's track in both tells.
    clock_offset_s: Option<f64>,
}

/// What the quadrotor's pose is.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum PoseSource {
    /// The autopilot's estimate: `vehicle_local_position` with `vehicle_attitude`.
    #[default]
    Estimate,
    /// Motion capture as the autopilot received it: `vehicle_visual_odometry`.
    Vision,
}

/// What the command is.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
enum CommandSource {
    /// What the autopilot was asked for.
    #[default]
    TrajectorySetpoint,
    /// What its position controller made of it.
    VehicleLocalPositionSetpoint,
}

/// While what flew it the set-points count.
#[derive(Debug, Clone, Copy, Default, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Mode {
    /// A base station.
    #[default]
    Offboard,
    /// Whatever.
    Any,
}

fn max_gap_s() -> f64 {
    0.1
}

fn max_command_gap_s() -> f64 {
    0.06
}

/// Two times closer than this are the same to PX4, which counts microseconds, s.
const SAME_TIME_S: f64 = 1e-6;

/// A log as a flight.
pub struct LoggedFlight {
    /// The flight, at 20 Hz.
    pub flight: Flight,
    /// What its reader should know.
    pub notes: Vec<String>,
    /// Whether the file was cut off.
    pub is_cut: bool,
}

/// Reads a log as a flight at 20 Hz: its longest stretch of position set-points.
pub fn read_ulog(path: &Path, options: &Path) -> Result<LoggedFlight> {
    let shown = options.display().to_string();
    let text = std::fs::read_to_string(options).with_context(|| shown.clone())?;
    let options: LogOptions = options_of(&text, options.parent()).with_context(|| shown)?;
    let shown = path.display().to_string();
    let log = Log::read(path).with_context(|| shown.clone())?;
    let commands = stretch(&log, &options).with_context(|| shown.clone())?;
    let (begin_s, end_s) = (commands[0].t_s, commands[commands.len() - 1].t_s);
    let (rows, notes) = rows_of(&log, &options, &commands).with_context(|| shown.clone())?;
    let recording = Recording { name: shown, rows };
    let mut flight = resample(&recording, options.max_gap_s)?;
    // The poses go on for a while, so that the last one can be interpolated.
    flight
        .samples
        .retain(|sample| begin_s + sample.t_s < end_s + SAME_TIME_S);
    Ok(LoggedFlight {
        flight,
        notes,
        is_cut: log.is_cut,
    })
}

fn options_of(text: &str, folder: Option<&Path>) -> Result<LogOptions> {
    let mut options: LogOptions = toml::from_str(text)?;
    let above_zero = [options.length_m, options.max_gap_s, options.max_command_gap_s];
    ensure!(
        above_zero
            .iter()
            .all(|number| number.is_finite() && *number > 0.0)
            && options.pressure_kpa.is_finite(),
        "expected a length and gaps above 0, and a finite pressure"
    );
    if let Some(tip) = &mut options.end_effector {
        ensure!(
            tip.clock_offset_s.is_none_or(f64::is_finite),
            "clock_offset_s: expected a finite number"
        );
        if let Some(folder) = folder {
            tip.file = folder.join(&tip.file);
        }
    }
    Ok(options)
}

/// What was logged while `commands` were, by time, and what to know of it.
fn rows_of(
    log: &Log,
    options: &LogOptions,
    commands: &[Stamped<[f64; 3]>],
) -> Result<(Vec<RecordingRow>, Vec<String>)> {
    let (begin_s, end_s) = (commands[0].t_s, commands[commands.len() - 1].t_s);
    let is_within = |t_s: f64| t_s >= begin_s - options.max_gap_s && t_s <= end_s + options.max_gap_s;
    let poses: Vec<Stamped<Reading<Pose>>> = quadrotor(log, options)?
        .into_iter()
        .filter(|pose| is_within(pose.t_s))
        .collect();
    ensure!(!poses.is_empty(), "no poses during the set-points");

    let mut notes = Vec::new();
    if log.dropouts > 0 {
        notes.push(format!(
            "messages that the logger dropped: {} times, for {:.2} s in all",
            log.dropouts, log.dropped_s
        ));
    }
    let mut rows = Rows::new(options);
    // How sparse poses may be is for max_gap_s to say: there is a row wherever the flight will have one.
    for k in 0..=((end_s - begin_s) / DT) as usize {
        rows.at(begin_s + k as f64 * DT);
    }
    for pose in &poses {
        rows.at(pose.t_s).quadrotor = pose.value;
    }
    for command in commands {
        rows.at(command.t_s).command = Some(command.value);
    }
    match &options.end_effector {
        Some(tip_options) => {
            let shown = tip_options.file.display().to_string();
            let tip = tip::read(tip_options, &poses, [begin_s, end_s]).with_context(|| shown.clone())?;
            notes.extend(tip.agreement.map(|agreement| format!("{shown}: {agreement}")));
            for position in tip.positions.iter().filter(|position| is_within(position.t_s)) {
                rows.at(position.t_s).end_effector = position.value;
            }
        }
        None => notes.push("the end effector's columns are empty: PX4 knows nothing of it".to_owned()),
    }
    Ok((rows.rows.into_values().collect(), notes))
}

/// The longest stretch of position set-points in the wanted mode.
fn stretch(log: &Log, options: &LogOptions) -> Result<Vec<Stamped<[f64; 3]>>> {
    let (topic, setpoints) = match options.command {
        CommandSource::TrajectorySetpoint => (log::TRAJECTORY_SETPOINT, &log.trajectory_setpoints),
        CommandSource::VehicleLocalPositionSetpoint => (log::POSITION_SETPOINT, &log.position_setpoints),
    };
    ensure!(!setpoints.is_empty(), "no messages of topic {topic}");
    let counts = |setpoint: &&Setpoint| options.mode == Mode::Any || log.is_offboard(setpoint.t_s);
    let in_mode: Vec<&Setpoint> = setpoints.iter().filter(counts).collect();
    ensure!(
        !in_mode.is_empty(),
        "none of {} set-points ({topic}) was logged in OFFBOARD (vehicle_status.nav_state 14); mode = \"any\" takes those of \
         the autopilot's own modes",
        setpoints.len()
    );
    // One without a position, or a time without any, ends a stretch.
    let mut stretches: Vec<Vec<Stamped<[f64; 3]>>> = vec![Vec::new()];
    let mut gap_s: f64 = 0.0;
    for setpoint in in_mode {
        let current = stretches.last_mut().expect("there is one");
        if let Some(before) = current.last() {
            let step_s = setpoint.t_s - before.t_s;
            if step_s > options.max_command_gap_s || setpoint.value.is_none() {
                gap_s = gap_s.max(step_s);
                stretches.push(Vec::new());
            }
        }
        if let Some(position) = setpoint.value {
            let current = stretches.last_mut().expect("there is one");
            current.push(Stamped {
                t_s: setpoint.t_s,
                value: position,
            });
        }
    }
    let duration_s = |stretch: &Vec<Stamped<[f64; 3]>>| match (stretch.first(), stretch.last()) {
        (Some(first), Some(last)) => last.t_s - first.t_s,
        _ => 0.0,
    };
    let longest = stretches
        .into_iter()
        .max_by(|a, b| duration_s(a).total_cmp(&duration_s(b)))
        .expect("there is one");
    if longest.len() < 2 {
        bail!(
            "no stretch of position set-points ({topic}): up to {gap_s:.3} s between two, expected at most {} s; have the \
             autopilot log them all (a line `{topic} 0` in etc/logging/logger_topics.txt on its SD card), or set \
             max_command_gap_s if they did not change in between",
            options.max_command_gap_s
        );
    }
    Ok(longest)
}

/// The quadrotor's poses, in order.
fn quadrotor(log: &Log, options: &LogOptions) -> Result<Vec<Stamped<Reading<Pose>>>> {
    if let PoseSource::Vision = options.quadrotor {
        ensure!(!log.vision.is_empty(), "no messages of topic {}", log::VISION);
        return Ok(log.vision.clone());
    }
    ensure!(
        !log.positions.is_empty(),
        "no messages of topic {}",
        log::POSITION
    );
    ensure!(
        !log.attitudes.is_empty(),
        "no messages of topic {}",
        log::ATTITUDE
    );
    Ok(log
        .positions
        .iter()
        .map(|position| Stamped {
            t_s: position.t_s,
            value: match (position.value, attitude_at(log, position.t_s, options.max_gap_s)) {
                (Some(position), Some(attitude)) => Reading::Measured(Pose { position, attitude }),
                (None, _) => Reading::Invalid,
                (_, None) => Reading::Absent,
            },
        })
        .collect())
}

/// The attitude at a time, between two that are near enough.
fn attitude_at(log: &Log, t_s: f64, max_gap_s: f64) -> Option<[f64; 4]> {
    let after = log.attitudes.partition_point(|attitude| attitude.t_s < t_s);
    let next = log.attitudes.get(after)?;
    if next.t_s == t_s {
        return Some(next.value);
    }
    let before = log.attitudes.get(after.checked_sub(1)?)?;
    let step_s = next.t_s - before.t_s;
    (step_s <= max_gap_s).then(|| quaternion::slerp(before.value, next.value, (t_s - before.t_s) / step_s))
}

/// The rows of a recording by time, to the microsecond, which is what PX4 counts.
struct Rows {
    rows: BTreeMap<i64, RecordingRow>,
    empty: RecordingRow,
}

impl Rows {
    fn new(options: &LogOptions) -> Self {
        Self {
            rows: BTreeMap::new(),
            empty: RecordingRow {
                t_s: 0.0,
                configuration: Configuration {
                    length_m: options.length_m,
                    pressure_kpa: options.pressure_kpa,
                },
                command: None,
                command_velocity: None,
                quadrotor: Reading::Absent,
                end_effector: Reading::Absent,
            },
        }
    }

    /// The row at a time.
    fn at(&mut self, t_s: f64) -> &mut RecordingRow {
        let key = (1e6 * t_s).round() as i64;
        self.rows.entry(key).or_insert(RecordingRow {
            t_s: 1e-6 * key as f64,
            ..self.empty
        })
    }
}
