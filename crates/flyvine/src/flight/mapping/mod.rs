//! Reading anyone's CSV: which columns hold what, in which units and frames, as a TOML file.
//!
//! ```toml
//! rate_hz = 100.0
//! time = { column = "t", unit = "s" }
//! command = { x = "cmd_x", y = "cmd_y", z = "cmd_z", unit = "m" }
//!
//! [quadrotor]
//! position = { x = "quad_x", y = "quad_y", z = "quad_z", unit = "m" }
//! attitude = { w = "quat_w", x = "quat_x", y = "quat_y", z = "quat_z" }
//!
//! [end_effector]
//! position = { x = "payload_x", y = "payload_y", z = "payload_z", unit = "m" }
//!
//! [configuration]
//! length_m = 0.51
//! pressure_kpa = 0.0
//! ```

mod frame;
mod reader;
mod units;

use std::path::Path;

use serde::Deserialize;

pub use self::frame::{Axes, Direction};
pub use self::units::{LengthUnit, PressureUnit, TimeUnit, VelocityUnit};

use super::error::{FlightError, Problem};
use super::plausible;

/// How to read the recordings of one laboratory. Unknown keys are refused.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mapping {
    /// The median rate that recordings should have, Hz, at least 20; checked to 5 %.
    pub rate_hz: f64,
    /// Longest time between two measurements that poses are interpolated across, s. Default 0.1.
    #[serde(default = "default_max_gap_s")]
    pub max_gap_s: f64,
    /// What separates the cells; one ASCII character. Default `,`.
    #[serde(default = "default_delimiter")]
    pub delimiter: char,
    /// The recording's axes, of world and quadrotor alike. Default `z_up`.
    #[serde(default)]
    pub axes: Axes,
    /// Time stamps.
    pub time: TimeColumn,
    /// Commanded quadrotor position. An empty cell means that the last command still holds.
    pub command: Vector<LengthUnit>,
    /// Commanded quadrotor velocity, where there is one.
    pub command_velocity: Option<Vector<VelocityUnit>>,
    /// Quadrotor pose.
    pub quadrotor: Quadrotor,
    /// End-effector (or payload) position.
    pub end_effector: EndEffector,
    /// Which rows are to be trusted, for both bodies. Default: all.
    pub valid: Option<Validity>,
    /// The arm's length and pressure.
    pub configuration: ConfigurationSource,
}

/// The column of time stamps.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimeColumn {
    /// Its name.
    pub column: String,
    /// Its unit.
    pub unit: TimeUnit,
}

/// Three columns of a vector.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vector<U> {
    /// Column of the x component, in the recording's axes.
    pub x: String,
    /// Column of the y component.
    pub y: String,
    /// Column of the z component.
    pub z: String,
    /// Unit of all three.
    pub unit: U,
}

/// Columns of the quadrotor's pose.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Quadrotor {
    /// Its position.
    pub position: Vector<LengthUnit>,
    /// Its attitude; naming each component settles their order.
    pub attitude: Attitude,
    /// Where this body is to be trusted. Default: everywhere.
    pub valid: Option<Validity>,
}

/// Columns of a Hamilton quaternion.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Attitude {
    /// Column of the scalar part.
    pub w: String,
    /// Column of the x component.
    pub x: String,
    /// Column of the y component.
    pub y: String,
    /// Column of the z component.
    pub z: String,
    /// Which way the quaternion turns. Default `world_from_body`.
    #[serde(default)]
    pub direction: Direction,
}

/// Columns of the end effector.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EndEffector {
    /// Its position.
    pub position: Vector<LengthUnit>,
    /// Where this body is to be trusted. Default: everywhere.
    pub valid: Option<Validity>,
}

/// A column that says whether a row is to be trusted.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Validity {
    /// Its name.
    pub column: String,
    /// What it says in a good row; numbers are compared as numbers, text without regard to case.
    pub equals: Cell,
}

/// The content of a cell.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(untagged)]
pub enum Cell {
    /// `true` or `false`.
    Bool(bool),
    /// A number.
    Number(f64),
    /// Anything else.
    Text(String),
}

/// Where the arm's configuration comes from. In the file, each quantity is either a constant
/// (`length_m`, `pressure_kpa`) or a column with a unit (`length`, `pressure`).
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(try_from = "ConfigurationTable")]
pub struct ConfigurationSource {
    /// Rest distance from quadrotor to end effector; constant in m.
    pub length: Source<LengthUnit>,
    /// Gauge pressure; constant in kPa.
    pub pressure: Source<PressureUnit>,
}

/// A constant or a column.
#[derive(Debug, Clone, PartialEq)]
pub enum Source<U> {
    /// The same for the whole recording.
    Constant(f64),
    /// A column; an empty cell means that the last value still holds.
    Column {
        /// Its name.
        column: String,
        /// Its unit.
        unit: U,
    },
}

/// `[configuration]` as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ConfigurationTable {
    length_m: Option<f64>,
    length: Option<ScalarColumn<LengthUnit>>,
    pressure_kpa: Option<f64>,
    pressure: Option<ScalarColumn<PressureUnit>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ScalarColumn<U> {
    column: String,
    unit: U,
}

impl TryFrom<ConfigurationTable> for ConfigurationSource {
    type Error = String;

    fn try_from(table: ConfigurationTable) -> Result<Self, String> {
        let length = Source::new(table.length_m, table.length);
        let pressure = Source::new(table.pressure_kpa, table.pressure);
        Ok(ConfigurationSource {
            length: length
                .ok_or("expected exactly one of `length_m` (a constant) and `length` (a column)")?,
            pressure: pressure
                .ok_or("expected exactly one of `pressure_kpa` (a constant) and `pressure` (a column)")?,
        })
    }
}

impl<U> Source<U> {
    fn new(constant: Option<f64>, column: Option<ScalarColumn<U>>) -> Option<Self> {
        match (constant, column) {
            (Some(value), None) => Some(Source::Constant(value)),
            (None, Some(ScalarColumn { column, unit })) => Some(Source::Column { column, unit }),
            _ => None,
        }
    }
}

fn default_max_gap_s() -> f64 {
    0.1
}

fn default_delimiter() -> char {
    ','
}

impl Mapping {
    /// Reads a mapping from a TOML file.
    ///
    /// # Errors
    /// The file cannot be read; unknown, missing or mistyped keys; values outside their range.
    pub fn read(path: &Path) -> Result<Mapping, FlightError> {
        let shown = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|e| FlightError::in_file(&shown, e.into()))?;
        Mapping::parse(&shown, &text)
    }

    /// Reads a mapping from TOML text; `name` is what error messages call it.
    ///
    /// # Errors
    /// As [`Mapping::read`].
    pub fn parse(name: &str, text: &str) -> Result<Mapping, FlightError> {
        let mapping: Mapping = toml::from_str(text).map_err(|error| {
            FlightError::in_file(name, Problem::Toml(error.to_string().trim_end().to_owned()))
        })?;
        mapping
            .check()
            .map_err(|(key, problem)| FlightError::in_file(name, problem).field(key))?;
        Ok(mapping)
    }

    /// Checks the ranges that types cannot express; the error names the key.
    fn check(&self) -> Result<(), (&'static str, Problem)> {
        let range = |key, found: String, expected| Err((key, Problem::MappingValue { found, expected }));
        if !(20.0..=1e5).contains(&self.rate_hz) {
            return range(
                "rate_hz",
                self.rate_hz.to_string(),
                "20 … 100000 Hz (slower recordings cannot be resampled to 20 Hz)",
            );
        }
        if !(0.0..=0.5).contains(&self.max_gap_s) {
            return range("max_gap_s", self.max_gap_s.to_string(), "0 … 0.5 s");
        }
        if !self.delimiter.is_ascii() || matches!(self.delimiter, '"' | '\r' | '\n') {
            return range(
                "delimiter",
                format!("{:?}", self.delimiter),
                "one ASCII character such as `,`, `;` or a tab",
            );
        }
        if let Source::Constant(length_m) = self.configuration.length {
            plausible::length(length_m).map_err(|problem| ("configuration.length_m", problem))?;
        }
        if let Source::Constant(pressure_kpa) = self.configuration.pressure {
            plausible::pressure(pressure_kpa).map_err(|problem| ("configuration.pressure_kpa", problem))?;
        }
        let mut columns = self.measured_columns();
        columns.sort_unstable();
        match columns.windows(2).find(|pair| pair[0] == pair[1]) {
            Some(pair) => {
                let found = format!("column `{}` twice", pair[0]);
                range("command, quadrotor, end_effector", found, "each column used once")
            }
            None => Ok(()),
        }
    }

    /// The columns of time, command and poses. No column can be two of them.
    fn measured_columns(&self) -> Vec<&str> {
        let vectors = [
            &self.command,
            &self.quadrotor.position,
            &self.end_effector.position,
        ];
        let velocity = self.command_velocity.iter().flat_map(|v| [&v.x, &v.y, &v.z]);
        let Attitude { w, x, y, z, .. } = &self.quadrotor.attitude;
        let all = vectors
            .into_iter()
            .flat_map(|v| [&v.x, &v.y, &v.z])
            .chain(velocity);
        all.chain([w, x, y, z, &self.time.column])
            .map(String::as_str)
            .collect()
    }
}

#[cfg(test)]
mod tests;
