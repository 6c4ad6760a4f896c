//! Flights as CSV files, one row per 0.05 s.
//!
//! ```text
//! t_s,length_m,pressure_kpa,cmd_x,cmd_y,cmd_z,qr_x,qr_y,qr_z,qr_qw,qr_qx,qr_qy,qr_qz,ee_x,ee_y,ee_z
//! ```
//!
//! The order of the columns is free and further ones are ignored, except `cmd_vx,cmd_vy,cmd_vz` (commanded
//! velocity, m/s), which are read where all three are there. A pose that motion capture missed is empty cells.

use std::fmt::Write;
use std::io::Read;

use super::continuity::check_rate;
use super::control_step::{ControlStep, STEP_COLUMNS, StepRow};
use super::error::{FlightError, Problem};
use super::table::{Column, Row, Table};
use super::{Configuration, Flight, Pose, Sample, plausible, quaternion};

/// The columns of every flight as a table: time (s), configuration (m, kPa), command (m), quadrotor position (m) and attitude
/// quaternion (scalar first), end effector (m).
#[rustfmt::skip]
pub const COLUMNS: [&str; 16] = [
    "t_s", "length_m", "pressure_kpa", "cmd_x", "cmd_y", "cmd_z",
    "qr_x", "qr_y", "qr_z", "qr_qw", "qr_qx", "qr_qy", "qr_qz", "ee_x", "ee_y", "ee_z",
];
/// Columns of the commanded velocity (m/s), where it was recorded.
pub const VELOCITY_COLUMNS: [&str; 3] = ["cmd_vx", "cmd_vy", "cmd_vz"];

const CONFIGURATION: [&str; 2] = columns(1);
/// Those of the command.
pub const COMMAND_COLUMNS: [&str; 3] = columns(3);
const QUADROTOR: [&str; 7] = columns(6);
const END_EFFECTOR: [&str; 3] = columns(13);

/// The columns of `flight`: [`COLUMNS`], and [`VELOCITY_COLUMNS`] if a row has a commanded velocity.
pub fn columns_of(flight: &Flight) -> Vec<&'static str> {
    let mut names = COLUMNS.to_vec();
    if flight
        .samples
        .iter()
        .any(|sample| sample.command_velocity.is_some())
    {
        names.extend(VELOCITY_COLUMNS);
    }
    names
}

/// N of [`COLUMNS`], from number `first` on.
const fn columns<const N: usize>(first: usize) -> [&'static str; N] {
    let mut names = [""; N];
    let mut i = 0;
    while i < N {
        names[i] = COLUMNS[first + i];
        i += 1;
    }
    names
}

/// Reads a flight in the CSV format from any reader (`text.as_bytes()` for a string). `name` is the flight's
/// name and what error messages call the input.
///
/// # Errors
/// As [`read_flight`](super::read_flight).
pub fn parse_csv(name: &str, input: impl Read) -> Result<Flight, FlightError> {
    let table = Table::read(name, input, b',')?;
    let columns = Columns::find(&table)?;
    let samples = table
        .rows()
        .iter()
        .map(|row| columns.sample(&table, row))
        .collect::<Result<Vec<_>, _>>()?;
    for (row, pair) in table.rows()[1..].iter().zip(samples.windows(2)) {
        let (previous, found) = (pair[0].t_s, pair[1].t_s);
        if found <= previous {
            let problem = Problem::TimeNotIncreasing { found, previous };
            return Err(table.error(row, columns.time, problem));
        }
    }
    check_rate(name, &samples)?;
    Ok(Flight {
        name: name.to_owned(),
        samples,
    })
}

/// The flight as CSV text. Rust prints the shortest decimal that reads back as the same number.
pub(super) fn format_csv(file: &str, flight: &Flight, steps: &[ControlStep]) -> Result<String, FlightError> {
    let mut names = columns_of(flight);
    let has_velocity = names.len() > COLUMNS.len();
    if !steps.is_empty() {
        names.extend(STEP_COLUMNS);
    }
    let mut steps_left = steps.iter().peekable();
    let mut text = names.join(",") + "\n";
    for (index, sample) in flight.samples.iter().enumerate() {
        let Configuration {
            length_m,
            pressure_kpa,
        } = sample.configuration;
        let mut cells = vec![Some(sample.t_s), Some(length_m), Some(pressure_kpa)];
        cells.extend(sample.command.map(Some));
        let ([x, y, z], [qw, qx, qy, qz]) = match sample.quadrotor {
            Some(pose) => (pose.position.map(Some), pose.attitude.map(Some)),
            None => ([None; 3], [None; 4]),
        };
        cells.extend([x, y, z, qw, qx, qy, qz]);
        cells.extend(optional(sample.end_effector));
        if has_velocity {
            cells.extend(optional(sample.command_velocity));
        }
        for (column, cell) in cells.into_iter().enumerate() {
            if column > 0 {
                text.push(',');
            }
            let Some(found) = cell else { continue };
            if !found.is_finite() {
                let line = index as u64 + 2;
                return Err(
                    FlightError::in_line(file, line, Problem::NotFinite { found }).field(names[column])
                );
            }
            write!(text, "{found}").expect("writing to a string cannot fail");
        }
        if !steps.is_empty() {
            let cells = match steps_left.next_if(|step| step.row == index) {
                Some(step) => StepRow::new(step).cells(),
                None => Default::default(),
            };
            for cell in cells {
                text.push(',');
                text.push_str(&cell);
            }
        }
        text.push('\n');
    }
    Ok(text)
}

/// The controller's steps in a flight's CSV file, of the rows that have one.
pub(super) fn parse_steps(file: &str, bytes: &[u8]) -> Result<Vec<ControlStep>, FlightError> {
    let not_a_step = |line: u64, reason: String| {
        FlightError::in_line(file, line, Problem::NotAMessage(reason)).field("step_…")
    };
    let mut reader = ::csv::Reader::from_reader(bytes);
    let headers = reader
        .headers()
        .map_err(|error| not_a_step(1, error.to_string()))?
        .clone();
    let Some(column) = headers.iter().position(|name| name == STEP_COLUMNS[0]) else {
        return Ok(Vec::new());
    };
    let mut steps = Vec::new();
    for (row, record) in reader.records().enumerate() {
        let line = row as u64 + 2;
        let record = record.map_err(|error| not_a_step(line, error.to_string()))?;
        if record.get(column).is_some_and(|cell| !cell.is_empty()) {
            let step: StepRow = record
                .deserialize(Some(&headers))
                .map_err(|error| not_a_step(line, error.to_string()))?;
            steps.push(step.step(row).map_err(|reason| not_a_step(line, reason))?);
        }
    }
    Ok(steps)
}

fn optional(vector: Option<[f64; 3]>) -> [Option<f64>; 3] {
    vector.map_or([None; 3], |v| v.map(Some))
}

/// Where the format's columns are in one file.
struct Columns {
    time: Column,
    configuration: [Column; 2],
    command: [Column; 3],
    command_velocity: Option<[Column; 3]>,
    quadrotor: [Column; 7],
    end_effector: [Column; 3],
}

impl Columns {
    fn find(table: &Table) -> Result<Columns, FlightError> {
        let has_velocity = VELOCITY_COLUMNS.iter().all(|name| table.has(name));
        Ok(Columns {
            time: table.column("t_s")?,
            configuration: table.columns(CONFIGURATION)?,
            command: table.columns(COMMAND_COLUMNS)?,
            command_velocity: has_velocity
                .then(|| table.columns(VELOCITY_COLUMNS))
                .transpose()?,
            quadrotor: table.columns(QUADROTOR)?,
            end_effector: table.columns(END_EFFECTOR)?,
        })
    }

    fn sample(&self, table: &Table, row: &Row) -> Result<Sample, FlightError> {
        let [length, pressure] = self.configuration;
        let configuration = Configuration {
            length_m: required(table, row, length, plausible::length)?,
            pressure_kpa: required(table, row, pressure, plausible::pressure)?,
        };
        let mut command = [0.0; 3];
        for (value, column) in command.iter_mut().zip(self.command) {
            *value = required(table, row, column, plausible::position)?;
        }
        let command_velocity = match self.command_velocity {
            Some(columns) => whole(table, row, columns, |_| plausible::velocity)?,
            None => None,
        };
        let quadrotor = whole(table, row, self.quadrotor, |i| {
            if i < 3 { plausible::position } else { finite }
        })?
        .map(|[x, y, z, q @ ..]| {
            let attitude = quaternion::unit(q)
                .map_err(|norm| table.error(row, self.quadrotor[3], Problem::NotUnitQuaternion { norm }))?;
            Ok(Pose {
                position: [x, y, z],
                attitude,
            })
        })
        .transpose()?;
        Ok(Sample {
            t_s: required(table, row, self.time, finite)?,
            configuration,
            command,
            command_velocity,
            quadrotor,
            end_effector: whole(table, row, self.end_effector, |_| plausible::position)?,
        })
    }
}

/// What a value must satisfy.
type Check = fn(f64) -> Result<(), Problem>;

pub(super) fn finite(found: f64) -> Result<(), Problem> {
    if found.is_finite() {
        Ok(())
    } else {
        Err(Problem::NotFinite { found })
    }
}

/// The number in a cell that must not be empty.
fn required(table: &Table, row: &Row, column: Column, check: Check) -> Result<f64, FlightError> {
    let value = table
        .number(row, column)?
        .ok_or_else(|| table.error(row, column, Problem::EmptyCell))?;
    check(value).map_err(|problem| table.error(row, column, problem))?;
    Ok(value)
}

/// The numbers of cells that are all empty (`None`) or all filled.
fn whole<const N: usize>(
    table: &Table,
    row: &Row,
    columns: [Column; N],
    check: impl Fn(usize) -> Check,
) -> Result<Option<[f64; N]>, FlightError> {
    if columns.iter().all(|&column| table.text(row, column).is_empty()) {
        return Ok(None);
    }
    let mut values = [0.0; N];
    for (i, column) in columns.into_iter().enumerate() {
        values[i] = table
            .number(row, column)?
            .ok_or_else(|| table.error(row, column, Problem::PartialPose))?;
        check(i)(values[i]).map_err(|problem| table.error(row, column, problem))?;
    }
    Ok(Some(values))
}

#[cfg(test)]
pub(super) mod tests;
