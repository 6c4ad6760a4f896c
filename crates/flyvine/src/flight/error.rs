//! What can be wrong with a recording or with its column mapping.

use std::fmt;

use thiserror::Error;

/// A recording or a column mapping that cannot be used: where, and what is wrong there.
#[derive(Debug, Error)]
#[error("{place}: {problem}")]
pub struct FlightError {
    /// Where it was found.
    pub place: Place,
    /// What was found and what was expected.
    pub problem: Box<Problem>,
}

/// A place in an input file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// The file, as it was named by the caller.
    pub file: String,
    /// Line, counted from 1.
    pub line: Option<u64>,
    /// Column of a table, or key of a mapping.
    pub field: Option<String>,
}

/// What is wrong with an input.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum Problem {
    /// The file cannot be read or written.
    #[error("cannot be read or written: {0}")]
    Io(#[from] std::io::Error),
    /// Not a text file.
    #[error("found bytes that are not UTF-8 text, expected CSV")]
    NotText,
    /// The file has no header.
    #[error("found an empty file, expected a header row and data rows")]
    Empty,
    /// The file has a header only.
    #[error("found a header but no data rows")]
    NoRows,
    /// A column is absent.
    #[error("missing; the file has the columns {}", available.join(", "))]
    MissingColumn {
        /// The file's header.
        available: Vec<String>,
    },
    /// A column that is needed occurs more than once.
    #[error("found {count} columns of this name, expected one")]
    DuplicateColumn {
        /// How often the name occurs.
        count: usize,
    },
    /// A row is cut short, or has surplus cells.
    #[error("found {found} cells, expected {expected} as in the header (is the file truncated?)")]
    CellCount {
        /// Cells in this row.
        found: usize,
        /// Cells in the header.
        expected: usize,
    },
    /// A cell that must not be empty is.
    #[error("found an empty cell, expected a number (only poses may be missing)")]
    EmptyCell,
    /// Some cells of a pose are empty, others are not.
    #[error(
        "found an empty cell in a pose of which other cells are filled; a pose is missing as a whole or not at all"
    )]
    PartialPose,
    /// A cell is no number.
    #[error("found `{found}`, expected a number")]
    NotANumber {
        /// The cell.
        found: String,
    },
    /// A number is NaN or infinite.
    #[error("found {found}, expected a finite number (leave the cells of a missed pose empty)")]
    NotFinite {
        /// The value.
        found: f64,
    },
    /// Time stands still or runs backwards.
    #[error("found {found} s after {previous} s, expected time to increase from row to row")]
    TimeNotIncreasing {
        /// This row's time, s.
        found: f64,
        /// The row before's time, s.
        previous: f64,
    },
    /// A quaternion is far from unit length.
    #[error(
        "found a quaternion of norm {norm:.4}, expected 1 ± 0.01 \
         (are these Euler angles, or is tracking lost here?)"
    )]
    NotUnitQuaternion {
        /// Its norm.
        norm: f64,
    },
    /// A quantity that must be positive is not.
    #[error("found {found}, expected more than 0")]
    NotPositive {
        /// The value.
        found: f64,
    },
    /// A value far outside anything a flight in a room can show: most likely another unit.
    #[error("found {found} {unit}, expected {expected} {unit}: {question}")]
    WrongUnit {
        /// The value.
        found: f64,
        /// The unit the value was taken to be in.
        unit: &'static str,
        /// The plausible range.
        expected: &'static str,
        /// The likely mistake.
        question: &'static str,
    },
    /// A flight is not sampled at 20 Hz.
    #[error(
        "found a median time step of {step_s:.4} s, expected 0.05 s (20 Hz): {}",
        rate_hint(*step_s)
    )]
    NotTwentyHertz {
        /// Median time step, s.
        step_s: f64,
    },
    /// A recording is sampled too slowly to be resampled to 20 Hz.
    #[error(
        "found a median rate of {found_hz:.2} Hz, expected at least 20 Hz: poses between would be invented"
    )]
    RateTooLow {
        /// Median rate, Hz.
        found_hz: f64,
    },
    /// A recording's rate is not what its mapping says.
    #[error(
        "found a median rate of {found_hz:.2} Hz, expected {expected_hz} Hz ± 5 % as the mapping says (is the unit of time right?)"
    )]
    RateMismatch {
        /// Median rate, Hz.
        found_hz: f64,
        /// The mapping's rate, Hz.
        expected_hz: f64,
    },
    /// A recording has no command at all.
    #[error("found no row with a command, expected at least one")]
    NoCommand,
    /// A recording is shorter than two samples at 20 Hz.
    #[error("found {found_s} s of recording from the first command on, expected at least 0.05 s")]
    TooShort {
        /// Its duration, s.
        found_s: f64,
    },
    /// The file is not MCAP, or damaged.
    #[error("not a whole MCAP file: {0}")]
    NotMcap(String),
    /// The MCAP file ends too early.
    #[error(
        "the file is cut off after {rows} whole rows, expected the end of an MCAP file; these rows can be recovered"
    )]
    CutOff {
        /// Rows that are whole.
        rows: usize,
    },
    /// A message is not what its topic promises.
    #[error("not the message expected: {0}")]
    NotAMessage(String),
    /// A row of an MCAP file lacks a message.
    #[error("missing, expected one message per row")]
    NoMessage,
    /// The mapping is not the TOML it should be.
    #[error("{0}")]
    Toml(String),
    /// A value of the mapping is outside its range.
    #[error("found {found}, expected {expected}")]
    MappingValue {
        /// The value.
        found: String,
        /// What is allowed.
        expected: &'static str,
    },
}

impl FlightError {
    /// An error that concerns a whole file.
    pub(super) fn in_file(file: &str, problem: Problem) -> Self {
        let place = Place {
            file: file.to_owned(),
            line: None,
            field: None,
        };
        FlightError {
            place,
            problem: Box::new(problem),
        }
    }

    /// An error in one line.
    pub(super) fn in_line(file: &str, line: u64, problem: Problem) -> Self {
        let mut error = Self::in_file(file, problem);
        error.place.line = Some(line);
        error
    }

    /// The same error, in one field.
    pub(super) fn field(mut self, field: &str) -> Self {
        self.place.field = Some(field.to_owned());
        self
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file)?;
        if let Some(line) = self.line {
            write!(f, ", line {line}")?;
        }
        if let Some(field) = &self.field {
            write!(f, ", `{field}`")?;
        }
        Ok(())
    }
}

/// Guesses why a flight's time step is not 0.05 s.
fn rate_hint(step_s: f64) -> &'static str {
    let is_dt_in = |unit: f64| (step_s * unit / crate::DT - 1.0).abs() < 0.2;
    if is_dt_in(1e-3) {
        "is the time in milliseconds?"
    } else if is_dt_in(1e-6) {
        "is the time in microseconds?"
    } else if is_dt_in(1e-9) {
        "is the time in nanoseconds?"
    } else {
        "read it through a column mapping, which resamples"
    }
}
