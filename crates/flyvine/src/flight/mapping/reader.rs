//! Applying a mapping to a file.

use std::io::Read;
use std::path::Path;

use super::units::{LengthUnit, PressureUnit, Unit};
use super::{Cell, Mapping, Source, Validity, Vector};
use crate::flight::continuity::median_step;
use crate::flight::csv::finite;
use crate::flight::error::{FlightError, Problem};
use crate::flight::files::flight_name;
use crate::flight::table::{Column, Row, Table};
use crate::flight::{
    Configuration, Flight, Pose, Reading, Recording, RecordingRow, plausible, quaternion, resample,
};

/// Largest share by which a recording's median rate may differ from the mapping's.
const RATE_TOLERANCE: f64 = 0.05;

impl Mapping {
    /// Reads a recording from a CSV file and resamples it to a flight at [`crate::DT`], named after the file.
    ///
    /// # Errors
    /// As [`Mapping::parse_recording`] and [`resample`].
    pub fn read_flight(&self, path: &Path) -> Result<Flight, FlightError> {
        let shown = path.display().to_string();
        let file = std::fs::File::open(path).map_err(|e| FlightError::in_file(&shown, e.into()))?;
        let mut flight = resample(&self.parse_recording(&shown, file)?, self.max_gap_s)?;
        flight.name = flight_name(path);
        Ok(flight)
    }

    /// Reads a recording at its own rate, in flyvine's units and axes. Empty cells and NaN in a pose mean
    /// that it was not measured; rows that the validity columns disown are not looked at further. `name` is
    /// what error messages call the input.
    ///
    /// # Errors
    /// Columns that are absent or there twice; cells that are no numbers; time that does not increase; a
    /// quaternion far from unit length; values whose unit looks wrong; a rate other than the mapping's.
    pub fn parse_recording(&self, name: &str, input: impl Read) -> Result<Recording, FlightError> {
        // The mapping's check allows ASCII only.
        let table = Table::read(name, input, self.delimiter as u8)?;
        let mut reader = Reader::new(self, &table)?;
        let rows = table
            .rows()
            .iter()
            .map(|row| reader.row(row))
            .collect::<Result<Vec<_>, _>>()?;
        if let Some(step_s) = median_step(rows.iter().map(|row| row.t_s)) {
            let found_hz = step_s.recip();
            if (found_hz / self.rate_hz - 1.0).abs() > RATE_TOLERANCE {
                let problem = Problem::RateMismatch {
                    found_hz,
                    expected_hz: self.rate_hz,
                };
                return Err(FlightError::in_file(name, problem).field(&self.time.column));
            }
        }
        Ok(Recording {
            name: name.to_owned(),
            rows,
        })
    }
}

/// The mapping's columns in one table, and what its rows hold on to.
struct Reader<'a> {
    mapping: &'a Mapping,
    table: &'a Table,
    time: Column,
    command: [Column; 3],
    command_velocity: Option<[Column; 3]>,
    quadrotor: [Column; 7],
    end_effector: [Column; 3],
    valid: Check<'a>,
    quadrotor_valid: Check<'a>,
    end_effector_valid: Check<'a>,
    length: Held<LengthUnit>,
    pressure: Held<PressureUnit>,
    /// First time stamp, in the recording's unit.
    start: Option<f64>,
    previous_s: f64,
}

/// A validity column and what it must say; `None` accepts every row.
type Check<'a> = Option<(Column, &'a Cell)>;

/// A constant, or a column whose last value holds where it is empty.
enum Held<U> {
    Constant(f64),
    Column {
        column: Column,
        unit: U,
        last: Option<f64>,
    },
}

impl<'a> Reader<'a> {
    fn new(mapping: &'a Mapping, table: &'a Table) -> Result<Self, FlightError> {
        let vector = |x: &str, y: &str, z: &str| table.columns([x, y, z]);
        let check = |valid: &'a Option<Validity>| -> Result<Check<'a>, FlightError> {
            valid
                .as_ref()
                .map(|v| Ok((table.column(&v.column)?, &v.equals)))
                .transpose()
        };
        let (position, attitude) = (&mapping.quadrotor.position, &mapping.quadrotor.attitude);
        let tip = &mapping.end_effector.position;
        Ok(Reader {
            mapping,
            table,
            time: table.column(&mapping.time.column)?,
            command: vector(&mapping.command.x, &mapping.command.y, &mapping.command.z)?,
            command_velocity: mapping
                .command_velocity
                .as_ref()
                .map(|v| vector(&v.x, &v.y, &v.z))
                .transpose()?,
            quadrotor: table.columns([
                &position.x,
                &position.y,
                &position.z,
                &attitude.w,
                &attitude.x,
                &attitude.y,
                &attitude.z,
            ])?,
            end_effector: vector(&tip.x, &tip.y, &tip.z)?,
            valid: check(&mapping.valid)?,
            quadrotor_valid: check(&mapping.quadrotor.valid)?,
            end_effector_valid: check(&mapping.end_effector.valid)?,
            length: Held::new(&mapping.configuration.length, table)?,
            pressure: Held::new(&mapping.configuration.pressure, table)?,
            start: None,
            previous_s: f64::NEG_INFINITY,
        })
    }

    fn row(&mut self, row: &Row) -> Result<RecordingRow, FlightError> {
        let t_s = self.time(row)?;
        let configuration = Configuration {
            length_m: self.length.value(self.table, row, plausible::length)?,
            pressure_kpa: self.pressure.value(self.table, row, plausible::pressure)?,
        };
        let valid = self.accepts(row, self.valid);
        let (mapping, axes) = (self.mapping, self.mapping.axes);
        let command = self.vector(row, self.command, &mapping.command, plausible::position)?;
        let command_velocity = match (self.command_velocity, &mapping.command_velocity) {
            (Some(columns), Some(vector)) => self.vector(row, columns, vector, plausible::velocity)?,
            _ => None,
        };
        let quadrotor = if valid && self.accepts(row, self.quadrotor_valid) {
            self.quadrotor(row)?
        } else {
            Reading::Invalid
        };
        let end_effector = if valid && self.accepts(row, self.end_effector_valid) {
            let vector = &mapping.end_effector.position;
            match self.vector(row, self.end_effector, vector, plausible::position)? {
                Some(position) => Reading::Measured(axes.vector(position)),
                None => Reading::Absent,
            }
        } else {
            Reading::Invalid
        };
        Ok(RecordingRow {
            t_s,
            configuration,
            command: command.map(|u| axes.vector(u)),
            command_velocity: command_velocity.map(|v| axes.vector(v)),
            quadrotor,
            end_effector,
        })
    }

    /// Time since the first row, s.
    fn time(&mut self, row: &Row) -> Result<f64, FlightError> {
        let error = |problem| self.table.error(row, self.time, problem);
        let stamp = self
            .table
            .number(row, self.time)?
            .ok_or_else(|| error(Problem::EmptyCell))?;
        finite(stamp).map_err(error)?;
        // The difference is taken first: time stamps since 1970 leave few digits for the rest.
        let start = *self.start.get_or_insert(stamp);
        let t_s = (stamp - start) * self.mapping.time.unit.factor();
        if t_s <= self.previous_s {
            let problem = Problem::TimeNotIncreasing {
                found: t_s,
                previous: self.previous_s,
            };
            return Err(self.table.error(row, self.time, problem));
        }
        self.previous_s = t_s;
        Ok(t_s)
    }

    fn quadrotor(&self, row: &Row) -> Result<Reading<Pose>, FlightError> {
        let [x, y, z, qw, qx, qy, qz] = self.quadrotor;
        let vector = &self.mapping.quadrotor.position;
        let position = self.vector(row, [x, y, z], vector, plausible::position)?;
        let attitude = self.numbers(row, [qw, qx, qy, qz])?;
        let (Some(position), Some(attitude)) = (position, attitude) else {
            return match (position, attitude) {
                (None, None) => Ok(Reading::Absent),
                (None, _) => Err(self.table.error(row, x, Problem::PartialPose)),
                _ => Err(self.table.error(row, qw, Problem::PartialPose)),
            };
        };
        let attitude = quaternion::unit(attitude)
            .map_err(|norm| self.table.error(row, qw, Problem::NotUnitQuaternion { norm }))?;
        let attitude = self
            .mapping
            .quadrotor
            .attitude
            .direction
            .world_from_body(attitude);
        let axes = self.mapping.axes;
        Ok(Reading::Measured(Pose {
            position: axes.vector(position),
            attitude: axes.attitude(attitude),
        }))
    }

    /// A vector in the recording's axes, in SI units; `None` if it was not measured.
    fn vector<U: Unit>(
        &self,
        row: &Row,
        columns: [Column; 3],
        vector: &Vector<U>,
        check: fn(f64) -> Result<(), Problem>,
    ) -> Result<Option<[f64; 3]>, FlightError> {
        let Some(mut values) = self.numbers(row, columns)? else {
            return Ok(None);
        };
        for (value, column) in values.iter_mut().zip(columns) {
            *value *= vector.unit.factor();
            check(*value).map_err(|problem| self.table.error(row, column, problem))?;
        }
        Ok(Some(values))
    }

    /// The numbers of several cells; `None` if all are empty or NaN.
    fn numbers<const N: usize>(
        &self,
        row: &Row,
        columns: [Column; N],
    ) -> Result<Option<[f64; N]>, FlightError> {
        let mut values = [0.0; N];
        let mut empty = None;
        for (value, column) in values.iter_mut().zip(columns) {
            match self.table.number(row, column)?.filter(|number| !number.is_nan()) {
                Some(number) => {
                    finite(number).map_err(|problem| self.table.error(row, column, problem))?;
                    *value = number;
                }
                None => {
                    *value = f64::NAN;
                    empty = Some(column);
                }
            }
        }
        match empty {
            None => Ok(Some(values)),
            Some(_) if values.iter().all(|value| value.is_nan()) => Ok(None),
            Some(column) => Err(self.table.error(row, column, Problem::PartialPose)),
        }
    }

    /// Whether the row's validity column says what it must.
    fn accepts(&self, row: &Row, check: Check) -> bool {
        check.is_none_or(|(column, equals)| equals.matches(self.table.text(row, column)))
    }
}

impl Cell {
    fn matches(&self, text: &str) -> bool {
        match self {
            Cell::Bool(expected) => text.eq_ignore_ascii_case(&expected.to_string()),
            Cell::Number(expected) => text.parse() == Ok(*expected),
            Cell::Text(expected) => text.eq_ignore_ascii_case(expected),
        }
    }
}

impl<U: Unit> Held<U> {
    fn new(source: &Source<U>, table: &Table) -> Result<Self, FlightError> {
        Ok(match source {
            Source::Constant(value) => Held::Constant(*value),
            Source::Column { column, unit } => Held::Column {
                column: table.column(column)?,
                unit: *unit,
                last: None,
            },
        })
    }

    /// The quantity's value in this row, in flyvine's units.
    fn value(
        &mut self,
        table: &Table,
        row: &Row,
        check: fn(f64) -> Result<(), Problem>,
    ) -> Result<f64, FlightError> {
        match self {
            Held::Constant(value) => Ok(*value),
            Held::Column { column, unit, last } => {
                let newest = table.number(row, *column)?.filter(|number| !number.is_nan());
                let value = newest.map(|number| number * unit.factor()).or(*last);
                let value = value.ok_or_else(|| table.error(row, *column, Problem::EmptyCell))?;
                check(value).map_err(|problem| table.error(row, *column, problem))?;
                *last = Some(value);
                Ok(value)
            }
        }
    }
}
