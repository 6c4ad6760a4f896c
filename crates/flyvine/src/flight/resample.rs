//! Recordings at any rate, and resampling to the rate of flights.
//!
//! A command acts from when it was sent until the next one. A flight's row holds one command until the next row, so it
//! gets the mean of those that acted meanwhile: a vehicle that was sent a moving set-point at 100 Hz is not told it 25 ms
//! late. (Real flights with a slung load, models fitted without the fast one: on that one their rollouts of 2.5 s are off
//! by half as much as with the newest command at the row's time.) Configurations are held. Poses are interpolated,
//! linearly in position and on the shorter arc in attitude, but only between two measurements that are near in time:
//! never across invalid rows, never over a long gap.

use super::continuity::median_step;
use super::error::{FlightError, Problem};
use super::{Configuration, Flight, Pose, Sample, quaternion};
use crate::DT;

/// What one row of a recording says about a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reading<T> {
    /// A measurement.
    Measured(T),
    /// Nothing: the body was not measured at this time. Its neighbours may still be interpolated.
    Absent,
    /// The recording says that it is not to be trusted here: nothing is interpolated across.
    Invalid,
}

/// One row of a recording, in flyvine's units and frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordingRow {
    /// Time since the first row, s.
    pub t_s: f64,
    /// Configuration of the arm.
    pub configuration: Configuration,
    /// Commanded quadrotor position, m; `None` where no new command was logged.
    pub command: Option<[f64; 3]>,
    /// Commanded quadrotor velocity, m/s, where logged.
    pub command_velocity: Option<[f64; 3]>,
    /// Quadrotor pose.
    pub quadrotor: Reading<Pose>,
    /// End-effector position, m.
    pub end_effector: Reading<[f64; 3]>,
}

/// A recording at any rate.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Where it came from, for messages and reports.
    pub name: String,
    /// Rows; time increases from row to row.
    pub rows: Vec<RecordingRow>,
}

/// Two times closer than this are the same, s.
const SAME_TIME_S: f64 = 1e-9;

/// Resamples a recording to [`DT`]. Row 0 of the flight is the first row that has a command; poses are
/// interpolated where the measurements around are at most `max_gap_s` apart, and missing elsewhere. A pose
/// is also missing where the recording is invalid at any time before the next row, so that no transition
/// contains what the recording disowns.
///
/// # Errors
/// No command; fewer than two samples; a median rate below 20 Hz, which would need invented poses.
pub fn resample(recording: &Recording, max_gap_s: f64) -> Result<Flight, FlightError> {
    let fail = |problem| Err(FlightError::in_file(&recording.name, problem));
    let Some(first) = recording.rows.iter().position(|row| row.command.is_some()) else {
        return fail(Problem::NoCommand);
    };
    let start_s = recording.rows[first].t_s;
    let rows = &recording.rows[first..];
    let duration_s = rows[rows.len() - 1].t_s - start_s;
    if duration_s < DT - SAME_TIME_S {
        return fail(Problem::TooShort { found_s: duration_s });
    }
    if let Some(step_s) = median_step(rows.iter().map(|row| row.t_s))
        && step_s > 1.02 * DT
    {
        return fail(Problem::RateTooLow {
            found_hz: step_s.recip(),
        });
    }

    let knots = |time_s: &RecordingRow| time_s.t_s - start_s;
    let quadrotor = Track::new(
        recording.rows.iter().map(|row| (knots(row), row.quadrotor)),
        max_gap_s,
    );
    let end_effector = Track::new(
        recording.rows.iter().map(|row| (knots(row), row.end_effector)),
        max_gap_s,
    );

    let mut held = Held {
        row: 0,
        command: [0.0; 3],
        command_velocity: None,
    };
    held.update(&rows[0]);
    let num_samples = ((duration_s + SAME_TIME_S) / DT).floor() as usize + 1;
    let samples = (0..num_samples).map(|k| {
        let t_s = k as f64 / DT.recip();
        while held.row + 1 < rows.len() && rows[held.row + 1].t_s - start_s <= t_s + SAME_TIME_S {
            held.row += 1;
            held.update(&rows[held.row]);
        }
        let later = rows[held.row + 1..]
            .iter()
            .map(|row| (row, (row.t_s - start_s - t_s) / DT))
            .take_while(|(_, share)| *share < 1.0 - SAME_TIME_S / DT);
        let command = mean(
            held.command,
            later.clone().map(|(row, share)| (row.command, share)),
        );
        let command_velocity = held
            .command_velocity
            .map(|velocity| mean(velocity, later.map(|(row, share)| (row.command_velocity, share))));
        Sample {
            t_s,
            configuration: rows[held.row].configuration,
            command,
            command_velocity,
            quadrotor: quadrotor.at(t_s, |a, b, s| Pose {
                position: mix(a.position, b.position, s),
                attitude: quaternion::slerp(a.attitude, b.attitude, s),
            }),
            end_effector: end_effector.at(t_s, mix),
        }
    });
    Ok(Flight {
        name: recording.name.clone(),
        samples: samples.collect(),
    })
}

/// The newest command.
struct Held {
    row: usize,
    command: [f64; 3],
    command_velocity: Option<[f64; 3]>,
}

impl Held {
    fn update(&mut self, row: &RecordingRow) {
        if let Some(command) = row.command {
            self.command = command;
        }
        if row.command_velocity.is_some() {
            self.command_velocity = row.command_velocity;
        }
    }
}

/// Mean over a row that begins with `value`; `later` holds what replaces it, where anything does, and at which share of the
/// row's time. Without any that is `value` to the last bit.
fn mean(value: [f64; 3], later: impl Iterator<Item = (Option<[f64; 3]>, f64)>) -> [f64; 3] {
    let mut mean = value;
    let mut held = value;
    for (next, share) in later {
        if let Some(next) = next {
            mean = std::array::from_fn(|i| mean[i] + (1.0 - share) * (next[i] - held[i]));
            held = next;
        }
    }
    mean
}

/// `(1 − s) a + s b`
fn mix(a: [f64; 3], b: [f64; 3], s: f64) -> [f64; 3] {
    std::array::from_fn(|i| (1.0 - s) * a[i] + s * b[i])
}

/// One body's measurements in time order; `None` marks invalid times.
struct Track<T> {
    knots: Vec<(f64, Option<T>)>,
    max_gap_s: f64,
}

impl<T: Copy> Track<T> {
    fn new(readings: impl Iterator<Item = (f64, Reading<T>)>, max_gap_s: f64) -> Self {
        let knots = readings.filter_map(|(t_s, reading)| match reading {
            Reading::Measured(value) => Some((t_s, Some(value))),
            Reading::Invalid => Some((t_s, None)),
            Reading::Absent => None,
        });
        Track {
            knots: knots.collect(),
            max_gap_s,
        }
    }

    /// The value at `t_s`, `interpolate(a, b, s)` between two measurements.
    fn at(&self, t_s: f64, interpolate: impl Fn(T, T, f64) -> T) -> Option<T> {
        let after = self.knots.partition_point(|(t, _)| *t <= t_s + SAME_TIME_S);
        let is_invalid = |(_, value): &(f64, Option<T>)| value.is_none();
        if self.knots[after..]
            .iter()
            .take_while(|(t, _)| *t < t_s + DT - SAME_TIME_S)
            .any(is_invalid)
        {
            return None;
        }
        let (t_a, a) = *self.knots.get(after.checked_sub(1)?)?;
        if (t_s - t_a).abs() <= SAME_TIME_S {
            return a;
        }
        let (t_b, b) = *self.knots.get(after)?;
        let gap_s = t_b - t_a;
        (gap_s <= self.max_gap_s + SAME_TIME_S).then(|| Some(interpolate(a?, b?, (t_s - t_a) / gap_s)))?
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::flight::CLOCK_TOLERANCE_S;

    const CONFIGURATION: Configuration = Configuration {
        length_m: 0.7,
        pressure_kpa: 0.0,
    };

    /// Uniform motion: position `p + v t`, a turn at constant rate about x, end effector `−v t`.
    fn row(t_s: f64, velocity: f64, rate: f64) -> RecordingRow {
        let half = 0.5 * rate * t_s;
        RecordingRow {
            t_s,
            configuration: CONFIGURATION,
            command: Some([t_s, 0.0, 1.5]),
            command_velocity: None,
            quadrotor: Reading::Measured(Pose {
                position: [velocity * t_s, 0.0, 1.5],
                attitude: [half.cos(), half.sin(), 0.0, 0.0],
            }),
            end_effector: Reading::Measured([-velocity * t_s, 1.0, 0.8]),
        }
    }

    fn recording(rows: Vec<RecordingRow>) -> Recording {
        Recording {
            name: "test".into(),
            rows,
        }
    }

    fn uniform(rate_hz: f64, duration_s: f64) -> Vec<RecordingRow> {
        (0..=(duration_s * rate_hz).round() as usize)
            .map(|i| row(i as f64 / rate_hz, 1.0, 1.0))
            .collect()
    }

    proptest! {
        #[test]
        fn uniform_motion_is_reproduced(
            steps in prop::collection::vec(0.001..0.05, 60..200),
            velocity in -8.0..8.0,
            rate in -10.0..10.0,
        ) {
            let mut t_s = 0.0;
            let rows: Vec<RecordingRow> = std::iter::once(0.0)
                .chain(steps)
                .map(|step| {
                    t_s += step;
                    row(t_s, velocity, rate)
                })
                .collect();
            let flight = resample(&recording(rows.clone()), 0.1).unwrap();
            prop_assert_eq!(flight.samples.len(), ((t_s + SAME_TIME_S) / DT) as usize + 1);
            for (k, sample) in flight.samples.iter().enumerate() {
                prop_assert_eq!(sample.t_s, k as f64 / 20.0);
                let Reading::Measured(pose) = row(sample.t_s, velocity, rate).quadrotor else { unreachable!() };
                let found = sample.quadrotor.unwrap();
                prop_assert!((found.position[0] - pose.position[0]).abs() < 1e-8);
                prop_assert!((quaternion::dot(found.attitude, pose.attitude).abs() - 1.0).abs() < 1e-12);
                prop_assert!((sample.end_effector.unwrap()[0] + pose.position[0]).abs() < 1e-8);
                // The command is the mean of those that acted until the next row: here by steps of 0.25 ms.
                let at = |t_s: f64| rows.iter().rfind(|row| row.t_s <= t_s + SAME_TIME_S).unwrap().command.unwrap()[0];
                let mean = (0..50_000).step_by(250).map(|i| at(sample.t_s + (f64::from(i) + 125.0) * 1e-6)).sum::<f64>() / 200.0;
                prop_assert!((sample.command[0] - mean).abs() < 5e-4, "{} {}", sample.command[0], mean);
            }
            prop_assert!(flight.samples.windows(2).all(|w| (w[1].t_s - w[0].t_s - DT).abs() < CLOCK_TOLERANCE_S));
        }

        #[test]
        fn nothing_is_interpolated_across_invalid_rows(invalid in prop::collection::vec(any::<bool>(), 101)) {
            let mut rows = uniform(100.0, 1.0);
            for (row, &invalid) in rows.iter_mut().zip(&invalid) {
                if invalid {
                    row.quadrotor = Reading::Invalid;
                }
            }
            let flight = resample(&recording(rows), 0.1).unwrap();
            for (k, sample) in flight.samples.iter().enumerate() {
                // Five rows per sample: the pose exists if and only if none of them is invalid.
                let disowned = invalid[5 * k..(5 * k + 5).min(101)].contains(&true);
                prop_assert_eq!(sample.quadrotor.is_none(), disowned);
                prop_assert!(sample.end_effector.is_some());
            }
        }
    }

    #[test]
    fn resampling_a_20_hz_recording_changes_nothing() {
        let rows = uniform(20.0, 2.0);
        let flight = resample(&recording(rows.clone()), 0.1).unwrap();
        assert_eq!(flight.samples.len(), rows.len());
        for (sample, row) in flight.samples.iter().zip(&rows) {
            assert_eq!(Reading::Measured(sample.quadrotor.unwrap()), row.quadrotor);
            assert_eq!(Some(sample.command), row.command);
        }
    }

    #[test]
    fn long_gaps_stay_missing_and_short_ones_are_bridged() {
        let mut rows = uniform(100.0, 2.0);
        for row in &mut rows[51..=58] {
            row.end_effector = Reading::Absent; // 0.5 … 0.59 s: a gap of 0.09 s
        }
        for row in &mut rows[101..=115] {
            row.end_effector = Reading::Absent; // 1.0 … 1.16 s: a gap of 0.16 s
        }
        let flight = resample(&recording(rows), 0.1).unwrap();
        let missing: Vec<usize> = (0..flight.samples.len())
            .filter(|&k| flight.samples[k].end_effector.is_none())
            .collect();
        assert_eq!(missing, [21, 22, 23]);
        assert!((flight.samples[11].end_effector.unwrap()[0] + 0.55).abs() < 1e-12);
    }

    #[test]
    fn commands_act_until_the_next_one_and_the_flight_begins_with_the_first() {
        let mut rows = uniform(100.0, 1.0);
        rows.iter_mut().for_each(|row| row.command = None);
        rows[30].command = Some([1.0, 0.0, 1.5]);
        rows[53].command = Some([2.0, 0.0, 1.5]);
        let flight = resample(&recording(rows), 0.1).unwrap();
        assert_eq!(flight.samples.len(), 15);
        assert!((flight.samples[0].quadrotor.unwrap().position[0] - 0.3).abs() < 1e-12);
        let commands: Vec<f64> = flight.samples.iter().map(|sample| sample.command[0]).collect();
        // The second is sent 0.23 s after the first: two fifths of a row are left.
        assert_eq!(commands[..4], [1.0; 4]);
        assert!((commands[4] - 1.4).abs() < 1e-12);
        assert_eq!(commands[5..], [2.0; 10]);
    }

    #[test]
    fn slow_short_and_commandless_recordings_are_refused() {
        let problem = |rows| *resample(&recording(rows), 0.1).unwrap_err().problem;
        assert!(matches!(problem(uniform(10.0, 2.0)), Problem::RateTooLow { .. }));
        assert!(matches!(problem(uniform(100.0, 0.04)), Problem::TooShort { .. }));
        let mut rows = uniform(100.0, 1.0);
        rows.iter_mut().for_each(|row| row.command = None);
        assert!(matches!(problem(rows), Problem::NoCommand));
    }
}
